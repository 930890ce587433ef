"""Moves the flange in addition to its plan: integrates commanded twists as motions of the joints."""

from collections.abc import Callable
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, length
from cosim.devices.controller import RobotState
from cosim.errors import InputError
from cosim.plan.joint_path import JointReference

_SMALLEST: Final = 1e-2
"""Singular values of the Jacobian below this fraction of the largest are left out."""
_MISSED: Final = 1e-6


@final
class FlangeOffset:
    """Offset of the joint references from the plan; it is constant while no twist is commanded.

    Args:
        joints: number of joints.
    """

    def __init__(self, joints: int) -> None:
        self.state: Array = np.zeros(joints)
        """The offset (joints,) [rad]."""

    def moved(
        self,
        planned: JointReference,
        twist: tuple[float, ...] | None,
        see: Callable[[], RobotState],
        step_s: float,
    ) -> JointReference:
        """Return the joint reference of a tick, and integrate the twist over the tick.

        Args:
            planned: reference at the start of the tick.
            twist: (6,) [m/s, rad/s] of the flange's origin, world axes, added to the plan; None for none.
            see: returns the robot's present state.
            step_s: length of the tick.

        Raises:
            InputError: no motion of the joints gives this twist.
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
    """Return the smallest joint speeds (joints,) [rad/s] that give the flange a twist.

    Args:
        jacobian: (6, joints).
        twist: (6,) [m/s, rad/s].

    Raises:
        InputError: there are none, or the arm is near a singular configuration.
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
