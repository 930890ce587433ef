"""A thin sphere and a thin closed cylinder under pressure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import held_on_axis, octant_sphere, tube
from cosim.verification.support.specimen import UNLOADED, Specimen

FILM = Film(300e6, 0.3, 1e-4)
RADIUS_M, LENGTH_M = 0.04, 0.08
SPHERE_PA, CYLINDER_PA = 200.0, 100.0
RINGS, SIDES = (8, 16), (32, 64)


def inflated_sphere(rings: int) -> tuple[float, float]:
    """Return (dR / R from the enclosed volume, mean principal stress [Pa]) of an octant."""
    shape = octant_sphere(RADIUS_M, rings)
    body = SoftBody.from_arrays(shape.positions, shape.triangles, FILM)
    specimen = Specimen(body, shape.symmetry, NewtonOptions(tolerance_N=1e-9))
    found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(SPHERE_PA,)))
    volume = specimen.system.volume
    specimen.system.evaluate(body.positions, UNLOADED, np.zeros(0), specimen.system.memory, hessian=False)
    stress = body.principal_stress(found.state.positions).mean(axis=1)
    mean = float(stress @ body.areas / body.areas.sum())
    return (volume / specimen.system.volume) ** (1.0 / 3.0) - 1.0, mean


@final
@dataclass(frozen=True)
class PressurisedSphere(Case):
    """Stress and growth of a sphere at a strain of 2e-4, where the linear formulas hold to 1e-3."""

    name: ClassVar[str] = "pressurised_sphere"
    title: ClassVar[str] = "Sphere under pressure"
    source: ClassVar[str] = "sigma = p R / 2 t, dR / R = p R (1 - nu) / (2 E t)"

    def run(self) -> tuple[Figure, ...]:
        stress = SPHERE_PA * RADIUS_M / (2.0 * FILM.thickness_m)
        growth = stress * (1.0 - FILM.poisson_ratio) / FILM.young_modulus_Pa
        coarse, fine = map(inflated_sphere, RINGS)
        return (
            Figure.refined("dR / R", "1", coarse[0], fine[0], growth),
            Figure.refined("mean stress", "Pa", coarse[1], fine[1], stress),
        )


def inflated_cylinder(sides: int) -> tuple[float, float, float, float]:
    """Return (dR / R, dL / L, hoop stress, axial stress [Pa]) of a cylinder closed by caps."""
    rows = sides // 4
    positions, triangles = tube(RADIUS_M, LENGTH_M, sides, rows)
    last = rows * sides + np.arange(sides)
    caps = (np.arange(sides)[::-1].copy(), last)
    body = SoftBody.from_arrays(positions, triangles, FILM, caps=caps)
    specimen = Specimen(body, held_on_axis(sides, body.nodes), NewtonOptions(tolerance_N=1e-9))
    found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(CYLINDER_PA,)))
    x = found.state.positions
    radius = float(np.hypot(x[:, 0], x[:, 1]).mean())
    hoop, axial = body.principal_stress(x).mean(axis=0)
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
        hoop, nu = CYLINDER_PA * RADIUS_M / FILM.thickness_m, FILM.poisson_ratio
        strain = hoop / FILM.young_modulus_Pa
        exact = (strain * (1.0 - 0.5 * nu), strain * (0.5 - nu), hoop, 0.5 * hoop)
        coarse, fine = map(inflated_cylinder, SIDES)
        names = (("dR / R", "1"), ("dL / L", "1"), ("hoop stress", "Pa"), ("axial stress", "Pa"))
        return tuple(
            Figure.refined(name, unit, c, f, r)
            for (name, unit), c, f, r in zip(names, coarse, fine, exact, strict=True)
        )
