"""The tension field of a film, isotropic or woven: its energy after arbitrarily fine wrinkling.

With S the compliance of the plain law, the energy density psi(E) is the maximum of N : E - N : S : N / 2 over
all N without compression. With k^4 = C22 / C11, membrane forces and strains along warp and weft become
    x = ((k N11 + N22 / k) / 2, (k N11 - N22 / k) / 2, N12),
    y = (E11 / k + k E22, E11 / k - k E22, 2 E12),
    psi* = (a0 x0^2 + a1 x1^2 + a2 x2^2) / 2,   a = 2 / (c + C12), 2 / (c - C12), 1 / C33,   c^2 = C11 C22:
no product of two of them is left. There is no compression in the cone x0 >= |(x1, x2)|, so x is the point of
a cone nearest to y / a:
    slack     |(y1, y2)| <= -y0:                x = 0,
    taut      |(y1 / a1, y2 / a2)| <= y0 / a0:  x = y / a, the plain law,
    wrinkled  otherwise: x = z (1, p1, p2), p_i = y_i / (A_i z - y0), A_i = a0 + a_i, z such that |p| = 1.
Of isotropic film A1 = A2, so that z = (y0 + |(y1, y2)|) / A1: E t e1 / 2, e1 the first principal strain.
psi is convex with a continuous gradient; its second derivative jumps where the state changes.
A fraction f of the plain law can stay, f psi_plain + (1 - f) psi: the film's bending resists fine wrinkles.
With f = 0 a slack triangle has no resistance and may collapse; a hinge next to it has then no angle. The rest
of the plain law softens once a length is below 1 / sqrt(3) of the drawn one, and vanishes with the length. So
with 0 < f < 1 a triangle whose area is below that fraction, d = det(2 E + 1) < d0 = 1/3, has in addition
    psi_packed = f (1 - f) C11 (d0 / d - 1)^3,
without bound as its area goes to zero: wrinkles can be packed only so far. Where hinges are, f should be 1e-4
or more.
A film can resist compression up to a force b [N/m] across any line before it wrinkles, as a curved sheet does
up to its buckling load. Then N + b 1 has no compression: with E0 = C^-1 b 1 the law is
    psi(E) = psi_without(E + E0) - b tr(E) - psi_without(E0).
Source: Pipkin, IMA J. Appl. Math. 36 (1986) 85-99; Steigmann, Proc. R. Soc. A 429 (1990) 141-173; of woven
film: Epstein and Forcinito, Int. J. Solids Struct. 38 (2001) 5253-5272, with the cone derived here.
"""

import math
from typing import Final

from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import device_function

_PACKED: Final = 1.0 / 3.0
"""d0, square of the fraction of its area below which a triangle resists collapse."""
_CONE_ROUNDING: Final = 4e-16
_CONE_STEPS: Final = 60  # each squares the error; one is enough for isotropic film, 3 to 6 are common


@device_function
def tension_field(
    strain: tuple[float, float, float], stiffness: Matrix, compression: Vector, n: Vector, c: Matrix
) -> float:
    """Fill n (3,) and c (3, 3), first and second derivative of the energy density by (E11, E22, 2 E12).

    Args:
        strain: E11, E22, 2 E12, along warp and weft if the film is woven.
        stiffness: (3, 3) [N/m], of the plain law.
        compression: (2,), f and b [N/m].
        n: filled.
        c: filled.

    Returns:
        Energy density [J/m^2].
    """
    fraction, force = compression[0], compression[1]
    packing = fraction * (1.0 - fraction) * stiffness[0, 0]
    if force == 0.0:
        return _relaxed(strain, stiffness, fraction, n, c) + _packed(strain, packing, n, c)
    c00, c01, c11 = stiffness[0, 0], stiffness[0, 1], stiffness[1, 1]
    flat = force / (c00 * c11 - c01 * c01)
    first, second = flat * (c11 - c01), flat * (c00 - c01)  # E0
    e11, e22 = strain[0] + first, strain[1] + second
    density = _relaxed((e11, e22, strain[2]), stiffness, fraction, n, c)
    n[0] -= force
    n[1] -= force
    density += _packed(strain, packing, n, c)
    return density - force * (e11 + e22 - 0.5 * (first + second))


@device_function
def _packed(strain: tuple[float, float, float], packing: float, n: Vector, c: Matrix) -> float:
    """Add psi_packed to n (3,) and c (3, 3), so that a triangle keeps an area; return the density [J/m^2].

    Args:
        strain: E11, E22, 2 E12.
        packing: f (1 - f) C11 [N/m].
        n: added to.
        c: added to.
    """
    first, second, third = 1.0 + 2.0 * strain[1], 1.0 + 2.0 * strain[0], -strain[2]  # dd/dE / 2
    square = first * second - third * third
    if packing == 0.0 or square >= _PACKED:
        return 0.0
    if not square > 0.0:
        return math.inf
    ratio = _PACKED / square
    above = ratio - 1.0
    slope = -6.0 * packing * above * above * ratio / square
    curvature = 24.0 * packing * above * ratio * (ratio + above) / (square * square)
    for r, by_r in ((0, first), (1, second), (2, third)):
        n[r] += slope * by_r
        for s, by_s in ((0, first), (1, second), (2, third)):
            c[r, s] += curvature * by_r * by_s
    c[0, 1] += 2.0 * slope
    c[1, 0] += 2.0 * slope
    c[2, 2] -= slope
    return packing * above * above * above


@device_function
def _relaxed(
    strain: tuple[float, float, float], stiffness: Matrix, fraction: float, n: Vector, c: Matrix
) -> float:
    """Fill n and c as `tension_field` does, for a film that resists no compression.

    In the wrinkled state x = z (1, p1, p2) stays on the cone, whose tangent plane there has the directions
    a = (1, p1, p2) and w = (0, -p2, p1). By e both are turned into those of N:
        n = z a,   c = [a w] Q^-1 [a w]^T,   Q = [a w]^T diag(a0 - m, a1 + m, a2 + m) [a w],
    m = a0 - y0 / z. Q is positive definite: nothing is divided by a small number.

    Args:
        strain: E11, E22, 2 E12, along warp and weft if the film is woven.
        stiffness: (3, 3) [N/m], of the plain law.
        fraction: f, 0 to 1.
        n: filled.
        c: filled.

    Returns:
        Energy density [J/m^2].
    """
    e11, e22, e12 = strain
    k, modulus, shear = 1.0, stiffness[0, 0], stiffness[2, 2]
    if stiffness[1, 1] != modulus:
        k, modulus = math.sqrt(math.sqrt(stiffness[1, 1] / modulus)), math.sqrt(modulus * stiffness[1, 1])
    mean, half = 0.5 * (modulus + stiffness[0, 1]), 0.5 * (modulus - stiffness[0, 1])
    y0, y1, y2 = e11 / k + k * e22, e11 / k - k * e22, e12
    x0, x1, x2 = mean * y0, half * y1, shear * y2
    taut = x0 > 0.0 and x1 * x1 + x2 * x2 <= x0 * x0
    weight = 1.0 if taut else fraction
    n[0] = weight * (stiffness[0, 0] * e11 + stiffness[0, 1] * e22)
    n[1] = weight * (stiffness[1, 0] * e11 + stiffness[1, 1] * e22)
    n[2] = weight * stiffness[2, 2] * e12
    for r in range(3):
        for s in range(3):
            c[r, s] = weight * stiffness[r, s]
    density = 0.5 * (e11 * n[0] + e22 * n[1] + e12 * n[2])
    if taut or (y0 <= 0.0 and y1 * y1 + y2 * y2 <= y0 * y0):
        return density
    a0, a1, a2 = 1.0 / mean, 1.0 / half, 1.0 / shear
    z, p1, p2 = _on_cone((y0, y1, y2), (a0, a0 + a1, a0 + a2))
    q_aa, q_aw = a0 + a1 * p1 * p1 + a2 * p2 * p2, (a2 - a1) * p1 * p2
    q_ww = a1 * p2 * p2 + a2 * p1 * p1 + a0 - y0 / z
    relaxed = 1.0 - fraction
    scale = relaxed / (q_aa * q_ww - q_aw * q_aw)
    q_aa, q_aw, q_ww = scale * q_aa, scale * q_aw, scale * q_ww
    t0, t1, t2 = (1.0 + p1) / k, k * (1.0 - p1), p2  # along the tension
    w0, w1, w2 = -p2 / k, k * p2, p1  # turning it
    for r, along, turned in ((0, t0, w0), (1, t1, w1), (2, t2, w2)):
        n[r] += relaxed * z * along
        along_row, turn_row = q_ww * along - q_aw * turned, q_aa * turned - q_aw * along
        c[r, 0] += along_row * t0 + turn_row * w0
        c[r, 1] += along_row * t1 + turn_row * w1
        c[r, 2] += along_row * t2 + turn_row * w2
    return density + 0.5 * relaxed * z * (y0 + p1 * y1 + p2 * y2)


@device_function
def _on_cone(y: tuple[float, float, float], a: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return z, p1, p2 with |p| = 1 from y and a0, A1, A2, by Newton's method on 1 - 1 / |p|.

    The function grows and is concave in z, so Newton's method from below never overshoots.
    """
    y0, y1, y2 = y
    z = max(y0 / a[0], (y0 + math.sqrt(y1 * y1 + y2 * y2)) / max(a[1], a[2]))
    p1, p2, size = 1.0, 0.0, 1.0
    for _ in range(_CONE_STEPS):
        b1, b2 = a[1] * z - y0, a[2] * z - y0
        p1, p2 = y1 / b1, y2 / b2
        size = math.sqrt(p1 * p1 + p2 * p2)
        step = size * size * (size - 1.0) / (a[1] * p1 * p1 / b1 + a[2] * p2 * p2 / b2)
        if not step > _CONE_ROUNDING * z:
            break
        z += step
    return z, p1 / size, p2 / size
