"""What `cosim.run` returns: the summary and arrays over time."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from cosim._version import __version__
from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.summary import SummaryBuilder, reason_of
from cosim.telemetry.tick_batch import TickBatch


@final
@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """A run as arrays, one row per snapshot (the state before the first tick, then every tick).

    World frame, SI units. Node positions are kept at the recording's frame rate only.

    Args:
        stage: what does not change during the run: film triangles, cable routes, and names, `joint_names` of
            all joints, `body_names` of all bodies, objects by theirs; see `body`.
        summary: as in summary.json.
        directory: where the files are, or None if none were written.
        tick: (rows,) count of ticks.
        time_s: (rows,).
        phase: (rows,) index into `stage.phase_names`.
        joint_position: (rows, joints) [rad].
        joint_velocity: (rows, joints) [rad/s]; in statics the mean one over the increment.
        joint_torque: (rows, joints) [N m], that the servos gave in the tick; at rest, what they hold with.
        joint_target: (rows, joints) [rad].
        body_position: (rows, bodies, 3) [m], of the frames of the arm's links and the objects, world.
        body_quaternion: (rows, bodies, 4), (w, x, y, z), world from body.
        body_contact_force: (rows, bodies, 3) [N], of the soft robot's contacts on each body, world axes.
        flange_position: (rows, 3) [m].
        flange_quaternion: (rows, 4), (w, x, y, z).
        flange_force: (rows, 3) [N], that the soft robot exerts on the flange.
        flange_torque: (rows, 3) [N m], the same, about the flange's origin.
        tip_position: (rows, 3) [m], centre of the last hole ring.
        tip_direction: (rows, 3), its unit normal.
        sag_m: (rows,).
        pressure_Pa: (rows,), gauge, in the first chamber; of a sealed gas at its present volume.
        volume_m3: (rows,) of all chambers.
        chamber_pressure_Pa: (rows, chambers), gauge.
        chamber_volume_m3: (rows, chambers).
        cable_tension_N: (rows, cables), at the base end.
        cable_length_m: (rows, cables), of the routes; (rows, 0) in a scenario without devices.
        cable_unstretched_m: (rows, cables), off the drum; not a number while the tension is commanded.
        bending_angle_rad: (rows,), between the tip's direction and the flange's z axis.
        residual_N: (rows,) of the soft step.
        newton_iterations: (rows,) of the soft step.
        power_error_W: (rows,) at the interface.
        stability_ratio: (rows,) of the coupling.
        contacts: (rows,) points of the film that press on something.
        contact_force_N: (rows,) sum of their normal forces.
        contact_depth_m: (rows,) of the deepest.
        self_contacts: (rows,) points of the film that press on another film of the soft robot.
        self_contact_force_N: (rows,) sum of their normal forces.
        self_contact_depth_m: (rows,) of the deepest.
        tick_wall_s: (rows,) wall time.
        frame_time_s: (frames,).
        node_position: (frames, nodes, 3) [m].
    """

    stage: RunInfo
    summary: dict[str, Any]
    directory: Path | None
    tick: IntArray
    time_s: Array
    phase: IntArray
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    joint_target: Array
    body_position: Array
    body_quaternion: Array
    body_contact_force: Array
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
            f"{rows} rows of {len(_COLUMNS)} arrays, {frames} frames of the film, {', '.join(sizes)}{where}"
        )


_ROUNDING_S = 1e-9
"""Far below a tick, far above the rounding error of a time."""


@final
class ResultBuilder:
    """Follows a run and gathers its arrays.

    Args:
        frames_per_s: how often node positions are kept, in simulated time.
    """

    def __init__(self, frames_per_s: float) -> None:
        self._stage: RunInfo | None = None
        self._frame_s = 1.0 / frames_per_s
        self._frame = -1
        self._arrays: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
        self._frame_time_s: list[Array] = []
        self._node_position: list[Array] = []

    def open(self, stage: RunInfo) -> None:
        """Take in what does not change during the run."""
        self._stage = stage

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        for name, found in self._arrays.items():
            found.append(getattr(batch, name))
        frames = np.floor((batch.time_s + _ROUNDING_S) / self._frame_s).astype(np.int64)
        rows = np.flatnonzero(np.diff(frames, prepend=self._frame))
        self._frame = int(frames[-1])
        if len(rows):
            self._frame_time_s.append(batch.time_s[rows])
            self._node_position.append(batch.film.some(rows).node_position())

    def close(self) -> None:
        """Nothing to do."""

    def result(self, summary: dict[str, Any], directory: Path | None) -> RunResult:
        """Return the arrays of all ticks so far.

        Raises:
            ValueError: the run has not been opened.
        """
        if self._stage is None:
            raise ValueError("no run has been opened")
        return RunResult(
            stage=self._stage,
            summary=summary,
            directory=directory,
            frame_time_s=_joined(self._frame_time_s),
            node_position=_joined(self._node_position),
            **{name: _joined(found) for name, found in self._arrays.items()},
        )


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


def _joined(found: list[Any]) -> Any:
    return np.concatenate(found) if found else np.zeros(0)


_COLUMNS: Final = tuple(
    field.name
    for field in fields(RunResult)
    if field.name not in ("stage", "summary", "directory", "frame_time_s", "node_position")
)
"""Of a batch, one row per tick."""
