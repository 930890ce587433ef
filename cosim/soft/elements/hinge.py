"""Rotational springs on the dihedral angle of interior edges, and their stiffness for bending of the film.

Nodes (i, j, k, l): j-k is the edge, i and l its opposite corners. With u = x_i - x_j, e = x_k - x_j,
w = x_k - x_l, m = u x e, n = e x w the angle is
    theta = atan2(e/|e| . (m x n), m . n)  in [0, 2 pi),   theta = pi where the film is flat,
    energy = k (theta - theta0)^2 / 2  between theta1 and theta2 = 2 pi - theta1.
Beyond them the moment grows as k (theta1 - theta0) - (2 k theta1 / pi) tan(pi (theta1 - theta) / (2 theta1)).
This would be infinite where the two films touch (theta = 0 or 2 pi), and shapes with crossed films would have
no energy. So from x_c theta1 on, a closed fold, the moment continues along its tangent, also beyond
theta = 0; the energy is finite and twice differentiable except for a kink of the tangent at x_c theta1.
Angles are unwrapped: of the angles that fit the shape, that within pi of the last accepted one is used.
A fold that has closed by 0.003 rad too far reads -0.003, not 2 pi - 0.003; one that turns by more than pi at
once reads as one that has turned the other way.
Source: Liu and Paulino, Proc. R. Soc. A 473 (2017) 20170348, equations for theta and the barrier; the
second derivatives are written here in the orthonormal frames of the two triangles.
Energy and gradient are summed in groups, one hinge per lane; neither m nor n is normalised:
    theta = atan2(|e| m . w, m . n),
    a = dtheta/dx_i = |e| m / m^2,   b = dtheta/dx_l = -|e| n / n^2,
    dtheta/dx_j = (alpha - 1) a - beta b,   dtheta/dx_k = (beta - 1) b - alpha a,
alpha = u . e / e^2, beta = w . e / e^2.
Stiffness of hinges that bend like a shell of flexural rigidity D = E t^3 / (12 (1 - nu^2)): bend a flat
triangulated sheet to a cylinder of small curvature kappa along the unit direction n in its plane.
At the hinge of two triangles, with p and q from the edge's nodes to a triangle's far corner,
    theta - pi = kappa (b_i + b_l),   b = (n . p) (n . q) / (2 h),   h the height over the edge.
A hinge represents the area a around its edge: a third of each triangle, more where a triangle has edges
without hinge. The rule asks that, averaged over all n, it stores that area's energy:
    k <(b_i + b_l)^2> / 2 = D a / 2,   <(n . M n)^2> = ((tr M)^2 + 2 tr M^2) / 8 for symmetric M.
For equilateral triangles this is k = D L^2 / (A_i + A_l) = 2 D / sqrt(3), and exact in every direction.
Hinges cannot be isotropic on other triangles: the mean is exact, single directions are off (right-angled
triangles with parallel diagonals: 0.5 to 2, alternating ones: 7/8 to 9/8, the chambers here: 0.92 to 1.08).
k does not depend on the size of the triangles.
Source: form of the energy: Grinspun et al., Discrete shells, SCA 2003; equilateral triangles: Seung and
Nelson, Phys. Rev. A 38 (1988) 1005; the rule by area and mean direction is derived here.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector
from cosim.errors import MeshError
from cosim.soft.elements.element import NODES, ROWS, Call, LeafElement, Remembered, writable
from cosim.soft.geometry.surface import TURN, dihedral_angle, directed_edges, full_angle, triangle_area

CLOSED_FRACTION: Final = 4e-4
"""x_c: below x_c theta1 a fold is closed, its stiffness k (2 / (pi x_c))^2 = 2.5e6 k.

At 1e-2 films passed one another. The folds of the paper's examples stay above 4.5e-4 theta1.
"""
_CLOSED_ARGUMENT = 0.5 * math.pi * (1.0 - CLOSED_FRACTION)
_CLOSED_TANGENT = math.tan(_CLOSED_ARGUMENT)
_CLOSED_STIFFNESS = 1.0 / math.cos(_CLOSED_ARGUMENT) ** 2
_CLOSED_LOGARITHM = math.log(math.cos(_CLOSED_ARGUMENT))


@device_function
def fold_law(angle: float, rest: float, stiffness: float, theta1: float) -> tuple[float, float, float]:
    """Return energy, moment and tangent of one spring, all finite and continuous, also beyond 0 and 2 pi."""
    if theta1 <= 0.0 or theta1 < angle < TURN - theta1:
        return 0.5 * stiffness * (angle - rest) * (angle - rest), stiffness * (angle - rest), stiffness
    # mirror the upper barrier onto the lower one: angle -> 2 pi - angle flips the moment's sign
    sign = 1.0
    if angle > math.pi:
        sign, angle, rest = -1.0, TURN - angle, TURN - rest
    start = theta1 - rest
    scale = 2.0 * theta1 / math.pi
    further = angle - CLOSED_FRACTION * theta1
    if further < 0.0:
        moment = start - scale * _CLOSED_TANGENT
        energy = 0.5 * start * start + start * (angle - further - theta1) - scale * scale * _CLOSED_LOGARITHM
        energy += further * (moment + 0.5 * _CLOSED_STIFFNESS * further)
        moment += _CLOSED_STIFFNESS * further
        return stiffness * energy, sign * stiffness * moment, stiffness * _CLOSED_STIFFNESS
    argument = 0.5 * math.pi * (theta1 - angle) / theta1
    cosine = math.cos(argument)
    moment = stiffness * (start - scale * math.tan(argument))
    energy = stiffness * (0.5 * start * start + start * (angle - theta1) - scale * scale * math.log(cosine))
    return energy, sign * moment, stiffness / (cosine * cosine)


# Quantity q of lane e is at s[q * LANES + e]: constant strides let loops over lanes vectorise.
LANES = 64
U, E, W, A, B, ALPHA, BETA, ANGLE, MOMENT, TANGENT, ENERGY, FORCE = (
    LANES * place for place in (0, 3, 6, 9, 12, 15, 16, 17, 18, 19, 20, 21)
)
QUANTITIES = 33
ROOM = QUANTITIES * LANES


class HingeRows(NamedTuple):
    """Rotational springs, for kernels.

    Args:
        nodes: (h, 4) node indices i, j, k, l.
        stiffness: (h,) [N m/rad].
        rest: (h,) [rad], stress-free angle.
        fold_barrier: theta1 [rad], where the barrier begins; 0 for none.
    """

    nodes: IndexTable
    stiffness: Vector
    rest: Vector
    fold_barrier: float


@device_function
def nodes_of(hinges: IndexTable, h: int) -> tuple[Any, Any, Any, Any]:
    """Return the nodes of a hinge, unsigned, so that no test for negative indices is compiled."""
    i, j, k, m = hinges[h, 0], hinges[h, 1], hinges[h, 2], hinges[h, 3]
    return np.uint64(i), np.uint64(j), np.uint64(k), np.uint64(m)


@device_function
def differentiate(x: Matrix, hinges: IndexTable, first: int, lanes: int, s: Vector) -> None:
    """Fill u, e, w, angle, a, b, alpha and beta of a group; spare lanes repeat the first hinge."""
    for lane in range(LANES):
        h = first + (lane if lane < lanes else 0)
        i, j, k, m = nodes_of(hinges, h)
        for r in range(3):
            s[U + r * LANES + lane] = x[i, r] - x[j, r]
            s[E + r * LANES + lane] = x[k, r] - x[j, r]
            s[W + r * LANES + lane] = x[k, r] - x[m, r]

    for lane in range(LANES):
        u0, u1, u2 = s[U + lane], s[U + LANES + lane], s[U + 2 * LANES + lane]
        e0, e1, e2 = s[E + lane], s[E + LANES + lane], s[E + 2 * LANES + lane]
        w0, w1, w2 = s[W + lane], s[W + LANES + lane], s[W + 2 * LANES + lane]
        m0, m1, m2 = u1 * e2 - u2 * e1, u2 * e0 - u0 * e2, u0 * e1 - u1 * e0
        n0, n1, n2 = e1 * w2 - e2 * w1, e2 * w0 - e0 * w2, e0 * w1 - e1 * w0
        square = e0 * e0 + e1 * e1 + e2 * e2
        length = math.sqrt(square)
        sine = length * (m0 * w0 + m1 * w1 + m2 * w2)
        s[ANGLE + lane] = full_angle(sine, m0 * n0 + m1 * n1 + m2 * n2)
        a = length / (m0 * m0 + m1 * m1 + m2 * m2)
        b = -length / (n0 * n0 + n1 * n1 + n2 * n2)
        s[A + lane], s[A + LANES + lane], s[A + 2 * LANES + lane] = a * m0, a * m1, a * m2
        s[B + lane], s[B + LANES + lane], s[B + 2 * LANES + lane] = b * n0, b * n1, b * n2
        s[ALPHA + lane] = (u0 * e0 + u1 * e1 + u2 * e2) / square
        s[BETA + lane] = (w0 * e0 + w1 * e1 + w2 * e2) / square


@device_function
def load(springs: HingeRows, angles: Remembered, first: int, lanes: int, s: Vector) -> float:
    """Fill a group's unwrapped angles, moments and tangents; return the energy."""
    k, rest_angle, theta1 = springs.stiffness[first:], springs.rest[first:], springs.fold_barrier
    before, after = angles.before[first:], angles.now[first:]
    for lane in range(lanes):
        angle = s[ANGLE + lane]
        beyond = angle - before[lane]
        angle = angle - TURN if beyond > math.pi else angle + TURN if beyond < -math.pi else angle
        after[lane] = s[ANGLE + lane] = angle
        deviation, stiffness = angle - rest_angle[lane], k[lane]
        s[ENERGY + lane], s[MOMENT + lane] = 0.5 * stiffness * deviation * deviation, stiffness * deviation
        s[TANGENT + lane] = stiffness
    total = 0.0
    for lane in range(lanes):
        angle = s[ANGLE + lane]
        if not theta1 < angle < TURN - theta1:
            law = fold_law(angle, rest_angle[lane], k[lane], theta1)
            s[ENERGY + lane], s[MOMENT + lane], s[TANGENT + lane] = law
        total += s[ENERGY + lane]
    return total


# Entry (r, c) of pair p is at h[(9 p + 3 r + c) * _FEW + lane]; pairs ii ji jj ki kj kk li lj lk ll.
_FEW = 16
_ENTRIES = 90 * _FEW
_II, _JI, _JJ, _KI, _KJ, _KK, _LI, _LJ, _LK, _LL = (9 * _FEW * pair for pair in range(10))


@device_function
def _second_derivatives(s: Vector, begin: int, h: Vector) -> None:
    """Fill the second derivatives of the angle."""
    for lane in range(_FEW):
        at = begin + lane
        alpha, beta = s[ALPHA + at], s[BETA + at]
        e0, e1, e2 = s[E + at], s[E + LANES + at], s[E + 2 * LANES + at]
        a0, a1, a2 = s[A + at], s[A + LANES + at], s[A + 2 * LANES + at]
        b0, b1, b2 = s[B + at], s[B + LANES + at], s[B + 2 * LANES + at]
        inverse_square = 1.0 / (e0 * e0 + e1 * e1 + e2 * e2)
        unit = math.sqrt(inverse_square)
        a, b, e = (a0, a1, a2), (b0, b1, b2), (e0 * inverse_square, e1 * inverse_square, e2 * inverse_square)
        p = unit * (e1 * a2 - e2 * a1), unit * (e2 * a0 - e0 * a2), unit * (e0 * a1 - e1 * a0)
        q = unit * (e1 * b2 - e2 * b1), unit * (e2 * b0 - e0 * b2), unit * (e0 * b1 - e1 * b0)
        for c in range(3):
            d_alpha = inverse_square * s[U + c * LANES + at] - 2.0 * alpha * e[c]
            d_beta = inverse_square * s[W + c * LANES + at] + e[c] - 2.0 * beta * e[c]
            for r in range(3):
                entry, mirror = (3 * r + c) * _FEW + lane, (3 * c + r) * _FEW + lane
                first, second = p[r] * a[c] + a[r] * p[c], q[r] * b[c] + b[r] * q[c]
                a_e, b_e = alpha * first - e[r] * a[c], beta * second - e[r] * b[c]
                h[_II + entry] = -first
                h[_JI + mirror] = first - a_e
                h[_KI + mirror] = a_e
                h[_LL + entry] = second
                h[_LK + entry] = b_e - second
                h[_LJ + entry] = -b_e
                h[_KK + entry] = (beta - 1.0) * (b_e - second) + b[r] * d_beta - alpha * a_e - a[r] * d_alpha


@device_function
def _complete(s: Vector, begin: int, h: Vector) -> None:
    """Fill the other second derivatives of the angle by invariance; replace all by those of the energy."""
    for lane in range(_FEW):
        at = begin + lane
        alpha, beta, moment, tangent = s[ALPHA + at], s[BETA + at], s[MOMENT + at], s[TANGENT + at]
        a = s[A + at], s[A + LANES + at], s[A + 2 * LANES + at]
        b = s[B + at], s[B + LANES + at], s[B + 2 * LANES + at]
        j = (
            (alpha - 1.0) * a[0] - beta * b[0],
            (alpha - 1.0) * a[1] - beta * b[1],
            (alpha - 1.0) * a[2] - beta * b[2],
        )
        k = (
            (beta - 1.0) * b[0] - alpha * a[0],
            (beta - 1.0) * b[1] - alpha * a[1],
            (beta - 1.0) * b[2] - alpha * a[2],
        )
        for r in range(3):
            for c in range(3):
                entry, mirror = (3 * r + c) * _FEW + lane, (3 * c + r) * _FEW + lane
                kj = -h[_KI + entry] - h[_LK + mirror] - h[_KK + entry]
                jk = -h[_KI + mirror] - h[_LK + entry] - h[_KK + mirror]
                jj = -h[_JI + entry] - h[_LJ + mirror] - jk
                h[_KJ + entry] = moment * kj + tangent * k[r] * j[c]
                h[_JJ + entry] = moment * jj + tangent * j[r] * j[c]
        for r in range(3):
            for c in range(3):
                entry = (3 * r + c) * _FEW + lane
                h[_II + entry] = moment * h[_II + entry] + tangent * a[r] * a[c]
                h[_JI + entry] = moment * h[_JI + entry] + tangent * j[r] * a[c]
                h[_KI + entry] = moment * h[_KI + entry] + tangent * k[r] * a[c]
                h[_KK + entry] = moment * h[_KK + entry] + tangent * k[r] * k[c]
                h[_LI + entry] = tangent * b[r] * a[c]
                h[_LJ + entry] = moment * h[_LJ + entry] + tangent * b[r] * j[c]
                h[_LK + entry] = moment * h[_LK + entry] + tangent * b[r] * k[c]
                h[_LL + entry] = moment * h[_LL + entry] + tangent * b[r] * b[c]


@device_function
def _add_hessians(s: Vector, first: int, lanes: int, h: Vector, slots: IndexTable, blocks: Blocks) -> None:
    """Add the Hessians of a group of hinges to blocks."""
    for begin in range(0, lanes, _FEW):
        _second_derivatives(s, begin, h)
        _complete(s, begin, h)
        for lane in range(min(_FEW, lanes - begin)):
            for pair in range(10):
                slot, at = slots[first + begin + lane, pair], 9 * _FEW * pair + lane
                if slot >= 0:
                    for r in range(3):
                        for c in range(3):
                            blocks[slot, r, c] += h[at + (3 * r + c) * _FEW]
                else:
                    slot = -1 - slot
                    for r in range(3):
                        for c in range(3):
                            blocks[slot, c, r] += h[at + (3 * r + c) * _FEW]


@device_function
def _add_group(
    x: Matrix, springs: HingeRows, angles: Remembered, first: int, s: Vector, gradient: Matrix
) -> float:
    """Add a group of hinges to gradient; return its energy."""
    lanes = min(LANES, springs.nodes.shape[0] - first)
    differentiate(x, springs.nodes, first, lanes, s)
    energy = load(springs, angles, first, lanes, s)
    for r in range(3):
        for lane in range(LANES):
            moment, alpha, beta = s[MOMENT + lane], s[ALPHA + lane], s[BETA + lane]
            a, b = moment * s[A + r * LANES + lane], moment * s[B + r * LANES + lane]
            s[FORCE + 4 * r * LANES + lane], s[FORCE + (4 * r + 1) * LANES + lane] = a, b
            s[FORCE + (4 * r + 2) * LANES + lane] = (alpha - 1.0) * a - beta * b
            s[FORCE + (4 * r + 3) * LANES + lane] = (beta - 1.0) * b - alpha * a
    for lane in range(LANES):
        if lane == lanes:
            break
        i, j, k, m = nodes_of(springs.nodes, first + lane)
        for r in range(3):
            gradient[i, r] += s[FORCE + 4 * r * LANES + lane]
            gradient[m, r] += s[FORCE + (4 * r + 1) * LANES + lane]
            gradient[j, r] += s[FORCE + (4 * r + 2) * LANES + lane]
            gradient[k, r] += s[FORCE + (4 * r + 3) * LANES + lane]
    return energy


@kernel
def add_hinges(
    x: Matrix, springs: HingeRows, angles: Remembered, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add all hinges to gradient and, if slots is not empty, their Hessian to blocks.

    Angles are unwrapped against those before. Returns the energy [J]. One loop for both, with a branch for
    the Hessian, would take a fifth longer without the Hessian.
    """
    s, count, energy = small_vector(ROOM), springs.nodes.shape[0], 0.0
    if slots.shape[0] == 0:
        for first in range(0, count, LANES):
            energy += _add_group(x, springs, angles, first, s, gradient)
        return energy
    h = small_vector(_ENTRIES)
    for first in range(0, count, LANES):
        energy += _add_group(x, springs, angles, first, s, gradient)
        _add_hessians(s, first, min(LANES, count - first), h, slots, blocks)
    return energy


@final
@dataclass(frozen=True)
class Hinges(LeafElement):
    """All rotational springs of a body; they remember their angles, unwrapped.

    Args:
        nodes: (h, 4) node indices i, j, k, l.
        stiffness: (h,) [N m/rad].
        rest_angle: (h,) [rad], stress-free angle.
        fold_barrier_rad: theta1, where the barrier begins; 0 for none.
    """

    label: ClassVar[str] = "hinges"
    single: ClassVar[bool] = True

    nodes: Annotated[IntArray, NODES]
    stiffness: Annotated[Array, ROWS]
    rest_angle: Annotated[Array, ROWS]
    fold_barrier_rad: float

    @cached_property
    def _bends(self) -> bool:
        """Whether they have a potential: any stiffness or barrier."""
        return bool(self.stiffness.any()) or self.fold_barrier_rad > 0.0

    @property
    def coupled(self) -> IntArray:
        return self.nodes if self._bends else self.nodes[:0]

    def first_memory(self, positions: Array) -> Array:
        return dihedral_angle(positions, self.nodes)

    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call | None:
        if not self._bends:
            return None
        return Call(add_hinges, (self.arrays, memory, slots, gradient, blocks))

    @cached_property
    def arrays(self) -> HingeRows:
        """The springs, for kernels."""
        nodes, stiffness, rest = writable(self.nodes), writable(self.stiffness), writable(self.rest_angle)
        return HingeRows(nodes, stiffness, rest, self.fold_barrier_rad)


def _angle_forms(positions: Array, hinges: IntArray) -> Array:
    """Return M (h, 2, 2) [m]: theta - pi = kappa n . M n, axes along the edge and across it, unfolded."""
    xi, xj, xk, xl = (positions[hinges[:, a]] for a in range(4))
    edge = xk - xj
    length = np.linalg.norm(edge, axis=1)
    along = edge / length[:, None]
    total = np.zeros((len(hinges), 2, 2))
    # unfolded, the second triangle lies on the other side of the edge
    for corner, side in ((xi, 1.0), (xl, -1.0)):
        s = np.einsum("hr,hr->h", corner - xj, along)
        height = np.linalg.norm(corner - xj - s[:, None] * along, axis=1)
        p = np.stack([s, side * height], axis=1)
        q = np.stack([s - length, side * height], axis=1)
        product = np.einsum("ha,hb->hab", p, q)
        total += (product + product.transpose(0, 2, 1)) / (4.0 * height)[:, None, None]
    return total


def mean_square_angle(positions: Array, hinges: IntArray) -> Array:
    """Return <(theta - pi)^2> / kappa^2 (h,) [m^2] of each hinge over all directions of a cylinder.

    Args:
        positions: (n, 3) [m], drawn shape; it need not be flat, each pair of triangles is unfolded.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
    """
    form = _angle_forms(positions, hinges)
    trace = np.trace(form, axis1=1, axis2=2)
    return np.asarray((trace**2 + 2.0 * np.einsum("hab,hab->h", form, form)) / 8.0)


def hinge_areas(positions: Array, triangles: IntArray, hinges: IntArray) -> Array:
    """Return the area (h,) [m^2] that each hinge represents; triangles are divided among their hinges.

    Args:
        positions: (n, 3) [m], drawn shape.
        triangles: (m, 3).
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.

    Raises:
        MeshError: a hinge lies on no edge of the triangles.
    """
    areas = np.zeros(len(hinges))
    if not len(hinges):
        return areas
    number = np.array([len(positions), 1])
    keys = np.sort(hinges[:, 1:3], axis=1) @ number
    order = np.argsort(keys)
    edges = np.sort(directed_edges(triangles), axis=1) @ number
    hinge = order[np.minimum(np.searchsorted(keys[order], edges), len(order) - 1)]
    carried = keys[hinge] == edges
    area_per_hinge = triangle_area(positions, triangles) / np.maximum(carried.reshape(-1, 3).sum(axis=1), 1)
    np.add.at(areas, hinge[carried], np.repeat(area_per_hinge, 3)[carried])
    stray = np.flatnonzero(areas == 0.0)
    if stray.size:
        edge = hinges[stray[0], 1:3].tolist()
        raise MeshError(f"hinge {stray[0]} (edge {edge}) lies on no edge of the triangles")
    return areas


def shell_stiffness(
    positions: Array, triangles: IntArray, hinges: IntArray, rigidity_Nm: Array | float
) -> Array:
    """Return the stiffness (h,) [N m/rad] with which the hinges bend like a shell.

    k = D a / <(theta - pi)^2 / kappa^2>, see the module's text.

    Args:
        positions: (n, 3) [m], drawn shape.
        triangles: (m, 3).
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
        rigidity_Nm: (h,) or one number, D [N m].

    Raises:
        MeshError: a hinge lies on no edge of the triangles.
    """
    return rigidity_Nm * hinge_areas(positions, triangles, hinges) / mean_square_angle(positions, hinges)


def bending_measure(positions: Array, hinges: IntArray, stiffness: Array | float = 1.0) -> float:
    """Return sum k <(theta - pi)^2> / kappa^2 [N m^3], twice the mean cylinder bending energy over kappa^2.

    For a shell it is D times the area. A uniform stiffness keeps it over refinement when it is scaled by
    the ratio of the measures, near 1: a finer mesh has hinges along seams that the coarse one lacks.

    Args:
        positions: (n, 3) [m], drawn shape.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
        stiffness: (h,) or one number [N m/rad].
    """
    return float(np.sum(stiffness * mean_square_angle(positions, hinges)))
