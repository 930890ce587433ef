"""The turns of a ring's nodes that are in balance at given positions: a small Newton's method.

A ring of m nodes has 3 m unknown turns. Given the positions, the energy of its beams has a minimum in them;
it is followed from given quaternions by Newton's method with a line search, shifted where the tangent is not
positive definite, and led away from saddles, such as that of a flat ring whose beams buckle. The factor is
kept while steps shrink well, in dynamics from one step in time to the next; the search ends where what the
last step leaves is below a small turn, judged by how the steps shrink. All of it happens in axes of the ring,
laid through three of its nodes, so that a rigid motion changes nothing.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import CUBES, INDEX_TABLE, MATRIX, VECTOR, allocating, device_function
from cosim.soft.beams.band_cholesky import BAND, backward, factorise, forward, place_in_band
from cosim.soft.beams.beam import beam_energies

_STEPS_MAX = 100
_HALVINGS_MAX = 12
_LARGEST_TURN = 0.5  # [rad] in one step
SMALL_TURN: Final = 1e-11
SMALL_TURN_IN_MOTION: Final = 3e-9
"""Where steps in time ask for newtons alone: a beam of 4 mm x 2.5 GPa, 25 mm long, answers with 4e-7 N."""
_STUCK_TURN = 1e-3
_POWERS = 8
_UNSTABLE_TURN = 0.02
_SHRINKS = 0.03  # a new factor takes as long as some three steps
_ROUNDED_TURN = 1e-8  # what it changes of the energy is lost in rounding


class BeamArrays(NamedTuple):
    """The beams of all rings.

    Args:
        rings: (f, m) nodes.
        directors: (f, m, 3, 3), d1, d2, d3 of the beam from each node to the next, in axes of the ring.
        lengths: (f, m) [m], drawn.
        rigidities: (4,), see `RectangularSection`.
    """

    rings: IntArray
    directors: Array
    lengths: Array
    rigidities: Array


BEAM_ARRAYS = types.NamedTuple((INDEX_TABLE, CUBES, MATRIX, VECTOR), BeamArrays)


class RingWork(NamedTuple):
    """Scratch of one ring of m nodes; turns are in the order of the band.

    Args:
        axes: (3, 3), of the ring, as columns.
        positions: (m, 3) [m], in them.
        turns: (m, 4), quaternions of the nodes, in them.
        trial: (m, 4), the same after a step.
        rotations: (m, 3, 3), that belong to `trial`.
        moment: (3 m,) [N m], derivative by the turns.
        band: (3 m, 9), of second derivatives by the turns.
        factor: (3 m, 9), its Cholesky factor.
        step: (3 m,).
    """

    axes: Array
    positions: Array
    turns: Array
    trial: Array
    rotations: Array
    moment: Array
    band: Array
    factor: Array
    step: Array


@allocating
def ring_work(m):  # type: ignore[no-untyped-def]
    """Return the scratch of rings of m nodes."""
    return RingWork(
        np.empty((3, 3)), np.empty((m, 3)), np.empty((m, 4)), np.empty((m, 4)), np.empty((m, 3, 3)),
        np.empty(3 * m), np.empty((3 * m, BAND)), np.empty((3 * m, BAND)), np.empty(3 * m),
    )  # fmt: skip


@device_function
def fill_axes(x, ring, axes):  # type: ignore[no-untyped-def]
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
def _cross_columns(axes, a, b, into):  # type: ignore[no-untyped-def]
    for r in range(3):
        p, q = (r + 1) % 3, (r + 2) % 3
        axes[r, into] = axes[p, a] * axes[q, b] - axes[q, a] * axes[p, b]


@device_function
def place_ring(x, ring, w):  # type: ignore[no-untyped-def]
    """Fill axes and positions of a ring (m,)."""
    fill_axes(x, ring, w.axes)
    for i in range(ring.shape[0]):
        for c in range(3):
            w.positions[i, c] = 0.0
            for r in range(3):
                w.positions[i, c] += w.axes[r, c] * (x[ring[i], r] - x[ring[0], r])


@device_function
def _turn_by(w, fraction):  # type: ignore[no-untyped-def]
    """Fill the trial quaternions and rotations: the step's fraction after the turns that there are."""
    count = w.turns.shape[0]
    for i in range(count):
        at = 3 * place_in_band(i, count)
        half = 0.5 * fraction
        a, b, c = half * w.step[at], half * w.step[at + 1], half * w.step[at + 2]
        q0, q1, q2, q3 = w.turns[i, 0], w.turns[i, 1], w.turns[i, 2], w.turns[i, 3]
        # tan(angle / 2) = |step| / 2: as good as the angle itself, which is a step of Newton's method
        p0 = q0 - a * q1 - b * q2 - c * q3
        p1 = q1 + a * q0 + b * q3 - c * q2
        p2 = q2 + b * q0 + c * q1 - a * q3
        p3 = q3 + c * q0 + a * q2 - b * q1
        over = 1.0 / math.sqrt(p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3)
        p0, p1, p2, p3 = over * p0, over * p1, over * p2, over * p3
        w.trial[i, 0], w.trial[i, 1], w.trial[i, 2], w.trial[i, 3] = p0, p1, p2, p3
        m = w.rotations[i]
        m[0, 0], m[0, 1], m[0, 2] = (
            1 - 2 * (p2 * p2 + p3 * p3),
            2 * (p1 * p2 - p0 * p3),
            2 * (p1 * p3 + p0 * p2),
        )
        m[1, 0], m[1, 1], m[1, 2] = (
            2 * (p1 * p2 + p0 * p3),
            1 - 2 * (p1 * p1 + p3 * p3),
            2 * (p2 * p3 - p0 * p1),
        )
        m[2, 0], m[2, 1], m[2, 2] = (
            2 * (p1 * p3 - p0 * p2),
            2 * (p2 * p3 + p0 * p1),
            1 - 2 * (p1 * p1 + p2 * p2),
        )


@device_function
def lay_beams(beams, f, w, b):  # type: ignore[no-untyped-def]
    """Fill chords and directors of the beams of ring f."""
    count = w.turns.shape[0]
    for e in range(count):
        other = (e + 1) % count
        for r in range(3):
            b.chord[e, r] = w.positions[other, r] - w.positions[e, r]
            for k in range(3):
                begin = end = 0.0
                for c in range(3):
                    begin += w.rotations[e, r, c] * beams.directors[f, e, k, c]
                    end += w.rotations[other, r, c] * beams.directors[f, e, k, c]
                b.directors[e, 0, k, r], b.directors[e, 1, k, r] = begin, end


@device_function
def _sum_beams(beams, f, w, b, hessian, whole):  # type: ignore[no-untyped-def]
    """Sum all beams of ring f at the trial turns, with the band if told to; return the energy [J].

    The beams' own Hessians are filled with it: wholly, or what belongs to the turns alone.
    """
    count = w.turns.shape[0]
    lay_beams(beams, f, w, b)
    energy = beam_energies(beams.rigidities, beams.lengths[f], b, hessian, whole)
    w.moment[:] = 0.0
    for e in range(count):
        first, second = 3 * place_in_band(e, count), 3 * place_in_band((e + 1) % count, count)
        for r in range(3):
            w.moment[first + r] += b.gradient[e, 3 + r]
            w.moment[second + r] += b.gradient[e, 6 + r]
    if hessian:
        _fill_band(w, b)
    return energy


@device_function
def _fill_band(w, b):  # type: ignore[no-untyped-def]
    count, band = w.turns.shape[0], w.band
    band[:] = 0.0
    for e in range(count):
        first, second = 3 * place_in_band(e, count), 3 * place_in_band((e + 1) % count, count)
        h = b.hessian[e]
        for r in range(3):
            for c in range(r + 1):
                band[first + r, r - c] += h[3 + r, 3 + c]
                band[second + r, r - c] += h[6 + r, 6 + c]
            for c in range(3):
                if second > first:
                    band[second + r, second + r - first - c] += h[6 + r, 3 + c]
                else:
                    band[first + r, first + r - second - c] += h[3 + r, 6 + c]


@device_function
def _fill_step(w):  # type: ignore[no-untyped-def]
    """Fill the step that the factor gives; return its largest entry and its slope."""
    for i in range(w.step.shape[0]):
        w.step[i] = w.moment[i]
    forward(w.factor, w.step)
    slope, largest = 0.0, 0.0
    for i in range(w.step.shape[0]):
        slope -= w.step[i] * w.step[i]
    backward(w.factor, w.step)
    for i in range(w.step.shape[0]):
        w.step[i] = -w.step[i]
        largest = max(largest, abs(w.step[i]))
    return largest, slope


@device_function
def _fill_unstable_step(w):  # type: ignore[no-untyped-def]
    """Fill a step the way the energy curves down most, away from a saddle; return what `_fill_step` does."""
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
def balance_turns(beams, f, w, b, hessian, small, kept):  # type: ignore[no-untyped-def]
    """Bring the turns of ring f into balance from those in `w.turns`; return the energy [J], or infinity.

    Afterwards `w` and `b` hold turns and first derivatives there; if told to, second ones too, and the
    factor of those by the turns. The search ends with an error of `small` [rad]; with `kept` it begins with
    the factor that is in `w`.
    """
    stiffest = 0.0
    for e in range(w.turns.shape[0]):
        stiffest = max(stiffest, (beams.rigidities[1] + beams.rigidities[2]) / beams.lengths[f, e])
    w.step[:] = 0.0
    _turn_by(w, 0.0)
    energy, shift, last = _sum_beams(beams, f, w, b, not kept, hessian), 0.0, 1.0
    fresh, done = not kept, False
    for _ in range(_STEPS_MAX):
        if fresh:
            shift = 0.0
            while not factorise(w.band, shift, w.factor):
                shift = max(4.0 * shift, 1e-3 * stiffest)
                if not shift < 1e9 * stiffest:
                    return np.inf
        if done and shift == 0.0:
            return energy
        largest, slope = _fill_step(w)
        if not hessian and shift == 0.0 and largest < small:
            return energy
        if shift > 0.0 and largest < _STUCK_TURN:
            largest, slope = _fill_unstable_step(w)
        fraction, before = min(1.0, _LARGEST_TURN / max(largest, 1e-300)), energy
        if kept:  # nothing has shown yet how well it serves
            last, kept = max(largest, 1e-300) / _SHRINKS, False
            shrinks = True
        else:
            shrinks = largest < _SHRINKS * last and shift == 0.0
        # a factor that serves well is kept; what it leaves shrinks as the steps do
        done = shift == 0.0 and largest * min(1.0, largest / last) < small
        fresh = (done and hessian) if shrinks or done else True
        for _ in range(_HALVINGS_MAX):
            _turn_by(w, fraction)
            energy = _sum_beams(beams, f, w, b, fresh, hessian)
            lower = energy <= before + 1e-4 * fraction * slope + 1e-12 * before
            if lower or largest < _ROUNDED_TURN:
                break
            fraction, fresh, done = 0.5 * fraction, True, False
        last = max(largest, 1e-300)
        for i in range(w.turns.shape[0]):
            for r in range(4):
                w.turns[i, r] = w.trial[i, r]
        if done and not fresh:
            return energy
    return np.inf
