"""The Mylar balloon: two discs of inextensible film welded along their edge."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from scipy.special import gamma

from cosim.soft.elements.material import Film
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.cushion import inflated_cushion
from cosim.verification.support.meshes import quarter_disc

FILM = Film(1e10, 0.3, 1e-3, "tension_field")
RADIUS_M = 1.0
PRESSURE_PA = 100.0
RINGS = 20


def balloon() -> tuple[float, float, float]:
    """Return (radius, thickness, volume) for discs of radius 1.

    The profile z' = -x^2 / sqrt(r^4 - x^4) from the axis to x = r has the length 1 of the disc's radius and
    the volume 2 pi r^2 / 3. Length / r and height / r are the lemniscate's integrals of 1 / sqrt(1 - u^4) and
    u^2 / sqrt(1 - u^4); the first is Gamma(1/4)^2 / (4 sqrt(2 pi)), their product pi / 4.
    """
    lemniscate = float(gamma(0.25)) ** 2 / (4.0 * math.sqrt(2.0 * math.pi))
    r = 1.0 / lemniscate
    half_height = r * 0.25 * math.pi / lemniscate
    return r, 2.0 * half_height, 2.0 / 3.0 * math.pi * r * r


@final
@dataclass(frozen=True)
class MylarBalloon(Case):
    """Volume, thickness and radius of the balloon, with p A / E t = 1e-5.

    The film wrinkles everywhere, more and more towards the rim. There the mesh crumples instead: its nodes
    lie between 0.67 and 0.78 of the disc's radius, and only their mean is compared.
    """

    name: ClassVar[str] = "mylar_balloon"
    title: ClassVar[str] = "Mylar balloon, tension field"
    source: ClassVar[str] = (
        "Paulsen, Am. Math. Monthly 101 (1994) 953; Mladenov and Oprea, ibid. 110 (2003) 761"
    )

    def run(self) -> tuple[Figure, ...]:
        shape = quarter_disc(RADIUS_M, RINGS)
        rim = np.linalg.norm(shape.positions, axis=1) > RADIUS_M * (1.0 - 1e-9)
        found = inflated_cushion(shape, rim, FILM, PRESSURE_PA, 0.4)
        radius, thickness, volume = balloon()
        return (
            Figure("volume / A^3", "1", found.volume / RADIUS_M**3, volume, 1e-2),
            Figure("thickness / A", "1", 2.0 * found.height / RADIUS_M, thickness, 1e-2),
            Figure(
                "mean radius / A",
                "1",
                float(np.linalg.norm(found.positions[rim], axis=1).mean()),
                radius,
                2e-2,
            ),
        )
