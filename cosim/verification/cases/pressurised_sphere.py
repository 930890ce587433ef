"""A thin sphere under pressure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import octant_sphere
from cosim.verification.support.specimen import UNLOADED, Specimen

FILM = Film(300e6, 0.3, 1e-4)
RADIUS_M = 0.04
PRESSURE_PA = 200.0
COARSE, FINE = 8, 16


def inflated(rings: int) -> tuple[float, float]:
    """Return (dR / R from the enclosed volume, mean principal stress [Pa]) of an octant."""
    shape = octant_sphere(RADIUS_M, rings)
    body = SoftBody.from_arrays(shape.positions, shape.triangles, FILM)
    specimen = Specimen(body, shape.symmetry, NewtonOptions(tolerance_N=1e-9))
    found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=PRESSURE_PA))
    volume = specimen.system.volume
    specimen.system.evaluate(body.positions, UNLOADED, np.zeros(0), specimen.system.angles, hessian=False)
    stress = body.membranes.principal_stress(found.state.positions).mean(axis=1)
    mean = float(stress @ body.membranes.areas / body.membranes.areas.sum())
    return (volume / specimen.system.volume) ** (1.0 / 3.0) - 1.0, mean


@final
@dataclass(frozen=True)
class PressurisedSphere(Case):
    """Stress and growth of a sphere at a strain of 2e-4, where the linear formulas hold to 1e-3."""

    name: ClassVar[str] = "pressurised_sphere"
    title: ClassVar[str] = "Sphere under pressure"
    source: ClassVar[str] = "sigma = p R / 2 t, dR / R = p R (1 - nu) / (2 E t)"

    def run(self) -> tuple[Figure, ...]:
        stress = PRESSURE_PA * RADIUS_M / (2.0 * FILM.thickness_m)
        growth = stress * (1.0 - FILM.poisson_ratio) / FILM.young_modulus_Pa
        coarse, fine = inflated(COARSE), inflated(FINE)
        return (
            Figure.refined("dR / R", "1", coarse[0], fine[0], growth),
            Figure.refined("mean stress", "Pa", coarse[1], fine[1], stress),
        )
