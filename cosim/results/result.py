"""What `cosim.run` returns: the summary and arrays over time.

A run as a short table for notebooks.

What each array of a run holds, and the usual curves of a run as a picture, which needs matplotlib.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from html import escape
from itertools import product
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cosim._version import __version__
from cosim.base.frames import Array, IntArray
from cosim.base.names import TERMS, texts_of
from cosim.config.toml.keys import unit_of, unit_text
from cosim.devices.device_report import SensorNames
from cosim.errors import InputError
from cosim.telemetry.figures import branching_lines, overlap_lines
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.summary import Status, SummaryBuilder, phase_cells, reason_of
from cosim.telemetry.tick_batch import RigidColumns, TickBatch

_ENTRY: Final = re.compile(r"\(([^)]*)\)(?: \[([^\]]*)\])?,? ?(.*)")
_XYZ: Final = ("x", "y", "z")
_WXYZ: Final = ("w", "x", "y", "z")


@final
@dataclass(frozen=True)
class ArrayText:
    """What an array holds.

    Args:
        name: of the array.
        axes: what it runs over: "rows" or "frames", then names of what has an entry each, or a number.
        unit: such as "m"; "1" without one.
        meaning: in words.
    """

    name: str
    axes: tuple[str, ...]
    unit: str
    meaning: str

    def components(self, stage: RunInfo, shape: tuple[int, ...]) -> list[str]:
        """Return a name for every number of a row, such as "tool.x"; none for an array of single numbers.

        Args:
            stage: of the run.
            shape: of a row.
        """
        if not shape:
            return []
        pairs = zip(self.axes[1:], shape, strict=True)
        return [".".join(names) for names in product(*(_names(axis, size, stage) for axis, size in pairs))]


@cache
def array_texts(kind: type) -> dict[str, ArrayText]:
    """Return what the arrays of a dataclass hold, by name: its fields that are documented with their axes.

    Args:
        kind: its arguments read as `name: (rows, 3) [unit], meaning`.
    """
    found = ((name, _ENTRY.fullmatch(entry)) for name, entry in texts_of(kind)[1].items())
    return {name: _text(name, *entry.groups()) for name, entry in found if entry is not None}


def unit_by_name(name: str) -> str:
    """Return the unit that a name ends in, as people write it; "1" for a name without one."""
    return unit_text(unit_of(name)) or "1"


def _text(name: str, axes: str, unit: str | None, meaning: str) -> ArrayText:
    listed = tuple(axis.strip() for axis in axes.split(",") if axis.strip())
    return ArrayText(name, listed, unit or unit_by_name(name), meaning)


def _names(axis: str, size: int, stage: RunInfo) -> Iterator[str]:
    """Yield the names of the entries along an axis; their places where they have none."""
    readings = [".".join(filter(None, (each.name, value))) for each in stage.sensors for value in each.values]
    known = {
        "readings": readings,
        "joints": stage.joint_names, "bodies": stage.body_names, "chambers": stage.chamber_names,
        "cables": stage.cable_names, "3": _XYZ, "4": _WXYZ,
        "energies": [term.removesuffix("_J") for term in TERMS],
    }.get(axis, ())  # fmt: skip
    yield from known if len(known) == size else map(str, range(size))


USUAL: Final = (
    "tip_position", "sag_m", "bending_angle_rad", "chamber_pressure_Pa", "cable_tension_N", "flange_force",
    "contact_force_N", "joint_position",
)  # fmt: skip
_PREFIXES: Final = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa"), "rad": (180.0 / np.pi, "degrees")}
_ACROSS: Final = 2
_SHOWN_CELLS: Final = (0, 1, 2, 4, 5)  # of a phase's row of the summary


@final
@dataclass(frozen=True)
class Panel:
    """The curves of one array.

    Args:
        title: of the array.
        unit: in which they are drawn.
        values: (rows, curves).
        labels: of the curves; none for a single one.
    """

    title: str
    unit: str
    values: Array
    labels: Sequence[str]


def panels(result: RunResult, names: Sequence[str] = ()) -> Iterator[Panel]:
    """Yield what is drawn of a run: the named arrays, or the usual ones that are not 0 throughout.

    Args:
        result: of a run.
        names: of arrays with a row per tick, or of sensors.

    Raises:
        InputError: there is no such array.
    """
    texts = {name: text for name, text in array_texts(RunResult).items() if text.axes[0] == "rows"}
    sensors = {each.name: each for each in result.stage.sensors}
    for name in names or (*USUAL, *sensors):
        if name in sensors:
            yield _sensor_panel(result, sensors[name])
            continue
        if name not in texts:
            there = ", ".join([*texts, *sensors])
            raise InputError(f"there is no array '{name}' over the ticks; there are {there}")
        array = getattr(result, name)
        if not array.size or not (names or np.nan_to_num(array).any()):
            continue
        scale, unit = _PREFIXES.get(texts[name].unit, (1.0, texts[name].unit))
        labels = texts[name].components(result.stage, array.shape[1:])
        title = name.removesuffix(f"_{texts[name].unit}").replace("_", " ")
        yield Panel(title, unit, scale * array.reshape(len(array), -1), labels if len(labels) > 1 else [])


def _sensor_panel(result: RunResult, sensor: SensorNames) -> Panel:
    scale, unit = _PREFIXES.get(sensor.unit, (1.0, sensor.unit))
    labels = [" ".join(filter(None, pair)) for pair in product(("sensor", "truth"), sensor.values)]
    return Panel(sensor.name, unit, scale * np.hstack(result.sensor(sensor.name)), labels)


def drawn(result: RunResult, names: Sequence[str] = ()) -> Any:
    """Return a matplotlib figure of a run's curves over time, phases marked.

    Args:
        result: of a run.
        names: of arrays; none: the usual ones.

    Raises:
        InputError: there is no such array, nothing to draw, or no matplotlib.
    """
    figure_class = figure_kind()
    shown = list(panels(result, names))
    if not shown:
        raise InputError(f"{result.stage.scenario}: the run has no ticks to draw")
    down = -(-len(shown) // _ACROSS)
    figure = figure_class(figsize=(11.0, 2.4 * down + 0.6), layout="constrained")
    axes = figure.subplots(down, min(len(shown), _ACROSS), sharex=True, squeeze=False).ravel()
    changes = result.time_s[np.flatnonzero(np.diff(result.phase))]
    for place, panel in zip(axes, shown, strict=False):
        place.plot(result.time_s, panel.values, lw=1.0, label=panel.labels or None)
        place.set_ylabel(panel.title if panel.unit == "1" else f"{panel.title} [{panel.unit}]")
        place.grid(alpha=0.3)
        if panel.labels:
            place.legend(fontsize=7)
        for time_s in changes:
            place.axvline(time_s, color="0.7", lw=0.8)
    for place in axes[len(shown) :]:
        place.remove()
    for place in axes[max(len(shown) - _ACROSS, 0) : len(shown)]:
        place.set_xlabel("time [s]")
        place.tick_params(labelbottom=True)
    figure.suptitle(f"{result.stage.title} ({result.status})", fontsize=10)
    return figure


def figure_kind() -> Any:
    """Return matplotlib's class of figures, which need no screen.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("plots need matplotlib: pip install 'cosim[plot]'") from None
    return Figure


def as_html(text: str, summary: Mapping[str, Any]) -> str:
    """Return a run's outcome and its phases as HTML.

    Args:
        text: lines on the run.
        summary: of the run.
    """
    lines = [*text.split("\n"), *([f"reason: {summary['reason']}"] if summary.get("reason") else [])]
    lines += [f"warning: {text}" for text in summary.get("warnings", ())]
    heads = ("phase", "end [s]", "pressure [kPa]", "tip [mm]", "sag [mm]")
    lines += [f"stability: {text}" for text in branching_lines(summary.get("branchings", []))]
    lines += [f"overlap: {text}" for text in overlap_lines(summary.get("overlaps", []))]
    rows = [[phase_cells(phase)[k] for k in _SHOWN_CELLS] for phase in summary["phases"]]
    table = "".join(_row("td", row) for row in rows)
    texts = "<br>".join(map(escape, lines))
    return f"<div>{texts}<table><thead>{_row('th', heads)}</thead><tbody>{table}</tbody></table></div>"


def _row(kind: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{kind}>{escape(cell)}</{kind}>" for cell in cells) + "</tr>"


@final
@dataclass(frozen=True, eq=False, repr=False)
class CameraImages:
    """What one camera saw, a row for each picture.

    Args:
        tick: (pictures,), after which it was taken.
        time_s: (pictures,), simulated time.
        rgb: (pictures, height, width, 3), colours from 0 to 255, from the upper left corner.
        depth_m: (pictures, height, width), along the camera's line of sight; infinite where nothing is.
        segments: (pictures, height, width), 0: nothing, 1: film, 2 + k: body k of `RunInfo.body_names`.
        position: (pictures, 3) [m], of the camera, world.
        rotation: (pictures, 3, 3), world from camera: x to the right, y up, z against the line of sight.
    """

    tick: IntArray
    time_s: Array
    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    segments: NDArray[np.int16]
    position: Array
    rotation: Array

    def __repr__(self) -> str:
        """Return one line: how many there are, and how large."""
        return f"{len(self.tick)} pictures of {self.rgb.shape[2]} x {self.rgb.shape[1]} pixels"


IMAGE_COLUMNS: Final = tuple(entry.name for entry in fields(CameraImages))


@final
@dataclass(frozen=True, eq=False, repr=False)
class RunResult(RigidColumns):
    """A run as arrays, one row per snapshot (the state before the first tick, then every tick).

    World frame, SI units. Node positions are kept at the recording's frame rate only. The files of a run
    repeat shape, unit and meaning as they stand here; without [unit], the unit is the end of the name.

    Args:
        stage: what does not change during the run: film triangles, cable routes, and names, `joint_names` of
            all joints, `body_names` of all bodies, objects by theirs; see `body`.
        summary: as in summary.json.
        directory: where the files are, or None if none were written.
        tick: (rows,), count of ticks, 0 before the first one.
        time_s: (rows,), simulated time.
        phase: (rows,), index into `stage.phase_names`.
        joint_position: (rows, joints) [rad], of the arm; a joint that slides has metres.
        joint_velocity: (rows, joints) [rad/s], in statics the mean one over the increment.
        joint_torque: (rows, joints) [N m], that the servos gave in the tick; at rest, their holding torque.
        joint_target: (rows, joints) [rad], targets of the servos.
        body_position: (rows, bodies, 3) [m], of the frames of the arm's links and the objects, world.
        body_quaternion: (rows, bodies, 4), (w, x, y, z), world from body.
        body_contact_force: (rows, bodies, 3) [N], of the soft robot's contacts on each body, world axes.
        flange_position: (rows, 3) [m], of its origin, world.
        flange_quaternion: (rows, 4), (w, x, y, z), world from flange.
        flange_force: (rows, 3) [N], that all that hangs on the flange exerts on it, world axes: the soft
            robot, and weight, inertia and contacts of a palm, as a sensor between arm and flange shows.
        flange_torque: (rows, 3) [N m], the same, about the flange's origin.
        soft_center: (rows, 3) [m], centre of mass of the soft robot, world.
        soft_inertia: (rows, 3, 3) [kg m^2], of the soft robot about that, world axes.
        tip_position: (rows, 3) [m], centre of the last hole ring.
        tip_direction: (rows, 3), its unit normal.
        sag_m: (rows,), distance of the tip from where a straight arm along the flange's axis would have it.
        pressure_Pa: (rows,), gauge, in the first chamber; of a sealed gas at its present volume.
        volume_m3: (rows,), of all chambers.
        chamber_pressure_Pa: (rows, chambers), gauge.
        chamber_volume_m3: (rows, chambers), inside the film.
        cable_tension_N: (rows, cables), at the base end.
        cable_length_m: (rows, cables), of the routes; (rows, 0) without devices or commanded lengths.
        cable_unstretched_m: (rows, cables), off the drum; not a number while the tension is commanded.
        sensor_reading: (rows, readings) [1], of all sensors, each in its unit; see `sensor`.
        sensor_truth: (rows, readings) [1], true values, at the same instants.
        bending_angle_rad: (rows,), between the tip's direction and the flange's z axis.
        residual_N: (rows,), largest force component that the soft step was left with.
        newton_iterations: (rows,), of the soft step.
        power_error_W: (rows,), that appeared at the interface.
        stability_ratio: (rows,), of the coupling; stable below 1.
        contacts: (rows,), points of the film that press on something.
        contact_force_N: (rows,), sum of the normal forces that acted on bodies, mean over the tick.
        contact_depth_m: (rows,), of the deepest point in the pressed body.
        palm_contacts: (rows,), of what is mounted on the flange with rigid bodies.
        self_contacts: (rows,), points of the film that press on another film of the soft robot.
        self_contact_force_N: (rows,), sum of their normal forces.
        self_contact_depth_m: (rows,), of the deepest point behind another film.
        tick_wall_s: (rows,), wall time.
        energy_J: (rows, energies) [J], balance of energy since the start: put in by gas, cables, flange,
            gravity, bodies, lost in contact, at eyelets, by damping and the integrator, held; elastic energy
            and rest every 0.1 s, else not numbers. (rows, 0) where the run has no balance.
        frame_tick: (frames,), tick at which the film's nodes were kept.
        frame_time_s: (frames,), when the film's nodes were kept.
        node_position: (frames, nodes, 3) [m], of the film, world.
        images: what each camera of the scenario saw, by its name.
    """

    stage: RunInfo
    summary: dict[str, Any]
    directory: Path | None
    flange_position: Array
    flange_quaternion: Array
    flange_force: Array
    flange_torque: Array
    soft_center: Array
    soft_inertia: Array
    tip_position: Array
    tip_direction: Array
    sag_m: Array
    pressure_Pa: Array
    volume_m3: Array
    chamber_pressure_Pa: Array
    chamber_volume_m3: Array
    cable_tension_N: Array
    cable_length_m: Array
    cable_unstretched_m: Array
    sensor_reading: Array
    sensor_truth: Array
    bending_angle_rad: Array
    residual_N: Array
    newton_iterations: IntArray
    power_error_W: Array
    stability_ratio: Array
    contacts: IntArray
    contact_force_N: Array
    contact_depth_m: Array
    palm_contacts: IntArray
    self_contacts: IntArray
    self_contact_force_N: Array
    self_contact_depth_m: Array
    tick_wall_s: Array
    energy_J: Array
    frame_tick: IntArray
    frame_time_s: Array
    node_position: Array

    images: Mapping[str, CameraImages] = field(default_factory=dict)

    @property
    def status(self) -> str:
        """How the run ended: "completed", "interrupted" or "failed"."""
        return str(self.summary["status"])

    def body(self, name: str) -> int:
        """Return the place of a body in `body_position`, `body_quaternion` and `body_contact_force`.

        Args:
            name: of an object of the scenario, or of a link of the arm.

        Raises:
            InputError: there is no such body.
        """
        names = self.stage.body_names
        if name not in names:
            raise InputError(f"there is no body '{name}'; there are {', '.join(names) or 'none'}")
        return names.index(name)

    def sensor(self, name: str) -> tuple[Array, Array]:
        """Return readings and truth of a sensor, (rows, values) each, in its unit.

        Args:
            name: of a sensor of the scenario.

        Raises:
            InputError: there is no such sensor.
        """
        begin = 0
        for each in self.stage.sensors:
            end = begin + len(each.values)
            if each.name == name:
                return self.sensor_reading[:, begin:end], self.sensor_truth[:, begin:end]
            begin = end
        names = ", ".join(each.name for each in self.stage.sensors)
        raise InputError(f"there is no sensor '{name}'; there are {names or 'none'}")

    def plot(self, *names: str) -> Any:
        """Return a matplotlib figure of curves over time; `figure.savefig(path)` writes it.

        Args:
            names: of arrays with a row per tick, or of sensors; none: the usual ones.

        Raises:
            InputError: there is no such array, nothing to draw, or no matplotlib.
        """
        return drawn(self, names)

    def _repr_html_(self) -> str:
        """Return the outcome and a table of the phases, for notebooks."""
        return as_html(repr(self), self.summary)

    def __repr__(self) -> str:
        """Return two lines: how the run ended, and how much is held."""
        stage, rows, frames = self.stage, len(self.tick), len(self.frame_time_s)
        end_s, ticks = (self.time_s[-1], self.tick[-1]) if rows else (0.0, 0)
        sizes = [
            f"{len(stage.phase_names)} phases", f"{len(stage.joint_names)} joints",
            f"{len(stage.body_names)} bodies", f"{len(stage.chamber_names)} chambers",
            f"{len(stage.cables)} cables",
        ]  # fmt: skip
        where = "" if self.directory is None else f"; files in {self.directory}"
        return (
            f"RunResult of {stage.scenario}, {stage.mode}, {self.status}: {ticks} of {stage.ticks} ticks, "
            f"{end_s:g} of {stage.duration_s:g} s\n"
            f"{rows} rows of {len(COLUMNS)} arrays, {frames} frames of the film, {', '.join(sizes)}{where}"
        )


FRAME_COLUMNS: Final = ("frame_tick", "frame_time_s", "node_position")
"""One row per frame."""
COLUMNS: Final = tuple(
    field.name
    for field in fields(RunResult)
    if field.name not in ("stage", "summary", "directory", "images", *FRAME_COLUMNS)
)
"""Of a batch, one row per tick."""

_ROUNDING_S = 1e-9
"""Far below a tick, far above the rounding error of a time."""


@final
class ResultBuilder:
    """Follows a run and gathers its arrays.

    Args:
        frames_per_s: how often node positions are kept, in simulated time.
        after_s: simulated time that the run continues from; None from its start.
    """

    def __init__(self, frames_per_s: float, after_s: float | None = None) -> None:
        self._stage: RunInfo | None = None
        self._frames_per_s = frames_per_s
        self._frame = -1 if after_s is None else int(_frames(np.array([after_s]), frames_per_s)[0])
        self._gathered: dict[str, list[Any]] = {name: [] for name in (*COLUMNS, *FRAME_COLUMNS)}
        self._images: dict[str, list[tuple[Any, ...]]] = {}

    def open(self, stage: RunInfo) -> None:
        """Take in what does not change during the run."""
        self._stage = stage

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        for name in COLUMNS:
            self._gathered[name].append(getattr(batch, name))
        rows = frame_rows(batch.time_s, self._frames_per_s, self._frame)
        self._frame = int(_frames(batch.time_s[-1:], self._frames_per_s)[0])
        if len(rows):
            self._gathered["frame_tick"].append(batch.tick[rows])
            self._gathered["frame_time_s"].append(batch.time_s[rows])
            self._gathered["node_position"].append(batch.film.some(rows).node_position())
        for row, seen in batch.images.items():
            for one in seen:
                found = (one.rgb, one.depth_m, one.segments, one.position, one.rotation)
                taken = (batch.tick[row], batch.time_s[row], *found)
                self._images.setdefault(one.camera, []).append(taken)

    def arrays(self) -> dict[str, Any]:
        """Return the arrays of all ticks that were gathered, by name."""
        found = self._gathered.items()
        return {name: _joined(parts) if parts else np.zeros(0) for name, parts in found}

    def images(self) -> dict[str, CameraImages]:
        """Return the pictures that were gathered, by camera."""
        return {
            name: CameraImages(*map(np.array, zip(*rows, strict=True))) for name, rows in self._images.items()
        }

    def forget(self) -> None:
        """Gather anew; frames go on as they would."""
        self._gathered, self._images = {name: [] for name in self._gathered}, {}

    def close(self) -> None:
        """Nothing to do."""

    def result(self, summary: dict[str, Any], directory: Path | None) -> RunResult:
        """Return the arrays of all ticks so far.

        Raises:
            ValueError: the run has not been opened.
        """
        if self._stage is None:
            raise ValueError("no run has been opened")
        found = {"images": self.images(), **self.arrays()}
        return RunResult(stage=self._stage, summary=summary, directory=directory, **found)


def frame_rows(time_s: Array, frames_per_s: float, before: int = -1) -> IntArray:
    """Return the rows at which the film's nodes are kept: the first one of each frame.

    Args:
        time_s: (rows,), ascending.
        frames_per_s: how often they are kept.
        before: frame of the row before these, counted from 0.
    """
    return np.flatnonzero(np.diff(_frames(time_s, frames_per_s), prepend=before))


def _frames(time_s: Array, frames_per_s: float) -> IntArray:
    """Return the frame that each time falls into, counted from 0."""
    return np.floor((time_s + _ROUNDING_S) / (1.0 / frames_per_s)).astype(np.int64)


def _joined(parts: list[Any]) -> Any:
    """Return rows one after the other; ticks before a length was commanded have no cables, here NaN."""
    shape = max(part.shape[1:] for part in parts)
    return np.concatenate([
        part if part.shape[1:] == shape else np.full((len(part), *shape), np.nan) for part in parts
    ])  # fmt: skip


def result_of(
    stage: RunInfo, frames_per_s: float, batches: Iterable[TickBatch], error: BaseException | None = None
) -> RunResult:
    """Return what a run that has been stepped by hand shows of some ticks, and of the error that ended it."""
    arrays, summary = ResultBuilder(frames_per_s), SummaryBuilder(stage, 0.0, __version__)
    arrays.open(stage)
    began = time.perf_counter()
    for batch in batches:
        arrays.observe(summary.observe(batch))
    ended: tuple[Status, str | None] = ("completed", None) if error is None else ("failed", reason_of(error))
    figures = summary.finish(*ended, time.perf_counter() - began)
    return arrays.result(figures, None)
