"""Known answers of cushions that are computed on two meshes: made for them, and from a drawing."""

from __future__ import annotations

import math

from scipy.special import gamma

from cosim.soft.elements.material import Film

MYLAR, MYLAR_Pa = Film(1e10, 0.3, 1e-3, "tension_field"), 100.0


def mylar_balloon() -> tuple[float, float, float]:
    """Return radius, thickness and volume of a Mylar balloon of two inextensible discs of radius 1.

    The profile z' = -x^2 / sqrt(r^4 - x^4) from the axis to x = r has the length 1 of the disc's radius and
    the volume 2 pi r^2 / 3. Length / r and height / r are the lemniscate's integrals of 1 / sqrt(1 - u^4) and
    u^2 / sqrt(1 - u^4); the first is Gamma(1/4)^2 / (4 sqrt(2 pi)), their product pi / 4.
    Sources: Paulsen, Am. Math. Monthly 101 (1994) 953; Mladenov and Oprea, ibid. 110 (2003) 761.
    """
    lemniscate = float(gamma(0.25)) ** 2 / (4.0 * math.sqrt(2.0 * math.pi))
    r = 1.0 / lemniscate
    return r, 0.5 * r * math.pi / lemniscate, 2.0 / 3.0 * math.pi * r * r
