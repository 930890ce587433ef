"""A weight on a column of sealed gas between stiff walls."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.gas import SealedGas, STANDARD_ATMOSPHERE_Pa
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import tube
from cosim.verification.support.specimen import UNLOADED, Specimen

LOADS = (-0.2, 0.5, 1.0)
"""Weight over p_a A; a negative one pulls."""

EXPONENT = 1.4
SIDES = 12
_RADIUS_M, _HEIGHT_M, _MASS_kg = 0.05, 0.2, 2.0
_FILM = Film(10.0, 0.3, 1e-4)
"""So soft that it carries less than 1e-7 of the load: E t / (p_a R)."""


def cylinder() -> tuple[Specimen, float]:
    """Return a closed prism whose film can only move up and down, held at its bottom; its section [m^2]."""
    positions, triangles = tube(_RADIUS_M, _HEIGHT_M, SIDES, 1)
    top = SIDES + np.arange(SIDES)
    body = SoftBody.from_arrays(
        positions, triangles, _FILM, caps=(np.arange(SIDES)[::-1].copy(), top), tip=top
    )
    held = np.ones(positions.shape, dtype=bool)
    held[top, 2] = False
    section = 0.5 * SIDES * _RADIUS_M**2 * math.sin(2.0 * math.pi / SIDES)
    return Specimen(body, held, NewtonOptions(tolerance_N=1e-6, iterations_max=200)), section


def on_top(body: SoftBody, weight_N: float) -> Array:
    """Return nodal forces (n, 3) [N] of a weight on the piston."""
    force = np.zeros((body.nodes, 3))
    force[body.tip, 2] = -weight_N / len(body.tip)
    return force


@final
@dataclass(frozen=True)
class SealedPiston(Case):
    """Height of the piston under three weights, isothermal, and its frequency, adiabatic.

    The gas is at the atmosphere's pressure p_a while nothing weighs on it. A weight W on the section A asks
    for p = p_a + W / A, so the height falls as 1 / (1 + W / p_a A). The tolerance leaves the film its share.
    """

    name: ClassVar[str] = "sealed_piston"
    title: ClassVar[str] = "Piston on sealed gas: height under a weight, and bounce"
    source: ClassVar[str] = "Boyle 1662: p V = const; Rüchardt 1929: omega^2 = gamma p A^2 / (m V)"

    def run(self) -> tuple[Figure, ...]:
        specimen, section = cylinder()
        body = specimen.body
        volume, pressure = section * _HEIGHT_M, STANDARD_ATMOSPHERE_Pa
        slow, fast = (SealedGas(pressure, volume, exponent) for exponent in (1.0, EXPONENT))
        here = specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(slow,), nodal_force=on_top(body, 0.0)))
        figures = []
        for load in LOADS:
            force = on_top(body, load * pressure * section)
            found = specimen.follow(here, replace(UNLOADED, gas=(slow,), nodal_force=force), 4)
            height = float(body.tip_position(found.state.positions)[2]) / _HEIGHT_M
            figures.append(
                Figure(f"height / h_0, W / p_a A = {load:g}", "1", height, 1.0 / (1.0 + load), 1e-5)
            )
        still = specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(fast,)))
        up = np.zeros((body.nodes, 3))
        up[body.tip, 2] = 1.0
        omega = math.sqrt(float(up.ravel() @ specimen.stiffness(still) @ up.ravel()) / _MASS_kg)
        exact = math.sqrt(EXPONENT * pressure * section**2 / (_MASS_kg * volume))
        return (*figures, Figure("frequency, adiabatic", "rad/s", omega, exact, 1e-5))
