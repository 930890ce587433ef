"""The rectangular section of a beam: its stiffness against stretch, bending and twist."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import InputError


@final
@dataclass(frozen=True)
class RectangularSection:
    """Rectangular section of a beam along a ring, of an isotropic material.

    Args:
        width_m: b, in the plane of the ring.
        height_m: h, across that plane.
        young_modulus_Pa: E.
        poisson_ratio: nu; the shear modulus is G = E / (2 (1 + nu)).
        strength_strain: largest strain that the material bears; infinite where nobody said it.

    Raises:
        InputError: a constant out of its bounds.
    """

    width_m: float
    height_m: float
    young_modulus_Pa: float
    poisson_ratio: float = 0.35
    strength_strain: float = math.inf

    def __post_init__(self) -> None:
        for name in ("width_m", "height_m", "young_modulus_Pa"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} is {getattr(self, name)}; it must be positive and finite")
        if not self.strength_strain > 0.0:
            raise InputError(f"strength_strain is {self.strength_strain}; it must be positive")
        if not -1.0 < self.poisson_ratio <= 0.5:
            raise InputError(
                f"poisson_ratio is {self.poisson_ratio}; it must lie above -1 and be 0.5 at most"
            )

    @property
    def area_m2(self) -> float:
        """A = b h."""
        return self.width_m * self.height_m

    @property
    def torsion_constant_m4(self) -> float:
        """J = s r^3 (1/3 - 64 r / (pi^5 s) sum over odd n of tanh(n pi s / (2 r)) / n^5), r <= s the sides.

        Source: Saint-Venant's solution, e.g. Timoshenko and Goodier, Theory of Elasticity, section 109.
        """
        short, long = sorted((self.width_m, self.height_m))
        series = sum(math.tanh(0.5 * n * math.pi * long / short) / n**5 for n in range(1, 12, 2))
        return long * short**3 * (1.0 / 3.0 - 64.0 * short / (math.pi**5 * long) * series)

    @property
    def rigidities(self) -> Array:
        """(4,): E A [N]; E h b^3 / 12 in the plane, E b h^3 / 12 out of it, G J [N m^2]."""
        e, b, h = self.young_modulus_Pa, self.width_m, self.height_m
        shear = 0.5 * e / (1.0 + self.poisson_ratio)
        return np.array(
            [e * self.area_m2, e * h * b**3 / 12.0, e * b * h**3 / 12.0, shear * self.torsion_constant_m4]
        )
