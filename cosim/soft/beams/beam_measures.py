"""The energy of straight beams between nodes that have rotations, and their measures of strain.

A beam leads from node 1 to node 2: chord v, its length l = |v|, direction t = v / l, drawn length L. Each
end turns with its node; its directors d1, d2, d3 are along the drawn chord, in the ring's plane, and across.
With c = t . d1, s_k = t . d_k the section at an end is turned against the chord by the angles
    theta_k = s_k arccos(c) / (1 - c^2)^(1/2),   k = 2, 3.
Between the ends the centre line is the cubic that has them, longer than its chord by its slope squared,
    strain = l / L - 1 + sum over k (2 theta_k1^2 - theta_k1 theta_k2 + 2 theta_k2^2) / 30,
and the twist phi is the part about d1 of the turn between the ends,
    phi = atan2(S, C),   S = d3_1 . d2_2 - d2_1 . d3_2,   C = d2_1 . d2_2 + d3_1 . d3_2,
    energy = E A L strain^2 / 2 + sum over k 2 E I_k / L (theta_k1^2 + theta_k1 theta_k2 + theta_k2^2)
             + G J phi^2 / (2 L).
So loads on nodes bend a straight beam as they should whatever the number of nodes (strains small, turns of
any size). The measures l, (c, s_2, s_3) at both ends, S and C are linear in t and in each end's directors.
Source: Crisfield, Non-linear Finite Element Analysis of Solids and Structures, vol. 2, chapter 17, for
corotational beams; Oran, J. Struct. Div. ASCE 99 (1973) 987, for the strain by bowing.
"""

from __future__ import annotations

import math

from cosim.base.kernels import device_function
from cosim.soft.beams.beam_work import BEGIN, COSINE, END, SINE, STRETCH

# arccos(c) / (1 - c^2)^(1/2) = sum of a_n (1 - c)^n, a_n = a_(n-1) n / (2 n + 1); the highest power first
_SERIES = tuple(math.prod((k / (2 * k + 1) for k in range(1, n + 1)), start=1.0) for n in range(12, -1, -1))
_SHORT_SERIES = _SERIES[6:]


@device_function
def _fill_series(series, u, out):  # type: ignore[no-untyped-def]
    """Fill out with a power series in u = 1 - c and its first two derivatives by c."""
    value = slope = curvature = 0.0
    for a in series:
        curvature = curvature * u + 2.0 * slope
        slope = slope * u + value
        value = value * u + a
    out[0], out[1], out[2] = value, -slope, curvature


@device_function
def _angle_factor(c, out):  # type: ignore[no-untyped-def]
    """Fill out = arccos(c) / (1 - c^2)^(1/2) and its first two derivatives by c."""
    u = 1.0 - c
    if u < 2e-3:
        _fill_series(_SHORT_SERIES, u, out)
    elif u < 0.05:
        _fill_series(_SERIES, u, out)
    else:
        c = max(c, -1.0 + 1e-12)
        w = 1.0 - c * c
        out[0] = math.acos(c) / math.sqrt(w)
        out[1] = (c * out[0] - 1.0) / w
        out[2] = (3.0 * c * out[1] + out[0]) / w


@device_function
def fill_measures(lengths, w):  # type: ignore[no-untyped-def]
    """Fill measures, turns of the ends and strains; chords and directors are given, drawn lengths (m,)."""
    for e in range(lengths.shape[0]):
        v, d, m, t = w.chord[e], w.directors[e], w.measures[e], w.direction[e]
        m[STRETCH] = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        over = 1.0 / m[STRETCH]
        for r in range(3):
            t[r] = over * v[r]
        m[SINE] = m[COSINE] = 0.0
        for k in range(3):
            m[BEGIN + k] = d[0, k, 0] * t[0] + d[0, k, 1] * t[1] + d[0, k, 2] * t[2]
            m[END + k] = d[1, k, 0] * t[0] + d[1, k, 1] * t[1] + d[1, k, 2] * t[2]
            m[SINE] += d[0, 2, k] * d[1, 1, k] - d[0, 1, k] * d[1, 2, k]
            m[COSINE] += d[0, 1, k] * d[1, 1, k] + d[0, 2, k] * d[1, 2, k]
        for a in range(2):
            _angle_factor(m[1 + 3 * a], w.factor[e, a])
            for k in range(2):
                w.turn[e, a, k] = w.factor[e, a, 0] * m[2 + 3 * a + k]
        w.strain[e] = m[STRETCH] / lengths[e] - 1.0
        for k in range(2):
            begin, end = w.turn[e, 0, k], w.turn[e, 1, k]
            w.strain[e] += (2.0 * begin * begin - begin * end + 2.0 * end * end) / 30.0


@device_function
def add_twists(torsion, lengths, w):  # type: ignore[no-untyped-def]
    """Fill derivatives by S and C; return the energy of twisting [J]."""
    energy = 0.0
    for e in range(lengths.shape[0]):
        sine, cosine, stiffness = w.measures[e, SINE], w.measures[e, COSINE], torsion / lengths[e]
        phi, over = math.atan2(sine, cosine), 1.0 / (sine * sine + cosine * cosine)
        energy += 0.5 * stiffness * phi * phi
        by_sine, by_cosine = cosine * over, -sine * over
        w.first[e, SINE], w.first[e, COSINE] = stiffness * phi * by_sine, stiffness * phi * by_cosine
        mixed = 2.0 * by_sine * by_cosine  # -2 S C / (S^2 + C^2)^2
        w.second[e, SINE, SINE] = stiffness * (by_sine * by_sine + phi * mixed)
        w.second[e, COSINE, COSINE] = stiffness * (by_cosine * by_cosine - phi * mixed)
        cross = by_sine * by_cosine + phi * (by_cosine * by_cosine - by_sine * by_sine)
        w.second[e, SINE, COSINE] = w.second[e, COSINE, SINE] = stiffness * cross
    return energy


@device_function
def add_stretches_and_bends(rigidities, lengths, w):  # type: ignore[no-untyped-def]
    """Fill first derivatives by l, c and s; return the energy of stretching and bending [J]."""
    energy = 0.0
    for e in range(lengths.shape[0]):
        force, first = rigidities[0] * w.strain[e], w.first[e]
        energy += 0.5 * force * w.strain[e] * lengths[e]
        first[STRETCH] = force
        for a in range(2):
            first[1 + 3 * a] = 0.0
            for k in range(2):
                here, there = w.turn[e, a, k], w.turn[e, 1 - a, k]
                bending = 2.0 * rigidities[1 + k] / lengths[e]
                energy += 0.5 * bending * here * (2.0 * here + there)
                by_turn = force * lengths[e] * (4.0 * here - there) / 30.0 + bending * (2.0 * here + there)
                first[1 + 3 * a] += by_turn * w.factor[e, a, 1] * w.measures[e, 2 + 3 * a + k]
                first[2 + 3 * a + k] = by_turn * w.factor[e, a, 0]
    return energy


@device_function
def fill_second(rigidities, lengths, w):  # type: ignore[no-untyped-def]
    """Fill second derivatives by l, c and s."""
    for e in range(lengths.shape[0]):
        second, m, factor, along = w.second[e], w.measures[e], w.factor[e], rigidities[0] / lengths[e]
        second[:7, :7] = 0.0
        second[STRETCH, STRETCH] = along
        for a in range(2):
            for k in range(2):
                c, s = 1 + 3 * a, 2 + 3 * a + k
                by_c, bow = (
                    factor[a, 1] * m[s],
                    lengths[e] * (4.0 * w.turn[e, a, k] - w.turn[e, 1 - a, k]) / 30.0,
                )
                by_turn = w.first[e, s] / factor[a, 0]
                second[STRETCH, c] += along * bow * by_c
                second[STRETCH, s] = along * bow * factor[a, 0]
                second[c, c] += by_turn * factor[a, 2] * m[s]
                second[c, s] += by_turn * factor[a, 1]
                for b in range(2):
                    for j in range(2):
                        other = 2 + 3 * b + j
                        value = lengths[e] * (4.0 * w.turn[e, b, j] - w.turn[e, 1 - b, j]) / 30.0
                        value *= along * bow
                        if k == j:
                            bending, same = 2.0 * rigidities[1 + k] / lengths[e], a == b
                            value += rigidities[0] * w.strain[e] * lengths[e] / 30.0 * (4.0 if same else -1.0)
                            value += bending * (2.0 if same else 1.0)
                        second[s, other] = value * factor[a, 0] * factor[b, 0]
                        second[c, other] += value * by_c * factor[b, 0]
                        second[c, 1 + 3 * b] += value * by_c * factor[b, 1] * m[other]
        for r in range(1, 7):
            second[r, STRETCH] = second[STRETCH, r]
            if r not in (1, 4):
                second[r, 1], second[r, 4] = second[1, r], second[4, r]
