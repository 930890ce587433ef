"""Kernels of rings of beams: what they add to gradient and tangent, how far their fibres are strained."""

from __future__ import annotations

from typing import Final

import numpy as np

from cosim.base.kernels import (
    BLOCKS,
    BOOLEAN,
    INDEX_TABLE,
    MATRIX,
    REAL,
    VECTOR,
    device_function,
    kernel,
    small_matrix,
)
from cosim.soft.beams.beam_lanes import BENT, FORCE, LANES, SECOND, STRAIN, TURNS, lane_of, three
from cosim.soft.beams.node_turns import (
    BAND,
    BEAM_ARRAYS,
    SMALL_TURN,
    SMALL_TURN_BY_KEPT,
    SMALL_TURN_IN_MOTION,
    balance_turns,
    fill_axes,
    forward_rows,
    place_in_band,
    place_ring,
    ring_work,
)
from cosim.soft.linear.pattern import add_block

REMEMBERED: Final = 4 + 3 * BAND
"""Numbers that a ring remembers for each of its nodes: all turns, then the factor of the tangent by them."""


@device_function
def _copy(values, to):  # type: ignore[no-untyped-def]
    for i in range(values.shape[0]):
        to[i] = values[i]


@device_function
def _read_memory(x, beams, f, memory, w):  # type: ignore[no-untyped-def]
    """Lay ring f with the turns and fill the factor that it remembers; return whether there is a factor."""
    count, factor = beams.rings.shape[1], w.factor.reshape(w.factor.size)
    first = REMEMBERED * f * count
    place_ring(x, beams, f, memory[first:], w.axes, w.lanes)
    _copy(memory[first + 4 * count : first + REMEMBERED * count], factor)
    return factor[0] > 0.0


@device_function
def _write_memory(w, f, memory):  # type: ignore[no-untyped-def]
    """Keep turns and factor of ring f."""
    count, factor = w.beams.hessian.shape[0], w.factor.reshape(w.factor.size)
    first = REMEMBERED * f * count
    for e in range(count):
        turns, s = memory[first + 4 * e :], w.lanes[lane_of(e) :]
        for r in range(4):
            turns[r] = s[TURNS + r * LANES]
    _copy(factor, memory[first + 4 * count :])


@device_function
def _fill_matrix(w, mixed, matrix):  # type: ignore[no-untyped-def]
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
    forward_rows(w.factor, mixed)
    for k in range(3 * count):
        for i in range(3 * count):
            for j in range(i + 1):
                matrix[i, j] -= mixed[k, i] * mixed[k, j]


@device_function
def _add_matrix(w, slots, matrix, blocks):  # type: ignore[no-untyped-def]
    """Add the lower triangle of a matrix in axes of the ring to blocks in those of the world."""
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


@kernel(REAL(MATRIX, BEAM_ARRAYS, VECTOR, BOOLEAN, INDEX_TABLE, MATRIX, BLOCKS, VECTOR), allocates=True)
def add_beam_rings(x, beams, memory, moving, slots, gradient, blocks, tracked):  # type: ignore[no-untyped-def]
    """Add all rings to gradient and, if slots is not empty, their Hessian to blocks.

    The search for the turns begins at those in memory (REMEMBERED f m,), and without a Hessian with the
    factor there, if there is one; it ends sooner in a step in time (moving). What it ends with is written to
    tracked.
    Returns the energy [J]; infinity where no turns in balance are found.
    """
    count, with_hessian = beams.rings.shape[1], slots.shape[0] > 0
    w, energy = ring_work(count), 0.0
    size = 3 * count if with_hessian else 0
    mixed, matrix = np.empty((size, size)), np.empty((size, size))
    for f in range(beams.rings.shape[0]):
        there = _read_memory(x, beams, f, memory, w)
        kept = there and not with_hessian
        small = SMALL_TURN_IN_MOTION if moving else SMALL_TURN_BY_KEPT if kept else SMALL_TURN
        energy += balance_turns(beams, f, w, with_hessian, small, kept)
        if not energy < np.inf:
            return np.inf
        for i in range(count):
            node, other = beams.rings[f, i], beams.rings[f, (i + 1) % count]
            own = three(w.lanes, FORCE + lane_of(i))
            for r in range(3):
                force = w.axes[r, 0] * own[0] + w.axes[r, 1] * own[1] + w.axes[r, 2] * own[2]
                gradient[node, r] -= force
                gradient[other, r] += force
        _write_memory(w, f, tracked)
        if with_hessian:
            _fill_matrix(w, mixed, matrix)
            _add_matrix(w, slots[f], matrix, blocks)
    return energy


@kernel(MATRIX(MATRIX, BEAM_ARRAYS, REAL, REAL, VECTOR), allocates=True)
def peak_strains(x, beams, width, height, memory):  # type: ignore[no-untyped-def]
    """Return the largest strain (f, m) of each beam's fibres, at its ends; NaN where no balance is found."""
    count = beams.rings.shape[1]
    w, found = ring_work(count), np.empty(beams.rings.shape)
    no = count < 0  # False itself would be a type of its own, for which all is compiled once more
    for f in range(beams.rings.shape[0]):
        _read_memory(x, beams, f, memory, w)
        balanced = balance_turns(beams, f, w, no, SMALL_TURN, no) < np.inf
        for e in range(count):
            at, bent = lane_of(e), 0.0
            for a in range(2):
                here, there = BENT + a * SECOND + at, BENT + (1 - a) * SECOND + at
                in_plane = width * abs(2.0 * w.lanes[here] + w.lanes[there])
                across = height * abs(2.0 * w.lanes[here + LANES] + w.lanes[there + LANES])
                bent = max(bent, (in_plane + across) / beams.lengths[f, e])
            found[f, e] = abs(w.lanes[STRAIN + at]) + bent if balanced else np.nan
    return found


@kernel(BLOCKS(MATRIX, INDEX_TABLE), allocates=True)
def ring_axes(x, rings):  # type: ignore[no-untyped-def]
    """Return the axes (f, 3, 3) of all rings, as columns."""
    axes = np.empty((rings.shape[0], 3, 3))
    for f in range(rings.shape[0]):
        fill_axes(x, rings[f], axes[f])
    return axes
