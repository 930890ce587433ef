"""Detects sudden motion of the tip: a soft robot that leaves an unstable state speeds up."""

import math
from dataclasses import dataclass
from typing import Final, final

from cosim.base.frames import Array

_SUDDEN: Final = 3.0
"""Speed over the mean speed, or over that of the last check, above which a motion is sudden."""
_MEAN_s: Final = 0.25


@final
@dataclass(frozen=True)
class TipSpeed:
    """Speed of the tip in the flange frame so far.

    Args:
        tip: (3,) [m], flange frame; NaN before the first tick.
        mean: [m/s], over the last quarter of a second.
        checked: [m/s], at the last check of the present motion; 0 if it is not faster than its mean.
    """

    tip: Array
    mean: float = 0.0
    checked: float = 0.0

    def after(self, tips: Array, tick_s: float, least: float) -> "tuple[list[int], TipSpeed]":
        """Return the rows of ticks with a sudden motion, and the speed after all ticks.

        Args:
            tips: (k, 3) [m], flange frame.
            tick_s: length of a tick.
            least: speed [m/s] below which the tip counts as at rest.
        """
        rows, mean, checked = [], self.mean, self.checked
        a, b, c = self.tip.tolist()
        for row, (x, y, z) in enumerate(tips.tolist()):
            way = math.sqrt((x - a) * (x - a) + (y - b) * (y - b) + (z - c) * (z - c))
            speed = way / tick_s if way >= 0.0 else 0.0  # unknown in the first tick
            checked = checked if speed > mean else 0.0
            if speed > max(least, _SUDDEN * max(mean, checked)):
                rows.append(row)
                checked = speed
            mean += (speed - mean) * tick_s / (_MEAN_s + tick_s)
            a, b, c = x, y, z
        return rows, TipSpeed(tips[-1], mean, checked)
