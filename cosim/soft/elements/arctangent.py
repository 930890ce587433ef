"""The angle of a point in the plane, in arithmetic that compilers turn into vector instructions."""

from __future__ import annotations

import math

from cosim.base.kernels import inlined

TURN = 2.0 * math.pi
_EIGHTH = math.tan(math.pi / 8.0)


@inlined
def full_angle(sine, cosine):  # type: ignore[no-untyped-def]
    """Return atan2(sine, cosine) in [0, 2 pi), to 2e-15; NaN where both are zero.

    The ratio is brought to |t| <= tan(pi / 8); there (atan(t) / t - 1) / t^2 is a polynomial in t^2 that
    meets the series at 11 Chebyshev points (5e-18 off in between).
    """
    height, width = abs(sine), abs(cosine)
    steep = height > width
    large = height if steep else width
    small = width if steep else height
    beyond = small > _EIGHTH * large
    t = (small - large if beyond else small) / (small + large if beyond else large)
    z = t * t
    p = 0.03923044778479309 - 0.019175404711104935 * z
    p = p * z - 0.050854078345894844
    p = p * z + 0.05858140904866328
    p = p * z - 0.06664510525508936
    p = p * z + 0.07692183125376892
    p = p * z - 0.0909090457530649
    p = p * z + 0.11111111015187018
    p = p * z - 0.14285714284665682
    p = p * z + 0.19999999999995516
    p = p * z - 0.3333333333333333
    angle = t + t * z * p + (0.25 * math.pi if beyond else 0.0)
    angle = 0.5 * math.pi - angle if steep else angle
    angle = math.pi - angle if cosine < 0.0 else angle
    return TURN - angle if sine < 0.0 else angle
