"""Contact of film with film: points of one unit on triangles of another, exactly conservative.

A point y = sum_a w_a x_a presses on the plane of a triangle (x_1, x_2, x_3) with outer unit normal n:

    d = n . (y - x_1),   d(d) = n . (dy - sum_j b_j dx_j)

with b_j the barycentric coordinates of y's foot on the plane: equal and opposite forces along one line, so
that momentum and angular momentum are conserved. With g_j the gradients of b_j in the plane, c = (w, -b) and
G = (0, g) over the six nodes,

    d2(d) / dx_a dx_b = -c_a G_b n^T - c_b n G_a^T - d (G_a . G_b) n n^T.

The energy in d is that of `contact_law`. Film on film is counted from both sides, with half of the stiffness
each: the pressure is the law's stiffness per area times the depth of one film in the other. So two equal
films pressed together behave like each of them on a rigid plane in between, under a law twice as stiff and
half as wide. Friction: u = (1 - m m^T)(y - sum_j a_j x_j + stretch), with m the normal and a the foot at the
start of the step, both frozen; `stretch` remains from earlier slips. Friction forces are equal and opposite
too, but not along one line: a moment of the friction times the distance of y from its foot remains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import (
    device_function,
    inlined,
    kernel,
    small_matrix,
    small_vector,
    unchecked,
    zero_matrix,
    zero_vector,
)
from cosim.soft.contact import contact_law, triangle_foot
from cosim.soft.contact.contact_law import ContactLaw, depth_of, press
from cosim.soft.contact.triangle_foot import distance_of, feet, fill_point, plane_of
from cosim.soft.linear.pattern import PatternRows, add_block, find_block

_NEAR_WIDTHS = 2.0  # distance, in widths of the law, up to which pairs often press in the next solution


@final
@dataclass(frozen=True)
class FilmMemory:
    """Pairs of contact point and unit that press on each other at the end of a step, for the next one.

    Args:
        key: (k,) ascending.
        normal_force: (k,) [N].
        distance: (k,) [m], negative if the point is behind the other film.
        stretch: (k, 3) [m], of the stick springs, world.
    """

    key: Annotated[IntArray, ("k",)]
    normal_force: Annotated[Array, ("k",)]
    distance: Annotated[Array, ("k",)]
    stretch: Annotated[Array, ("k", 3)]

    @property
    def count(self) -> int:
        """Number of points that press."""
        return len(self.key)

    @property
    def normal_force_N(self) -> float:
        """Sum of the normal forces [N] over the points of both films."""
        return float(self.normal_force.cumsum()[-1]) if self.count else 0.0  # in order, as in kernels

    @property
    def depth_m(self) -> float:
        """Depth of the deepest point behind the other film [m]; negative if none is behind."""
        return -float(self.distance.min()) if self.count else 0.0

    def carried(self, motion: Pose) -> FilmMemory:
        """Return the memory moved rigidly by `motion` (world to world)."""
        return FilmMemory(self.key, self.normal_force, self.distance, self.stretch @ motion.rotation.T)


class PairRows(NamedTuple):
    """Points of the film and the triangles they may press on in one step, for kernels.

    Args:
        nodes: (k, 6), three of the point (unused ones have weight 0), three of the triangle.
        weights: (k, 3) of the point.
        stiffness: (k,) [N/m].
        friction: (k,) [N], largest friction force.
        foot: (k, 3) weights of the point's foot on the triangle at the start of the step.
        normal: (k, 3) of the triangle then.
        stretch: (k, 3) [m], of the stick springs then, world.
        spare: (k,) [m], added to the distance, see `contact_law.spare`; negative for frames, whose surface is
            in front of the point.
        widths: (2,) [m], of the law's transitions: pressing, sticking.
        out: (k, 5), filled with normal force [N], distance [m], and the force on the point (3,) [N].
    """

    nodes: IndexTable
    weights: Matrix
    stiffness: Vector
    friction: Vector
    foot: Matrix
    normal: Matrix
    stretch: Matrix
    spare: Vector
    widths: Vector
    out: Matrix

    @classmethod
    def empty(cls, count: int, widths: Array) -> PairRows:
        """Return allocated arrays for `count` pairs, by a law of these widths."""
        numbers = np.empty((count, 3)), np.empty(count), np.empty(count), np.empty((count, 3))
        rest = np.empty((count, 3)), np.empty((count, 3)), np.zeros(count), widths, np.empty((count, 5))
        return cls(np.empty((count, 6), np.int64), *numbers, *rest)


@inlined
def _evaluate(
    x: Matrix, pairs: PairRows, e: int, shape: tuple[Vector, Vector, Matrix], y: Vector
) -> tuple[float, float, float, float]:
    """Fill a pair's normal, and c and G if it has forces; return its distance, energy, E' and E''."""
    n, weight, slope = shape
    nodes, width, stiffness = pairs.nodes[e], pairs.widths[0], pairs.stiffness[e]
    fill_point(x, nodes, pairs.weights[e], y)
    shrink = plane_of(x, nodes[3:], n)
    d = distance_of(x, nodes[3], n, y)
    level, push, rate = press(depth_of(d, width) - pairs.spare[e], width)
    if push != 0.0 or pairs.friction[e] != 0.0:
        triangle_foot.fill_slopes(x, nodes[3:], n, shrink, slope[3:])
        triangle_foot.fill_weights(x, nodes[3:], slope[3:], y, weight[3:])
        for a in range(3):
            weight[a], weight[3 + a] = pairs.weights[e, a], -weight[3 + a]
    return d, stiffness * level, stiffness * push, stiffness * rate


@device_function
def _stick_spring(x: Matrix, pairs: PairRows, e: int, w: Vector, rub: Vector, drag: Matrix) -> float:
    """Fill the nodal weights, force and stiffness of a pair's stick spring; return its energy."""
    rub[:], drag[:] = 0.0, 0.0
    for a in range(3):
        w[a], w[3 + a] = pairs.weights[e, a], -pairs.foot[e, a]
    limit, u = pairs.friction[e], small_vector(3)
    if not limit > 0.0:
        return 0.0
    for r in range(3):
        u[r] = pairs.stretch[e, r]
        for a in range(6):
            u[r] += w[a] * x[pairs.nodes[e, a], r]
    return contact_law.rub(u, pairs.normal[e], limit, pairs.widths[1], rub, drag)


@kernel
def add_pairs(x: Matrix, pairs: PairRows, gradient: Matrix) -> float:
    """Add the gradient of all pairs, and fill the force of each; return the energy [J]."""
    nodes, out, y, n = pairs.nodes, pairs.out, small_vector(3), small_vector(3)
    weight, slope, w = zero_vector(6), zero_matrix(6, 3), zero_vector(6)
    rub, drag, energy = small_vector(3), small_matrix(3, 3), 0.0
    for e in range(nodes.shape[0]):
        d, level, push, _ = _evaluate(x, pairs, e, (n, weight, slope), y)
        energy += level
        if push == 0.0 and pairs.friction[e] == 0.0:
            out[e, 0], out[e, 1], out[e, 2], out[e, 3], out[e, 4] = 0.0, d, 0.0, 0.0, 0.0
            continue
        energy += _stick_spring(x, pairs, e, w, rub, drag)
        out[e, 0], out[e, 1] = push, d
        for r in range(3):
            out[e, 2 + r] = push * n[r] - rub[r]
        for a in range(6):
            for r in range(3):
                gradient[nodes[e, a], r] += w[a] * rub[r] - push * weight[a] * n[r]
    return energy


@kernel
def add_pair_blocks(x: Matrix, pairs: PairRows, wide: PatternRows, used: Indices, blocks: Blocks) -> int:
    """Add the Hessian of all pairs with forces; return the number of blocks that the pattern lacks.

    Few of thousands of near pairs have forces; the others would only fill the factor.

    Args:
        x: (n, 3) [m].
        pairs: see `PairRows`.
        wide: pattern of the blocks.
        used: (b,), filled with 1 for each block of pairs with forces.
        blocks: (b, 3, 3) [N/m], added to.
    """
    nodes, y, n, missing = pairs.nodes, small_vector(3), small_vector(3), 0
    weight, slope, w = zero_vector(6), zero_matrix(6, 3), zero_vector(6)
    rub, k, drag = small_vector(3), small_matrix(3, 3), small_matrix(3, 3)
    for e in range(nodes.shape[0]):
        d, _, push, rate = _evaluate(x, pairs, e, (n, weight, slope), y)
        if push == 0.0 and pairs.friction[e] == 0.0:
            continue
        _stick_spring(x, pairs, e, w, rub, drag)
        for a in range(6):
            for b in range(a + 1):
                slot = find_block(wide, nodes[e, a], nodes[e, b])
                if slot == wide.column.shape[0]:
                    missing += 1
                    continue
                used[slot] = 1
                if (a < 3 and w[a] == 0.0) or (b < 3 and w[b] == 0.0):
                    continue
                outer = rate * weight[a] * weight[b]  # E'' c_a c_b n n^T + E' d2(d), E' = -push
                for r in range(3):
                    outer += push * d * slope[a, r] * slope[b, r]
                for r in range(3):
                    for c in range(3):
                        turning = weight[a] * slope[b, r] * n[c] + weight[b] * n[r] * slope[a, c]
                        k[r, c] = outer * n[r] * n[c] + push * turning + w[a] * w[b] * drag[r, c]
                add_block(blocks, slot if nodes[e, a] >= nodes[e, b] else -1 - slot, k)
    return missing


@device_function
def _work_of(
    before: Matrix, x: Matrix, pairs: PairRows, e: int, pushes: tuple[float, float], n: Vector
) -> float:
    """Return the work of a pair on the film in a step, from its normal forces and its normal at the end."""
    nodes, u0, u1 = pairs.nodes[e], small_vector(3), small_vector(3)
    rub0, rub1, drag = zero_vector(3), zero_vector(3), zero_matrix(3, 3)
    slope, foot, y, start_motion, end_motion = small_matrix(3, 3), small_vector(3), small_vector(3), 0.0, 0.0
    if pushes[1] != 0.0:
        fill_point(x, nodes, pairs.weights[e], y)
        triangle_foot.fill_slopes(x, nodes[3:], n, plane_of(x, nodes[3:], n), slope)
        triangle_foot.fill_weights(x, nodes[3:], slope, y, foot)
    for r in range(3):
        u0[r] = u1[r] = pairs.stretch[e, r]
        for a in range(3):
            u0[r] += pairs.weights[e, a] * before[nodes[a], r] - pairs.foot[e, a] * before[nodes[3 + a], r]
            u1[r] += pairs.weights[e, a] * x[nodes[a], r] - pairs.foot[e, a] * x[nodes[3 + a], r]
        from_start_foot = from_end_foot = (
            u1[r] - u0[r]
        )  # motion of the point relative to its foot at the start, and at the end
        if pushes[1] != 0.0:
            for a in range(3):
                corner_motion = x[nodes[3 + a], r] - before[nodes[3 + a], r]
                from_end_foot += (pairs.foot[e, a] - foot[a]) * corner_motion
        start_motion += pairs.normal[e, r] * from_start_foot
        end_motion += n[r] * from_end_foot
    work = pushes[0] * start_motion + pushes[1] * end_motion
    if pairs.friction[e] > 0.0:
        went0, went1, went2 = u1[0] - u0[0], u1[1] - u0[1], u1[2] - u0[2]
        contact_law.rub(u0, pairs.normal[e], pairs.friction[e], pairs.widths[1], rub0, drag)
        contact_law.rub(u1, pairs.normal[e], pairs.friction[e], pairs.widths[1], rub1, drag)
        work -= (rub0[0] + rub1[0]) * went0 + (rub0[1] + rub1[1]) * went1 + (rub0[2] + rub1[2]) * went2
    return 0.5 * work


@kernel
def end_pairs(
    before: Matrix, x: Matrix, pairs: PairRows, resting: bool, pressing: Indices, ends: Matrix
) -> tuple[int, float]:
    """Fill the memory of the pairs that press at the end of a step.

    Args:
        before: (n, 3) [m], nodes at the start, for which the pairs were found.
        x: (n, 3) [m], nodes at the end.
        pairs: k.
        resting: whether all stick springs are slack, as at the start of a motion; otherwise their stretch is
            updated: in the plane, at most `stick`.
        pressing: (k,), its first entries are filled with the pairs that press.
        ends: (k, 5), filled with normal force [N], distance [m] and stretch (3,) [m] of these.

    Returns:
        Number of pairs that press, and the work [J] of all pairs on the film in the step, by the mean of the
        forces at start and end.
    """
    y, n, count, width, work = small_vector(3), small_vector(3), 0, pairs.widths[0], 0.0
    for e in range(pairs.nodes.shape[0]):
        nodes, weights, spare, k = pairs.nodes[e], pairs.weights[e], pairs.spare[e], pairs.stiffness[e]
        fill_point(before, nodes, weights, y)
        first = distance_of(before, nodes[3], pairs.normal[e], y)
        fill_point(x, nodes, weights, y)
        plane_of(x, nodes[3:], n)
        last = distance_of(x, nodes[3], n, y)
        pushes = (
            k * press(depth_of(first, width) - spare, width)[1],
            k * press(depth_of(last, width) - spare, width)[1],
        )
        if pushes[0] != 0.0 or pushes[1] != 0.0 or pairs.friction[e] > 0.0:
            work += _work_of(before, x, pairs, e, pushes, n)
        if not pushes[1] > 0.0:
            continue
        stretch = ends[count, 2:]
        pressing[count], ends[count, 0], ends[count, 1] = e, pushes[1], last + min(spare, 0.0)
        for r in range(3):
            stretch[r] = 0.0 if resting else pairs.stretch[e, r]
            for a in range(0 if resting else 3):
                stretch[r] += weights[a] * x[nodes[a], r] - pairs.foot[e, a] * x[nodes[3 + a], r]
        if not resting:
            contact_law.shorten(stretch, pairs.normal[e], pairs.widths[1])
        count += 1
    return count, work


@final
@dataclass(frozen=True)
class FilmPairs:
    """The possible pairs of self-contact in one step.

    Args:
        key: (k,) ascending; identifies the pair of point and unit.
        triangle: (k,) under the point.
        rows: arguments for kernels.
    """

    key: IntArray
    triangle: IntArray
    rows: PairRows

    @classmethod
    def slack(
        cls, key: IntArray, triangle: IntArray, nodes: IntArray, weights: Array, stiffness: Array,
        law: ContactLaw, positions: Array,
    ) -> FilmPairs:  # fmt: skip
        """Return pairs without friction; arguments are fields of `FilmPairs` and `PairRows`.

        Args:
            key: (k,).
            triangle: (k,).
            nodes: (k, 6).
            weights: (k, 3).
            stiffness: (k,) [N/m].
            law: between films.
            positions: (n, 3) [m], at the start of the step.
        """
        foot, normal, _ = feet(positions, nodes, weights)
        friction, stretch, out = np.zeros(len(key)), np.zeros((len(key), 3)), np.empty((len(key), 5))
        pair = nodes, weights, stiffness, friction
        rows = PairRows(*pair, foot, normal, stretch, np.zeros(len(key)), law.widths, out)
        return cls(key, triangle, rows)

    def __len__(self) -> int:
        return len(self.key)

    @property
    def acting(self) -> IntArray:
        """Nodes (j, 6) of the pairs with forces at the last evaluation."""
        return self.rows.nodes[(self.rows.out[:, 0] > 0.0) | (self.rows.friction > 0.0)]

    @property
    def near(self) -> IntArray:
        """Nodes (j, 6) of the pairs with forces, or nearly so, at the last evaluation."""
        distance, widths = self.rows.out[:, 1], self.rows.widths
        acting = (self.rows.out[:, 0] > 0.0) | (self.rows.friction > 0.0)
        return self.rows.nodes[acting | (np.abs(distance) < _NEAR_WIDTHS * widths[0])]

    def end(self, before: Array, positions: Array) -> tuple[FilmMemory | None, float]:
        """Return the memory of the pairs that press, None for none, and the work [J] of all pairs.

        Args:
            before: (n, 3) [m], at the start of the step, for which the pairs were found.
            positions: (n, 3) [m], at its end.
        """
        return self._ended(before, positions, resting=False)

    def memory(self, positions: Array, *, resting: bool = False) -> FilmMemory | None:
        """Return the memory of the pairs that press at the end of a step; None for none.

        Args:
            positions: (n, 3) [m], at the end.
            resting: whether all stick springs are slack, as at the start of a motion.
        """
        return self._ended(positions, positions, resting=resting)[0]

    def _ended(self, before: Array, x: Array, *, resting: bool) -> tuple[FilmMemory | None, float]:
        pressing, ends = np.empty(len(self), np.int64), np.empty((len(self), 5))
        count, work_J = unchecked(end_pairs)(before, x, self.rows, resting, pressing, ends)
        if not count:
            return None, work_J
        rows, key = ends[:count], self.key[pressing[:count]]
        return FilmMemory(key, rows[:, 0].copy(), rows[:, 1].copy(), rows[:, 2:].copy()), work_J

    def holding(self, positions: Array, slack: float, reach_m: float) -> Mask:
        """Return which pairs (k,) are still valid: foot in the triangle up to `slack`, distance in reach."""
        foot, _, distance = feet(positions, self.rows.nodes, self.rows.weights)
        inside = (foot[:, 0] >= -slack) & (foot[:, 1] >= -slack) & (foot[:, 2] >= -slack)
        return np.asarray(inside & (np.abs(distance) < reach_m))
