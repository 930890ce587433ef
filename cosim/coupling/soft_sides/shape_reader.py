"""What is read off the film's shape, for many ticks at once: one by one it costs several times as much."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.body.body import SoftBody
from cosim.soft.body.center_line import hole_rings, ring_figures

Rows: TypeAlias = slice | IntArray
"""Some rows of an array."""


@final
@dataclass(frozen=True)
class ShapeFigures:
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

    @classmethod
    def of(cls, points: Array, nodes: int, volumes_m3: Array) -> ShapeFigures:
        """Return the figures of tip and center line.

        Args:
            points: (k, nodes + rings, 3) [m], the tip ring in order, then the centres of the hole rings from
                base to tip.
            nodes: of the tip ring.
            volumes_m3: (k, chambers).
        """
        count = len(points)
        center, normal, length = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
        ring_figures(points, nodes, center, normal, length)
        return cls(center, normal, length, volumes_m3)

    def of_rows(self, rows: Rows) -> ShapeFigures:
        """Return the figures of some of the shapes."""
        return ShapeFigures(
            self.tip_position[rows], self.tip_direction[rows], self.center_line_m[rows], self.volumes_m3[rows]
        )

    def sag_m(self, origin: Array, axis: Array) -> Array:
        """Return how far each tip is from where it would be on a straight line of the same length (k,) [m].

        Args:
            origin: (k, 3) [m], where the lines begin.
            axis: (k, 3), unit vectors along them.
        """
        away = self.tip_position - origin - self.center_line_m[:, None] * axis
        return np.asarray(np.sqrt((away * away).sum(axis=1)))


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


class ShapeRows(ABC):
    """Shapes of some ticks in a row, one row each, in arrays that nothing changes any more."""

    @property
    @abstractmethod
    def reader(self) -> ShapeReader:
        """What reads each shape by itself."""

    @abstractmethod
    def shape(self, row: int) -> Any:
        """Return the shape in a row for the reader, in arrays of its own."""

    @abstractmethod
    def films(self, rows: Rows) -> Array:
        """Return the film's nodes (k, n, 3) [m] of some rows, at least one."""

    @abstractmethod
    def figures(self, rows: Rows) -> ShapeFigures:
        """Return the figures of some rows, at least one."""


@final
class MeshReader(ShapeReader):
    """Reads shapes that are the film's nodes.

    Args:
        body: whose.
        volumes: returns the volume [m^3] of each chamber at nodes (n, 3) [m].
    """

    def __init__(self, body: SoftBody, volumes: Callable[[Array], tuple[float, ...]]) -> None:
        self._tip, self._rings, self._volumes = body.tip, hole_rings(body), volumes

    def positions(self, shape: Array) -> Array:
        """Return the shape itself."""
        return shape

    def films(self, shapes: Sequence[Array]) -> Array:
        """Return the shapes one after the other."""
        return np.concatenate(shapes).reshape(len(shapes), -1, 3)

    def figures(self, shapes: Sequence[Array]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        tip = np.stack([shape[self._tip] for shape in shapes])
        centers = np.stack([shape[self._rings] for shape in shapes]).mean(axis=2)
        volumes = np.array([self._volumes(shape) for shape in shapes])
        return ShapeFigures.of(np.concatenate([tip, centers], axis=1), tip.shape[1], volumes)
