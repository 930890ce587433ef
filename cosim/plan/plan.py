"""The plan of a run: for every phase where flange, pressure and tensions begin and end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.config.rules.gas_rules import GasRule
from cosim.config.schema.phase import PhaseTable
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.plan.joint_path import JointPath
from cosim.plan.paths.tip_path import PlannedTipPath
from cosim.plan.robot_command import SoftCommand


@final
@dataclass(frozen=True)
class Holding:
    """What is held otherwise from the start of a phase on.

    Args:
        release: (m,) nodes let go.
        hold: (n, 3) bool, components held from then on.
    """

    release: IntArray
    hold: Mask

    def apply(self, soft: SoftSide, world_from_flange: Pose) -> None:
        """Change what a soft body is held by, where it is now."""
        if len(self.release):
            soft.let_go(self.release)
        if self.hold.any():
            soft.hold_also(self.hold, world_from_flange)


@final
@dataclass(frozen=True)
class PhasePlan:
    """One phase, ready to run.

    Args:
        phase: as in the scenario.
        joints: joint angles along it.
        begin: asked of the soft robot at its start, as if no gas was sealed.
        end: at its end, the same.
        gas: how the gas of each chamber is given.
        holding: what is held otherwise from its start on.
        tip_target: (3,) [m]; components that are free are NaN; None without a target.
        flange: where it is to be at its end.
        tip_path: that the tip follows; None without one.
    """

    phase: PhaseTable
    joints: JointPath
    begin: SoftCommand
    end: SoftCommand
    gas: tuple[GasRule, ...]
    holding: Holding
    tip_target: Array | None
    flange: Pose
    tip_path: PlannedTipPath | None = None


@final
@dataclass(frozen=True)
class Plan:
    """All phases of a run, and where it starts.

    Args:
        start: pose of the flange.
        joints: (joints,) [rad] at the start.
        command: to the soft robot at the start.
        gravity: (3,) [m/s^2], world.
        phases: in order.
    """

    start: Pose
    joints: Array
    command: SoftCommand
    gravity: tuple[float, float, float]
    phases: tuple[PhasePlan, ...]
