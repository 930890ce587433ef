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
from typing import Final

from cosim.base.kernels import device_function, inlined
from cosim.soft.beams.beam_work import COSINE, SINE, STRETCH
from cosim.soft.elements.hinge_gradient import full_angle

# arccos(c) / (1 - c^2)^(1/2) = sum of a_n (1 - c)^n, a_n = a_(n-1) n / (2 n + 1); the highest power first
_SERIES = tuple(math.prod((k / (2 * k + 1) for k in range(1, n + 1)), start=1.0) for n in range(12, -1, -1))
FAR: Final = 0.05
"""1 - c from which on the series is not used."""


@inlined
def factor_by_series(c):  # type: ignore[no-untyped-def]
    """Return arccos(c) / (1 - c^2)^(1/2) and its first two derivatives by c, by a series in 1 - c."""
    u, value, slope, curvature = 1.0 - c, 0.0, 0.0, 0.0
    for a in _SERIES:
        curvature = curvature * u + 2.0 * slope
        slope = slope * u + value
        value = value * u + a
    return value, -slope, curvature


@device_function
def angle_factor(c):  # type: ignore[no-untyped-def]
    """Return arccos(c) / (1 - c^2)^(1/2) and its first two derivatives by c."""
    if 1.0 - c < FAR:
        return factor_by_series(c)
    c = max(c, -1.0 + 1e-12)
    w = 1.0 - c * c
    value = math.acos(c) / math.sqrt(w)
    slope = (c * value - 1.0) / w
    return value, slope, (3.0 * c * slope + value) / w


@inlined
def bowing(begin, end):  # type: ignore[no-untyped-def]
    """Return by how much of the chord the angles theta_k1 and theta_k2 make the centre line longer."""
    return (2.0 * begin * begin - begin * end + 2.0 * end * end) / 30.0


@inlined
def by_bow(here, there):  # type: ignore[no-untyped-def]
    """Return the derivative of that by theta_k of one end."""
    return (4.0 * here - there) / 30.0


@inlined
def twist(sine, cosine):  # type: ignore[no-untyped-def]
    """Return phi and its derivatives by S and C."""
    over = 1.0 / (sine * sine + cosine * cosine)
    return math.copysign(full_angle(abs(sine), cosine), sine), cosine * over, -sine * over


@device_function
def _fill_second_of_twist(stiffness, m, second):  # type: ignore[no-untyped-def]
    phi, by_sine, by_cosine = twist(m[SINE], m[COSINE])
    mixed = 2.0 * by_sine * by_cosine  # -2 S C / (S^2 + C^2)^2
    second[SINE, SINE] = stiffness * (by_sine * by_sine + phi * mixed)
    second[COSINE, COSINE] = stiffness * (by_cosine * by_cosine - phi * mixed)
    cross = by_sine * by_cosine + phi * (by_cosine * by_cosine - by_sine * by_sine)
    second[SINE, COSINE] = second[COSINE, SINE] = stiffness * cross


@device_function
def fill_second(rigidities, lengths, w):  # type: ignore[no-untyped-def]
    """Fill second derivatives by the measures."""
    for e in range(lengths.shape[0]):
        second, m, factor, along = w.second[e], w.measures[e], w.factor[e], rigidities[0] / lengths[e]
        second[:7, :7] = 0.0
        second[STRETCH, STRETCH] = along
        for a in range(2):
            for k in range(2):
                c, s = 1 + 3 * a, 2 + 3 * a + k
                by_c, bow = factor[a, 1] * m[s], lengths[e] * by_bow(w.turn[e, a, k], w.turn[e, 1 - a, k])
                by_turn = w.first[e, s] / factor[a, 0]
                second[STRETCH, c] += along * bow * by_c
                second[STRETCH, s] = along * bow * factor[a, 0]
                second[c, c] += by_turn * factor[a, 2] * m[s]
                second[c, s] += by_turn * factor[a, 1]
                for b in range(2):
                    for j in range(2):
                        other = 2 + 3 * b + j
                        value = lengths[e] * by_bow(w.turn[e, b, j], w.turn[e, 1 - b, j]) * along * bow
                        if k == j:
                            bending, same = 2.0 * rigidities[1 + k] / lengths[e], a == b
                            value += w.first[e, STRETCH] * lengths[e] / 30.0 * (4.0 if same else -1.0)
                            value += bending * (2.0 if same else 1.0)
                        second[s, other] = value * factor[a, 0] * factor[b, 0]
                        second[c, other] += value * by_c * factor[b, 0]
                        second[c, 1 + 3 * b] += value * by_c * factor[b, 1] * m[other]
        for r in range(1, 7):
            second[r, STRETCH] = second[STRETCH, r]
            if r not in (1, 4):
                second[r, 1], second[r, 4] = second[1, r], second[4, r]
        _fill_second_of_twist(rigidities[3] / lengths[e], m, second)
