"""A sphere filled with a given amount of gas: its pressure, and the frequency at which it breathes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.optimize import brentq

from cosim.soft.body.body import SoftBody
from cosim.soft.elements.gas import SealedGas, STANDARD_ATMOSPHERE_Pa
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import octant_sphere
from cosim.verification.support.specimen import UNLOADED, Specimen

FILM = Film(20e6, 0.3, 1e-4)
RADIUS_M = 0.04
DENSITY = 1200.0
EXPONENT = 1.4
FILLING = 1.02
"""Absolute pressure over the atmosphere's, in the drawn volume."""
RINGS = 16


def filled_pressure() -> float:
    """Return the gauge pressure [Pa] at which gas (isothermal) and film agree on the radius.

    With the growth e = dR / R and the filling f, the gas has p = p_a (f / (1 + e)^3 - 1). The film's energy
    is 4 pi R^2 E t g^2 / (1 - nu) with the Green strain g = e + e^2 / 2, and its derivative by the volume
    is p = 2 E t g / ((1 - nu) R (1 + e)).
    """
    stiffness = 2.0 * FILM.young_modulus_Pa * FILM.thickness_m / ((1.0 - FILM.poisson_ratio) * RADIUS_M)

    def gas(e: float) -> float:
        return STANDARD_ATMOSPHERE_Pa * (FILLING / (1.0 + e) ** 3 - 1.0)

    def film(e: float) -> float:
        return stiffness * (e + 0.5 * e * e) / (1.0 + e)

    return gas(float(brentq(lambda e: gas(e) - film(e), 0.0, 0.1, xtol=1e-15)))


def breathing() -> float:
    """Return omega [rad/s] of the sphere at rest:  2 E / (rho R^2 (1 - nu)) + 3 gamma p_a / (rho t R)."""
    film = 2.0 * FILM.young_modulus_Pa / (RADIUS_M**2 * (1.0 - FILM.poisson_ratio))
    gas = 3.0 * EXPONENT * STANDARD_ATMOSPHERE_Pa / (FILM.thickness_m * RADIUS_M)
    return math.sqrt((film + gas) / DENSITY)


@final
@dataclass(frozen=True)
class SealedGasSphere(Case):
    """A filled sphere at rest, and its breathing with the film's and the gas's stiffness.

    The gas takes a good half of the breathing stiffness. The frequency is Rayleigh's quotient of the radial
    motion.
    """

    name: ClassVar[str] = "sealed_gas"
    title: ClassVar[str] = "Sphere with a sealed gas: pressure and breathing"
    source: ClassVar[str] = "p V^gamma = const; omega^2 = 2E / (rho R^2 (1-nu)) + 3 gamma p / (rho t R)"

    def run(self) -> tuple[Figure, ...]:
        shape = octant_sphere(RADIUS_M, RINGS)
        body = SoftBody.from_arrays(shape.positions, shape.triangles, FILM)
        specimen = Specimen(body, shape.symmetry, NewtonOptions(tolerance_N=1e-9))
        specimen.gradient(specimen.solve(specimen.drawn(), UNLOADED))
        drawn_volume = specimen.system.volume
        rest = SealedGas(STANDARD_ATMOSPHERE_Pa, drawn_volume, EXPONENT)
        filled = SealedGas(FILLING * STANDARD_ATMOSPHERE_Pa, drawn_volume, 1.0)

        specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(filled,)))
        pressure = specimen.system.pressure_Pa

        stiffness = specimen.stiffness(specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(rest,))))
        radial = shape.positions.ravel() / RADIUS_M
        mass = np.zeros(body.nodes)
        np.add.at(mass, shape.triangles, body.areas[:, None] * DENSITY * FILM.thickness_m / 3.0)
        omega = math.sqrt(float(radial @ stiffness @ radial) / float(mass.sum()))
        return (
            Figure("gauge pressure of the filled sphere", "Pa", pressure, filled_pressure(), 5e-3),
            Figure("breathing frequency", "rad/s", omega, breathing(), 5e-3),
        )
