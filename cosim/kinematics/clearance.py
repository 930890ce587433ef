"""Distances between solids, by coal."""

from collections.abc import Callable, Sequence
from typing import Any, Final, final

import coal
import numpy as np

from cosim.base.frames import Array
from cosim.base.solid import Solid

_TOLERANCE: Final = 1e-9
_OVERLAP_TOLERANCE: Final = 1e-6  # coal's default: with less, EPA sometimes fails on round shapes
_ROUNDS: Final = 500


@final
class Clearance:
    """Computes distances between solids.

    Args:
        solids: on bodies.
    """

    def __init__(self, solids: Sequence[Solid]) -> None:
        self._solids = tuple(solids)
        self._shapes = tuple(_shape(solid) for solid in solids)
        self._request = request = coal.DistanceRequest(True, 0.0, 0.0)
        request.gjk_tolerance, request.gjk_max_iterations = _TOLERANCE, _ROUNDS
        request.epa_tolerance, request.enable_signed_distance = _OVERLAP_TOLERANCE, True

    def at(self, positions: Array, rotations: Array) -> Callable[[int, int], float]:
        """Return the function of two solids' indices that gives their distance [m], negative for an overlap.

        A surface has no inside: its distance is 0 or below if it intersects another solid, but not if it is
        completely inside it.

        Args:
            positions: (bodies, 3) [m], world.
            rotations: (bodies, 3, 3), world from body.
        """
        shapes, request = self._shapes, self._request
        placed = [_placed(solid, positions, rotations) for solid in self._solids]

        def between(one: int, other: int) -> float:
            result = coal.DistanceResult()
            found = coal.distance(shapes[one], placed[one], shapes[other], placed[other], request, result)
            return float(found)

        return between


def _placed(solid: Solid, positions: Array, rotations: Array) -> Any:
    turn, place = rotations[solid.body], positions[solid.body]
    return coal.Transform3s(turn @ solid.pose.rotation, turn @ solid.pose.translation + place)


def _shape(solid: Solid) -> Any:
    x, y, z = solid.size.tolist()
    match solid.shape:
        case "box":
            return coal.Box(2.0 * x, 2.0 * y, 2.0 * z)
        case "sphere":
            return coal.Sphere(x)
        case "capsule":
            return coal.Capsule(x, 2.0 * y)
        case "cylinder":
            return coal.Cylinder(x, 2.0 * y)
        case "ellipsoid":
            return coal.Ellipsoid(x, y, z)
        case "plane":
            return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    points = coal.StdVec_Vec3s()
    for vertex in solid.vertices:
        points.append(vertex)
    if solid.shape == "hull":
        return coal.Convex.convexHull(points, True, "Qt")
    triangles = coal.StdVec_Triangle()
    for triangle in solid.triangles.tolist():
        triangles.append(coal.Triangle(*triangle))
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(triangles), len(points))
    surface.addSubModel(points, triangles)
    surface.endModel()
    return surface
