"""A ring in lanes: its beams in groups as `beam_lanes` takes them, what goes in and what comes out."""

from __future__ import annotations

import math

import numpy as np

from cosim.base.kernels import device_function
from cosim.soft.beams.beam_lanes import (
    DIRECTION,
    DRAWN,
    DRAWN_LENGTH,
    ENERGY,
    LANES,
    LENGTH,
    MOMENT,
    SECOND,
    SIZE,
    STEP,
    TRIAL,
    TURNS,
    lane_of,
)
from cosim.soft.beams.triples import dot


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
def place_ring(x, beams, f, turns, axes, lanes):  # type: ignore[no-untyped-def]
    """Fill axes and groups of ring f, its turns from quaternions (4 m,)."""
    ring, count = beams.rings[f], beams.rings.shape[1]
    fill_axes(x, ring, axes)
    for n in range(lanes.shape[0] // SIZE * LANES):
        e = min(n, count - 1)
        other = e + 1 if e + 1 < count else 0
        s, directors, length = lanes[lane_of(n) :], beams.directors[f, e], beams.lengths[f, e]
        here, there = x[np.uint64(ring[e])], x[np.uint64(ring[other])]
        chord = there[0] - here[0], there[1] - here[1], there[2] - here[2]
        s[DRAWN_LENGTH], s[LENGTH] = length, math.sqrt(dot(chord, chord))
        over = 1.0 / s[LENGTH]
        for c in range(3):
            along = axes[0, c] * chord[0] + axes[1, c] * chord[1] + axes[2, c] * chord[2]
            s[DIRECTION + c * LANES] = over * along
            for k in range(3):
                s[DRAWN + (3 * k + c) * LANES] = directors[k, c]
        begin, end = turns[4 * e :], turns[4 * other :]
        for r in range(4):
            s[TURNS + r * LANES], s[SECOND + TURNS + r * LANES] = begin[r], end[r]


@device_function
def place_step(lanes, places, step):  # type: ignore[no-untyped-def]
    """Hand a step to the groups."""
    for n in range(lanes.shape[0] // SIZE * LANES):
        e = min(n, places.shape[0] - 2)
        s, begin, end = lanes[lane_of(n) :], step[places[e] :], step[places[e + 1] :]
        for r in range(3):
            s[STEP + r * LANES], s[SECOND + STEP + r * LANES] = begin[r], end[r]


@device_function
def accept(s):  # type: ignore[no-untyped-def]
    """Make the trial quaternions the turns."""
    for first in range(0, s.shape[0], SIZE):
        for k in range(4 * LANES):
            s[first + TURNS + k] = s[first + TRIAL + k]
        for k in range(4 * LANES):
            s[first + SECOND + TURNS + k] = s[first + SECOND + TRIAL + k]


@device_function
def sum_lanes(lanes, places, moment):  # type: ignore[no-untyped-def]
    """Fill the moments; return the energy."""
    energy = 0.0
    for i in range(moment.shape[0]):
        moment[i] = 0.0
    for e in range(places.shape[0] - 1):
        s, begin, end = lanes[lane_of(e) :], moment[places[e] :], moment[places[e + 1] :]
        energy += s[ENERGY]
        for r in range(3):
            begin[r] += s[MOMENT + r * LANES]
            end[r] += s[SECOND + MOMENT + r * LANES]
    return energy
