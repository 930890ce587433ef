"""Readers of recorded shapes of a soft robot: nodes, figures and moments of many shapes at once."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.robots.shape_moments import ShapeMoments
from cosim.coupling.shape_figures import ShapeFigures
from cosim.soft.body.body import SoftBody
from cosim.soft.body.places import center_rings, ring_figures


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


def centers_of(rings: Array) -> Array:
    """Return the mean (k, 3) of the nodes of rings (k, n, 3), summed in order."""
    total = rings[:, 0].copy()
    for node in range(1, rings.shape[1]):
        total += rings[:, node]
    return np.asarray(total / rings.shape[1])


class ShapeReader(ABC):
    """Reads shapes that `SoftRobot.current_shape` has returned."""

    @abstractmethod
    def positions(self, shape: Any) -> Array:
        """Return the film's nodes (n, 3) [m]."""

    @abstractmethod
    def films(self, shapes: Sequence[Any]) -> Array:
        """Return the film's nodes (k, n, 3) [m] of k shapes, at least one."""

    @abstractmethod
    def figures(self, shapes: Sequence[Any]) -> ShapeFigures:
        """Return the figures of k shapes, at least one."""

    @abstractmethod
    def tips(self, shapes: Sequence[Any]) -> Array:
        """Return the tip positions (k, 3) [m] of k shapes, at least one, without other figures."""

    def moments(self, shapes: Sequence[Any]) -> Array:
        """Return the moments (k, m, 3) [kg^1/2 m] of k shapes, see `ShapeMoments`; m = 0 if not available.

        Args:
            shapes: at least one.
        """
        return np.zeros((len(shapes), 0, 3))


@final
class MeshReader(ShapeReader):
    """Reads shapes that are arrays of the film's nodes.

    Args:
        body: mesh.
        volumes: shapes (k, n, 3) [m] -> volume (k, chambers) [m^3] of each chamber.
    """

    def __init__(self, body: SoftBody, volumes: Callable[[Array], Array]) -> None:
        self._body, self._volumes = body, volumes
        self._tip, self._rings = body.tip, center_rings(body)
        self._tip_direction = body.tip_way if body.tip_is_line else None

    def positions(self, shape: Array) -> Array:
        """Return the shape itself."""
        return shape

    def films(self, shapes: Sequence[Array]) -> Array:
        """Return the shapes as one array."""
        return np.concatenate(shapes).reshape(len(shapes), -1, 3)

    def figures(self, shapes: Sequence[Array]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        films = self.films(shapes)
        tip, centers = films.take(self._tip, axis=1), films.take(self._rings, axis=1).mean(axis=2)
        points = np.concatenate([tip, centers], axis=1)
        figures = figures_at(points, tip.shape[1], self._volumes(films))
        if self._tip_direction is None:
            return figures
        nodes, weights = self._tip_direction
        direction = np.einsum("n,knr->kr", weights, films.take(nodes, axis=1))
        return replace(figures, tip_direction=direction / np.linalg.norm(direction, axis=1, keepdims=True))

    def tips(self, shapes: Sequence[Array]) -> Array:
        """Return the tips; see `ShapeReader.tips`."""
        return centers_of(np.stack([shape.take(self._tip, axis=0) for shape in shapes]))

    def moments(self, shapes: Sequence[Array]) -> Array:
        """Return the moments; see `ShapeReader.moments`."""
        return self._moments.of(self.films(shapes))

    @cached_property
    def _moments(self) -> ShapeMoments:
        return ShapeMoments(self._body)
