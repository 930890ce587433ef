"""A configuration far from singularities and joint limits, for arms whose files name none."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.kinematics.arm import Arm

_DRAWN = 1000
_MIDDLE = 0.8  # of the joint ranges
_SHORTEST_M = 1e-3  # of an arm
_HIGH = 0.25  # of the reach: how far the flange is to be above the base


def far_from_singularities(arm: Arm) -> Array:
    """Return the joint angles (joints,) with the largest smallest singular value of J among many drawn ones.

    Lengths in J are in units of the reach. The flange is above the base by a quarter of the reach, where it
    can be.

    Args:
        arm: standing upright, whatever way it is mounted.
    """
    rng = np.random.default_rng(0)
    lower, upper = arm.drawn_from
    turning = ~arm.prismatic
    lower, upper = (
        np.where(turning, np.maximum(lower, -np.pi), lower),
        np.where(turning, np.minimum(upper, np.pi), upper),
    )
    middle, half = 0.5 * (lower + upper), 0.5 * _MIDDLE * (upper - lower)
    scale = np.repeat([1.0 / max(arm.reach, _SHORTEST_M), 1.0], 3)[:, None]
    best, best_score = middle, -np.inf
    for _ in range(_DRAWN):
        q = middle + half * rng.uniform(-1.0, 1.0, arm.joint_count)
        above = float(arm.forward(q).translation[2] - arm.shoulder[2])
        least = float(np.linalg.svd(scale * arm.jacobian(q), compute_uv=False)[-1])
        score = least if above > _HIGH * arm.reach else least - 1.0
        if score > best_score:
            best, best_score = q, score
    return best
