"""Figures of the film's shape (tip, length, volumes), and its shapes at the ends of a tick's substeps."""

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, IntArray, Shown


@final
@dataclass(frozen=True, eq=False)
class SubstepRecord(Shown):
    """The soft robot's shape and the flange's motion at the end of each of a tick's k substeps; read-only.

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
    """Figures of k shapes of a soft robot.

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

    def select(self, rows: IntArray) -> "ShapeFigures":
        """Return the figures of the shapes with these indices."""
        return ShapeFigures(*(column[rows] for column in vars(self).values()))

    def sag_m(self, origin: Array, axis: Array) -> Array:
        """Return the distance (k,) [m] of each tip from the end of a straight line of the same length.

        Args:
            origin: (k, 3) [m], start of each line.
            axis: (k, 3), unit vector along it.
        """
        offset = self.tip_position - origin - self.center_line_m[:, None] * axis
        return np.asarray(np.sqrt((offset * offset).sum(axis=1)))
