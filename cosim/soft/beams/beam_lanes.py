"""Energies and gradients of a ring's beams in groups, one beam per lane, by the measures of `beam_measures`.

Quantity q of a lane is at s[q + lane], q a multiple of LANES: constant distances are what lets loops over
lanes vectorise. Those of a beam's second end are SECOND further on than those of its first. What is linear in
the chord's direction and the directors has the vectors that these meet in it as derivatives.
"""

from __future__ import annotations

import math
from typing import Final

from cosim.base.kernels import device_function, inlined
from cosim.soft.beams.beam_measures import FAR, angle_factor, bowing, by_bow, factor_by_series, twist
from cosim.soft.beams.triples import added, cross, dot, scaled

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
def lane_of(e):  # type: ignore[no-untyped-def]
    """Return where the quantities of a beam begin."""
    return e // LANES * SIZE + e % LANES


@inlined
def three(s, at):  # type: ignore[no-untyped-def]
    """Return a vector of a lane."""
    return s[at], s[at + LANES], s[at + 2 * LANES]


@inlined
def put(s, at, vector):  # type: ignore[no-untyped-def]
    """Write a vector of a lane."""
    s[at], s[at + LANES], s[at + 2 * LANES] = vector


@inlined
def _turned(q, half):  # type: ignore[no-untyped-def]
    """Return a quaternion turned by twice a vector."""
    a, b, c = half
    # tan(angle / 2) = |step| / 2: as good as the angle itself, which is a step of Newton's method
    p0 = q[0] - a * q[1] - b * q[2] - c * q[3]
    p1 = q[1] + a * q[0] + b * q[3] - c * q[2]
    p2 = q[2] + b * q[0] + c * q[1] - a * q[3]
    p3 = q[3] + c * q[0] + a * q[2] - b * q[1]
    over = 1.0 / math.sqrt(p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3)
    return over * p0, over * p1, over * p2, over * p3


@inlined
def _rotation(q):  # type: ignore[no-untyped-def]
    """Return the rows of the rotation by a quaternion."""
    p0, p1, p2, p3 = q
    return (
        (1 - 2 * (p2 * p2 + p3 * p3), 2 * (p1 * p2 - p0 * p3), 2 * (p1 * p3 + p0 * p2)),
        (2 * (p1 * p2 + p0 * p3), 1 - 2 * (p1 * p1 + p3 * p3), 2 * (p2 * p3 - p0 * p1)),
        (2 * (p1 * p3 - p0 * p2), 2 * (p2 * p3 + p0 * p1), 1 - 2 * (p1 * p1 + p2 * p2)),
    )


@inlined
def _measure_end(s, lane, end, fraction):  # type: ignore[no-untyped-def]
    """Fill the quaternion after the step's fraction, directors and measures of one end."""
    at = end + lane
    q = s[TURNS + at], s[TURNS + LANES + at], s[TURNS + 2 * LANES + at], s[TURNS + 3 * LANES + at]
    p = _turned(q, scaled(0.5 * fraction, three(s, STEP + at)))
    s[TRIAL + at], s[TRIAL + LANES + at], s[TRIAL + 2 * LANES + at], s[TRIAL + 3 * LANES + at] = p
    x, y, z = _rotation(p)
    one, two, last = (
        three(s, DRAWN + lane),
        three(s, DRAWN + 3 * LANES + lane),
        three(s, DRAWN + 6 * LANES + lane),
    )
    d1 = dot(x, one), dot(y, one), dot(z, one)
    d2 = dot(x, two), dot(y, two), dot(z, two)
    d3 = dot(x, last), dot(y, last), dot(z, last)
    put(s, DIRECTORS + at, d1)
    put(s, DIRECTORS + 3 * LANES + at, d2)
    put(s, DIRECTORS + 6 * LANES + at, d3)
    t = three(s, DIRECTION + lane)
    cosine = dot(d1, t)
    put(s, MEASURES + at, (cosine, dot(d2, t), dot(d3, t)))
    s[FACTOR + at], s[FACTOR + LANES + at], _ = factor_by_series(cosine)


@device_function
def _correct_factor(s, at):  # type: ignore[no-untyped-def]
    """Replace the factor of an end's angle where the series does not reach."""
    if 1.0 - s[MEASURES + at] >= FAR:
        s[FACTOR + at], s[FACTOR + LANES + at], _ = angle_factor(s[MEASURES + at])


@inlined
def _strain(stretch, s, lane):  # type: ignore[no-untyped-def]
    """Fill angles, strain and the derivatives by l and v that come of it; return the energy."""
    for at in (lane, SECOND + lane):
        factor = s[FACTOR + at]
        s[BENT + at] = factor * s[MEASURES + LANES + at]
        s[BENT + LANES + at] = factor * s[MEASURES + 2 * LANES + at]
    drawn, other = s[DRAWN_LENGTH + lane], SECOND + lane
    strain = s[LENGTH + lane] / drawn - 1.0 + bowing(s[BENT + lane], s[BENT + other])
    strain += bowing(s[BENT + LANES + lane], s[BENT + LANES + other])
    pull = stretch * strain
    s[STRAIN + lane], s[PULL + lane] = strain, pull
    put(s, FORCE + lane, scaled(pull, three(s, DIRECTION + lane)))
    return 0.5 * pull * strain * drawn


@inlined
def _bend(second, third, s, lane, end):  # type: ignore[no-untyped-def]
    """Fill what one end's measures give of all derivatives; return its part of the energy of bending."""
    at, there = end + lane, SECOND - end + lane
    t, length = three(s, DIRECTION + lane), s[DRAWN_LENGTH + lane]
    pull, over = s[PULL + lane] * length, 2.0 / length
    turn2, turn3, other2, other3 = (
        s[BENT + at],
        s[BENT + LANES + at],
        s[BENT + there],
        s[BENT + LANES + there],
    )
    moment2 = over * second * (2.0 * turn2 + other2)
    moment3 = over * third * (2.0 * turn3 + other3)
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
def _twist(torsion, s, lane):  # type: ignore[no-untyped-def]
    """Fill S and C, and add what they give of all derivatives; return the energy of twisting."""
    other, stiffness = SECOND + lane, torsion / s[DRAWN_LENGTH + lane]
    b2, b3 = three(s, DIRECTORS + 3 * LANES + lane), three(s, DIRECTORS + 6 * LANES + lane)
    e2, e3 = three(s, DIRECTORS + 3 * LANES + other), three(s, DIRECTORS + 6 * LANES + other)
    sine, cosine = dot(b3, e2) - dot(b2, e3), dot(b2, e2) + dot(b3, e3)
    phi, by_sine, by_cosine = twist(sine, cosine)
    by_sine, by_cosine = stiffness * phi * by_sine, stiffness * phi * by_cosine
    s[TWIST + lane], s[TWIST + LANES + lane] = sine, cosine
    s[BY_TWIST + lane], s[BY_TWIST + LANES + lane] = by_sine, by_cosine
    meets2 = added(scaled(by_cosine, e2), scaled(-by_sine, e3))
    meets3 = added(scaled(by_cosine, e3), scaled(by_sine, e2))
    moment = added(cross(b2, meets2), cross(b3, meets3))
    put(s, MOMENT + lane, added(three(s, MOMENT + lane), moment))
    put(s, MOMENT + other, added(three(s, MOMENT + other), scaled(-1.0, moment)))
    return 0.5 * stiffness * phi * phi


@device_function
def differentiate(rigidities, s, fraction):  # type: ignore[no-untyped-def]
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
    for at in range(lanes):
        _correct_factor(s, at)
        _correct_factor(s, SECOND + at)
    stretch, second, third, torsion = rigidities[0], rigidities[1], rigidities[2], rigidities[3]
    for lane in range(lanes):
        energy = _strain(stretch, s, lane)
        energy += _bend(second, third, s, lane, 0) + _bend(second, third, s, lane, SECOND)
        s[ENERGY + lane] = energy + _twist(torsion, s, lane)
