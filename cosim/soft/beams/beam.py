"""Second derivatives of the energies of beams by their chords and by the turns of their nodes.

The energy is one of measures that are linear in the chord's direction t and in the directors d of each end
(`beam_lanes`). A turn w of a node changes its directors by w x d + w x (w x d) / 2, a change of the chord
v the direction by (1 - t t^T) dv / l; the derivatives of products follow from these.
"""

from __future__ import annotations

from cosim.base.kernels import device_function
from cosim.soft.beams.beam_lanes import (
    BENT,
    BY_MEASURES,
    BY_TWIST,
    COSINE,
    COUNT,
    DIRECTION,
    DIRECTORS,
    LANES,
    LENGTH,
    MEASURES,
    PULL,
    SECOND,
    SINE,
    STRETCH,
    TWIST,
    angle_factor,
    fill_second,
    lane_of,
)


@device_function
def _read_lanes(s, w):  # type: ignore[no-untyped-def]
    """Fill what the groups hold of all beams, and the factors of the angles with both derivatives."""
    for e in range(w.hessian.shape[0]):
        lane, first, m = lane_of(e), w.first[e], w.measures[e]
        m[STRETCH], first[STRETCH] = s[LENGTH + lane], s[PULL + lane]
        m[SINE], m[COSINE] = s[TWIST + lane], s[TWIST + LANES + lane]
        first[SINE], first[COSINE] = s[BY_TWIST + lane], s[BY_TWIST + LANES + lane]
        for r in range(3):
            w.direction[e, r] = s[DIRECTION + r * LANES + lane]
        for a in range(2):
            at = a * SECOND + lane
            for k in range(3):
                m[1 + 3 * a + k] = s[MEASURES + k * LANES + at]
                first[1 + 3 * a + k] = s[BY_MEASURES + k * LANES + at]
                for r in range(3):
                    w.directors[e, a, k, r] = s[DIRECTORS + (3 * k + r) * LANES + at]
            for k in range(2):
                w.turn[e, a, k] = s[BENT + k * LANES + at]
            w.factor[e, a, 0], w.factor[e, a, 1], w.factor[e, a, 2] = angle_factor(m[1 + 3 * a])


@device_function
def _fill_jacobians(w):  # type: ignore[no-untyped-def]
    """Fill the derivatives of the measures."""
    for e in range(w.hessian.shape[0]):
        d, j, m, t = w.directors[e], w.jacobian[e], w.measures[e], w.direction[e]
        for r in range(3):
            p, q = (r + 1) % 3, (r + 2) % 3
            j[STRETCH, r] = t[r]
            for a in range(2):
                for k in range(3):
                    row = 1 + 3 * a + k
                    j[row, r] = (d[a, k, r] - m[row] * t[r]) / m[STRETCH]
                    j[row, 3 + 3 * a + r] = d[a, k, p] * t[q] - d[a, k, q] * t[p]
            sine = d[0, 2, p] * d[1, 1, q] - d[0, 2, q] * d[1, 1, p]
            sine -= d[0, 1, p] * d[1, 2, q] - d[0, 1, q] * d[1, 2, p]
            cosine = d[0, 1, p] * d[1, 1, q] - d[0, 1, q] * d[1, 1, p]
            cosine += d[0, 2, p] * d[1, 2, q] - d[0, 2, q] * d[1, 2, p]
            j[SINE, 3 + r], j[SINE, 6 + r] = sine, -sine
            j[COSINE, 3 + r], j[COSINE, 6 + r] = cosine, -cosine


@device_function
def _fill_products(w, begin):  # type: ignore[no-untyped-def]
    """Fill the Hessians, from a row and column on, with what the first derivatives of the measures give."""
    for e in range(w.hessian.shape[0]):
        jacobian, second, hessian, product = w.jacobian[e], w.second[e], w.hessian[e], w.product
        for r in range(begin, COUNT):
            for c in range(begin, COUNT):
                hessian[r, c] = 0.0
        for k in range(COUNT):
            for c in range(begin, COUNT):
                product[k, c] = 0.0
            for r in range(COUNT):
                value = second[k, r]
                if value != 0.0:  # both factors are half empty
                    for c in range(begin, COUNT):
                        product[k, c] += value * jacobian[r, c]
            for r in range(begin, COUNT):
                value = jacobian[k, r]
                if value != 0.0:
                    for c in range(begin, COUNT):
                        hessian[r, c] += value * product[k, c]


@device_function
def _add_by_turned_chords(w, whole):  # type: ignore[no-untyped-def]
    """Add to the Hessians, whole or by turns alone, what the second derivatives of l, c, s_2 and s_3 give."""
    pull = w.pull
    for e in range(w.hessian.shape[0]):
        h, t, d, over = w.hessian[e], w.direction[e], w.directors[e], 1.0 / w.measures[e, STRETCH]
        if whole:
            for r in range(3):
                for c in range(3):
                    h[r, c] += w.first[e, STRETCH] * over * ((1.0 if r == c else 0.0) - t[r] * t[c])
        for a in range(2):
            first, along, turn = 1 + 3 * a, 0.0, 3 + 3 * a
            for r in range(3):
                pull[r] = 0.0
                for k in range(3):
                    pull[r] += w.first[e, first + k] * d[a, k, r]
                along += pull[r] * t[r]
            for r in range(3):
                for c in range(3):
                    one, sym = 1.0 if r == c else 0.0, pull[r] * t[c] + t[r] * pull[c]
                    h[turn + r, turn + c] += 0.5 * sym - along * one
                    if whole:
                        h[r, c] -= over * over * (sym + along * (one - 3.0 * t[r] * t[c]))
            for c in range(3 if whole else 0):  # dt . (w x pull) = w . (pull x dt), dt = (1 - t t^T) dv / l
                p, q = (c + 1) % 3, (c + 2) % 3
                across = pull[p] * t[q] - pull[q] * t[p]
                for r in range(3):
                    value = -over * across * t[r]
                    if r == q:
                        value += over * pull[p]
                    elif r == p:
                        value -= over * pull[q]
                    h[turn + c, r] += value
                    h[r, turn + c] += value


@device_function
def _add_by_twists(w):  # type: ignore[no-untyped-def]
    """Add to the Hessians what the second derivatives of S and C give."""
    meets = w.pull  # the sum of the directors of the second end that d_k of the first meets in S and C
    for e in range(w.hessian.shape[0]):
        h, d, first = w.hessian[e], w.directors[e], w.first[e]
        for k in range(1, 3):
            sign, dot = 1.0 if k == 2 else -1.0, 0.0
            for r in range(3):
                meets[r] = first[COSINE] * d[1, k, r] + sign * first[SINE] * d[1, 3 - k, r]
                dot += d[0, k, r] * meets[r]
            for r in range(3):
                for c in range(3):
                    one = dot if r == c else 0.0
                    sym = 0.5 * (d[0, k, r] * meets[c] + meets[r] * d[0, k, c]) - one
                    h[3 + r, 3 + c] += sym
                    h[6 + r, 6 + c] += sym
                    cross = one - meets[r] * d[0, k, c]
                    h[3 + r, 6 + c] += cross
                    h[6 + c, 3 + r] += cross


@device_function
def fill_hessians(rigidities, lengths, s, w, whole):  # type: ignore[no-untyped-def]
    """Fill the Hessians by chords and turns.

    Args:
        rigidities: (4,), see `RectangularSection`.
        lengths: (m,) [m], drawn.
        s: the beams in groups, see `beam_lanes`.
        w: `BeamWork`.
        whole: all of them, or what belongs to the turns alone.
    """
    _read_lanes(s, w)
    fill_second(rigidities, lengths, w)
    _fill_jacobians(w)
    _fill_products(w, 0 if whole else 3)
    _add_by_turned_chords(w, whole)
    _add_by_twists(w)
