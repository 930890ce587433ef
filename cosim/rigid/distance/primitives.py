"""Signed distance and outward normal of sphere, cylinder, box and ellipsoid. Each function fills `normal`
(3,) and returns the distance [m], negative inside, exact at every depth; on a medial axis, where several
surface points are nearest, the normal is that of one of them. Source: plane geometry; for the ellipsoid
Eberly, "Distance from a Point to an Ellipsoid" (2013), with Newton's method from a bound below the root,
where the function is convex.
"""

from typing import Any

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernels import device_function

_ROOT_ITERATIONS_MAX = 200
_ROOT_RELATIVE = 1e-14
_OFF_PLANE = 1e-13  # least distance of a point from the planes of symmetry, over the shortest half axis


@device_function
def from_center_line(x: float, y: float, z: float, radius: float, normal: Array) -> Any:
    """Return the distance to a sphere, p from the nearest point of the centre line."""
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        normal[0], normal[1], normal[2] = x / length, y / length, z / length
    else:
        normal[0], normal[1], normal[2] = 1.0, 0.0, 0.0
    return length - radius


@device_function
def cylinder(x: float, y: float, z: float, size: Array, normal: Array) -> Any:
    """Return the distance to a cylinder of radius size[0], |z| < size[1]."""
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
    """Return the distance to a box |x| < size[0], |y| < size[1], |z| < size[2]."""
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
    """Return the distance to an ellipsoid with half axes size[0..2] along x, y, z."""
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
