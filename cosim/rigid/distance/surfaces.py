"""Signed distance and outward normal of surfaces given by data: convex hulls, and grids of distances. Each
function fills `normal` (3,), outward, and returns the distance [m], negative inside. Source of the closest
point on a triangle: Ericson, Real-Time Collision Detection, section 5.1.5.
"""

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Blocks, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector

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
    """Return the distance to a convex hull; above `reach` any number above it.

    Args:
        p: (3,) [m], hull frame.
        planes: (f, 4), outward unit normal and offset [m] of each face.
        corners: (f, 3, 3) [m], of each face.
        reach: largest distance of interest [m].
        weight: (3,), scratch.
        normal: (3,), filled.
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
    """Return the distance from a trilinear table of distances [m]; the normal is along its gradient."""
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

    A point is inside if the solid angles of all triangles add up to 4 pi (van Oosterom and Strackee, 1983).
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
