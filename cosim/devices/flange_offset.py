"""x"""

from collections.abc import Callable
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, length
from cosim.devices.command_source import RobotState
from cosim.errors import InputError
from cosim.plan.joint_path import JointReference

_SMALLEST: Final = 1e-2
"""Of a Jacobian's singular values to its largest, below which no motion of the joints is asked for."""
_MISSED: Final = 1e-6


@final
class FlangeOffset:
    """The joints' reference, moved off the plan; where nothing moves it further, it stays off.

    Args:
        joints: how many.
    """

    def __init__(self, joints: int) -> None:
        self.state: Array = np.zeros(joints)
        """By how much it is off, (joints,) [rad]."""

    def moved(
        self,
        planned: JointReference,
        twist: tuple[float, ...] | None,
        see: Callable[[], RobotState],
        step_s: float,
    ) -> JointReference:
        """Return what the servos follow in a tick.

        Args:
            planned: at its start.
            twist: (6,) [m/s, rad/s] of the flange's origin, world axes, besides the plan; None for none.
            see: looks at the robot as it is.
            step_s: length of the tick.

        Raises:
            InputError: no motion of the joints moves the flange like that.
        """
        if twist is None:
            if not self.state.any():
                return planned
            return JointReference(planned.position + self.state, planned.velocity, planned.acceleration)
        rate = joint_rate(see().flange_jacobian, np.array(twist))
        position, velocity = planned.position + self.state, planned.velocity + rate
        self.state = self.state + step_s * rate
        return JointReference(position, velocity, planned.acceleration)


def joint_rate(jacobian: Array, twist: Array) -> Array:
    """Return the smallest joint speeds (joints,) [rad/s] that move the flange by a twist.

    Args:
        jacobian: (6, joints).
        twist: (6,) [m/s, rad/s].

    Raises:
        InputError: there are none, or only with the arm near a singular configuration.
    """
    if not jacobian.shape[1]:
        raise InputError("the flange is commanded to move, but robot = 'none' has no joints to move it")
    rate = np.asarray(np.linalg.lstsq(jacobian, twist, rcond=_SMALLEST)[0])
    if length(jacobian @ rate - twist) > _MISSED * length(twist):
        raise InputError(
            f"the flange is commanded to move with the twist {np.round(twist, 4).tolist()}, which the arm "
            "cannot follow in its present configuration: it is near a singular one; keep away from there, or "
            "begin where the arm is bent (start.flange)"
        )
    return rate
