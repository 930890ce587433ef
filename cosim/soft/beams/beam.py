"""The energy of a ring's beams between nodes with rotations, in lanes, and its first and second derivatives.

Beams are computed in groups, one per lane. Quantity q of a lane is at s[q + lane], q a multiple of LANES;
constant strides let loops over lanes vectorise, and vectors of three values are tuples for the same reason.
Quantities of a beam's second end are SECOND further on than those of its first. A beam leads from node 1 to
node 2: chord v, its length l = |v|, direction t = v / l, drawn length L. Each end turns with its node; its
directors d1, d2, d3 are along the drawn chord, in the ring's plane, and across.
With c = t . d1, s_k = t . d_k the section at an end is turned against the chord by the angles
    theta_k = s_k arccos(c) / (1 - c^2)^(1/2),   k = 2, 3.
Between the ends the centre line is the cubic that has them, longer than its chord by its slope squared,
    strain = l / L - 1 + sum over k (2 theta_k1^2 - theta_k1 theta_k2 + 2 theta_k2^2) / 30,
and the twist phi is the part about d1 of the turn between the ends,
    phi = atan2(S, C),   S = d3_1 . d2_2 - d2_1 . d3_2,   C = d2_1 . d2_2 + d3_1 . d3_2,
    energy = E A L strain^2 / 2 + sum over k 2 E I_k / L (theta_k1^2 + theta_k1 theta_k2 + theta_k2^2)
             + G J phi^2 / (2 L).
So loads on nodes bend a straight beam correctly for any number of nodes (small strains, rotations of any
size). The measures l, (c, s_2, s_3) at both ends, S and C are linear in t and in each end's directors.
Source: Crisfield, Non-linear Finite Element Analysis of Solids and Structures, vol. 2, chapter 17, for
corotational beams; Oran, J. Struct. Div. ASCE 99 (1973) 987, for the strain by bowing.
Second derivatives follow from these: a rotation w of a node changes its directors by w x d + w x (w x d) / 2,
and a change dv of the chord changes its direction by (1 - t t^T) dv / l.
"""

import math
from typing import Final, NamedTuple

from cosim.base.frames import Array
from cosim.base.kernel_types import Vector
from cosim.base.kernels import device_function, inlined
from cosim.soft.geometry.surface import full_angle


@inlined
def dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def scaled(factor: float, a: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return factor a."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def added(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


COUNT: Final = 9
"""of measures."""
STRETCH, SINE, COSINE = 0, 7, 8


class BeamWork(NamedTuple):
    """Scratch for the Hessians of the m beams of a ring.

    Args:
        directors: (m, 2, 3, 3), d_k at both ends.
        measures: (m, 9), l, (c, s_2, s_3) at both ends, S, C.
        direction: (m, 3), t.
        turn: (m, 2, 2), theta_k at both ends.
        factor: (m, 2, 3), arccos(c) / (1 - c^2)^(1/2) at both ends, with two derivatives by c.
        first: (m, 9), derivative of the energy by the measures.
        second: (m, 9, 9), the same twice.
        jacobian: (m, 9, 9), of the measures by v and the turns of both nodes.
        hessian: (m, 9, 9), of the energy by these.
        pull: (3,), derivative by t at one end, or by a director.
        product: (9, 9), second times jacobian.
    """

    directors: Array
    measures: Array
    direction: Array
    turn: Array
    factor: Array
    first: Array
    second: Array
    jacobian: Array
    hessian: Array
    pull: Array
    product: Array


# arccos(c) / (1 - c^2)^(1/2) = sum of a_n (1 - c)^n, a_n = a_(n-1) n / (2 n + 1); the highest power first
_SERIES = tuple(math.prod((k / (2 * k + 1) for k in range(1, n + 1)), start=1.0) for n in range(12, -1, -1))
FAR: Final = 0.05
"""1 - c from which on the series is not used."""


@inlined
def factor_by_series(c: float) -> tuple[float, float, float]:
    """Return arccos(c) / (1 - c^2)^(1/2) and its first two derivatives by c, by a series in 1 - c."""
    u, value, slope, curvature = 1.0 - c, 0.0, 0.0, 0.0
    for a in _SERIES:
        curvature = curvature * u + 2.0 * slope
        slope = slope * u + value
        value = value * u + a
    return value, -slope, curvature


@device_function
def angle_factor(c: float) -> tuple[float, float, float]:
    """Return arccos(c) / (1 - c^2)^(1/2) and its first two derivatives by c."""
    if 1.0 - c < FAR:
        return factor_by_series(c)
    c = max(c, -1.0 + 1e-12)
    w = 1.0 - c * c
    value = math.acos(c) / math.sqrt(w)
    slope = (c * value - 1.0) / w
    return value, slope, (3.0 * c * slope + value) / w


@inlined
def bowing(begin: float, end: float) -> float:
    """Return by how much of the chord the angles theta_k1 and theta_k2 make the centre line longer."""
    return (2.0 * begin * begin - begin * end + 2.0 * end * end) / 30.0


@inlined
def by_bow(this_angle: float, other_angle: float) -> float:
    """Return the derivative of `bowing` by theta_k of one end."""
    return (4.0 * this_angle - other_angle) / 30.0


@inlined
def twist(sine: float, cosine: float) -> tuple[float, float, float]:
    """Return phi and its derivatives by S and C."""
    inverse_square = 1.0 / (sine * sine + cosine * cosine)
    return math.copysign(full_angle(abs(sine), cosine), sine), cosine * inverse_square, -sine * inverse_square


@device_function
def fill_second(rigidities: Vector, lengths: Vector, w: BeamWork) -> None:
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
                        other_s = 2 + 3 * b + j
                        term = lengths[e] * by_bow(w.turn[e, b, j], w.turn[e, 1 - b, j]) * along * bow
                        if k == j:
                            bending, same_end = 2.0 * rigidities[1 + k] / lengths[e], a == b
                            term += w.first[e, STRETCH] * lengths[e] / 30.0 * (4.0 if same_end else -1.0)
                            term += bending * (2.0 if same_end else 1.0)
                        second[s, other_s] = term * factor[a, 0] * factor[b, 0]
                        second[c, other_s] += term * by_c * factor[b, 0]
                        second[c, 1 + 3 * b] += term * by_c * factor[b, 1] * m[other_s]
        for r in range(1, 7):
            second[r, STRETCH] = second[STRETCH, r]
            if r not in (1, 4):
                second[r, 1], second[r, 4] = second[1, r], second[4, r]
        stiffness, (phi, by_sine, by_cosine) = rigidities[3] / lengths[e], twist(m[SINE], m[COSINE])
        mixed = 2.0 * by_sine * by_cosine  # -2 S C / (S^2 + C^2)^2
        second[SINE, SINE] = stiffness * (by_sine * by_sine + phi * mixed)
        second[COSINE, COSINE] = stiffness * (by_cosine * by_cosine - phi * mixed)
        across = by_sine * by_cosine + phi * (by_cosine * by_cosine - by_sine * by_sine)
        second[SINE, COSINE] = second[COSINE, SINE] = stiffness * across


LANES: Final = 8
# of a beam: l drawn, l, t, drawn directors, (S, C), strain, derivatives by l and (S, C), by v; energy
DRAWN_LENGTH, LENGTH, DIRECTION, DRAWN, TWIST, STRAIN, PULL, BY_TWIST, FORCE, ENERGY = (
    LANES * place for place in (0, 1, 2, 5, 14, 16, 17, 18, 20, 23)
)
# of an end: quaternion, the same after a step, step, directors, (c, s_2, s_3), arccos(c) / (1 - c^2)^(1/2)
# and its derivative, (theta_2, theta_3), derivatives by (c, s_2, s_3) and by a turn
TURNS, TRIAL, STEP, DIRECTORS, MEASURES, FACTOR, BENT, BY_MEASURES, MOMENT = (
    LANES * place for place in (24, 28, 32, 35, 44, 47, 49, 51, 54)
)
SECOND: Final = LANES * 33
SIZE: Final = LANES * (24 + 2 * 33)


@device_function
def lane_of(e: int) -> int:
    """Return the index of a beam's first quantity."""
    return e // LANES * SIZE + e % LANES


@inlined
def three(s: Vector, at: int) -> tuple[float, float, float]:
    """Return a vector of a lane, from its index."""
    return s[at], s[at + LANES], s[at + 2 * LANES]


@inlined
def put(s: Vector, at: int, vector: tuple[float, float, float]) -> None:
    """Set a vector of a lane, at its index."""
    s[at], s[at + LANES], s[at + 2 * LANES] = vector


@inlined
def _turned(
    q: tuple[float, float, float, float], half: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """Return a quaternion turned by twice a vector."""
    a, b, c = half
    # tan(angle / 2) = |step| / 2: as good as the angle itself, which is a step of Newton's method
    p0 = q[0] - a * q[1] - b * q[2] - c * q[3]
    p1 = q[1] + a * q[0] + b * q[3] - c * q[2]
    p2 = q[2] + b * q[0] + c * q[1] - a * q[3]
    p3 = q[3] + c * q[0] + a * q[2] - b * q[1]
    inverse_norm = 1.0 / math.sqrt(p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3)
    return inverse_norm * p0, inverse_norm * p1, inverse_norm * p2, inverse_norm * p3


@inlined
def _rotation(
    q: tuple[float, float, float, float],
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """Return the rows of the rotation by a quaternion."""
    p0, p1, p2, p3 = q
    return (
        (1 - 2 * (p2 * p2 + p3 * p3), 2 * (p1 * p2 - p0 * p3), 2 * (p1 * p3 + p0 * p2)),
        (2 * (p1 * p2 + p0 * p3), 1 - 2 * (p1 * p1 + p3 * p3), 2 * (p2 * p3 - p0 * p1)),
        (2 * (p1 * p3 - p0 * p2), 2 * (p2 * p3 + p0 * p1), 1 - 2 * (p1 * p1 + p2 * p2)),
    )


@inlined
def _measure_end(s: Vector, lane: int, end: int, fraction: float) -> None:
    """Fill the quaternion after the step's fraction, directors and measures of one end."""
    at = end + lane
    q = s[TURNS + at], s[TURNS + LANES + at], s[TURNS + 2 * LANES + at], s[TURNS + 3 * LANES + at]
    p = _turned(q, scaled(0.5 * fraction, three(s, STEP + at)))
    s[TRIAL + at], s[TRIAL + LANES + at], s[TRIAL + 2 * LANES + at], s[TRIAL + 3 * LANES + at] = p
    x, y, z = _rotation(p)
    drawn_1, drawn_2, drawn_3 = (
        three(s, DRAWN + lane),
        three(s, DRAWN + 3 * LANES + lane),
        three(s, DRAWN + 6 * LANES + lane),
    )
    d1 = dot(x, drawn_1), dot(y, drawn_1), dot(z, drawn_1)
    d2 = dot(x, drawn_2), dot(y, drawn_2), dot(z, drawn_2)
    d3 = dot(x, drawn_3), dot(y, drawn_3), dot(z, drawn_3)
    put(s, DIRECTORS + at, d1)
    put(s, DIRECTORS + 3 * LANES + at, d2)
    put(s, DIRECTORS + 6 * LANES + at, d3)
    t = three(s, DIRECTION + lane)
    cosine = dot(d1, t)
    put(s, MEASURES + at, (cosine, dot(d2, t), dot(d3, t)))
    s[FACTOR + at], s[FACTOR + LANES + at], _ = factor_by_series(cosine)


@inlined
def _strain(stretch: float, s: Vector, lane: int) -> float:
    """Fill angles, strain, and its share in the derivatives by l and v; return the energy of stretching."""
    for at in (lane, SECOND + lane):
        factor = s[FACTOR + at]
        s[BENT + at] = factor * s[MEASURES + LANES + at]
        s[BENT + LANES + at] = factor * s[MEASURES + 2 * LANES + at]
    drawn, far_lane = s[DRAWN_LENGTH + lane], SECOND + lane
    strain = s[LENGTH + lane] / drawn - 1.0 + bowing(s[BENT + lane], s[BENT + far_lane])
    strain += bowing(s[BENT + LANES + lane], s[BENT + LANES + far_lane])
    pull = stretch * strain
    s[STRAIN + lane], s[PULL + lane] = strain, pull
    put(s, FORCE + lane, scaled(pull, three(s, DIRECTION + lane)))
    return 0.5 * pull * strain * drawn


@inlined
def _bend(second: float, third: float, s: Vector, lane: int, end: int) -> float:
    """Fill the derivatives by one end's measures; return its part of the energy of bending."""
    at, other_end = end + lane, SECOND - end + lane
    t, length = three(s, DIRECTION + lane), s[DRAWN_LENGTH + lane]
    pull, two_over_length = s[PULL + lane] * length, 2.0 / length
    turn2, turn3, other2, other3 = (
        s[BENT + at],
        s[BENT + LANES + at],
        s[BENT + other_end],
        s[BENT + LANES + other_end],
    )
    moment2 = two_over_length * second * (2.0 * turn2 + other2)
    moment3 = two_over_length * third * (2.0 * turn3 + other3)
    energy = 0.5 * (moment2 * turn2 + moment3 * turn3)
    moment2 += pull * by_bow(turn2, other2)
    moment3 += pull * by_bow(turn3, other3)
    cosine, sine2, sine3 = three(s, MEASURES + at)
    by_cosine = (moment2 * sine2 + moment3 * sine3) * s[FACTOR + LANES + at]
    by2, by3 = moment2 * s[FACTOR + at], moment3 * s[FACTOR + at]
    put(s, BY_MEASURES + at, (by_cosine, by2, by3))
    d2, d3 = three(s, DIRECTORS + 3 * LANES + at), three(s, DIRECTORS + 6 * LANES + at)
    meets = added(scaled(by_cosine, three(s, DIRECTORS + at)), added(scaled(by2, d2), scaled(by3, d3)))
    along = by_cosine * cosine + by2 * sine2 + by3 * sine3
    force = scaled(1.0 / s[LENGTH + lane], added(meets, scaled(-along, t)))
    put(s, FORCE + lane, added(three(s, FORCE + lane), force))
    put(s, MOMENT + at, cross(meets, t))
    return energy


@inlined
def _twist(torsion: float, s: Vector, lane: int) -> float:
    """Fill S and C, and add the derivatives by them; return the energy of twisting."""
    far_lane, stiffness = SECOND + lane, torsion / s[DRAWN_LENGTH + lane]
    b2, b3 = three(s, DIRECTORS + 3 * LANES + lane), three(s, DIRECTORS + 6 * LANES + lane)
    e2, e3 = three(s, DIRECTORS + 3 * LANES + far_lane), three(s, DIRECTORS + 6 * LANES + far_lane)
    sine, cosine = dot(b3, e2) - dot(b2, e3), dot(b2, e2) + dot(b3, e3)
    phi, by_sine, by_cosine = twist(sine, cosine)
    by_sine, by_cosine = stiffness * phi * by_sine, stiffness * phi * by_cosine
    s[TWIST + lane], s[TWIST + LANES + lane] = sine, cosine
    s[BY_TWIST + lane], s[BY_TWIST + LANES + lane] = by_sine, by_cosine
    meets2 = added(scaled(by_cosine, e2), scaled(-by_sine, e3))
    meets3 = added(scaled(by_cosine, e3), scaled(by_sine, e2))
    moment = added(cross(b2, meets2), cross(b3, meets3))
    put(s, MOMENT + lane, added(three(s, MOMENT + lane), moment))
    put(s, MOMENT + far_lane, added(three(s, MOMENT + far_lane), scaled(-1.0, moment)))
    return 0.5 * stiffness * phi * phi


@device_function
def differentiate(rigidities: Vector, s: Vector, fraction: float) -> None:
    """Fill energies and gradients of a group after a fraction of its step.

    Args:
        rigidities: (4,), see `RectangularSection`.
        s: (SIZE,), the group, with lengths, directions, turns and steps.
        fraction: of the step.
    """
    lanes = s.shape[0] // (SIZE // LANES)  # a known number of rounds would be unrolled and not vectorised
    for lane in range(lanes):
        _measure_end(s, lane, 0, fraction)
        _measure_end(s, lane, SECOND, fraction)
    for lane in range(lanes):
        for at in (lane, SECOND + lane):
            if 1.0 - s[MEASURES + at] >= FAR:  # the series does not reach
                s[FACTOR + at], s[FACTOR + LANES + at], _ = angle_factor(s[MEASURES + at])
    stretch, second, third, torsion = rigidities[0], rigidities[1], rigidities[2], rigidities[3]
    for lane in range(lanes):
        energy = _strain(stretch, s, lane)
        energy += _bend(second, third, s, lane, 0) + _bend(second, third, s, lane, SECOND)
        s[ENERGY + lane] = energy + _twist(torsion, s, lane)


@device_function
def _read_lanes(s: Vector, w: BeamWork) -> None:
    """Copy all beams' quantities from the groups; fill factors of angles and derivatives of measures."""
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
        d, j, t = w.directors[e], w.jacobian[e], w.direction[e]
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
def _add_by_turned_chords(w: BeamWork, whole: bool) -> None:
    """Add to the Hessians, whole or by turns alone, the second derivatives of l, c, s_2 and s_3."""
    pull = w.pull
    for e in range(w.hessian.shape[0]):
        h, t, d, inverse_length = w.hessian[e], w.direction[e], w.directors[e], 1.0 / w.measures[e, STRETCH]
        if whole:
            for r in range(3):
                for c in range(3):
                    h[r, c] += w.first[e, STRETCH] * inverse_length * ((1.0 if r == c else 0.0) - t[r] * t[c])
        for a in range(2):
            first, along, turn = 1 + 3 * a, 0.0, 3 + 3 * a
            for r in range(3):
                pull[r] = 0.0
                for k in range(3):
                    pull[r] += w.first[e, first + k] * d[a, k, r]
                along += pull[r] * t[r]
            for r in range(3):
                for c in range(3):
                    identity, sym = 1.0 if r == c else 0.0, pull[r] * t[c] + t[r] * pull[c]
                    h[turn + r, turn + c] += 0.5 * sym - along * identity
                    if whole:
                        h[r, c] -= (
                            inverse_length * inverse_length * (sym + along * (identity - 3.0 * t[r] * t[c]))
                        )
            for c in range(3 if whole else 0):  # dt . (w x pull) = w . (pull x dt), dt = (1 - t t^T) dv / l
                p, q = (c + 1) % 3, (c + 2) % 3
                across = pull[p] * t[q] - pull[q] * t[p]
                for r in range(3):
                    term = -inverse_length * across * t[r]
                    if r == q:
                        term += inverse_length * pull[p]
                    elif r == p:
                        term -= inverse_length * pull[q]
                    h[turn + c, r] += term
                    h[r, turn + c] += term


@device_function
def _add_by_twists(w: BeamWork) -> None:
    """Add the second derivatives of S and C to the Hessians."""
    meets = w.pull  # derivative of S and C by d_k of the first end
    for e in range(w.hessian.shape[0]):
        h, d, first = w.hessian[e], w.directors[e], w.first[e]
        for k in range(1, 3):
            sign, dot = 1.0 if k == 2 else -1.0, 0.0
            for r in range(3):
                meets[r] = first[COSINE] * d[1, k, r] + sign * first[SINE] * d[1, 3 - k, r]
                dot += d[0, k, r] * meets[r]
            for r in range(3):
                for c in range(3):
                    diagonal = dot if r == c else 0.0
                    sym = 0.5 * (d[0, k, r] * meets[c] + meets[r] * d[0, k, c]) - diagonal
                    h[3 + r, 3 + c] += sym
                    h[6 + r, 6 + c] += sym
                    cross = diagonal - meets[r] * d[0, k, c]
                    h[3 + r, 6 + c] += cross
                    h[6 + c, 3 + r] += cross


@device_function
def fill_hessians(rigidities: Vector, lengths: Vector, s: Vector, w: BeamWork, whole: bool) -> None:
    """Fill the Hessians by chords and turns.

    Args:
        rigidities: (4,), see `RectangularSection`.
        lengths: (m,) [m], drawn.
        s: the beams in groups, one per lane.
        w: `BeamWork`.
        whole: whether to fill them wholly; otherwise only the derivatives by turns.
    """
    _read_lanes(s, w)
    fill_second(rigidities, lengths, w)
    begin, product = 0 if whole else 3, w.product
    for e in range(w.hessian.shape[0]):  # products of first derivatives of the measures
        jacobian, second, hessian = w.jacobian[e], w.second[e], w.hessian[e]
        hessian[begin:, begin:] = 0.0
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
    _add_by_turned_chords(w, whole)
    _add_by_twists(w)
