"""What the kernels of contact are given and fill, as arrays of documented shapes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDEX_TABLE, INDICES, MATRIX, VECTOR


class NearPoints(NamedTuple):
    """Contact points of the film near shapes, then features near triangles of the film.

    Args:
        point: (k,) of the film.
        shape: (k,).
        distance: (k,) [m].
        normal: (k, 3), out of the shape.
        feature: (f,) index among all features of the scene.
        owner: (f,) its shape.
        place: (f, 3) [m], world.
        triangle: (f,) of the film.
        weight: (f, 3), of the nearest point of the triangle.
        film_distance: (f,) [m].
        film_normal: (f, 3), out of the film.
    """

    point: IntArray
    shape: IntArray
    distance: Array
    normal: Array
    feature: IntArray
    owner: IntArray
    place: Array
    triangle: IntArray
    weight: Array
    film_distance: Array
    film_normal: Array

    @classmethod
    def room(cls, points: int, features: int) -> NearPoints:
        """Return room for so many."""
        of_points = _no_indices(points), _no_indices(points), np.empty(points), np.empty((points, 3))
        owned = _no_indices(features), _no_indices(features), np.empty((features, 3)), _no_indices(features)
        rest = np.empty((features, 3)), np.empty(features), np.empty((features, 3))
        return cls(*of_points, *owned, *rest)

    def first(self, points: int, features: int) -> NearPoints:
        """Return the first of them."""
        return NearPoints(*(part[:points] for part in self[:4]), *(part[:features] for part in self[4:]))  # type: ignore[arg-type]


class SurfaceRows(NamedTuple):
    """The fields of `ContactSurface`."""

    nodes: IntArray
    weights: Array
    slots: IntArray
    area: Array
    triangles: IntArray
    triangle_slots: IntArray


class ShapeRows(NamedTuple):
    """Poses, coefficients of friction and bodies of shapes: fields of `ContactQuery`."""

    position: Array
    rotation: Array
    friction: Array
    body: IntArray


class MemoryRows(NamedTuple):
    """The fields of `ContactMemory`."""

    key: IntArray
    normal_force: Array
    offset: Array
    place: Array
    triangle: IntArray

    @classmethod
    def room(cls, count: int) -> MemoryRows:
        """Return room for so many."""
        return cls(
            _no_indices(count), np.empty(count), np.empty((count, 3)), np.empty((count, 3)),
            _no_indices(count),
        )  # fmt: skip


class Ties(NamedTuple):
    """What contacts are tied to.

    Args:
        shape: (k,) that is touched.
        key: (k,) names the pair of contact point and shape; first points of the film, then features.
        carrier: (k, 3) [m], world: the shape's origin; of a feature: where it is.
        triangle: (k,) of the film, that a feature is near; -1 for points of the film.
    """

    shape: IntArray
    key: IntArray
    carrier: Array
    triangle: IntArray

    @classmethod
    def room(cls, count: int) -> Ties:
        """Return room for so many."""
        return cls(_no_indices(count), _no_indices(count), np.empty((count, 3)), _no_indices(count))


class EndRows(NamedTuple):
    """What is left of contacts at the end of a tick.

    Args:
        point: (k, 3) [m], where they are.
        slack_friction: (k,) [N], by which they rub from now on.
        loads: (bodies, 6), force [N] and torque about the world's origin [N m] on each body, world axes.
        acting: (bodies,), 1 where any acts.
        held: (bodies,) [N/m], trace of the stiffness of a body's contacts, stick springs slack.
        film: (6,), the loads as the film's nodes bear them, summed over all bodies.
        figures: (2,), sum of the normal forces [N]; depth of the deepest that presses [m].
    """

    point: Array
    slack_friction: Array
    loads: Array
    acting: IntArray
    held: Array
    film: Array
    figures: Array

    @classmethod
    def room(cls, count: int, bodies: int) -> EndRows:
        """Return room for so many."""
        of_bodies = np.empty((bodies, 6)), _no_indices(bodies), np.empty(bodies)
        return cls(np.empty((count, 3)), np.empty(count), *of_bodies, np.empty(6), np.empty(2))


def _no_indices(count: int) -> IntArray:
    return np.empty(count, np.int64)


NEAR = types.NamedTuple(
    (INDICES, INDICES, VECTOR, MATRIX, INDICES, INDICES, MATRIX, INDICES, MATRIX, VECTOR, MATRIX), NearPoints
)
SURFACE = types.NamedTuple((INDEX_TABLE, MATRIX, INDEX_TABLE, VECTOR, INDEX_TABLE, INDEX_TABLE), SurfaceRows)
SHAPES = types.NamedTuple((MATRIX, BLOCKS, VECTOR, INDICES), ShapeRows)
MEMORY = types.NamedTuple((INDICES, VECTOR, MATRIX, MATRIX, INDICES), MemoryRows)
TIES = types.NamedTuple((INDICES, INDICES, MATRIX, INDICES), Ties)
END = types.NamedTuple((MATRIX, VECTOR, MATRIX, INDICES, VECTOR, VECTOR, VECTOR), EndRows)
