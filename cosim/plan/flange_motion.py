"""Motions of the flange through a phase: poses of a scenario's tables as transforms, straight motions with a
rotation about one axis, and oscillations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix, rotation_from_vector, vector_from_rotation
from cosim.config.schema.phase import FlangePoseTable, FlangeTurnTable, PhaseTable
from cosim.plan.ramp import progress

_PIECES_PER_CYCLE = 24
_DOWN = np.array([0.0, 0.0, -1.0])
_HANGING = np.diag([1.0, -1.0, -1.0])
_HALF_TURN_ABOUT_Y = np.diag([-1.0, 1.0, -1.0])
_KNOT_TURN_RAD = 0.05
_KNOT_SHIFT_M = 0.02
_OPPOSITE = 1e-9
"""1 + cosine below which the shortest turn has no unique axis."""


@final
@dataclass(frozen=True)
class Shake:
    """u(s) = amplitude w(s) sin(2 pi cycles s); w rises smoothly in the first cycle and falls in the last.

    Args:
        amplitude: (3,) [m], world.
        cycles: in the whole phase.
    """

    amplitude: Array
    cycles: float

    @classmethod
    def of(cls, phase: PhaseTable) -> Shake | None:
        """Return the oscillation of a phase; None without one."""
        given = phase.flange_shake
        if given is None:
            return None
        axis = np.array(given.axis)
        return cls(given.amplitude_m / np.linalg.norm(axis) * axis, given.frequency_Hz * phase.duration_s)

    def at(self, fraction: float) -> Array:
        """Return the displacement (3,) [m] at a fraction of the phase."""
        from_end = self.cycles * min(fraction, 1.0 - fraction)
        fade = progress("smooth", from_end, 1.0).value
        return np.asarray(fade * math.sin(2.0 * math.pi * self.cycles * fraction) * self.amplitude)

    @property
    def pieces(self) -> int:
        """Number of steps of inverse kinematics and statics along it."""
        return math.ceil(_PIECES_PER_CYCLE * self.cycles)


def rotation_from_direction(direction: Array, roll_rad: float = 0.0) -> Array:
    """Return the flange's rotation, world from flange, whose z axis is `direction`.

    R = R_shortest(down -> direction) R_hanging R_z(roll), where R_hanging has z down and x along the
    world's x axis, and R_shortest = I + S + S^2 / (1 + c) with S = [down x direction] and
    c = down . direction; straight up, half a turn about the world's y axis.

    Args:
        direction: (3,), not zero, world; normalised here.
        roll_rad: about the flange's z axis.
    """
    unit = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    skew, cosine = cross_matrix(np.cross(_DOWN, unit)), float(_DOWN @ unit)
    if 1.0 + cosine < _OPPOSITE:
        shortest = _HALF_TURN_ABOUT_Y
    else:
        shortest = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return np.asarray(shortest @ _HANGING @ rotation_from_vector(np.array([0.0, 0.0, roll_rad])))


def pose_of(flange: FlangePoseTable) -> Pose:
    """Return the pose, world from flange, that a scenario's `flange` table describes."""
    rotation = rotation_from_direction(np.array(flange.direction), flange.roll_rad)
    return Pose(rotation, np.array(flange.position_m))


@final
@dataclass(frozen=True)
class FlangeMotion:
    """A motion of the flange: its origin on a line, its rotation about one world axis.

    Args:
        begin: world from flange, at fraction 0.
        turn: (3,) [rad], axis times angle; may exceed half a turn.
        shift: (3,) [m].
        shake: added oscillation; None for none.
        even: whether its speed is constant, so that its ends are not at rest.
    """

    begin: Pose
    turn: Array
    shift: Array
    shake: Shake | None = None
    even: bool = False

    @classmethod
    def to(cls, begin: Pose, end: Pose) -> FlangeMotion:
        """Return the shortest motion from one pose to another."""
        turn = vector_from_rotation(end.rotation @ begin.rotation.T)
        return cls(begin, turn, end.translation - begin.translation)

    def at(self, fraction: float) -> Pose:
        """Return world_from_flange at a fraction of the motion."""
        rotation = rotation_from_vector(fraction * self.turn) @ self.begin.rotation
        place = self.begin.translation + fraction * self.shift
        return Pose(rotation, place if self.shake is None else place + self.shake.at(fraction))

    @classmethod
    def relative(
        cls, begin: Pose, turn: FlangeTurnTable | None, shift_m: Array | None, shake: Shake | None = None
    ) -> FlangeMotion:
        """Return a motion from a turn about the flange's origin, a shift and an oscillation, world axes."""
        vector = np.zeros(3)
        if turn is not None:
            vector = turn.angle_rad / np.linalg.norm(turn.axis) * np.array(turn.axis)
        return cls(
            begin, vector, np.zeros(3) if shift_m is None else np.asarray(shift_m, dtype=np.float64), shake
        )

    @property
    def rate_at_ends(self) -> Array:
        """d(linear, angular)/d(fraction) (6,) [m, rad], world axes, at the ends (oscillations rest there)."""
        return np.concatenate([self.shift, self.turn])

    @property
    def end(self) -> Pose:
        """World from flange at fraction 1."""
        return self.at(1.0)

    @property
    def pieces(self) -> int:
        """Number of steps of inverse kinematics and statics along the motion; 0 if nothing moves."""
        turn, shift = float(np.linalg.norm(self.turn)), float(np.linalg.norm(self.shift))
        shaken = 0 if self.shake is None else self.shake.pieces
        if turn < 1e-12 and shift < 1e-12 and not shaken:
            return 0
        return max(4, shaken, math.ceil(turn / _KNOT_TURN_RAD), math.ceil(shift / _KNOT_SHIFT_M))
