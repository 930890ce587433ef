"""What is read off the film's shape, for many ticks at once: one by one it costs several times as much."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.soft_sides.shape_figures import ShapeFigures
from cosim.soft.body.body import SoftBody
from cosim.soft.body.center_line import center_rings, ring_figures


def figures_at(points: Array, nodes: int, volumes_m3: Array) -> ShapeFigures:
    """Return the figures of k shapes.

    Args:
        points: (k, nodes + rings, 3) [m], the tip ring in order, then the centres of the hole rings from
            base to tip.
        nodes: of the tip ring.
        volumes_m3: (k, chambers).
    """
    count = len(points)
    center, normal, length = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    ring_figures(points, nodes, center, normal, length)
    return ShapeFigures(center, normal, length, volumes_m3)


class ShapeReader(ABC):
    """Reads the shapes that a soft side has kept with `SoftSide.shape_now`."""

    @abstractmethod
    def positions(self, shape: Any) -> Array:
        """Return the film's nodes (n, 3) [m]."""

    @abstractmethod
    def films(self, shapes: Sequence[Any]) -> Array:
        """Return the film's nodes (k, n, 3) [m] of some shapes, at least one."""

    @abstractmethod
    def figures(self, shapes: Sequence[Any]) -> ShapeFigures:
        """Return the figures of some shapes, at least one."""


@final
class MeshReader(ShapeReader):
    """Reads shapes that are the film's nodes.

    Args:
        body: whose.
        volumes: returns the volume (k, chambers) [m^3] of each chamber in shapes (k, n, 3) [m].
    """

    def __init__(self, body: SoftBody, volumes: Callable[[Array], Array]) -> None:
        self._tip, self._rings, self._volumes = body.tip, center_rings(body), volumes

    def positions(self, shape: Array) -> Array:
        """Return the shape itself."""
        return shape

    def films(self, shapes: Sequence[Array]) -> Array:
        """Return the shapes one after the other."""
        return np.concatenate(shapes).reshape(len(shapes), -1, 3)

    def figures(self, shapes: Sequence[Array]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        films = self.films(shapes)
        tip, centers = films.take(self._tip, axis=1), films.take(self._rings, axis=1).mean(axis=2)
        points = np.concatenate([tip, centers], axis=1)
        return figures_at(points, tip.shape[1], self._volumes(films))
