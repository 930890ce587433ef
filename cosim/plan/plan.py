"""The plan of a run: its start and its phases, with joint paths, commands and targets."""

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.config.gas_rules import GasRule
from cosim.config.schema.phase import PhaseTable
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.plan.commands import SoftCommand
from cosim.plan.joint_path import JointPath
from cosim.plan.tip_errors import PlannedTipPath


@final
@dataclass(frozen=True)
class Holding:
    """Changes of the held nodes at the start of a phase.

    Args:
        release: (m,) nodes that are released.
        hold: (n, 3) bool, components of nodes that are held from then on.
    """

    release: IntArray
    hold: Mask

    def apply(self, soft: SoftRobot, world_from_flange: Pose) -> None:
        """Change the held nodes of a soft side, at their present positions."""
        if len(self.release):
            soft.release(self.release)
        if self.hold.any():
            soft.hold_components(self.hold, world_from_flange)


@final
@dataclass(frozen=True)
class PhasePlan:
    """One phase of a plan.

    Args:
        phase: of the scenario.
        joints: joint angles along it.
        begin: command to the soft robot at its start, as if no gas was sealed.
        end: command at its end, likewise.
        gas: how the gas of each chamber is given.
        holding: changes of held nodes at its start.
        tip_target: (3,) [m], world; free components are NaN; None without a target.
        flange: pose at its end, world from flange.
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

    def tip_wanted(self, done: int, tick_s: float) -> Array | None:
        """Return the tip's target (3,) [m], world, at the start of a tick; None without a path or target.

        Args:
            done: ticks of the phase at its end, at least one.
            tick_s: length of a tick [s].
        """
        if self.tip_path is None:
            return self.tip_target
        course, ticks = self.tip_path.course, max(1, round(self.phase.duration_s / tick_s))
        return course.at((done - 1) / ticks * course.duration_s).position


@final
@dataclass(frozen=True)
class Plan:
    """The start and all phases of a run.

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
