"""Positions and speeds of a cell's joints through the phases of a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, final

import numpy as np

from cosim.base.frames import Array
from cosim.config.schema.phase import CELL_KEYS, PhaseTable
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.rules import Fault, Faults
from cosim.plan.ramp import progress

if TYPE_CHECKING:
    from cosim.rigid.build.description import CellJoint

_SLIDING: Final = ("cell_shift_m", "cell_speed_m_s")


@final
@dataclass(frozen=True)
class _Stretch:
    """Motion of a joint in a phase: a ramp to a position, or a constant speed; the other is zero.

    Args:
        begin: [m] or [rad].
        change: over the ramp [m] or [rad].
        speed: [m/s] or [rad/s].
        ramp: of the phase.
        ramp_s: its length.
    """

    begin: float
    change: float
    speed: float
    ramp: Literal["smooth", "linear", "step"]
    ramp_s: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at a time since the phase's start."""
        now = progress(self.ramp, time_s, self.ramp_s)
        return self.begin + self.change * now.value + self.speed * time_s, self.change * now.rate + self.speed


@final
@dataclass(frozen=True)
class CellMotion:
    """Motion of a cell's joints through a run.

    Args:
        stretches: by phase and joint.
    """

    stretches: tuple[tuple[_Stretch, ...], ...]

    def at(self, phase: int, time_s: float) -> tuple[Array, Array]:
        """Return positions (joints,) [m] or [rad] and speeds (joints,) at a time since a phase's start."""
        rows = [stretch.at(time_s) for stretch in self.stretches[phase]]
        return np.array([place for place, _ in rows]), np.array([speed for _, speed in rows])


def cell_motion(
    phases: Sequence[PhaseTable], joints: Sequence[CellJoint], lengths_s: Sequence[float]
) -> CellMotion:
    """Return the motion of a cell's joints through the phases; a position or speed holds until changed.

    Args:
        phases: of the scenario.
        joints: of the cell.
        lengths_s: durations of the phases, in whole ticks.

    Raises:
        ScenarioError: a joint is unknown or of another kind, or would leave its limits.
    """
    places, speeds, faults = [0.0] * len(joints), [0.0] * len(joints), Faults()
    beyond: set[str] = set()
    rows = []
    for phase, length_s in zip(phases, lengths_s, strict=True):
        _check_names(phase, joints, faults)
        row = []
        for k, joint in enumerate(joints):
            to, speed = _asked(phase, joint)
            if to is not None:
                speeds[k] = 0.0
            elif speed is not None:
                speeds[k] = speed
            change = 0.0 if to is None else to - places[k]
            row.append(_Stretch(places[k], change, speeds[k], phase.ramp, phase.duration_s))
            places[k] = row[-1].at(max(length_s, phase.duration_s))[0]
            low, high = joint.limits
            if not low <= places[k] <= high and joint.name not in beyond:
                faults.add(*_out_of_range(phase, joint, places[k]))
                beyond.add(joint.name)
        rows.append(tuple(row))
    faults.raise_all()
    return CellMotion(tuple(rows))


def _asked(phase: PhaseTable, joint: CellJoint) -> tuple[float | None, float | None]:
    """Return the position and the speed that a phase gives for a joint; None: not given."""
    places, speeds = phase.cell_angle_rad, phase.cell_speed_rad_s
    if joint.slides:
        places, speeds = phase.cell_shift_m, phase.cell_speed_m_s
    return (places or {}).get(joint.name), (speeds or {}).get(joint.name)


def _check_names(phase: PhaseTable, joints: Sequence[CellJoint], faults: Faults) -> None:
    named: set[str] = set()
    for key in CELL_KEYS:
        fitting = tuple(joint.name for joint in joints if joint.slides == (key in _SLIDING))
        for name in getattr(phase, key) or {}:
            where = f"phase.{phase.name}.{key}.{name}"
            if name not in fitting:
                kind = "slide of the cell" if key in _SLIDING else "hinge of the cell"
                faults.add(where, unknown_name_message(kind, name, fitting))
            elif name in named:
                faults.add(where, "is given a place and a speed in one phase; one of them drives it")
            named.add(name)


def _out_of_range(phase: PhaseTable, joint: CellJoint, place: float) -> Fault:
    """Return the fault of a phase that moves a joint beyond its limits."""
    (low, high), unit = joint.limits, "m" if joint.slides else "rad"
    keys = [key for key in CELL_KEYS if joint.name in (getattr(phase, key) or {})]
    where = f"phase.{phase.name}.{keys[0]}.{joint.name}" if keys else f"phase.{phase.name}"
    return Fault(
        where, f"takes the cell's joint to {place:g} {unit}; its range is {low:g} to {high:g} {unit}"
    )
