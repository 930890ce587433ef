"""Energy, moment and tangent of one rotational spring with its fold barrier; see `hinge`."""

from __future__ import annotations

import math
from typing import Final

from cosim.base.kernels import inlined
from cosim.soft.elements.arctangent import TURN

CLOSED_FRACTION: Final = 4e-4
"""x_c: below x_c theta1 a fold is closed, its stiffness k (2 / (pi x_c))^2 = 2.5e6 k.

At 1e-2 films passed one another. The folds of the paper's examples stay above 4.5e-4 theta1.
"""
_CLOSED_ARGUMENT = 0.5 * math.pi * (1.0 - CLOSED_FRACTION)
_CLOSED_TANGENT = math.tan(_CLOSED_ARGUMENT)
_CLOSED_STIFFNESS = 1.0 / math.cos(_CLOSED_ARGUMENT) ** 2
_CLOSED_LOGARITHM = math.log(math.cos(_CLOSED_ARGUMENT))


@inlined
def fold_law(angle, rest, stiffness, theta1):  # type: ignore[no-untyped-def]
    """Return energy, moment and tangent of one spring, all finite and continuous, also beyond 0 and 2 pi."""
    if theta1 <= 0.0 or theta1 < angle < TURN - theta1:
        difference = angle - rest
        return 0.5 * stiffness * difference * difference, stiffness * difference, stiffness
    # mirror the upper barrier onto the lower one: angle -> 2 pi - angle flips the moment's sign
    sign = 1.0
    if angle > math.pi:
        sign, angle, rest = -1.0, TURN - angle, TURN - rest
    start = theta1 - rest
    scale = 2.0 * theta1 / math.pi
    further = angle - CLOSED_FRACTION * theta1
    if further < 0.0:
        moment = start - scale * _CLOSED_TANGENT
        energy = 0.5 * start * start + start * (angle - further - theta1) - scale * scale * _CLOSED_LOGARITHM
        energy += further * (moment + 0.5 * _CLOSED_STIFFNESS * further)
        moment += _CLOSED_STIFFNESS * further
        return stiffness * energy, sign * stiffness * moment, stiffness * _CLOSED_STIFFNESS
    argument = 0.5 * math.pi * (theta1 - angle) / theta1
    cosine = math.cos(argument)
    moment = stiffness * (start - scale * math.tan(argument))
    energy = stiffness * (0.5 * start * start + start * (angle - theta1) - scale * scale * math.log(cosine))
    return energy, sign * moment, stiffness / (cosine * cosine)
