"""Signed distances from points of a soft body to the geoms of a MuJoCo model. Shapes are read once from the
compiled model, and each query reads only their poses. MuJoCo's collision functions are for convex pairs: for
points against distance grids they err by millimetres, and they are several times slower.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import unchecked
from cosim.errors import InputError
from cosim.rigid.build.object_bodies import hollow, mesh_of
from cosim.rigid.distance.feature_points import FeaturePoints, feature_points
from cosim.rigid.distance.shapes import GeomPoses, ShapeKind, ShapePoses, Shapes, fill_near_box
from cosim.rigid.distance.signed_distance import Hits, PointLists, near_points
from cosim.rigid.distance.surfaces import surface_distance

_GRID_CELLS = 40  # along the longest edge of a distance grid
_GRID_RIM_CELLS = 3  # cells of a distance grid around its surface
_SHEET_SIZE = 1e9


@final
class ContactQuery:
    """Signed distances from points to chosen geoms of a scene.

    Shapes are numbered as in `geoms`. `update` comes before the queries of an instant.

    Args:
        model: compiled scene.
        data: its state; poses are read from it.
        geoms: indices of the geoms that can be touched.
        friction: (g,), coefficients of contacts with them; None: those of the geoms.

    Raises:
        InputError: a mesh has no volume.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        geoms: Sequence[int] | IntArray,
        friction: Array | None = None,
    ) -> None:
        self.geoms: IntArray = np.asarray(geoms, dtype=np.int64)
        self.body: IntArray = np.asarray(model.geom_bodyid[self.geoms], dtype=np.int64)
        self.friction: Array = np.array(model.geom_friction[self.geoms, 0] if friction is None else friction)
        self._data = data
        self.shapes = shapes_of(model, self.geoms)
        self.features: FeaturePoints = feature_points(self.shapes)
        self.position: Array = np.zeros((len(self.geoms), 3))
        self.rotation: Array = np.zeros((len(self.geoms), 3, 3))
        self.update()

    def __len__(self) -> int:
        return len(self.geoms)

    def update(self) -> None:
        """Read the present poses of the geoms."""
        self.position[:] = self._data.geom_xpos[self.geoms]
        self.rotation[:] = self._data.geom_xmat[self.geoms].reshape(-1, 3, 3)

    @cached_property
    def geom_poses(self) -> GeomPoses:
        """MuJoCo's arrays of the geoms' poses."""
        return GeomPoses(self.geoms, self.body, self._data.geom_xpos, self._data.geom_xmat)

    @cached_property
    def poses(self) -> ShapePoses:
        """Poses that `update` has read."""
        return ShapePoses(self.position, self.rotation)

    def near(self, low: Array, high: Array, reach_m: float) -> IntArray:
        """Return the shapes that may come within `reach_m` of the box low (3,) .. high (3,) [m], world."""
        near = np.empty(len(self), np.int64)
        count = unchecked(fill_near_box)(self.shapes, self.poses, low, high, reach_m, near)
        return near[:count]

    def distances(self, points: Array, reach_m: float, active: IntArray | None = None) -> Hits:
        """Return the pairs of a point and a shape nearer than a bound.

        Args:
            points: (n, 3) [m], world.
            reach_m: bound on the signed distance [m].
            active: (a,) indices of shapes, from `near`; None: all.
        """
        tested = np.arange(len(self), dtype=np.int64) if active is None else active
        lists = PointLists.whole(len(points), tested)
        return near_points(np.ascontiguousarray(points), self.shapes, self.poses, lists, reach_m)

    def points_around(self, points: Array, reach_m: float, active: IntArray) -> PointLists:
        """Return lists with at least all points within a bound of each active shape.

        Args:
            points: (n, 3) [m], world.
            reach_m: bound [m].
            active: (a,) indices of shapes.
        """
        return PointLists.around(points, self.shapes, self.poses, reach_m, active)

    def feature_positions(self, chosen: IntArray) -> Array:
        """Return the positions (k, 3) [m], world, of feature points with indices `chosen` (k,)."""
        return self.features.carried(self.position, self.rotation, chosen)


def shapes_of(model: mujoco.MjModel, geoms: IntArray) -> Shapes:
    """Return the shapes of geoms (g,) of a compiled model.

    Raises:
        InputError: a mesh has no volume, or a geom's kind has no surface.
    """
    count = len(geoms)
    kind = np.asarray(model.geom_type[geoms], dtype=np.int64)
    kind[hollow(model)[geoms]] = ShapeKind.GRID
    known = {int(value) for value in ShapeKind}
    for geom, value in zip(geoms, kind, strict=True):
        if int(value) not in known:
            raise InputError(
                f"geom {model.geom(geom).name!r}: kind {int(value)} has no surface to touch; set its contype "
                "and conaffinity to 0"
            )
    planes, corners, values = [np.zeros((0, 4))], [np.zeros((0, 3, 3))], [np.zeros(0)]
    faces, table = np.zeros((count, 2), np.int64), np.zeros((count, 4), np.int64)
    origin, spacing = np.zeros((count, 3)), np.ones((count, 3))
    box = np.array(model.geom_aabb[geoms]).reshape(count, 2, 3)
    center, half = box[:, 0].copy(), box[:, 1].copy()
    for g, geom in enumerate(geoms):
        if kind[g] == ShapeKind.PLANE:
            center[g], half[g] = 0.0, _SHEET_SIZE
        elif kind[g] == ShapeKind.MESH:
            equations, triangles = _hull(model, int(geom))
            before = sum(map(len, planes))
            faces[g] = before, before + len(equations)
            planes.append(equations)
            corners.append(triangles)
        elif kind[g] == ShapeKind.GRID:
            distances, origin[g], spacing[g] = _distance_grid(model, int(geom))
            table[g] = sum(map(len, values)), *distances.shape
            values.append(distances.ravel())
    return Shapes(
        kind, np.array(model.geom_size[geoms]), center, half, faces, np.concatenate(planes),
        np.concatenate(corners), table, origin, spacing, np.concatenate(values),
    )  # fmt: skip


def _hull(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Return planes (f, 4) and corners (f, 3, 3) of a mesh geom's convex hull."""
    from scipy.spatial import ConvexHull, QhullError  # imported here because few scenes have meshes

    vertices, _ = mesh_of(model, geom)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        raise InputError(
            f"geom {model.geom(geom).name!r}: its mesh has no volume to touch; make it thicker"
        ) from None
    planes = np.array(hull.equations)
    planes[:, 3] *= -1.0
    return planes, vertices[hull.simplices]


def _distance_grid(model: mujoco.MjModel, geom: int) -> tuple[Array, Array, Array]:
    """Return distances (nx, ny, nz) [m], origin (3,) and spacing (3,) [m] around a closed mesh."""
    vertices, triangles = mesh_of(model, geom)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    cell = float((high - low).max()) / _GRID_CELLS
    shape = np.ceil((high - low) / cell).astype(np.int64) + 2 * _GRID_RIM_CELLS + 1
    origin = 0.5 * (low + high) - 0.5 * cell * (shape - 1)
    axes = [origin[r] + cell * np.arange(shape[r]) for r in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = surface_distance(points, vertices[triangles])
    return distances.reshape(tuple(shape)), origin, np.full(3, cell)
