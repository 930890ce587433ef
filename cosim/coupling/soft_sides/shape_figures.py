"""Figures of the film's shape at the ends of some ticks."""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Shown


@final
@dataclass(frozen=True, eq=False)
class ShapeFigures(Shown):
    """Figures of k shapes.

    Args:
        tip_position: (k, 3) [m], mean of the last hole ring.
        tip_direction: (k, 3), unit normal of the last hole ring, away from the base.
        center_line_m: (k,), length of the polyline through the centres of the hole rings.
        volumes_m3: (k, chambers).
    """

    tip_position: Array
    tip_direction: Array
    center_line_m: Array
    volumes_m3: Array

    def some(self, rows: IntArray) -> "ShapeFigures":
        """Return the figures of some of the shapes, by their places."""
        return ShapeFigures(*(column[rows] for column in vars(self).values()))

    def sag_m(self, origin: Array, axis: Array) -> Array:
        """Return how far each tip is from where it would be on a straight line of the same length (k,) [m].

        Args:
            origin: (k, 3) [m], where the lines begin.
            axis: (k, 3), unit vectors along them.
        """
        away = self.tip_position - origin - self.center_line_m[:, None] * axis
        return np.asarray(np.sqrt((away * away).sum(axis=1)))
