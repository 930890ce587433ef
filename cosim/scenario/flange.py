"""From a scenario's flange poses and motions to rigid transforms."""

from __future__ import annotations

import numpy as np

from cosim.frames import Array, Pose, cross_matrix, rotation_from_vector
from cosim.scenario.schema import FlangePose, FlangeTurn

_DOWN = np.array([0.0, 0.0, -1.0])
_HANGING = np.diag([1.0, -1.0, -1.0])
_HALF_TURN_ABOUT_Y = np.diag([-1.0, 1.0, -1.0])
_OPPOSITE = 1e-9
"""1 + cosine below which the shortest turn has no unique axis."""


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


def pose_of(flange: FlangePose) -> Pose:
    """Return the pose, world from flange, that a scenario's `flange` table describes."""
    rotation = rotation_from_direction(np.array(flange.direction), flange.roll_rad)
    return Pose(rotation, np.array(flange.position_m))


def moved(start: Pose, turn: FlangeTurn | None, shift_m: Array | None, share: float = 1.0) -> Pose:
    """Return a pose turned about its own origin and shifted, both along world axes.

    Args:
        start: world from flange.
        turn: right-handed, or None.
        shift_m: (3,) [m], or None.
        share: of the whole motion, 0 to 1.
    """
    rotation, translation = start.rotation, start.translation
    if turn is not None:
        axis = np.array(turn.axis) / np.linalg.norm(turn.axis)
        rotation = rotation_from_vector(share * turn.angle_rad * axis) @ rotation
    if shift_m is not None:
        translation = translation + share * np.asarray(shift_m)
    return Pose(rotation, translation)
