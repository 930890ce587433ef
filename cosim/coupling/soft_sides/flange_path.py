"""Where the flange is within a tick: on the parabola through its last three poses."""

from __future__ import annotations

from cosim.base.frames import Pose, rotation_from_vector, vector_from_rotation


def pose_within(before: Pose | None, begin: Pose, end: Pose, share: float) -> Pose:
    """Return the pose at a share s of a tick: x = x0 + s d1 + s (s - 1) (d1 + d_-1) / 2, exactly `end` at 1.

    d1 and d_-1 are the displacements from the tick's beginning to its end and to the beginning of the tick
    before, of the origin and as rotation vectors.

    Args:
        before: one tick before the tick's beginning; None: the way is straight.
        begin: at the tick's beginning.
        end: at its end.
        share: 0 to 1.
    """
    if before is None or share >= 1.0:
        return begin.interpolated(end, share)
    bend = 0.5 * share * (share - 1.0)
    ahead, back = end.translation - begin.translation, before.translation - begin.translation
    turn_ahead = vector_from_rotation(end.rotation @ begin.rotation.T)
    turn_back = vector_from_rotation(before.rotation @ begin.rotation.T)
    turn = share * turn_ahead + bend * (turn_ahead + turn_back)
    shift = share * ahead + bend * (ahead + back)
    return Pose(rotation_from_vector(turn) @ begin.rotation, begin.translation + shift)
