"""Kernels of rings of beams: equilibrium of their nodes' rotations, gradient, tangent, strain.

A ring of m nodes has 3 m unknown rotations. For given positions they minimise the energy of its beams, by
Newton's method with a line search from given quaternions, shifted where the tangent is not positive definite,
and led away from saddles, such as that of a flat ring whose beams buckle. The factor is reused while steps
shrink well, in dynamics across time steps, in statics within a solution. The search ends when the remaining
error, estimated from the shrinking steps, is below a small angle. All of it is in axes of the ring, set by
three of its nodes, so that a rigid motion changes nothing. The matrix of a closed ring couples each node with
itself and its two neighbours. In the order 0, 1, m - 1, 2, m - 2, ..., neighbours are at most two apart, so
that the matrix is a band: with three unknowns a node, row i reaches back to column i - 8. A band (3 m, 9)
holds entry (i, j), i - 8 <= j <= i, at [i, i - j]; in a factor, the diagonal is reciprocal.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Cubes, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import allocating, device_function, kernel, small_matrix
from cosim.soft.beams import beam
from cosim.soft.beams.beam import BeamWork, differentiate, dot, fill_hessians, lane_of, three
from cosim.soft.elements.element import Remembered
from cosim.soft.linear.pattern import add_block


@device_function
def fill_axes(x: Matrix, ring: Indices, axes: Matrix) -> None:
    """Fill the axes (3, 3), as columns, laid through three nodes of a ring (m,)."""
    count = ring.shape[0]
    first, second, third = ring[0], ring[count // 3], ring[2 * count // 3]
    for r in range(3):
        axes[r, 0], axes[r, 1] = x[second, r] - x[first, r], x[third, r] - x[first, r]
    _cross_columns(axes, 0, 1, 2)
    for c in (0, 2):
        size = math.sqrt(axes[0, c] ** 2 + axes[1, c] ** 2 + axes[2, c] ** 2)
        for r in range(3):
            axes[r, c] /= size
    _cross_columns(axes, 2, 0, 1)


@device_function
def _cross_columns(axes: Matrix, a: int, b: int, into: int) -> None:
    for r in range(3):
        p, q = (r + 1) % 3, (r + 2) % 3
        axes[r, into] = axes[p, a] * axes[q, b] - axes[q, a] * axes[p, b]


@device_function
def place_step(lanes: Vector, places: Indices, step: Vector) -> None:
    """Copy a step to the groups."""
    for n in range(lanes.shape[0] // beam.SIZE * beam.LANES):
        e = min(n, places.shape[0] - 2)
        s, begin, end = lanes[lane_of(n) :], step[places[e] :], step[places[e + 1] :]
        for r in range(3):
            s[beam.STEP + r * beam.LANES], s[beam.SECOND + beam.STEP + r * beam.LANES] = begin[r], end[r]


@device_function
def accept(s: Vector) -> None:
    """Accept the trial quaternions as the turns."""
    for first in range(0, s.shape[0], beam.SIZE):
        for k in range(4 * beam.LANES):
            s[first + beam.TURNS + k] = s[first + beam.TRIAL + k]
        for k in range(4 * beam.LANES):
            s[first + beam.SECOND + beam.TURNS + k] = s[first + beam.SECOND + beam.TRIAL + k]


_STEPS_MAX = 100
_HALVINGS_MAX = 12
_LARGEST_TURN = 0.5  # [rad] in one step
SMALL_TURN: Final = 1e-11
SMALL_TURN_REUSED: Final = 1e-12
"""In statics with a reused factor: each step shrinks by a constant factor, not quadratically."""
SMALL_TURN_IN_MOTION: Final = 3e-9
"""In steps in time, where only forces matter: for a beam of 4 mm x 2.5 GPa, 25 mm long, it is 4e-7 N."""
_STUCK_TURN = 1e-3
_POWERS = 8
_UNSTABLE_TURN = 0.02
_SHRINKS = 0.03  # a new factor takes as long as about three steps
_ROUNDED_TURN = 1e-8  # its change of the energy is below rounding


class BeamArrays(NamedTuple):
    """The beams of all rings.

    Args:
        rings: (f, m) nodes.
        directors: (f, m, 3, 3), d1, d2, d3 of the beam from each node to the next, in axes of the ring.
        lengths: (f, m) [m], drawn.
        rigidities: (4,), see `RectangularSection`.
        moving: whether they are in a step in time, where only forces matter.
    """

    rings: IndexTable
    directors: Cubes
    lengths: Matrix
    rigidities: Vector
    moving: bool = False


class RingWork(NamedTuple):
    """Scratch of one ring of m nodes; turns are in the order of the band.

    Args:
        axes: (3, 3), of the ring, as columns.
        places: (m + 1,), where the turn of each node begins; the last is the first.
        lanes: its beams in groups, see `beam`; spare lanes repeat the last beam.
        moment: (3 m,) [N m], derivative by the turns.
        band: (3 m, 9), of second derivatives by the turns.
        factor: (3 m, 9), its Cholesky factor.
        step: (3 m,).
        beams: scratch for their Hessians.
    """

    axes: Array
    places: IntArray
    lanes: Array
    moment: Array
    band: Array
    factor: Array
    step: Array
    beams: BeamWork


@allocating
def ring_work(m: int) -> RingWork:
    """Return the scratch of rings of m nodes; entries that are never written are zero."""
    places = np.empty(m + 1, np.int64)
    for i in range(m + 1):
        places[i] = 3 * place_in_band(i % m, m)
    beams = BeamWork(
        np.empty((m, 2, 3, 3)), np.empty((m, 9)), np.empty((m, 3)), np.empty((m, 2, 2)), np.empty((m, 2, 3)),
        np.empty((m, 9)), np.zeros((m, 9, 9)), np.zeros((m, 9, 9)), np.empty((m, 9, 9)), np.empty(3),
        np.empty((9, 9)),
    )  # fmt: skip
    return RingWork(
        np.empty((3, 3)), places, np.empty((m + beam.LANES - 1) // beam.LANES * beam.SIZE), np.empty(3 * m),
        np.empty((3 * m, BAND)), np.empty((3 * m, BAND)), np.empty(3 * m), beams,
    )  # fmt: skip


@device_function
def _sum_beams(beams: BeamArrays, f: int, w: RingWork, fraction: float, hessian: bool, whole: bool) -> float:
    """Sum all beams after the step's fraction, with `hessian` also the band; return the energy [J].

    The Hessian of each beam is filled as well: wholly, or only the derivatives by turns.
    """
    band, moment, energy = w.band, w.moment, 0.0
    for first in range(0, w.lanes.shape[0], beam.SIZE):
        differentiate(beams.rigidities, w.lanes[first : first + beam.SIZE], fraction)
    for i in range(moment.shape[0]):
        moment[i] = 0.0
    for e in range(w.places.shape[0] - 1):
        s, begin, end = w.lanes[lane_of(e) :], moment[w.places[e] :], moment[w.places[e + 1] :]
        energy += s[beam.ENERGY]
        for r in range(3):
            begin[r] += s[beam.MOMENT + r * beam.LANES]
            end[r] += s[beam.SECOND + beam.MOMENT + r * beam.LANES]
    if not hessian:
        return energy
    fill_hessians(beams.rigidities, beams.lengths[f], w.lanes, w.beams, whole)
    band[:] = 0.0
    for e in range(w.beams.hessian.shape[0]):
        h, first, second = w.beams.hessian[e], w.places[e], w.places[e + 1]
        for r in range(3):
            for c in range(r + 1):
                band[first + r, r - c] += h[3 + r, 3 + c]
                band[second + r, r - c] += h[6 + r, 6 + c]
            for c in range(3):
                if second > first:
                    band[second + r, second + r - first - c] += h[6 + r, 3 + c]
                else:
                    band[first + r, first + r - second - c] += h[3 + r, 6 + c]
    return energy


@device_function
def _fill_step(factor: Matrix, moment: Vector, step: Vector) -> tuple[float, float]:
    """Fill the step from the factor; return its largest entry and the energy's slope along it."""
    for i in range(step.shape[0]):
        step[i] = -moment[i]
    forward(factor, step)
    slope, largest = 0.0, 0.0
    for i in range(step.shape[0]):
        slope -= step[i] * step[i]
    backward(factor, step)
    for i in range(step.shape[0]):
        largest = max(largest, abs(step[i]))
    return largest, slope


@device_function
def _fill_unstable_step(w: RingWork) -> tuple[float, float]:
    """Fill a step along the most negative curvature, away from a saddle; return the same as `_fill_step`."""
    for i in range(w.step.shape[0]):
        w.step[i] = 1.0 + 0.1 * (i % 7)  # along no symmetry
    for _ in range(_POWERS):
        forward(w.factor, w.step)
        backward(w.factor, w.step)
        largest = 0.0
        for i in range(w.step.shape[0]):
            largest = max(largest, abs(w.step[i]))
        for i in range(w.step.shape[0]):
            w.step[i] *= _UNSTABLE_TURN / largest
    slope = np.dot(w.moment, w.step)
    if slope > 0.0:
        for i in range(w.step.shape[0]):
            w.step[i] = -w.step[i]
    return _UNSTABLE_TURN, -abs(slope)


@device_function
def balance_turns(beams: BeamArrays, f: int, w: RingWork, hessian: bool, small: float, reused: bool) -> float:
    """Find the turns of ring f in equilibrium, from the present ones; return the energy [J], or infinity.

    Afterwards `w` holds the turns and the first derivatives there; with `hessian` also the second derivatives
    and the factor of those by turns. The search ends at an error of `small` [rad]; with `reused` it starts
    with the factor in `w`.
    """
    stiffest = 0.0
    for e in range(beams.lengths.shape[1]):
        stiffest = max(stiffest, (beams.rigidities[1] + beams.rigidities[2]) / beams.lengths[f, e])
    w.step[:] = 0.0
    place_step(w.lanes, w.places, w.step)
    energy, shift, last = _sum_beams(beams, f, w, 0.0, not reused, hessian), 0.0, 1.0
    fresh, converged = not reused, False
    for _ in range(_STEPS_MAX):
        if fresh:
            shift = 0.0
            while not factorise(w.band, shift, w.factor):
                shift = max(4.0 * shift, 1e-3 * stiffest)
                if not shift < 1e9 * stiffest:
                    return np.inf
        if converged and shift == 0.0:
            return energy
        largest, slope = _fill_step(w.factor, w.moment, w.step)
        if not hessian and shift == 0.0 and largest < small:
            return energy
        if shift > 0.0 and largest < _STUCK_TURN:
            largest, slope = _fill_unstable_step(w)
        fraction, before = min(1.0, _LARGEST_TURN / max(largest, 1e-300)), energy
        shrinks = reused or (largest < _SHRINKS * last and shift == 0.0)
        if reused:  # its convergence is not known yet
            last, reused = max(largest, 1e-300) / _SHRINKS, False
        # a factor that converges well is reused; the remaining error shrinks as the steps do
        converged = shift == 0.0 and largest * min(1.0, largest / last) < small
        fresh = (converged and hessian) if shrinks or converged else True
        place_step(w.lanes, w.places, w.step)
        for _ in range(_HALVINGS_MAX):
            energy = _sum_beams(beams, f, w, fraction, fresh, hessian)
            lower = energy <= before + 1e-4 * fraction * slope + 1e-12 * before
            if lower or largest < _ROUNDED_TURN:
                break
            fraction, fresh, converged = 0.5 * fraction, True, False
        last = max(largest, 1e-300)
        accept(w.lanes)
        if converged and not fresh:
            return energy
    return np.inf


BAND: Final = 9


@device_function
def place_in_band(node: int, count: int) -> int:
    """Return the position in the band of a node, of a ring of `count` nodes."""
    if node == 0:
        return 0
    return 2 * node - 1 if 2 * node <= count else 2 * (count - node)


@device_function
def factorise(band: Matrix, shift: float, factor: Matrix) -> bool:
    """Fill factor with L, L L^T = band + shift 1; return whether that is positive definite."""
    for i in range(band.shape[0]):
        for j in range(max(0, i - BAND + 1), i + 1):
            value = band[i, i - j]
            for k in range(max(0, i - BAND + 1), j):
                value -= factor[i, i - k] * factor[j, j - k]
            if i > j:
                factor[i, i - j] = value * factor[j, 0]
            else:
                value += shift
                if not value > 0.0:
                    return False
                factor[i, 0] = 1.0 / math.sqrt(value)
    return True


@device_function
def _lower(factor: Matrix, values: Vector, i: int, reach: int) -> float:
    """Solve row i of L for its value, with `reach` rows before it."""
    row, before, value = factor[i], values[i - reach :], values[i]
    for k in range(reach):
        value -= row[reach - k] * before[k]
    return value * row[0]


@device_function
def _upper(factor: Matrix, values: Vector, i: int, reach: int) -> float:
    """Solve row i of L^T for its value, with `reach` rows after it."""
    rows, after, value = factor[i:], values[i:], values[i]
    for k in range(reach, 0, -1):
        value -= rows[k, k] * after[k]
    return value * rows[0, 0]


@device_function
def forward(factor: Matrix, values: Vector) -> None:
    """Replace values (3 m,) by L^-1 values."""
    for i in range(BAND - 1):
        values[i] = _lower(factor, values, i, i)
    for i in range(BAND - 1, factor.shape[0]):  # rows of constant length, whose loop is unrolled
        values[i] = _lower(factor, values, i, BAND - 1)


@device_function
def backward(factor: Matrix, values: Vector) -> None:
    """Replace values (3 m,) by L^-T values."""
    rows = factor.shape[0]
    for i in range(rows - 1, rows - BAND, -1):
        values[i] = _upper(factor, values, i, rows - 1 - i)
    for i in range(rows - BAND, -1, -1):
        values[i] = _upper(factor, values, i, BAND - 1)


REMEMBERED: Final = 4 + 3 * BAND
"""Numbers per node in the memory of a ring: first all turns, then the factor of the tangent by turns."""


@device_function
def _read_memory(x: Matrix, beams: BeamArrays, f: int, memory: Vector, w: RingWork) -> bool:
    """Fill geometry, turns and factor of ring f from its memory; return whether it has a factor."""
    ring, count, factor = beams.rings[f], beams.rings.shape[1], w.factor.reshape(w.factor.size)
    start = REMEMBERED * f * count
    fill_axes(x, ring, w.axes)
    for n in range(w.lanes.shape[0] // beam.SIZE * beam.LANES):
        e = min(n, count - 1)
        following = e + 1 if e + 1 < count else 0
        s, directors, length = w.lanes[lane_of(n) :], beams.directors[f, e], beams.lengths[f, e]
        near_node, far_node = x[np.uint64(ring[e])], x[np.uint64(ring[following])]
        chord = far_node[0] - near_node[0], far_node[1] - near_node[1], far_node[2] - near_node[2]
        s[beam.DRAWN_LENGTH], s[beam.LENGTH] = length, math.sqrt(dot(chord, chord))
        inverse_length = 1.0 / s[beam.LENGTH]
        for c in range(3):
            along = w.axes[0, c] * chord[0] + w.axes[1, c] * chord[1] + w.axes[2, c] * chord[2]
            s[beam.DIRECTION + c * beam.LANES] = inverse_length * along
            for k in range(3):
                s[beam.DRAWN + (3 * k + c) * beam.LANES] = directors[k, c]
        begin, end = memory[start + 4 * e :], memory[start + 4 * following :]
        for r in range(4):
            s[beam.TURNS + r * beam.LANES], s[beam.SECOND + beam.TURNS + r * beam.LANES] = begin[r], end[r]
    for i in range(factor.shape[0]):
        factor[i] = memory[start + 4 * count + i]
    return factor[0] > 0.0


@device_function
def _fill_matrix(w: RingWork, mixed: Matrix, matrix: Matrix) -> None:
    """Fill matrix (3 m, 3 m) = E_xx - E_xR E_RR^-1 E_Rx in axes of the ring; mixed (3 m, 3 m) is scratch."""
    count = w.beams.hessian.shape[0]
    matrix[:] = 0.0
    mixed[:] = 0.0
    for e in range(count):
        h, ends = w.beams.hessian[e], (e, (e + 1) % count)
        for a in range(2):
            for b in range(2):
                sign = 1.0 if a == b else -1.0
                for r in range(3):
                    for c in range(3):
                        matrix[3 * ends[a] + r, 3 * ends[b] + c] += sign * h[r, c]
                sign = 1.0 if b == 1 else -1.0
                row = 3 * place_in_band(ends[a], count)
                for r in range(3):
                    for c in range(3):
                        mixed[row + r, 3 * ends[b] + c] += sign * h[3 + 3 * a + r, c]
    factor = w.factor
    for i in range(factor.shape[0]):  # L^-1 times the columns
        for k in range(max(0, i - BAND + 1), i):
            for c in range(mixed.shape[1]):
                mixed[i, c] -= factor[i, i - k] * mixed[k, c]
        for c in range(mixed.shape[1]):
            mixed[i, c] *= factor[i, 0]
    for k in range(3 * count):
        for i in range(3 * count):
            for j in range(i + 1):
                matrix[i, j] -= mixed[k, i] * mixed[k, j]


@device_function
def _add_matrix(w: RingWork, slots: Indices, matrix: Matrix, blocks: Blocks) -> None:
    """Add the lower triangle of a matrix in axes of the ring to blocks in world axes."""
    axes, count = w.axes, w.beams.hessian.shape[0]
    block, half = small_matrix(3, 3), small_matrix(3, 3)
    for a in range(count):
        for b in range(a + 1):
            for r in range(3):
                for c in range(3):
                    half[r, c] = 0.0
                    for k in range(3):
                        i, j = 3 * a + k, 3 * b + c
                        half[r, c] += axes[r, k] * (matrix[i, j] if i >= j else matrix[j, i])
            for r in range(3):
                for c in range(3):
                    block[r, c] = half[r, 0] * axes[c, 0] + half[r, 1] * axes[c, 1] + half[r, 2] * axes[c, 2]
            add_block(blocks, slots[a * (a + 1) // 2 + b], block)


@kernel(allocates=True)
def add_beam_rings(
    x: Matrix, beams: BeamArrays, memory: Remembered, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add all rings to gradient and, if slots is not empty, their Hessian to blocks.

    The search for the turns starts from those in memory (REMEMBERED f m,), and without a Hessian also with
    the factor there, if any; its tolerance is larger in a step in time. The result is stored in the memory.
    Returns the energy [J]; infinity if no turns in equilibrium are found.
    """
    count, with_hessian = beams.rings.shape[1], slots.shape[0] > 0
    w, energy = ring_work(count), 0.0
    size = 3 * count if with_hessian else 0
    mixed, matrix = np.empty((size, size)), np.empty((size, size))
    for f in range(beams.rings.shape[0]):
        has_factor = _read_memory(x, beams, f, memory.before, w)
        reused = has_factor and not with_hessian
        small = SMALL_TURN_IN_MOTION if beams.moving else SMALL_TURN_REUSED if reused else SMALL_TURN
        energy += balance_turns(beams, f, w, with_hessian, small, reused)
        if not energy < np.inf:
            return np.inf
        for i in range(count):
            node, next_node = beams.rings[f, i], beams.rings[f, (i + 1) % count]
            beam_force = three(w.lanes, beam.FORCE + lane_of(i))
            for r in range(3):
                force = (
                    w.axes[r, 0] * beam_force[0] + w.axes[r, 1] * beam_force[1] + w.axes[r, 2] * beam_force[2]
                )
                gradient[node, r] -= force
                gradient[next_node, r] += force
        kept_factor, start = w.factor.reshape(w.factor.size), REMEMBERED * f * count
        for e in range(count):
            for r in range(4):
                memory.now[start + 4 * e + r] = w.lanes[lane_of(e) + beam.TURNS + r * beam.LANES]
        for i in range(kept_factor.shape[0]):
            memory.now[start + 4 * count + i] = kept_factor[i]
        if with_hessian:
            _fill_matrix(w, mixed, matrix)
            _add_matrix(w, slots[f], matrix, blocks)
    return energy


@kernel(allocates=True)
def peak_strains(x: Matrix, beams: BeamArrays, width: float, height: float, memory: Vector) -> Matrix:
    """Return the largest strain (f, m) of each beam's fibres, at its ends; NaN if no equilibrium is found."""
    count = beams.rings.shape[1]
    w, strains = ring_work(count), np.empty(beams.rings.shape)
    no = count < 0  # a literal False has a separate type, for which kernels would be compiled again
    for f in range(beams.rings.shape[0]):
        _read_memory(x, beams, f, memory, w)
        balanced = balance_turns(beams, f, w, no, SMALL_TURN, no) < np.inf
        for e in range(count):
            at, bent = lane_of(e), 0.0
            for a in range(2):
                this_end, other_end = beam.BENT + a * beam.SECOND + at, beam.BENT + (1 - a) * beam.SECOND + at
                in_plane = width * abs(2.0 * w.lanes[this_end] + w.lanes[other_end])
                across = height * abs(2.0 * w.lanes[this_end + beam.LANES] + w.lanes[other_end + beam.LANES])
                bent = max(bent, (in_plane + across) / beams.lengths[f, e])
            strains[f, e] = abs(w.lanes[beam.STRAIN + at]) + bent if balanced else np.nan
    return strains


@kernel(allocates=True)
def ring_axes(x: Matrix, rings: IndexTable) -> Blocks:
    """Return the axes (f, 3, 3) of all rings, as columns."""
    axes = np.empty((rings.shape[0], 3, 3))
    for f in range(rings.shape[0]):
        fill_axes(x, rings[f], axes[f])
    return axes
