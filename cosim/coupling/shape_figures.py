"""What of the film's shape ticks leave: its figures, and where it was at the ends of the pieces of one."""

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, IntArray, Shown


@final
@dataclass(frozen=True, eq=False)
class SubstepRecord(Shown):
    """Where the soft robot was at the ends of the pieces of one tick; nobody can write to its arrays.

    Args:
        positions: (k, nodes, 3) [m], world.
        twist: (k, 6), of the flange, linear and angular, world axes.
        origin: (k, 3) [m], of the flange.
    """

    positions: Annotated[Array, ("k", "nodes", 3)]
    twist: Annotated[Array, ("k", 6)]
    origin: Annotated[Array, ("k", 3)]


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

    tip_position: Annotated[Array, ("k", 3)]
    tip_direction: Annotated[Array, ("k", 3)]
    center_line_m: Annotated[Array, ("k",)]
    volumes_m3: Annotated[Array, ("k", "chambers")]

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
