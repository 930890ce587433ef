"""A strip rolled up by a moment at its end."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.solve.state import Equilibrium
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED, Specimen
from cosim.verification.support.strip import Strip

PANELS = 40
STEPS = 16
_ROUNDS = 12


def couple(strip: Strip, positions: Array, moment: float) -> Array:
    """Return the forces (n, 3) [N] of a moment about -y [N m] on the last panel, normal to it."""
    run = (positions[strip.tip] - positions[strip.tip - 2]).mean(axis=0)
    length = float(np.linalg.norm(run))
    normal = np.array([-run[2], 0.0, run[0]]) / length
    forces = np.zeros_like(positions)
    forces[strip.tip] = 0.5 * moment / length * normal
    forces[strip.tip - 2] = -0.5 * moment / length * normal
    return forces


def turned(strip: Strip, specimen: Specimen, begin: Equilibrium, moment: float) -> Equilibrium:
    """Return the equilibrium under a moment that follows the panel.

    The couple's forces are dead loads, turned with the panel until they no longer change. Where they are
    normal to the panel their moment is stationary in its slope, so this converges quadratically.
    """
    here = begin
    for _ in range(_ROUNDS):
        forces = couple(strip, here.state.positions, moment)
        if here.loads.nodal_force is not None:
            change = float(np.abs(forces - here.loads.nodal_force).max())
            if change < 1e-8 * moment / strip.panel_m:
                break
        here = specimen.follow(here, replace(UNLOADED, nodal_force=forces))
    return here


@final
@dataclass(frozen=True)
class RollUp(Case):
    """M = pi EI / L bends the strip to a half circle, 2 pi EI / L closes the circle.

    Under a constant moment the panels form a regular polygon: it closes exactly, and the half polygon is
    within O(1 / panels^2) of the half circle.
    """

    name: ClassVar[str] = "roll_up"
    title: ClassVar[str] = "Strip rolled up to a circle by an end moment"
    source: ClassVar[str] = "constant curvature M / EI; in every text on large rotations"

    def run(self) -> tuple[Figure, ...]:
        strip = Strip(PANELS)
        specimen = strip.specimen()
        here = specimen.solve(specimen.drawn(), UNLOADED)
        half = here
        for k in range(1, STEPS + 1):
            here = turned(strip, specimen, here, 2.0 * math.pi * strip.bending_stiffness * k / STEPS)
            if k == STEPS // 2:
                half = here
        x, z, _ = strip.deflection(here.state.positions)
        _, height, _ = strip.deflection(half.state.positions)
        hinge_turn = np.abs(here.state.memory - math.pi)
        return (
            Figure("height of the half circle / L", "1", height, 2.0 / math.pi, 5e-3),
            Figure("gap of the closed circle / L", "1", math.hypot(x, z), 0.0, 1e-3, absolute=True),
            Figure("turn per panel", "rad", float(hinge_turn.max()), 2.0 * math.pi / PANELS, 1e-3),
        )
