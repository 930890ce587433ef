"""Motion of an arm's joints that live commands ask for: at constant speed or along a cubic, within the
joints' limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.devices import flange_offset
from cosim.plan import joint_path

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm
    from cosim.plan.arm_limits import ArmLimits

_PIECE_RAD: Final = 0.01
"""Motion of a joint after which the Jacobian is computed again for a twist."""
_MOST_PIECES: Final = 64
_ROUNDING: Final = 1e-9


@final
@dataclass(frozen=True)
class JointMotion:
    """Joint references from some tick on: linear between knots, and then the last knot.

    Args:
        begin: ticks of the run before the motion.
        ticks: its duration, at least one.
        knots: (k, joints) [rad], evenly spaced in time, at least two.
        limits: text on limits that changed the motion.
        speed: (2, joints) [rad/s] at begin and end of a cubic from the first to the last knot; None: linear.
    """

    begin: int
    ticks: int
    knots: Annotated[Array, ("k", "joints")]
    limits: tuple[str, ...] = ()
    speed: Annotated[Array, (2, "joints")] | None = None

    def through(self, first: int, count: int, tick_s: float) -> joint_path.JointReference:
        """Return the references at the starts of some ticks.

        Args:
            first: ticks of the run before the first of them.
            count: number of ticks.
            tick_s: length of a tick [s].
        """
        pieces, knots, done = len(self.knots) - 1, self.knots, first - self.begin
        if self.speed is not None:
            return self._along_cubic(done + np.arange(count), tick_s)
        way = np.minimum(np.arange(done, done + count) / self.ticks, 1.0) * pieces
        place = np.minimum(way.astype(np.int64), pieces - 1)
        begin = knots[place]
        step = knots[place + 1] - begin
        speed = step * (pieces / (self.ticks * tick_s))
        if done + count > self.ticks:
            speed[way >= pieces] = 0.0
        return joint_path.JointReference(begin + (way - place)[:, None] * step, speed, np.zeros(step.shape))

    def _along_cubic(self, done: IntArray, tick_s: float) -> joint_path.JointReference:
        """Return the references after ticks (n,) on the Hermite cubic; after its end they are at rest."""
        assert self.speed is not None, "asked of cubics"
        lasts_s = self.ticks * tick_s
        (here, there), (leaving, arriving) = self.knots, lasts_s * self.speed
        u = np.minimum(done / self.ticks, 1.0)[:, None]
        moves, way = u < 1.0, there - here
        square, cube = 3.0 * way - 2.0 * leaving - arriving, leaving + arriving - 2.0 * way
        place = here + u * (leaving + u * (square + u * cube))
        speed = moves * (leaving + u * (2.0 * square + 3.0 * u * cube)) / lasts_s
        return joint_path.JointReference(place, speed, moves * (2.0 * square + 6.0 * u * cube) / lasts_s**2)

    def speed_at(self, tick: int, tick_s: float) -> Array:
        """Return the speed (joints,) [rad/s] after some ticks of the run."""
        if self.speed is not None and tick == self.begin + self.ticks:
            return self.speed[1]
        return self.through(tick, 1, tick_s).velocity[0]


@final
@dataclass(frozen=True)
class Departure:
    """Start of a commanded joint motion, and its duration.

    Args:
        here: (joints,) [rad], present references.
        begin: ticks of the run before the motion.
        ticks: commanded duration.
        limits: of the joints.
        tick_s: length of a tick [s].
    """

    here: Array
    begin: int
    ticks: int
    limits: ArmLimits
    tick_s: float

    def towards(self, joints: Array, speeds: Array | None = None) -> JointMotion:
        """Return the motion to joint positions; it takes longer than commanded if a joint is not fast enough.

        Args:
            joints: (joints,) [rad], targets; limited to their range.
            speeds: (2, joints) [rad/s] at begin and end, without effect if a limit changes the motion; None:
                constant speed.
        """
        limits, ticks = self.limits, self.ticks
        wanted = np.clip(joints, limits.lower, limits.upper)
        words = [
            f"position of {limits.joint_names[k]}: {joints[k]:.4g} was asked for, held at {wanted[k]:.4g}"
            for k in np.flatnonzero(np.abs(joints - wanted) > _ROUNDING)
        ]
        speed = np.abs(wanted - self.here) / (ticks * self.tick_s)
        share = speed / limits.velocity
        if share.max(initial=0.0) > 1.0:
            words += _speeds(share, limits)
            ticks = math.ceil(ticks * float(share.max()))
        knots = np.stack([self.here, wanted])
        return JointMotion(self.begin, ticks, knots, tuple(words), None if words else speeds)

    def to_pose(self, arm: Arm, pose: Pose) -> JointMotion:
        """Return the motion to a pose of the flange, linear in the joint angles.

        Args:
            arm: of Pinocchio.
            pose: world_from_flange.

        Raises:
            UnreachableError: no configuration of the joints reaches it.
        """
        from cosim.kinematics.inverse_kinematics import (
            solve,  # imported here so that no arm means no Pinocchio
        )

        return self.towards(solve(arm, pose, self.here, candidates=1).q)

    def along(self, arm: Arm, twist: Array) -> JointMotion:
        """Return the motion with a twist of the flange; slower for a joint at its speed limit.

        Args:
            arm: of Pinocchio.
            twist: (6,) [m/s, rad/s] of the flange's origin, world axes.

        Raises:
            InputError: no motion of the joints gives this twist.
        """
        limits, lasts_s = self.limits, self.ticks * self.tick_s
        first = flange_offset.joint_rate(arm.jacobian(self.here), twist)
        pieces = min(max(math.ceil(float(np.abs(first).max()) * lasts_s / _PIECE_RAD), 1), _MOST_PIECES)
        knots, words = [self.here], dict[str, None]()
        for k in range(pieces):
            q = knots[-1]
            at_first = flange_offset.joint_rate(arm.jacobian(q), twist) if k else first
            middle = q + 0.5 * lasts_s / pieces * at_first
            rate = flange_offset.joint_rate(arm.jacobian(middle), twist)
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
        return JointMotion(self.begin, self.ticks, np.array(knots), tuple(words))


def _speeds(share: Array, limits: ArmLimits) -> list[str]:
    return [
        f"speed of {limits.joint_names[k]}: a command asks for more than {limits.velocity[k]:.3g} "
        f"{'m/s' if limits.prismatic[k] else 'rad/s'}"
        for k in np.flatnonzero(share > 1.0)
    ]
