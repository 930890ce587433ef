"""x"""

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
        speed: (2, joints) [rad/s] at begin and end, with which it goes along a cubic from the first to the
            last knot; None: it goes evenly.
    """

    begin: int
    ticks: int
    knots: Annotated[Array, ("k", "joints")]
    limits: tuple[str, ...] = ()
    speed: Annotated[Array, (2, "joints")] | None = None

    def through(self, first: int, count: int, tick_s: float) -> joint_path.JointReference:
        """Return what is asked at the starts of some ticks.

        Args:
            first: ticks of the run before the first of them.
            count: of them.
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
        """Return the reference after some ticks (n,), by the cubic of Hermite; it rests after its end."""
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
        """Return the speed (joints,) [rad/s] that the motion has after some ticks of the run."""
        if self.speed is not None and tick == self.begin + self.ticks:
            return self.speed[1]
        return self.through(tick, 1, tick_s).velocity[0]


@final
@dataclass(frozen=True)
class Departure:
    """Where the joints are when they are commanded, and how long they are given.

    Args:
        here: (joints,) [rad].
        begin: ticks of the run before the motion begins.
        ticks: that it is to take.
        limits: of the joints.
        tick_s: length of a tick [s].
    """

    here: Array
    begin: int
    ticks: int
    limits: ArmLimits
    tick_s: float

    def towards(self, joints: Array, speeds: Array | None = None) -> JointMotion:
        """Return the motion to joint positions; it takes longer than asked for where a joint is not as fast.

        Args:
            joints: (joints,) [rad], wanted; cut down to their bounds.
            speeds: (2, joints) [rad/s] at begin and end, without effect where a bound is in the way; None: it
                goes evenly.
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
        """Return the motion to a pose of the flange, straight in the space of the joints.

        Args:
            arm: kinematics.
            pose: world_from_flange.

        Raises:
            UnreachableError: no configuration of the joints reaches it.
        """
        from cosim.kinematics.inverse_kinematics import solve  # here: see above

        return self.towards(solve(arm, pose, self.here, candidates=1).q)

    def along(self, arm: Arm, twist: Array) -> JointMotion:
        """Return the motion with a twist of the flange, slower where a joint is not as fast, up to its bound.

        Args:
            arm: kinematics.
            twist: (6,) [m/s, rad/s] of the flange's origin, world axes.

        Raises:
            InputError: no motion of the joints moves the flange like that.
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
