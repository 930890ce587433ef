"""What `cosim.run` returns: the summary and arrays over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from cosim.frames import Array, IntArray
from cosim.scenario.block import Block, read_now
from cosim.scenario.snapshot import Snapshot, Stage


@final
@dataclass(frozen=True, eq=False)
class RunResult:
    """A run as arrays, one row per snapshot (the state before the first tick, then every tick).

    World frame, SI units. Node positions are kept at the recording's frame rate only.

    Args:
        stage: what does not change during the run (film triangles, cable routes, names).
        summary: as in summary.json.
        directory: where the files are, or None if none were written.
        tick: (rows,) count of ticks.
        time_s: (rows,).
        phase: (rows,) index into `stage.phase_names`.
        joint_position: (rows, joints) [rad].
        joint_target: (rows, joints) [rad].
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
        bending_angle_rad: (rows,), between tip direction and flange axis; not a number without devices.
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

    stage: Stage
    summary: dict[str, Any]
    directory: Path | None
    tick: IntArray
    time_s: Array
    phase: IntArray
    joint_position: Array
    joint_target: Array
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


_ROUNDING_S = 1e-9
"""Far below a tick, far above the rounding error of a time."""


@final
class ResultBuilder:
    """Follows a run and gathers its arrays; reads them off many snapshots at once.

    Args:
        frames_per_s: how often node positions are kept, in simulated time.
    """

    def __init__(self, frames_per_s: float) -> None:
        self._stage: Stage | None = None
        self._frame_s = 1.0 / frames_per_s
        self._next_frame_s = 0.0
        self._unread: list[Snapshot] = []
        self._frames: list[Snapshot] = []
        self._arrays: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
        self._frame_time_s: list[Array] = []
        self._node_position: list[Array] = []

    def open(self, stage: Stage) -> None:
        """Take in what does not change during the run."""
        self._stage = stage

    def observe(self, snapshot: Snapshot) -> None:
        """Take in one snapshot."""
        self._unread.append(snapshot)
        if snapshot.time_s >= self._next_frame_s - _ROUNDING_S:
            self._frames.append(snapshot)
            frames = math.floor((snapshot.time_s + _ROUNDING_S) / self._frame_s)
            self._next_frame_s = (frames + 1.0) * self._frame_s
        if read_now(self._unread):
            self._read()

    def _read(self) -> None:
        """Read the arrays off the snapshots gathered, and let go of them."""
        if self._unread:
            block, self._unread = Block(self._unread), []
            for name, found in self._arrays.items():
                found.append(getattr(block, name))
        if self._frames:
            block, self._frames = Block(self._frames), []
            self._frame_time_s.append(block.time_s)
            self._node_position.append(block.node_position)

    def close(self) -> None:
        """Nothing to do."""

    def result(self, summary: dict[str, Any], directory: Path | None) -> RunResult:
        """Return the arrays of all snapshots so far.

        Raises:
            ValueError: the run has not been opened.
        """
        if self._stage is None:
            raise ValueError("no run has been opened")
        self._read()
        return RunResult(
            stage=self._stage,
            summary=summary,
            directory=directory,
            frame_time_s=_joined(self._frame_time_s),
            node_position=_joined(self._node_position),
            **{name: _joined(found) for name, found in self._arrays.items()},
        )


def _joined(found: list[Any]) -> Any:
    return np.concatenate(found) if found else np.zeros(0)


_COLUMNS: Final = (
    "tick", "time_s", "phase", "joint_position", "joint_target", "flange_position", "flange_quaternion",
    "flange_force", "flange_torque", "tip_position", "tip_direction", "sag_m", "pressure_Pa", "volume_m3",
    "chamber_pressure_Pa", "chamber_volume_m3", "cable_tension_N", "cable_length_m", "cable_unstretched_m",
    "bending_angle_rad", "residual_N", "newton_iterations", "power_error_W", "stability_ratio", "contacts",
    "contact_force_N", "contact_depth_m", "self_contacts", "self_contact_force_N", "self_contact_depth_m",
    "tick_wall_s",
)  # fmt: skip
"""Of a block."""
