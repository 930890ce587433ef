"""What `cosim.run` returns: the summary and arrays over time.

A run as a short table for notebooks.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from cosim._version import __version__
from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.results.curves import drawn
from cosim.telemetry.figures import branching_lines, overlap_lines
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.summary import SummaryBuilder, reason_of
from cosim.telemetry.tick_batch import RigidColumns, TickBatch


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
    rows = [
        (
            phase["name"] + ("" if phase["complete"] else " (incomplete)"),
            f"{phase['end_s']:.2f}",
            ", ".join(_scaled(entry["pressure_Pa"], 1e-3) for entry in phase["chambers"].values()),
            ", ".join(_scaled(value, 1e3) for value in phase["tip_position_m"]),
            _scaled(phase["sag_m"], 1e3),
        )
        for phase in summary["phases"]
    ]
    table = "".join(_row("td", row) for row in rows)
    texts = "<br>".join(map(escape, lines))
    return f"<div>{texts}<table><thead>{_row('th', heads)}</thead><tbody>{table}</tbody></table></div>"


def _row(kind: str, cells: tuple[str, ...]) -> str:
    return "<tr>" + "".join(f"<{kind}>{escape(cell)}</{kind}>" for cell in cells) + "</tr>"


def _scaled(value: float | None, scale: float) -> str:
    return "?" if value is None else f"{scale * value:.1f}"


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
        joint_torque: (rows, joints) [N m], that the servos gave in the tick; at rest, what they hold with.
        joint_target: (rows, joints) [rad], what the servos were asked for.
        body_position: (rows, bodies, 3) [m], of the frames of the arm's links and the objects, world.
        body_quaternion: (rows, bodies, 4), (w, x, y, z), world from body.
        body_contact_force: (rows, bodies, 3) [N], of the soft robot's contacts on each body, world axes.
        flange_position: (rows, 3) [m], of its origin, world.
        flange_quaternion: (rows, 4), (w, x, y, z), world from flange.
        flange_force: (rows, 3) [N], that the soft robot exerts on the flange, world axes.
        flange_torque: (rows, 3) [N m], the same, about the flange's origin.
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
        bending_angle_rad: (rows,), between the tip's direction and the flange's z axis.
        residual_N: (rows,), largest force component that the soft step was left with.
        newton_iterations: (rows,), of the soft step.
        power_error_W: (rows,), that appeared at the interface.
        stability_ratio: (rows,), of the coupling; stable below 1.
        contacts: (rows,), points of the film that press on something.
        contact_force_N: (rows,), sum of their normal forces.
        contact_depth_m: (rows,), of the deepest point in what it presses on.
        self_contacts: (rows,), points of the film that press on another film of the soft robot.
        self_contact_force_N: (rows,), sum of their normal forces.
        self_contact_depth_m: (rows,), of the deepest point behind another film.
        tick_wall_s: (rows,), wall time.
        frame_tick: (frames,), tick at which the film's nodes were kept.
        frame_time_s: (frames,), when the film's nodes were kept.
        node_position: (frames, nodes, 3) [m], of the film, world.
    """

    stage: RunInfo
    summary: dict[str, Any]
    directory: Path | None
    flange_position: Array
    flange_quaternion: Array
    flange_force: Array
    flange_torque: Array
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
    bending_angle_rad: Array
    residual_N: Array
    newton_iterations: IntArray
    power_error_W: Array
    stability_ratio: Array
    contacts: IntArray
    contact_force_N: Array
    contact_depth_m: Array
    self_contacts: IntArray
    self_contact_force_N: Array
    self_contact_depth_m: Array
    tick_wall_s: Array
    frame_tick: IntArray
    frame_time_s: Array
    node_position: Array

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

    def plot(self, *names: str) -> Any:
        """Return a matplotlib figure of curves over time; `figure.savefig(path)` writes it.

        Args:
            names: of arrays with a row per tick; none: the usual ones.

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
    if field.name not in ("stage", "summary", "directory", *FRAME_COLUMNS)
)
"""Of a batch, one row per tick."""

_ROUNDING_S = 1e-9
"""Far below a tick, far above the rounding error of a time."""


@final
class ResultBuilder:
    """Follows a run and gathers its arrays.

    Args:
        frames_per_s: how often node positions are kept, in simulated time.
        after_s: simulated time that the run goes on from; None from its start.
    """

    def __init__(self, frames_per_s: float, after_s: float | None = None) -> None:
        self._stage: RunInfo | None = None
        self._frames_per_s = frames_per_s
        self._frame = -1 if after_s is None else int(_frames(np.array([after_s]), frames_per_s)[0])
        self._gathered: dict[str, list[Any]] = {name: [] for name in (*COLUMNS, *FRAME_COLUMNS)}

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

    def arrays(self) -> dict[str, Any]:
        """Return the arrays of all ticks that were gathered, by name."""
        found = self._gathered.items()
        return {name: _joined(parts) if parts else np.zeros(0) for name, parts in found}

    def forget(self) -> None:
        """Gather anew; frames go on as they would."""
        self._gathered = {name: [] for name in self._gathered}

    def close(self) -> None:
        """Nothing to do."""

    def result(self, summary: dict[str, Any], directory: Path | None) -> RunResult:
        """Return the arrays of all ticks so far.

        Raises:
            ValueError: the run has not been opened.
        """
        if self._stage is None:
            raise ValueError("no run has been opened")
        return RunResult(stage=self._stage, summary=summary, directory=directory, **self.arrays())


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
    stage: RunInfo, frames_per_s: float, batches: Iterable[TickBatch], error: BaseException
) -> RunResult:
    """Return what a run that has been stepped by hand shows of some ticks, before an error ended it."""
    arrays, summary = ResultBuilder(frames_per_s), SummaryBuilder(stage, 0.0, __version__)
    arrays.open(stage)
    began = time.perf_counter()
    for batch in batches:
        arrays.observe(batch)
        summary.observe(batch)
    figures = summary.finish("failed", reason_of(error), time.perf_counter() - began)
    return arrays.result(figures, None)
