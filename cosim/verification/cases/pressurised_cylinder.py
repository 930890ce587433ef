"""A thin closed cylinder under pressure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import held_on_axis, tube
from cosim.verification.support.specimen import UNLOADED, Specimen

FILM = Film(300e6, 0.3, 1e-4)
RADIUS_M, LENGTH_M = 0.04, 0.08
PRESSURE_PA = 100.0
COARSE, FINE = 32, 64


def inflated(sides: int) -> tuple[float, float, float, float]:
    """Return (dR / R, dL / L, hoop stress, axial stress [Pa]) of a cylinder closed by caps."""
    rows = sides // 4
    positions, triangles = tube(RADIUS_M, LENGTH_M, sides, rows)
    last = rows * sides + np.arange(sides)
    caps = (np.arange(sides)[::-1].copy(), last)
    body = SoftBody.from_arrays(positions, triangles, FILM, caps=caps)
    specimen = Specimen(body, held_on_axis(sides, body.nodes), NewtonOptions(tolerance_N=1e-9))
    found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=PRESSURE_PA))
    x = found.state.positions
    radius = float(np.hypot(x[:, 0], x[:, 1]).mean())
    hoop, axial = body.membranes.principal_stress(x).mean(axis=0)
    length = float(x[last, 2].mean())
    return radius / RADIUS_M - 1.0, length / LENGTH_M - 1.0, float(hoop), float(axial)


@final
@dataclass(frozen=True)
class PressurisedCylinder(Case):
    """Stresses and growth of a cylinder that carries the pressure on its end caps."""

    name: ClassVar[str] = "pressurised_cylinder"
    title: ClassVar[str] = "Closed cylinder under pressure"
    source: ClassVar[str] = (
        "hoop p R / t, axial p R / 2 t; dR/R = (1 - nu/2) p R/E t, dL/L = (1/2 - nu) p R/E t"
    )

    def run(self) -> tuple[Figure, ...]:
        hoop, nu = PRESSURE_PA * RADIUS_M / FILM.thickness_m, FILM.poisson_ratio
        strain = hoop / FILM.young_modulus_Pa
        exact = (strain * (1.0 - 0.5 * nu), strain * (0.5 - nu), hoop, 0.5 * hoop)
        coarse, fine = inflated(COARSE), inflated(FINE)
        names = (("dR / R", "1"), ("dL / L", "1"), ("hoop stress", "Pa"), ("axial stress", "Pa"))
        return tuple(
            Figure.refined(name, unit, c, f, r)
            for (name, unit), c, f, r in zip(names, coarse, fine, exact, strict=True)
        )
