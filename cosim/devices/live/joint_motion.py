"""How commands from outside move the reference of an arm's joints: evenly, within their bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.devices.flange_offset import joint_rate
from cosim.plan.joint_path import JointReference

if TYPE_CHECKING:  # a scene without an arm waits for neither engine
    from cosim.kinematics.arm import Arm
    from cosim.plan.arm_limits import ArmLimits

_PIECE_RAD: Final = 0.01
"""Of a joint's way, after which a twist is asked of the Jacobian where the arm is then."""
_MOST_PIECES: Final = 64
_ROUNDING: Final = 1e-9


@final
@dataclass(frozen=True)
class JointMotion:
    """What the servos follow from some tick on: evenly through knots, and then the last of them.

    Args:
        begin: ticks of the run before it begins.
        ticks: that it takes, at least one.
        knots: (k, joints) [rad], evenly spaced in time, at least two.
        limits: what it was cut down to, in words.
    """

    begin: int
    ticks: int
    knots: Annotated[Array, ("k", "joints")]
    limits: tuple[str, ...] = ()

    def through(self, first: int, count: int, tick_s: float) -> JointReference:
        """Return what is asked at the starts of some ticks.

        Args:
            first: ticks of the run before the first of them.
            count: of them.
            tick_s: length of a tick [s].
        """
        pieces, knots, done = len(self.knots) - 1, self.knots, first - self.begin
        way = np.minimum(np.arange(done, done + count) / self.ticks, 1.0) * pieces
        place = np.minimum(way.astype(np.int64), pieces - 1)
        begin = knots[place]
        step = knots[place + 1] - begin
        speed = step * (pieces / (self.ticks * tick_s))
        if done + count > self.ticks:
            speed[way >= pieces] = 0.0
        return JointReference(begin + (way - place)[:, None] * step, speed, np.zeros(step.shape))


def towards(
    joints: Array, here: Array, begin: int, ticks: int, limits: ArmLimits, tick_s: float
) -> JointMotion:
    """Return the motion to joint positions; it takes longer than asked for where a joint is not as fast.

    Args:
        joints: (joints,) [rad], wanted; cut down to their bounds.
        here: (joints,) [rad].
        begin: ticks of the run before it begins.
        ticks: that it is to take.
        limits: of the joints.
        tick_s: length of a tick [s].
    """
    wanted = np.clip(joints, limits.lower, limits.upper)
    words = [
        f"position of {limits.joint_names[k]}: {joints[k]:.4g} was asked for, held at {wanted[k]:.4g}"
        for k in np.flatnonzero(np.abs(joints - wanted) > _ROUNDING)
    ]
    speed = np.abs(wanted - here) / (ticks * tick_s)
    share = speed / limits.velocity
    if share.max(initial=0.0) > 1.0:
        words += _speeds(share, limits)
        ticks = math.ceil(ticks * float(share.max()))
    return JointMotion(begin, ticks, np.stack([here, wanted]), tuple(words))


def along(
    arm: Arm, twist: Array, here: Array, begin: int, ticks: int, limits: ArmLimits, tick_s: float
) -> JointMotion:
    """Return the motion with a twist of the flange, slower where a joint is not as fast, up to its bound.

    Args:
        arm: kinematics.
        twist: (6,) [m/s, rad/s] of the flange's origin, world axes.
        here: (joints,) [rad].
        begin: ticks of the run before it begins.
        ticks: that it takes.
        limits: of the joints.
        tick_s: length of a tick [s].

    Raises:
        InputError: no motion of the joints moves the flange like that.
    """
    lasts_s = ticks * tick_s
    first = joint_rate(arm.jacobian(here), twist)
    pieces = min(max(math.ceil(float(np.abs(first).max()) * lasts_s / _PIECE_RAD), 1), _MOST_PIECES)
    knots, words = [here], dict[str, None]()
    for k in range(pieces):
        q = knots[-1]
        at_first = joint_rate(arm.jacobian(q), twist) if k else first
        middle = q + 0.5 * lasts_s / pieces * at_first
        rate = joint_rate(arm.jacobian(middle), twist)
        share = np.abs(rate) / limits.velocity
        largest = float(share.max())
        if largest > 1.0:
            words |= dict.fromkeys(_speeds(share, limits))
        ahead = q + lasts_s / pieces / max(1.0, largest) * rate
        beyond = (ahead > limits.upper) | (ahead < limits.lower)
        if beyond.any():
            words |= {
                f"position of {limits.joint_names[k]}: its bound stops the flange": None
                for k in np.flatnonzero(beyond)
            }
            ahead = q
        knots.append(ahead)
    return JointMotion(begin, ticks, np.array(knots), tuple(words))


def to_pose(
    arm: Arm, pose: Pose, here: Array, begin: int, ticks: int, limits: ArmLimits, tick_s: float
) -> JointMotion:
    """Return the motion to a pose of the flange, straight in the space of the joints.

    Args:
        arm: kinematics.
        pose: world_from_flange.
        here: (joints,) [rad].
        begin: ticks of the run before it begins.
        ticks: that it is to take.
        limits: of the joints.
        tick_s: length of a tick [s].

    Raises:
        UnreachableError: no configuration of the joints reaches it.
    """
    from cosim.kinematics.inverse_kinematics import InverseKinematicsOptions, solve  # here: see above

    found = solve(arm, pose, here, InverseKinematicsOptions(candidates=1))
    return towards(found.q, here, begin, ticks, limits, tick_s)


def _speeds(share: Array, limits: ArmLimits) -> list[str]:
    return [
        f"speed of {limits.joint_names[k]}: a command asks for more than {limits.velocity[k]:.3g} "
        f"{'m/s' if limits.prismatic[k] else 'rad/s'}"
        for k in np.flatnonzero(share > 1.0)
    ]
