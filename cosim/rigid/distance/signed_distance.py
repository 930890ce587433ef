"""Signed distance and outward normal from many points to many shapes of every kind.

Signed distance to surfaces given by data: convex hulls and grids of distances.

Each function fills `normal` (3,), outward, and returns the distance [m], negative inside.
Source of the closest point on a triangle: Ericson, Real-Time Collision Detection, section 5.1.5.

Negative inside; exact at every depth. Each function fills `normal` (3,) and returns the distance [m]. On a
medial axis, where several surface points are nearest, one of their normals is taken.
Source: plane geometry; for the ellipsoid Eberly, "Distance from a Point to an Ellipsoid" (2013), with the
root found by Newton's method from a bound below it, where the function is convex.

`ContactQuery` measures from points of a soft body to the geoms of a compiled model. MuJoCo's own collision
pipeline is for convex pairs; for points against distance grids it errs by millimetres, and it is several
times slower. So shapes are read once from the compiled model, and each query reads poses only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector, unchecked
from cosim.errors import InputError
from cosim.rigid.build.object_bodies import hollow, mesh_of
from cosim.rigid.distance.shapes import (
    FeaturePoints,
    GeomPoses,
    ShapeKind,
    ShapePoses,
    Shapes,
    feature_points,
    fill_near_box,
)

_BOUNDS = 9  # stands for a kind of shape that is as near as can be within its bounding box
FAR = 1e9  # distance reported where a surface is not defined


@device_function
def closest_on_triangle(p: Vector, a: Vector, b: Vector, c: Vector, weight: Vector) -> None:
    """Fill the barycentric weights (3,) of the point of triangle a, b, c closest to p."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for r in range(3):
        ab, ac = b[r] - a[r], c[r] - a[r]
        d1 += ab * (p[r] - a[r])
        d2 += ac * (p[r] - a[r])
        d3 += ab * (p[r] - b[r])
        d4 += ac * (p[r] - b[r])
        d5 += ab * (p[r] - c[r])
        d6 += ac * (p[r] - c[r])
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    v = w = 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    weight[0], weight[1], weight[2] = 1.0 - v - w, v, w


@device_function
def hull(p: Vector, planes: Matrix, corners: Blocks, reach: float, weight: Vector, normal: Vector) -> float:
    """Convex hull of triangles: planes (f, 4), outward normal and offset, corners (f, 3, 3).

    Distances above `reach` may be any number above it.
    """
    face, largest = 0, -np.inf
    for f in range(planes.shape[0]):
        height = planes[f, 0] * p[0] + planes[f, 1] * p[1] + planes[f, 2] * p[2] - planes[f, 3]
        if height > largest:
            face, largest = f, height
            if height > reach:
                return height
    if largest <= 0.0:
        for r in range(3):
            normal[r] = planes[face, r]
        return largest
    best = np.inf
    for f in range(planes.shape[0]):
        height = planes[f, 0] * p[0] + planes[f, 1] * p[1] + planes[f, 2] * p[2] - planes[f, 3]
        if height <= 0.0 or height * height >= best:
            continue
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        closest_on_triangle(p, a, b, c, weight)
        square = 0.0
        for r in range(3):
            square += (p[r] - weight[0] * a[r] - weight[1] * b[r] - weight[2] * c[r]) ** 2
        if square < best:
            best, face = square, f
    a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
    closest_on_triangle(p, a, b, c, weight)
    distance = np.sqrt(best)
    for r in range(3):
        offset = p[r] - weight[0] * a[r] - weight[1] * b[r] - weight[2] * c[r]
        normal[r] = offset / distance if distance > 1e-9 else planes[face, r]
    return distance


@device_function
def grid(p: Vector, table: Blocks, origin: Vector, spacing: Vector, normal: Vector) -> float:
    """Trilinear table of signed distances [m]; normal along its gradient."""
    i, j, k = 0, 0, 0
    s = small_vector(3)
    for r in range(3):
        u = (p[r] - origin[r]) / spacing[r]
        if u < 0.0 or u > table.shape[r] - 1:
            return FAR
        cell = min(int(np.floor(u)), table.shape[r] - 2)
        s[r] = u - cell
        if r == 0:
            i = cell
        elif r == 1:
            j = cell
        else:
            k = cell
    value = gx = gy = gz = 0.0
    for a in range(2):
        wa, da = (s[0], 1.0) if a else (1.0 - s[0], -1.0)
        for b in range(2):
            wb, db = (s[1], 1.0) if b else (1.0 - s[1], -1.0)
            for c in range(2):
                wc, dc = (s[2], 1.0) if c else (1.0 - s[2], -1.0)
                d = table[i + a, j + b, k + c]
                value += wa * wb * wc * d
                gx += da * wb * wc * d / spacing[0]
                gy += wa * db * wc * d / spacing[1]
                gz += wa * wb * dc * d / spacing[2]
    length = max(np.sqrt(gx * gx + gy * gy + gz * gz), 1e-12)
    normal[0], normal[1], normal[2] = gx / length, gy / length, gz / length
    return value


@kernel
def _exact_distances(points: Matrix, corners: Blocks, out: Matrix) -> None:
    """Fill out[:, 0] with the signed distance of points (n, 3) to a closed surface of corners (f, 3, 3).

    Inside is where the solid angles of all triangles add up (van Oosterom and Strackee, 1983).
    """
    weight = small_vector(3)
    for n in range(points.shape[0]):
        p = points[n]
        best, winding = np.inf, 0.0
        for f in range(corners.shape[0]):
            a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
            closest_on_triangle(p, a, b, c, weight)
            square = 0.0
            for r in range(3):
                square += (p[r] - weight[0] * a[r] - weight[1] * b[r] - weight[2] * c[r]) ** 2
            best = min(best, square)
            # component by component: temporary arrays would cost ten times as much
            ux, uy, uz = a[0] - p[0], a[1] - p[1], a[2] - p[2]
            vx, vy, vz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
            wx, wy, wz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
            lu, lv = np.sqrt(ux * ux + uy * uy + uz * uz), np.sqrt(vx * vx + vy * vy + vz * vz)
            lw = np.sqrt(wx * wx + wy * wy + wz * wz)
            uv, vw, wu = ux * vx + uy * vy + uz * vz, vx * wx + vy * wy + vz * wz, wx * ux + wy * uy + wz * uz
            volume = ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)
            below = lu * lv * lw + uv * lw + vw * lu + wu * lv
            winding += 2.0 * np.arctan2(volume, below)
        out[n, 0] = -np.sqrt(best) if winding > 2.0 * np.pi else np.sqrt(best)


def surface_distance(points: Array, corners: Array) -> Array:
    """Return the signed distance of points to a closed triangle surface, negative inside.

    Args:
        points: (n, 3) [m].
        corners: (f, 3, 3) [m], counter-clockwise seen from outside.

    Returns:
        (n,) [m].
    """
    out = np.empty((len(points), 1))
    _exact_distances(np.ascontiguousarray(points), np.ascontiguousarray(corners), out)
    return out[:, 0]


_ROOT_ITERATIONS_MAX = 200
_ROOT_RELATIVE = 1e-14
_OFF_PLANE = 1e-13  # share of the shortest half axis by which a point is kept off the planes of symmetry


@device_function
def _from_center_line(x: float, y: float, z: float, radius: float, normal: Array) -> Any:
    """Ball of a radius."""
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        normal[0], normal[1], normal[2] = x / length, y / length, z / length
    else:
        normal[0], normal[1], normal[2] = 1.0, 0.0, 0.0
    return length - radius


@device_function
def cylinder(x: float, y: float, z: float, size: Array, normal: Array) -> Any:
    """Radius size[0], |z| < size[1]."""
    rho = np.sqrt(x * x + y * y)
    cx, cy = (x / rho, y / rho) if rho > 0.0 else (1.0, 0.0)
    up = 1.0 if z >= 0.0 else -1.0
    side, end = rho - size[0], abs(z) - size[1]
    if side <= 0.0 or end <= 0.0:
        if side > end:
            normal[0], normal[1], normal[2] = cx, cy, 0.0
            return side
        normal[0], normal[1], normal[2] = 0.0, 0.0, up
        return end
    distance = np.sqrt(side * side + end * end)
    normal[0], normal[1], normal[2] = cx * side / distance, cy * side / distance, up * end / distance
    return distance


@device_function
def box(x: float, y: float, z: float, size: Array, normal: Array) -> Any:
    """|x| < size[0], |y| < size[1], |z| < size[2]."""
    p = (x, y, z)
    axis, largest, square = 0, -np.inf, 0.0
    for r in range(3):
        beyond = abs(p[r]) - size[r]
        if beyond > largest:
            axis, largest = r, beyond
        normal[r] = max(beyond, 0.0) * (1.0 if p[r] >= 0.0 else -1.0)
        square += max(beyond, 0.0) ** 2
    if square > 0.0:
        distance = np.sqrt(square)
        for r in range(3):
            normal[r] /= distance
        return distance
    normal[axis] = 1.0 if p[axis] >= 0.0 else -1.0
    return largest


@device_function
def ellipsoid(x: float, y: float, z: float, size: Array, normal: Array) -> Any:
    """Half axes size[0..2] along x, y, z."""
    p = (x, y, z)
    small = 0
    for r in range(1, 3):
        if size[r] < size[small]:
            small = r
    a, b = (small + 1) % 3, (small + 2) % 3
    least = size[small]
    # the distance has slope 1, so this moves it by as little as the point
    pa, pb = max(abs(p[a]), _OFF_PLANE * least), max(abs(p[b]), _OFF_PLANE * least)
    pc = max(abs(p[small]), _OFF_PLANE * least)
    ra, rb = (size[a] / least) ** 2, (size[b] / least) ** 2
    inside = (pa / size[a]) ** 2 + (pb / size[b]) ** 2 + (pc / least) ** 2 < 1.0
    # q > 0 with sum_i (r_i z_i / (q + r_i - 1))^2 = 1, z the point in half axes: no term exceeds 1 there, so
    # the root lies above each of these; from below Newton's method is monotone
    za, zb, zc = pa / size[a], pb / size[b], pc / least
    q = max(zc, ra * za - ra + 1.0, rb * zb - rb + 1.0)
    for _ in range(_ROOT_ITERATIONS_MAX):
        da, db = q + (ra - 1.0), q + (rb - 1.0)
        ta, tb, tc = ra * za / da, rb * zb / db, zc / q
        step = -(ta * ta + tb * tb + tc * tc - 1.0) / (-2.0 * (ta * ta / da + tb * tb / db + tc * tc / q))
        q += step
        if not step > _ROOT_RELATIVE * q:
            break
    fa, fb, fc = ra * pa / (q + (ra - 1.0)), rb * pb / (q + (rb - 1.0)), pc / q
    distance = np.sqrt((pa - fa) ** 2 + (pb - fb) ** 2 + (pc - fc) ** 2)
    na, nb, nc = fa / size[a] ** 2, fb / size[b] ** 2, fc / least**2
    length = np.sqrt(na * na + nb * nb + nc * nc)
    normal[a] = na / length * (1.0 if p[a] >= 0.0 else -1.0)
    normal[b] = nb / length * (1.0 if p[b] >= 0.0 else -1.0)
    normal[small] = nc / length * (1.0 if p[small] >= 0.0 else -1.0)
    return -distance if inside else distance


@device_function
def _distance(shapes: Shapes, g: int, p: Vector, reach: float, weight: Vector, normal: Vector) -> float:
    """Shape g, p in its frame; `weight` (3,) is scratch."""
    kind, size = shapes.kind[g], shapes.size[g]
    if kind == 0:  # half-space z < 0
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        return p[2]
    if kind == 2:
        return _from_center_line(p[0], p[1], p[2], size[0], normal)
    if kind == 3:  # radius size[0] about the segment |z| < size[1]
        return _from_center_line(p[0], p[1], p[2] - min(max(p[2], -size[1]), size[1]), size[0], normal)
    if kind == 4:
        return ellipsoid(p[0], p[1], p[2], size, normal)
    if kind == 5:
        return cylinder(p[0], p[1], p[2], size, normal)
    if kind == 6:
        return box(p[0], p[1], p[2], size, normal)
    if kind == 7:
        first, last = shapes.faces[g, 0], shapes.faces[g, 1]
        return hull(p, shapes.planes[first:last], shapes.corners[first:last], reach, weight, normal)
    if kind == 8:
        at, nx, ny, nz = shapes.table[g, 0], shapes.table[g, 1], shapes.table[g, 2], shapes.table[g, 3]
        distances = shapes.values[at : at + nx * ny * nz].reshape((nx, ny, nz))
        return grid(p, distances, shapes.origin[g], shapes.spacing[g], normal)
    return -FAR if kind == _BOUNDS else FAR


class PointLists(NamedTuple):
    """Points asked for, shape by shape: listed[spans[a, 0]] .. listed[spans[a, 1] - 1] of the a-th one.

    Args:
        active: (a,) shapes.
        spans: (a, 2).
        listed: (k,) indices of points.
    """

    active: Indices
    spans: IndexTable
    listed: Indices

    @classmethod
    def whole(cls, points: int, active: IntArray) -> "PointLists":
        """Return all points for each active shape."""
        return cls(active, np.tile([0, points], (len(active), 1)), np.arange(points))

    @classmethod
    def around(
        cls, points: Array, shapes: Shapes, poses: ShapePoses, reach_m: float, active: IntArray
    ) -> "PointLists":
        """Return, for each active shape, all points that come within `reach_m` of it, and some others.

        Arguments as of `near_points`.
        """
        # what a grid says of points that are not close to its surface is no bound on their distance
        bounds = shapes._replace(kind=np.where(shapes.kind == ShapeKind.GRID, _BOUNDS, shapes.kind))
        hits = near_points(points, bounds, poses, cls.whole(len(points), active), reach_m)
        ends = np.cumsum(np.bincount(hits.shape, minlength=len(shapes.kind))[active])
        return cls(active, np.column_stack([ends - np.diff(ends, prepend=0), ends]), hits.point.copy())


class HitRows(NamedTuple):
    """Room for pairs of a point and a shape.

    Args:
        point: (k,).
        shape: (k,).
        found: (k, 4), distance [m] and world normal.
    """

    point: Indices
    shape: Indices
    found: Matrix


@kernel
def points_near(
    points: Matrix, shapes: Shapes, poses: ShapePoses, lists: PointLists, reach: float, hits: HitRows
) -> int:
    """Fill the pairs nearer than `reach`; return how many."""
    count = 0
    p, normal, weight, bound = small_vector(3), small_vector(3), small_vector(3), small_vector(3)
    for a in range(lists.active.shape[0]):
        g = lists.active[a]
        turn, place = poses.rotation[g], poses.position[g]
        for r in range(3):
            bound[r] = shapes.half[g, r] + reach
        for k in range(lists.spans[a, 0], lists.spans[a, 1]):
            n = lists.listed[k]
            dx, dy, dz = points[n, 0] - place[0], points[n, 1] - place[1], points[n, 2] - place[2]
            outside = False
            for r in range(3):
                p[r] = turn[0, r] * dx + turn[1, r] * dy + turn[2, r] * dz
                if not abs(p[r] - shapes.center[g, r]) < bound[r]:
                    outside = True
                    break
            if outside:
                continue
            distance = _distance(shapes, g, p, reach, weight, normal)
            if distance < reach:
                hits.point[count], hits.shape[count], hits.found[count, 0] = n, g, distance
                for r in range(3):
                    hits.found[count, 1 + r] = (
                        turn[r, 0] * normal[0] + turn[r, 1] * normal[1] + turn[r, 2] * normal[2]
                    )
                count += 1
    return count


@final
@dataclass(frozen=True)
class Hits:
    """Pairs of a point and a shape that are near each other.

    Args:
        point: (k,) index of the point.
        shape: (k,) index of the shape.
        distance: (k,) [m], negative inside the shape.
        normal: (k, 3), outward unit normal of the shape at its nearest surface point, world.
    """

    point: IntArray
    shape: IntArray
    distance: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.point)


def near_points(points: Array, shapes: Shapes, poses: ShapePoses, lists: PointLists, reach_m: float) -> Hits:
    """Return every pair of a point and a shape with a signed distance below `reach_m`.

    Args:
        points: (n, 3) [m], world, C-contiguous.
        shapes: in their own frames.
        poses: of these.
        lists: points asked for.
        reach_m: bound [m].
    """
    room = int((lists.spans[:, 1] - lists.spans[:, 0]).sum())
    rows = HitRows(np.empty(room, np.int64), np.empty(room, np.int64), np.empty((room, 4)))
    count = points_near(points, shapes, poses, lists, reach_m, rows)
    found = rows.found[:count]
    return Hits(rows.point[:count], rows.shape[:count], found[:, 0].copy(), found[:, 1:].copy())


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
        friction: (g,), coefficient of what touches each of them; theirs unless given.

    Raises:
        InputError: a mesh without volume.
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
        """Read the present poses."""
        self.position[:] = self._data.geom_xpos[self.geoms]
        self.rotation[:] = self._data.geom_xmat[self.geoms].reshape(-1, 3, 3)

    @cached_property
    def geom_poses(self) -> GeomPoses:
        """Where MuJoCo has the geoms."""
        return GeomPoses(self.geoms, self.body, self._data.geom_xpos, self._data.geom_xmat)

    @cached_property
    def poses(self) -> ShapePoses:
        """As `update` has read them last."""
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
            active: shapes asked for, from `near`; all unless given.
        """
        asked = np.arange(len(self), dtype=np.int64) if active is None else active
        lists = PointLists.whole(len(points), asked)
        return near_points(np.ascontiguousarray(points), self.shapes, self.poses, lists, reach_m)

    def points_around(self, points: Array, reach_m: float, active: IntArray) -> PointLists:
        """Return, for each active shape, all points that `distances` can find within a bound, and others.

        Arguments as of `distances`.
        """
        return PointLists.around(points, self.shapes, self.poses, reach_m, active)

    def feature_positions(self, chosen: IntArray) -> Array:
        """Return where chosen feature points (k,) are (k, 3) [m], world."""
        return self.features.carried(self.position, self.rotation, chosen)


def shapes_of(model: mujoco.MjModel, geoms: IntArray) -> Shapes:
    """Return the shapes of chosen geoms (g,) of a compiled model.

    Raises:
        InputError: a mesh without volume, or a kind of geom that has no surface.
    """
    count = len(geoms)
    kind = np.asarray(model.geom_type[geoms], dtype=np.int64)
    kind[hollow(model)[geoms]] = ShapeKind.GRID
    known = {int(value) for value in ShapeKind}
    for geom, value in zip(geoms, kind, strict=True):
        if int(value) not in known:
            raise InputError(f"geom {model.geom(geom).name!r}: kind {int(value)} has no surface to touch")
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
    from scipy.spatial import ConvexHull, QhullError  # here: few scenes have meshes to touch

    vertices, _ = mesh_of(model, geom)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        raise InputError(f"geom {model.geom(geom).name!r}: its mesh has no volume to touch") from None
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
