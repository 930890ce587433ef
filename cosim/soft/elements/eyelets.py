"""Losses of a cable at its eyelets in both directions of sliding: stick and slip with a memory per eyelet.

Eyelet j is at the start of segment j; T_j-1 is the tension before it, for the first one the tension T_0 at
the base end. The cable beyond it is R_j = sum_(i >= j) L_i long, which measures the sliding: the cable slides
to the base while R_j falls. The difference d_j = T_j-1 - T_j follows elastically, between limits,

    d_j = k (A_j - R_j)   within   T_j-1 (1 - 1/f) - F/f  <=  d_j  <=  min(T_j-1 (1 - f) + F, T_j-1),

f = c exp(-mu theta_j) with the loss factor c, the coefficient mu and the angle theta_j by which the cable
turns there, F a constant loss: at the upper limit T_j = f T_j-1 - F as the cable slides to the base, at the
lower one T_j-1 = f T_j - F as it slides to the tip. Beyond a limit the anchor A_j moves, as a plastic strain
does (return mapping): A_j is the memory of an eyelet. The cable slides through it by the change of A_j, and
loses d_j times that, which is never negative. k is the stiffness of the whole cable, as a sticking cable
stretches: 0.1 mm per newton at 10 N/mm. With nine times that stiffness, that of one segment of nine, runs of
light film arms take four times as long. The cable's stretch does not count as sliding.
For one solution limits are frozen at its start. Then all d_j have one potential,
    energy = sum_j phi_j(A_j - R_j),  phi_j' = d_j:  a parabola between two straight lines,
    gradient = -d_j dR_j/dx,
    Hessian = k g_j g_j^T, g_j = dR_j/dx, of those that stick: all eyelets of a cable are coupled; the rest
    is in the segments' tensions T_i = T_0 - sum_(j <= i) d_j.
Eyelets that slip at the start of a solution follow T_0 by the factors f (tension ratio r_i = T_i / T_0), so
that a commanded tension or length at the base acts beyond them. In statics, and with commanded lengths, a
solution is repeated until the limits do not change any more; in motion limits follow one step later. A slack
cable that is pulled taut starts with all eyelets sliding to the base.
Sources: Simo and Hughes, Computational Inelasticity, 1998, chapter 1; Wriggers, Computational Contact
Mechanics, 2nd ed., section 5.2 (frozen limits).
"""

import math
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.soft.elements.cable import Cable, UNSLID_m, base_tension, segment_gradient, segment_length
from cosim.soft.elements.element import EyeletLaws
from cosim.soft.linear.pattern import add_block

BASE_FRACTION, RATIO, ANCHOR, LOWER, UPPER, PROPORTIONAL, STICKS = range(7)
"""Columns of frozen losses, a row per segment: its fraction r_i of the tension at the base end (with a
commanded length: weight w_i, see `cable`), r_i; and of the eyelet at its start the anchor A [m], limits [N],
the loss that r_i T_0 contains at the start of a solution [N], and 1 if it sticks, filled with the forces."""
COLUMNS: Final = STICKS + 1

Pulls: TypeAlias = tuple[tuple[float, ...], tuple[float | None, ...], tuple[float, ...]]

_SLIPS: Final = 1.0 - 1e-9  # of a limit: an eyelet that has slid up to this continues to slide


@kernel
def freeze_losses(x: Matrix, eyelets: EyeletLaws, memory: Vector, base: Vector, rows: Matrix) -> None:
    """Fill the rows (s, COLUMNS) of cables with memory; the tension ratio is r_i.

    Args:
        x: (n, 3) [m].
        eyelets: see `EyeletLaws`.
        memory: (values,), of the last accepted state.
        base: (cables,) [N], T_0.
        rows: filled.
    """
    segments = eyelets.segments
    for cable in range(eyelets.routes.shape[0] - 1):
        first, last = eyelets.routes[cable], eyelets.routes[cable + 1]
        if eyelets.places[first] < 0:
            continue
        beyond = 0.0
        for s in range(first, last):
            beyond += segment_length(x, segments[s, 0], segments[s, 1])
        pull, ratio, offset = max(base[cable], 0.0), 1.0, 0.0
        for s in range(first, last):
            factor, friction, constant, k = eyelets.laws[s]
            if friction > 0.0 and s > first:
                along = before = square = 0.0
                for r in range(3):
                    edge = x[segments[s, 1], r] - x[segments[s, 0], r]
                    edge_before = x[segments[s - 1, 1], r] - x[segments[s - 1, 0], r]
                    along += edge * edge_before
                    before += edge * edge
                    square += edge_before * edge_before
                cosine = along / max(math.sqrt(before * square), 1e-300)
                factor *= math.exp(-friction * math.acos(min(1.0, max(-1.0, cosine))))
            upper = min(pull * (1.0 - factor) + constant, pull)
            lower = pull * (1.0 - 1.0 / factor) - constant / factor
            anchor = memory[eyelets.places[s]]
            anchor_lead = anchor - beyond
            d = k * anchor_lead
            if anchor_lead > 0.5 * UNSLID_m or d >= _SLIPS * upper:
                d = upper
            elif d <= _SLIPS * lower:
                d = lower
            slope = 1.0
            if d == upper and (d < pull or pull == 0.0):
                slope = factor
            elif d == lower:
                slope = 1.0 / factor
            fixed = d - (1.0 - slope) * (pull + offset)
            ratio, offset = ratio * slope, offset + fixed
            rows[s, BASE_FRACTION] = rows[s, RATIO] = ratio
            rows[s, ANCHOR], rows[s, LOWER], rows[s, UPPER] = anchor, lower, upper
            rows[s, PROPORTIONAL], rows[s, STICKS] = d - fixed, 0.0
            pull = max(pull - d, 0.0)
            beyond -= segment_length(x, segments[s, 0], segments[s, 1])


@kernel
def pull_eyelets(
    x: Matrix, eyelets: EyeletLaws, rows: Matrix, cable: int, tracked: Vector, pull: Vector
) -> float:
    """Subtract the losses at a cable's eyelets from its segments' tensions, beyond their tension ratios.

    Args:
        x: (n, 3) [m].
        eyelets: see `EyeletLaws`.
        rows: (s, COLUMNS), frozen; which eyelets stick is filled.
        cable: which one.
        tracked: (values,), filled with its anchors.
        pull: (s,) [N], r_i T_0 before.

    Returns:
        The energy [J], less the change of sum T_i L_i by the changed pull.
    """
    first, last = eyelets.routes[cable], eyelets.routes[cable + 1]
    beyond, energy, lost_tension = 0.0, 0.0, 0.0
    for s in range(first, last):
        beyond += segment_length(x, eyelets.segments[s, 0], eyelets.segments[s, 1])
    for s in range(first, last):
        k, lower, upper = eyelets.laws[s, 3], rows[s, LOWER], rows[s, UPPER]
        anchor_lead = rows[s, ANCHOR] - beyond
        untouched, elastic = anchor_lead > 0.5 * UNSLID_m, k * anchor_lead
        d = upper if untouched else min(upper, max(lower, elastic))
        # phi without constants; the term d R belongs to the sum of T_i L_i
        energy += d * (rows[s, ANCHOR] - 0.5 * d / k)
        rows[s, STICKS] = 1.0 if _SLIPS * lower < elastic < _SLIPS * upper else 0.0
        slack = upper <= 0.0 and (untouched or lower >= 0.0)
        tracked[eyelets.places[s]] = beyond + (UNSLID_m if slack else d / k)
        lost_tension += d - rows[s, PROPORTIONAL]
        pull[s] -= lost_tension
        beyond -= segment_length(x, eyelets.segments[s, 0], eyelets.segments[s, 1])
    return energy


@device_function
def _bend(x: Matrix, segments: IndexTable, segment_range: tuple[int, int], node: int, bend: Vector) -> None:
    """Fill the derivative (3,) of a cable's length by one of its eyelets.

    segment_range: first segment of the cable, and the one after its last; node: index of the eyelet, from 0.
    """
    first, last = segment_range
    next_direction = small_vector(3)
    for r in range(3):
        bend[r] = 0.0
    if node > 0:
        segment_gradient(x, segments[first + node - 1, 0], segments[first + node - 1, 1], bend)
    if first + node < last:
        segment_gradient(x, segments[first + node, 0], segments[first + node, 1], next_direction)
        for r in range(3):
            bend[r] -= next_direction[r]


@kernel
def hold_eyelets(
    x: Matrix, eyelets: EyeletLaws, rows: Matrix, cable: int, slots: Indices, blocks: Blocks
) -> None:
    """Add the Hessian of those eyelets of a cable that stick.

    Args:
        x: (n, 3) [m].
        eyelets: see `EyeletLaws`.
        rows: (s, COLUMNS), filled by `pull_eyelets`.
        cable: which one.
        slots: of all pairs of its eyelets, see `BlockPattern.slots`.
        blocks: (b, 3, 3) [N/m].
    """
    first, last = eyelets.routes[cable], eyelets.routes[cable + 1]
    bend_a, bend_b, begins = small_vector(3), small_vector(3), small_vector(3)
    block = small_matrix(3, 3)
    stiffness_before = 0.0
    for b in range(last - first):
        k = eyelets.laws[first + b, 3] * rows[first + b, STICKS]
        if stiffness_before + k > 0.0:
            segment_gradient(x, eyelets.segments[first + b, 0], eyelets.segments[first + b, 1], begins)
            _bend(x, eyelets.segments, (first, last), b, bend_b)
            for a in range(b, last - first + 1):
                _bend(x, eyelets.segments, (first, last), a, bend_a)
                for r in range(3):
                    gradient_a = -begins[r] if a == b else bend_a[r]
                    for c in range(3):
                        block[r, c] = stiffness_before * bend_a[r] * bend_b[c] - k * gradient_a * begins[c]
                add_block(blocks, slots[a * (a + 1) // 2 + b], block)
        stiffness_before += k
    # the anchor, where no segment begins
    _bend(x, eyelets.segments, (first, last), last - first, bend_a)
    for r in range(3):
        for c in range(3):
            block[r, c] = stiffness_before * bend_a[r] * bend_a[c]
    a = last - first
    add_block(blocks, slots[a * (a + 1) // 2 + a], block)


@kernel
def eyelet_loss(x: Matrix, eyelets: EyeletLaws, before: Vector, after: Vector) -> float:
    """Return the work lost at all eyelets [J] from one accepted state to the next.

    Args:
        x: (n, 3) [m], at the end.
        eyelets: see `EyeletLaws`.
        before: (values,), memory of the elements at the start.
        after: memory at the end.
    """
    work = 0.0
    for cable in range(eyelets.routes.shape[0] - 1):
        beyond, first = 0.0, eyelets.routes[cable]
        for s in range(eyelets.routes[cable + 1] - 1, first - 1, -1):
            beyond += segment_length(x, eyelets.segments[s, 0], eyelets.segments[s, 1])
            anchor = eyelets.places[s]
            if anchor >= 0 and max(before[anchor], after[anchor]) - beyond < 0.5 * UNSLID_m:
                work += eyelets.laws[s, 3] * (after[anchor] - beyond) * (before[anchor] - after[anchor])
    return work


def eyelet_laws(cables: tuple[Cable, ...], places: tuple[slice, ...]) -> EyeletLaws:
    """Return the eyelets of cables, for kernels.

    Args:
        cables: of a body.
        places: slice of each in the memory.
    """
    no_indices, pairs = np.zeros(0, np.int64), np.zeros((0, 2), np.int64)
    counts = [len(cable.segments) for cable in cables]
    anchor_places = [
        np.arange(memory_slice.start, memory_slice.stop) if cable.remembers else np.full(count, -1)
        for cable, memory_slice, count in zip(cables, places, counts, strict=True)
    ]
    laws = [np.tile(cable.law, (count, 1)) for cable, count in zip(cables, counts, strict=True)]
    return EyeletLaws(
        np.concatenate([pairs, *(cable.segments for cable in cables)]),
        np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64),
        np.concatenate([no_indices, *anchor_places]),
        np.concatenate([np.zeros((0, 4)), *laws]),
    )


def frozen_losses(
    eyelets: EyeletLaws, cables: tuple[Cable, ...], positions: Array, memory: Array, pulls: Pulls
) -> Array:
    """Return the frozen losses of cables at a shape, (segments, COLUMNS).

    They are tensions relative to that at the base end; for a cable of commanded length the weights w_i, see
    `cable`.

    Args:
        eyelets: of all cables.
        cables: of a body.
        positions: (n, 3) [m].
        memory: (values,), of the elements at the last accepted state.
        pulls: commanded tensions [N], lengths [m] or None, and q of a step; the second is empty if no
            length is commanded, the third if q is 1 for all cables.
    """
    tension, lengths = pulls[0] or (0.0,) * len(cables), pulls[1] or (None,) * len(cables)
    stiffening = pulls[2] or (1.0,) * len(cables)
    rows = np.zeros((len(eyelets.segments), COLUMNS))
    commands = list(zip(cables, tension, lengths, pairwise(eyelets.routes.tolist()), strict=True))
    if any(cable.remembers for cable in cables):
        base = [
            pull if length is None else base_tension(cable, positions, length, q)
            for (cable, pull, length, _), q in zip(commands, stiffening, strict=True)
        ]
        freeze_losses(positions, eyelets, memory, np.array(base), rows)
    for cable, _, length, (first, last) in commands:
        cable_rows = rows[first:last]
        if not cable.remembers:
            cable_rows[:, RATIO] = cable_rows[:, BASE_FRACTION] = cable.tension_ratio(positions)
        if length is not None:
            lengths_m = cable.segment_lengths(positions)
            cable_rows[:, BASE_FRACTION] = cable_rows[:, RATIO] * (
                lengths_m.sum() / (cable_rows[:, RATIO] @ lengths_m)
            )
    return rows


def tensions(pull_N: float, cable: Cable, positions: Array, memory: Array) -> Array:
    """Return the tension of every segment (eyelets - 1,) [N] of a cable in an accepted state.

    Args:
        pull_N: T_0.
        cable: which one.
        positions: (n, 3) [m].
        memory: (eyelets - 1,) [m], its anchors; empty for a cable without memory.
    """
    if not cable.remembers:
        return pull_N * cable.tension_ratio(positions)
    beyond = np.cumsum(cable.segment_lengths(positions)[::-1])[::-1]
    anchor_lead = memory - beyond
    return np.asarray(
        pull_N - np.cumsum(np.where(anchor_lead > 0.5 * UNSLID_m, 0.0, cable.law[3] * anchor_lead))
    )
