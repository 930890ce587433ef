"""Energy, moment and tangent of one rotational spring with its fold barrier; see `hinge`."""

from __future__ import annotations

import math

import numpy as np

from cosim.kernels import inlined
from cosim.soft.arctangent import TURN


@inlined
def fold_law(angle, rest, stiffness, theta1):  # type: ignore[no-untyped-def]
    """Return energy, moment and tangent of one spring; infinite energy where the films have crossed."""
    if theta1 <= 0.0 or theta1 < angle < TURN - theta1:
        difference = angle - rest
        return 0.5 * stiffness * difference * difference, stiffness * difference, stiffness
    if angle <= 0.0 or angle >= TURN:
        return np.inf, np.inf, np.inf
    # mirror the upper barrier onto the lower one: angle -> 2 pi - angle flips the moment's sign
    sign = 1.0
    if angle > math.pi:
        sign, angle, rest = -1.0, TURN - angle, TURN - rest
    start = theta1 - rest
    argument = 0.5 * math.pi * (theta1 - angle) / theta1
    scale = 2.0 * theta1 / math.pi
    cosine = math.cos(argument)
    moment = stiffness * (start - scale * math.tan(argument))
    energy = stiffness * (0.5 * start * start + start * (angle - theta1) - scale * scale * math.log(cosine))
    return energy, sign * moment, stiffness / (cosine * cosine)
