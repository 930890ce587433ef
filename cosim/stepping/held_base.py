"""A held base of the soft robot, the simplest carrier."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from cosim.base.column import room_for
from cosim.base.columns import TickColumns
from cosim.base.frames import Pose, Wrench
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.ticks import ServoCommands, TickLog, figures_of, sizes_of
from cosim.plan.joint_path import JointPath, JointReference
from cosim.plan.tip_paths import AnyFlangeMotion
from cosim.soft.body.loads import Loads
from cosim.stepping.carrier import Carrier


@final
@dataclass(frozen=True)
class HeldBaseState:
    """State of a held base.

    Args:
        wrench: of the soft robot on the flange, at its origin, world axes.
    """

    wrench: Wrench


@final
class HeldBase(Carrier):
    """Holds the flange at its start, without arm, joints and rigid bodies.

    Args:
        soft: the soft side.
        world_from_flange: pose of the flange.
        tick_s: length of a tick [s].
    """

    def __init__(self, soft: SoftRobot, world_from_flange: Pose, tick_s: float) -> None:
        self._soft, self._pose, self._tick_s = soft, world_from_flange, tick_s
        self._room = room_for(TickColumns, sizes_of(joints=0, bodies=0, chambers=len(soft.pressures_Pa)))
        self.state = HeldBaseState(Wrench())
        """State for the next step."""

    @staticmethod
    def plan(start: Pose, ways: list[AnyFlangeMotion], blame: Callable[[int], str]) -> tuple[JointPath, ...]:
        """Return a path without joints for each phase."""
        return tuple(JointPath(np.zeros(0), None) for _ in ways)

    @property
    def flange_pose(self) -> Pose:
        return self._pose

    @property
    def wrench(self) -> Wrench:
        return self.state.wrench

    @property
    def report(self) -> Mapping[str, str]:
        return {"Arm": "none: the base is held at its start"}

    def couple(self, wrench: Wrench) -> None:
        self.state = HeldBaseState(wrench)

    def parts(self) -> dict[str, Any]:
        return {"base": self}

    def servos(self, references: JointReference) -> ServoCommands:
        return ServoCommands.without_payload(*[np.zeros_like(references.position)] * 3)

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        """Advance by one tick, as each takes long."""
        ticks = TickLog(self._room(1))
        ticks.flange_position[0], ticks.flange_rotation[0] = self._pose.translation, self._pose.rotation
        reply = self._soft.advance(self._pose, loads[0], self._tick_s)
        self.state = HeldBaseState(reply.wrench)
        ticks.end_tick(reply, self._soft, figures_of(self._soft, reply.wrench))
        return ticks
