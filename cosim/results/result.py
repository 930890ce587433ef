"""What `cosim.run` returns: the summary and arrays over time.

A run as a short table for notebooks, and its usual curves as a picture, which needs matplotlib.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import product
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cosim._version import __version__
from cosim.base.column import Column, Columns, columns_of, listing_columns
from cosim.base.columns import RunColumns
from cosim.base.frames import Array, IntArray
from cosim.config.schema.scenario import Scenario
from cosim.devices.device_report import SensorNames
from cosim.errors import InputError
from cosim.telemetry.figures import branching_lines, overlap_lines
from cosim.telemetry.phase_ends import PhaseEnds
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.summary import Status, SummaryBuilder, phase_cells, reason_of
from cosim.telemetry.tick_batch import TickBatch

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
    sensors = {each.name: each for each in result.stage.sensors}
    for name in names or (*USUAL, *sensors):
        if name in sensors:
            yield _sensor_panel(result, sensors[name])
            continue
        if name not in COLUMNS:
            there = ", ".join([*COLUMNS, *sensors])
            raise InputError(f"there is no array '{name}' over the ticks; there are {there}")
        array, column = getattr(result, name), COLUMNS[name]
        if not array.size or not (names or np.nan_to_num(array).any()):
            continue
        scale, unit = _PREFIXES.get(column.unit, (1.0, column.unit))
        labels = column.components(result.stage.names_along, array.shape[1:])
        title = name.removesuffix(f"_{column.unit}").replace("_", " ")
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


class ImageColumns(Columns):
    """The columns of the pictures of one camera."""

    tick = Column("pictures", "1", "after which it was taken.", fill=np.int64(0))
    time_s = Column("pictures", "s", "simulated time.")
    rgb = Column(
        "pictures, height, width, 3",
        "1",
        "colours from 0 to 255, from the upper left corner.",
        fill=np.uint8(0),
    )
    depth_m = Column(
        "pictures, height, width", "m", "along the camera's line of sight; infinite where nothing is.",
        fill=np.float32(0.0),
    )  # fmt: skip
    segments = Column(
        "pictures, height, width", "1", "0: nothing, 1: film, 2 + k: body k of `RunInfo.body_names`.",
        fill=np.int16(0),
    )  # fmt: skip
    position = Column("pictures, 3", "m", "of the camera, world.")
    rotation = Column(
        "pictures, 3, 3", "1", "world from camera: x to the right, y up, z against the line of sight."
    )


IMAGE_COLUMNS: Final = columns_of(ImageColumns)


@final
@listing_columns
@dataclass(frozen=True, eq=False, repr=False)
class CameraImages(ImageColumns):
    """What one camera saw, a row for each picture; its columns are attributes.

    Args:
        arrays: columns by name.
    """

    arrays: Mapping[str, NDArray[Any]]

    def __repr__(self) -> str:
        """Return one line: how many there are, and how large."""
        return f"{len(self.tick)} pictures of {self.rgb.shape[2]} x {self.rgb.shape[1]} pixels"


class FrameColumns(Columns):
    """The columns of the frames at which the film's nodes are kept."""

    frame_tick = Column("frames", "1", "tick at which the film's nodes were kept.", fill=np.int64(0))
    frame_time_s = Column("frames", "s", "when the film's nodes were kept.")
    node_position = Column("frames, nodes, 3", "m", "of the film, world.")


COLUMNS: Final = columns_of(RunColumns)
"""One row per tick."""
FRAME_COLUMNS: Final = columns_of(FrameColumns)
"""One row per frame."""


@final
@listing_columns
@dataclass(frozen=True, eq=False, repr=False)
class RunResult(FrameColumns, RunColumns):
    """A run as arrays, one row per snapshot (the state before the first tick, then every tick).

    World frame, SI units. Columns are attributes, such as `tip_position`; node positions are kept at the
    recording's frame rate only. The files of a run repeat shape, unit and meaning as they stand here; without
    [unit], the unit is the end of the name.

    Args:
        stage: what does not change during the run: film triangles, cable routes, and names, `joint_names` of
            all joints, `body_names` of all bodies, objects by theirs; see `body`.
        summary: as in summary.json.
        directory: where the files are, or None if none were written.
        arrays: columns by name.
        images: what each camera of the scenario saw, by its name.
        scenario: that was run; None where it is in the directory, or not known.
        ends: of the phases, for `cosim.error_bars`; None: the same.
    """

    stage: RunInfo
    summary: dict[str, Any]
    directory: Path | None
    arrays: Mapping[str, NDArray[Any]]
    images: Mapping[str, CameraImages] = field(default_factory=dict)
    scenario: Scenario | None = None
    ends: PhaseEnds | None = None

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
            name: CameraImages(dict(zip(IMAGE_COLUMNS, map(np.array, zip(*rows, strict=True)), strict=True)))
            for name, rows in self._images.items()
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
        return RunResult(self._stage, summary, directory, self.arrays(), self.images())


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
