"""Extrapolates increments of statics, as starts of the next one."""

from typing import Final

import numpy as np

from cosim.base.frames import Array

REMEMBERED: Final = 3
"""Increments from which the next one is extrapolated, in addition to the present one."""
_FAR_NEARER: Final = 0.25
"""Largest error of a parabola over that of a line: parabolas exaggerate kinks, where films slide."""


def next_of(trail: Array) -> Array:
    """Return the next value of a sequence, by a parabola if it led far nearer to the last value than a line.

    Through a, b, c at equal distances, the parabola leads to 3 c - 3 b + a, the line to 2 c - b (Lagrange).

    Args:
        trail: (k, ...), k >= 1, the last values.
    """
    if len(trail) == 1:
        return np.array(trail[0])
    d, c = trail[-1], trail[-2]
    if len(trail) > REMEMBERED:
        b, a = trail[-3], trail[-4]
        line, parabola = (d - c) - (c - b), (d - c) - 2.0 * (c - b) + (b - a)
        if np.vdot(parabola, parabola) < _FAR_NEARER**2 * np.vdot(line, line):
            return np.asarray(3.0 * (d - c) + b)
    return np.asarray(2.0 * d - c)
