"""A film on a mesh too coarse for its wrinkles: the plain law in tension, softer in compression.

A triangle stays flat up to its own buckling load s0. Beyond it wrinkles hide a fraction w >= 0 of length, and
the membrane force across them is -(s0 + r), r = f0 w^(1/n), n = 3. With thickness h, Young's modulus E,
Poisson's ratio nu, Y = E h, D = E h^3 / (12 (1 - nu^2)), drawn area A, and a the panel's width, seam to hole,
    f0 = C sqrt(D Y) / a,   s0 = min(beta pi^2 D / A, 1.5 f0)                                        [N/m].
Complementary density by the principal membrane forces N_i, <.> the positive part:
    psi*(N) = (N1^2 + N2^2 - 2 nu N1 N2) / (2 Y) + sum_i f0 / (n + 1) (<-N_i - s0> / f0)^(n + 1).
psi(E) = max over N of N : E - psi*(N) is convex and isotropic, with a continuous tangent. It is the plain law
of the strain without the hidden part, e_i + w_i, plus the work of hiding:
    psi = psi_plain(e + w) + sum_i (s0 w_i + n / (n + 1) f0 w_i^((n + 1) / n)).
States: taut, w = 0; wrinkled, across the first principal direction alone; slack, across both.
Reason for f0: a sheet compressed across its curvature k buckles at 2 sqrt(D Y) k. A panel of width a that
bulges by b has k = 2 b / a^2 and shortens by w = (2/3) (b / a)^2: r = 2 sqrt(6) sqrt(D Y) / a sqrt(w), n = 2,
without a constant to fit. n = 3 softens later, as the bulge grows gradually; C is such that both agree
at w = 0.05, of the size that units hide at 10 kPa. Fitted to three square units at 10 kPa C is 3.15.
Reason for s0: refined triangles fold by themselves, and must not hide the same length a second time; an
equilateral plate, simply supported under equal compression, buckles at 2.31 pi^2 D / A.
Source: buckling loads: Timoshenko and Gere, Theory of elastic stability, 2nd ed., sections 9.6 and 11.1;
complementary density: as for tension fields, see `tension_field`; the law is derived here.
"""

import math
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import device_function, inlined
from cosim.base.numba_insides import same_bits

HARDENING: Final = 2.0 * 6.0**0.5 * 0.05 ** (1.0 / 6.0)
"""C = 2.97, see above."""
PLATE: Final = 2.3
"""beta: buckling load of a triangular plate over pi^2 D / A."""
LARGEST_PLATE_RATIO: Final = 1.5
"""Bound of s0 / f0, chosen on a mesh refined three times; it acts where triangles are smaller yet."""
_ROOT_STEPS: Final = 5  # the start is off by at most 0.25 of 0.6; each step squares half of the error
_THIRD: Final = np.uint64(0x55555556)  # of 2^32, rounded up
_BIAS: Final = np.uint64(715094163)  # 2/3 of the exponent's bias, less a constant for the least error
_HALF: Final = np.uint64(32)  # of the bits
_SWEEPS: Final = 200  # each leaves at most nu^2 of the error, mostly far less: 2 to 4 are common


def wrinkling_forces(rigidity_Nm: float, young_N_m: float, panel_m: Array, areas: Array) -> Array:
    """Return s0 and f0 (m, 2) [N/m] of each triangle.

    Args:
        rigidity_Nm: D.
        young_N_m: Y.
        panel_m: (m,) [m], a.
        areas: (m,) [m^2], drawn.
    """
    hardening = HARDENING * math.sqrt(rigidity_Nm * young_N_m) / panel_m
    plate = PLATE * np.pi**2 * rigidity_Nm / areas
    return np.stack([np.minimum(plate, LARGEST_PLATE_RATIO * hardening), hardening], axis=1)


@inlined
def rough_cube_root(value: float) -> float:
    """Return the cube root of a positive number within 5 %: a third of its upper bits, and a bias.

    Loops over lanes are vectorised with it, as they are not with calls of a library.

    Source: a common start, e.g. cbrt of W. Kahan and K. C. Ng, in FreeBSD's msun.
    """
    third = ((same_bits(value) >> _HALF) * _THIRD) >> _HALF
    return same_bits((third + _BIAS) << _HALF)


@device_function
def _beyond(excess: float, compliance: float, hardening: float) -> float:
    """Return r of compliance r + (r / hardening)^3 = excess: r = m u of u^3 + 3 u = z, by Newton's method."""
    m = hardening * math.sqrt(compliance * hardening / 3.0)
    ratio = hardening / m
    z = abs(excess) * ratio * ratio * ratio
    v = rough_cube_root(z + 1.0)
    u = v - 1.0 / v
    for _ in range(_ROOT_STEPS):
        u = (2.0 * u * u * u + z) / (3.0 * u * u + 3.0)
    return m * u if excess >= 0.0 else -m * u


@device_function
def principal(e11: float, e22: float, e12: float) -> tuple[float, float, float, float]:
    """Return the principal strains, and cosine and sine of twice the first one's angle."""
    mean, half = 0.5 * (e11 + e22), 0.5 * (e11 - e22)
    radius = math.sqrt(half * half + 0.25 * e12 * e12)
    cosine, sine = (half / radius, 0.5 * e12 / radius) if radius > 0.0 else (1.0, 0.0)
    return mean + radius, mean - radius, cosine, sine


@device_function
def hide_across(
    e1: float, e2: float, stiffness: Matrix, plate: float, hardening: float
) -> tuple[float, float]:
    """Return r2 and N1 of principal strains in the wrinkled state; it is slack where N1 < -plate."""
    d00 = stiffness[0, 0]
    ratio = stiffness[0, 1] / d00
    r2 = _beyond(-(e2 + ratio * e1) - plate / d00, 1.0 / d00, hardening)
    return r2, d00 * (1.0 - ratio * ratio) * e1 - ratio * (plate + r2)


@device_function
def turn_forces(first: float, second: float, cosine: float, sine: float) -> tuple[float, float, float]:
    """Return N11, N22, N12 of principal forces, from cosine and sine of twice the first one's angle."""
    center, shear = 0.5 * (first + second), 0.5 * (first - second)
    return center + shear * cosine, center - shear * cosine, shear * sine


@device_function
def density(
    strain: tuple[float, float], first: float, below: tuple[float, float], plate: float, hardening: float
) -> float:
    """Return psi from principal strains, N1, and the amounts by which N1 and N2 are below -plate."""
    e1, e2 = strain
    r1, r2 = below
    t1, t2 = r1 / hardening, r2 / hardening
    w1, w2 = t1 * t1 * t1, t2 * t2 * t2
    elastic = 0.5 * (first * (e1 + w1) - (plate + r2) * (e2 + w2))
    return elastic + plate * (w1 + w2) + 0.75 * (r1 * w1 + r2 * w2)


@device_function
def wrinkling(
    strain: tuple[float, float, float],
    stiffness: Matrix,
    plate: float,
    hardening: float,
    n: Vector,
    c: Matrix,
) -> float:
    """Fill n (3,) and c, first and second derivative of the energy density by (E11, E22, 2 E12).

    With a, b the squares of the principal directions and v the turn of a, in the components of E,
        n = N1 a + N2 b,
        c = H11 a a^T + H12 (a b^T + b a^T) + H22 b b^T + 2 (N1 - N2) / (e1 - e2) v v^T,
    H the inverse of the second derivative of psi*. There e1 - e2 = (1 + nu) (N1 - N2) / Y + w2 - w1, and
    w2 - w1 = (N1 - N2) (r1^2 + r1 r2 + r2^2) / f0^3 in the slack state: it holds for equal strains too.

    Args:
        strain: E11, E22, 2 E12.
        stiffness: (3, 3) [N/m], of the plain law.
        plate: s0 [N/m].
        hardening: f0 [N/m].
        n: filled.
        c: (3, 3), filled; empty if it is not needed.

    Returns:
        Energy density [J/m^2].
    """
    e11, e22, e12 = strain
    d00, d01 = stiffness[0, 0], stiffness[0, 1]
    n0, n1, n2 = d00 * e11 + d01 * e22, d01 * e11 + d00 * e22, stiffness[2, 2] * e12
    with_tangent = c.shape[0] > 0
    above, half = 0.5 * (n0 + n1) + plate, 0.5 * (n0 - n1)
    if above >= 0.0 and above * above >= half * half + n2 * n2:  # the second principal force is above -s0
        n[0], n[1], n[2] = n0, n1, n2
        if with_tangent:
            for r in range(3):
                for k in range(3):
                    c[r, k] = stiffness[r, k]
        return 0.5 * (e11 * n0 + e22 * n1 + e12 * n2)
    ratio = d01 / d00
    young = d00 * (1.0 - ratio * ratio)
    e1, e2, cosine, sine = principal(e11, e22, e12)
    r1 = 0.0
    r2, first = hide_across(e1, e2, stiffness, plate, hardening)
    if first < -plate:
        common = plate * (1.0 - ratio) / young
        # (r_i - ratio r_j) / young + (r_i / hardening)^3 = -e_i - common, by turns
        compliance = 1.0 / young
        r2 = _beyond(-e2 - common, compliance, hardening)
        for _ in range(_SWEEPS):
            before = r1
            r1 = _beyond(-e1 - common + ratio * compliance * r2, compliance, hardening)
            r2 = _beyond(-e2 - common + ratio * compliance * r1, compliance, hardening)
            if abs(r1 - before) <= 1e-15 * hardening:
                break
        first = -plate - r1
    second = -plate - r2
    n[0], n[1], n[2] = turn_forces(first, second, cosine, sine)
    if with_tangent:
        _fill_tangent(c, stiffness, (r1, r2, hardening), (cosine, sine), first - second)
    return density((e1, e2), first, (r1, r2), plate, hardening)


@device_function
def _fill_tangent(
    c: Matrix,
    stiffness: Matrix,
    beyond: tuple[float, float, float],
    direction: tuple[float, float],
    difference: float,
) -> None:
    """Fill c (3, 3).

    Args:
        c: filled.
        stiffness: of the plain law.
        beyond: r1, r2, f0.
        direction: cosine and sine of twice the first principal angle.
        difference: N1 - N2.
    """
    r1, r2, hardening = beyond
    cosine, sine = direction
    ratio = stiffness[0, 1] / stiffness[0, 0]
    soft = 1.0 / (stiffness[0, 0] * (1.0 - ratio * ratio))
    cube = hardening * hardening * hardening
    p1, p2 = soft + 3.0 * r1 * r1 / cube, soft + 3.0 * r2 * r2 / cube
    scale = 1.0 / (p1 * p2 - ratio * ratio * soft * soft)
    h11, h12, h22 = scale * p2, scale * ratio * soft, scale * p1
    hidden = r1 * r1 + r1 * r2 + r2 * r2  # cubed f0 times (w2 - w1) / (N1 - N2)
    if r1 == 0.0 and r2 > 0.0:  # wrinkled
        hidden *= r2 / difference
    turn = 2.0 / ((1.0 + ratio) * soft + hidden / cube)
    a0, a1, a2 = 0.5 * (1.0 + cosine), 0.5 * (1.0 - cosine), 0.5 * sine
    v0, v2 = -0.5 * sine, 0.5 * cosine
    # b is (a1, a0, -a2)
    ha0, ha1, ha2 = h11 * a0 + h12 * a1, h11 * a1 + h12 * a0, (h11 - h12) * a2
    hb0, hb1, hb2 = h12 * a0 + h22 * a1, h12 * a1 + h22 * a0, (h12 - h22) * a2
    c[0, 0] = ha0 * a0 + hb0 * a1 + turn * v0 * v0
    c[1, 1] = ha1 * a1 + hb1 * a0 + turn * v0 * v0
    c[2, 2] = (ha2 - hb2) * a2 + turn * v2 * v2
    c[0, 1] = c[1, 0] = ha0 * a1 + hb0 * a0 - turn * v0 * v0
    c[0, 2] = c[2, 0] = ha0 * a2 - hb0 * a2 + turn * v0 * v2
    c[1, 2] = c[2, 1] = ha1 * a2 - hb1 * a2 - turn * v0 * v2
