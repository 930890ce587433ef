"""How a point presses and drags on a surface: penalty pressure and Coulomb friction with a stick spring.

With the depth s = width / 2 - d, d the distance from the tangent plane, and the stiffness k the energy is

    0                                  s <= 0
    k s^3 / (6 width)                  0 < s < width
    k ((s - width / 2)^2 / 2 + width^2 / 24)   beyond,

twice continuously differentiable; deep in contact the pressure is the stiffness per area times -d.
Friction: u = (1 - n n^T)(y - anchor), energy F f0(|u|), f0' = f1 = 2 z - z^2 for z = |u| / stick < 1 and 1
beyond, F = friction coefficient x normal force of the last step.
A glued point is held in every direction: energy k |y - anchor|^2 / 2.
Source: the smooth friction mollifier of Li et al., Incremental Potential Contact, ACM TOG 39 (2020) 49,
here on the distance from an anchor instead of the displacement in a step.

Where a point lies over a triangle: its distance from the plane, and its foot by weights of the corners. With
n the unit normal and A the area, the weight of corner j has the gradient n x e_j / (2 A), e_j the edge across
from it.
"""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.errors import InputError

GLUED: Final = -1.0
"""The friction by which a glued point is known."""


@final
@dataclass(frozen=True)
class ContactLaw:
    """How film and obstacle press on each other.

    Args:
        stiffness_N_m3: pressure per depth; 30 kPa of gas sink in by 0.1 mm at the default.
        smoothing_m: width of the transition; contact begins at half of it before touching.
        stick_m: tangential distance from the anchor at which the full friction acts.

    Raises:
        InputError: a value that is not above 0.
    """

    stiffness_N_m3: float = 3e8
    smoothing_m: float = 1e-4
    stick_m: float = 1e-4

    def __post_init__(self) -> None:
        for name in ("stiffness_N_m3", "smoothing_m", "stick_m"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"contact: {name} is {getattr(self, name)}; it must be above 0")


_APART: Final = 1e-3  # of the transition, nearer than films are drawn: rounding does not let them press


def spare(drawn_m: Array, smoothing_m: float) -> Array:
    """Return what is added to the distance of surfaces, so that they do not press where they are drawn.

    They press from half of the distance (k,) [m] at which they are drawn, or where the law begins.
    """
    begin = np.minimum(0.5 * np.maximum(drawn_m, 0.0) + np.minimum(drawn_m, 0.0), 0.5 * smoothing_m)
    return np.maximum(0.5 * smoothing_m - begin + _APART * smoothing_m * (begin < 0.5 * smoothing_m), 0.0)


@device_function
def pressing_law(depth: float, width: float) -> tuple[float, float, float]:
    """Return energy, force and stiffness over k at a depth."""
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    if depth < width:
        return depth**3 / (6.0 * width), depth**2 / (2.0 * width), depth / width
    beyond = depth - 0.5 * width
    return 0.5 * beyond * beyond + width * width / 24.0, beyond, 1.0


@device_function
def dragging_law(length: float, stick: float) -> tuple[float, float, float]:
    """Return f0, f1 / |u| and the derivative of f1 by |u| at |u| = length."""
    fraction = length / stick
    if fraction < 1.0:
        energy = stick * fraction * fraction * (1.0 - fraction / 3.0)
        return energy, (2.0 - fraction) / stick, 2.0 * (1.0 - fraction) / stick
    return length - stick / 3.0, 1.0 / length, 0.0


@device_function
def shorten(u: Vector, n: Vector, stick: float) -> None:
    """Leave of the stretch of a stick spring what a step leaves: its part across n, at most `stick` long."""
    along, square = 0.0, 0.0
    for r in range(3):
        along += n[r] * u[r]
    for r in range(3):
        u[r] -= along * n[r]
        square += u[r] * u[r]
    kept = min(1.0, stick / max(np.sqrt(square), 1e-300))
    for r in range(3):
        u[r] *= kept


@device_function
def touch(
    point: Vector,
    n: Vector,
    offset: float,
    stiffness: float,
    friction: float,
    anchor: Vector,
    width: float,
    stick: float,
    own: Vector,
    tangent: Matrix,
) -> tuple[float, float]:
    """Fill gradient (3,) and tangent (3, 3) of a contact by its point; return energy and normal force."""
    u = small_vector(3)
    if friction == GLUED:
        square = 0.0
        for r in range(3):
            own[r] = stiffness * (point[r] - anchor[r])
            square += (point[r] - anchor[r]) ** 2
            for c in range(3):
                tangent[r, c] = stiffness if r == c else 0.0
        return 0.5 * stiffness * square, 0.0
    distance, along = -offset, 0.0
    for r in range(3):
        distance += n[r] * point[r]
        u[r] = point[r] - anchor[r]
        along += n[r] * u[r]
    level, push, rate = pressing_law(0.5 * width - distance, width)
    pressing = stiffness * push
    energy = stiffness * level
    for r in range(3):
        own[r] = -pressing * n[r]
        for c in range(3):
            tangent[r, c] = stiffness * rate * n[r] * n[c]
    if friction > 0.0:
        square = 0.0
        for r in range(3):
            u[r] -= along * n[r]
            square += u[r] * u[r]
        length = np.sqrt(square)
        level, secant, rate = dragging_law(length, stick)
        energy += friction * level
        fold = friction * (rate - secant) / max(square, 1e-300)
        for r in range(3):
            own[r] += friction * secant * u[r]
            tangent[r, r] += friction * secant
            for c in range(3):
                tangent[r, c] += fold * u[r] * u[c] - friction * secant * n[r] * n[c]
    return energy, pressing


@kernel
def combine(x: Matrix, nodes: IndexTable, weights: Matrix, chosen: Indices, out: Matrix) -> None:
    """Fill out[k] = sum_a weights[k, a] x[nodes[k, a]] for chosen k."""
    for k in chosen:
        for r in range(3):
            out[k, r] = (
                weights[k, 0] * x[nodes[k, 0], r]
                + weights[k, 1] * x[nodes[k, 1], r]
                + weights[k, 2] * x[nodes[k, 2], r]
            )


@kernel
def span(x: Matrix, v: Matrix, low: Vector, high: Vector) -> float:
    """Fill smallest and largest coordinates of x; return the largest |v|."""
    low[:], high[:], fastest = np.inf, -np.inf, 0.0
    for n in range(x.shape[0]):
        square = 0.0
        for r in range(3):
            low[r] = min(low[r], x[n, r])
            high[r] = max(high[r], x[n, r])
            square += v[n, r] * v[n, r]
        fastest = max(fastest, square)
    return np.sqrt(fastest)


@device_function
def plane_of(x: Matrix, corners: Indices, n: Vector) -> float:
    """Fill a triangle's unit normal; return the reciprocal of twice its area."""
    a, b, c = corners[0], corners[1], corners[2]
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    n[0], n[1], n[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    shrink = 1.0 / np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    n[0], n[1], n[2] = shrink * n[0], shrink * n[1], shrink * n[2]
    return shrink


@device_function
def fill_slopes(x: Matrix, corners: Indices, n: Vector, shrink: float, slope: Matrix) -> None:
    """Fill the gradients of the weights of a foot, given what `plane_of` has found."""
    for j in range(3):
        b, c = corners[(j + 1) % 3], corners[(j + 2) % 3]
        ex, ey, ez = shrink * (x[c, 0] - x[b, 0]), shrink * (x[c, 1] - x[b, 1]), shrink * (x[c, 2] - x[b, 2])
        slope[j, 0] = n[1] * ez - n[2] * ey
        slope[j, 1] = n[2] * ex - n[0] * ez
        slope[j, 2] = n[0] * ey - n[1] * ex


@device_function
def fill_weights(x: Matrix, corners: Indices, slope: Matrix, y: Vector, weight: Vector) -> None:
    """Fill the weights of a point's foot."""
    for j in range(3):
        b, weight[j] = corners[(j + 1) % 3], 0.0
        for r in range(3):
            weight[j] += slope[j, r] * (y[r] - x[b, r])


@device_function
def fill_point(x: Matrix, nodes: Indices, weights: Vector, y: Vector) -> None:
    """Fill where a point is that combines three nodes."""
    a, b, c = nodes[0], nodes[1], nodes[2]
    for r in range(3):
        y[r] = weights[0] * x[a, r] + weights[1] * x[b, r] + weights[2] * x[c, r]


@device_function
def distance_of(x: Matrix, corner: int, n: Vector, y: Vector) -> float:
    """Return how far a point is in front of the plane through a corner."""
    return n[0] * (y[0] - x[corner, 0]) + n[1] * (y[1] - x[corner, 1]) + n[2] * (y[2] - x[corner, 2])


@kernel
def _feet(
    x: Matrix, nodes: IndexTable, weights: Matrix, foot: Matrix, normal: Matrix, distance: Vector
) -> None:
    y, slope = small_vector(3), small_matrix(3, 3)
    for e in range(nodes.shape[0]):
        fill_point(x, nodes[e], weights[e], y)
        shrink = plane_of(x, nodes[e, 3:], normal[e])
        fill_slopes(x, nodes[e, 3:], normal[e], shrink, slope)
        fill_weights(x, nodes[e, 3:], slope, y, foot[e])
        distance[e] = distance_of(x, nodes[e, 3], normal[e], y)


def feet(positions: Array, nodes: IntArray, weights: Array) -> tuple[Array, Array, Array]:
    """Return where points lie over triangles: weights of the feet (k, 3), normals (k, 3), distances (k,) [m].

    Args:
        positions: (n, 3) [m].
        nodes: (k, 6), three of each point and of its triangle.
        weights: (k, 3) of the point.
    """
    foot, normal, distance = np.empty((len(nodes), 3)), np.empty((len(nodes), 3)), np.empty(len(nodes))
    _feet(positions, nodes, weights, foot, normal, distance)
    return foot, normal, distance
