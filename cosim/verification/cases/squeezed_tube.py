"""A long flat tube of inextensible film under pressure, free or squeezed between two plates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from cosim.errors import ConvergenceError
from cosim.soft.solve.state import Equilibrium
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.sheet import PRESSURE_PA, Sheet
from cosim.verification.support.specimen import Specimen

GAPS = (0.2, 0.4)
PANELS = 80
_ROUNDS = 60


def squeezed(panels: int, gap: float) -> tuple[float, float]:
    """Return (F / (p W), V / W^2), per length of the tube, between plates at a gap in units of W.

    A quarter of the section, from the middle of the contact to the seam. The contact is a set of nodes held
    at half the gap: nodes beyond the plate join it, nodes that it would have to pull leave it.
    """
    sheet = Sheet(panels)
    height = 0.5 * gap * sheet.flat_width_m
    arc = 0.5 * math.pi * height
    positions = sheet.bent(flat=sheet.length_m - arc, radius=height)
    touching = positions[:, 2] > height * (1.0 - 1e-9)
    for _ in range(_ROUNDS):
        specimen, found = settled(sheet, positions, touching)
        push = np.where(touching, specimen.gradient(found)[:, 2], 0.0)
        x = found.state.positions
        # both nodes of a section touch or leave together
        pulled = np.repeat((push.reshape(-1, 2).sum(axis=1) > 0.0), 2) & touching
        beyond = np.repeat((x[:, 2].reshape(-1, 2).max(axis=1) > height * (1.0 + 1e-9)), 2)
        if not (pulled.any() or (beyond & ~touching).any()):
            break
        touching = (touching & ~pulled) | beyond
        positions = x.copy()
        positions[touching, 2] = height
    else:
        raise ConvergenceError("the contact of the squeezed tube did not settle", math.nan, _ROUNDS)
    width = sheet.flat_width_m
    force = -2.0 * float(push.sum()) / (sheet.depth_m * PRESSURE_PA * width)
    return force, sheet.section_area(specimen.system.volume) / width**2


def settled(sheet: Sheet, positions: np.ndarray, touching: np.ndarray) -> tuple[Specimen, Equilibrium]:
    """Return the equilibrium with the touching nodes held at their height."""
    held = sheet.symmetry()
    held[touching, 2] = True
    specimen = Specimen(sheet.body(), held, sheet.options())
    return specimen, specimen.solve(specimen.drawn(positions), sheet.loads())


@final
@dataclass(frozen=True)
class SqueezedTube(Case):
    """Force and volume of a tube of flat width W between plates at a gap h; radius of the free tube.

    The film is stiff enough (p W / E t = 3e-5) to count as inextensible. The force follows from the contact,
    the volume from the shape; virtual work ties them, F = -p dV/dh.
    """

    name: ClassVar[str] = "squeezed_tube"
    title: ClassVar[str] = "Flat tube between two plates"
    source: ClassVar[str] = "half circles of diameter h: F/L = p (W - pi h / 2), V/L = W h - pi h^2 / 4"

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for gap in GAPS:
            exact = (1.0 - 0.5 * math.pi * gap, gap - 0.25 * math.pi * gap**2)
            found = squeezed(PANELS, gap)
            figures += [
                Figure(f"{name}, h / W = {gap:g}", "1", value, reference, 5e-3)
                for name, value, reference in zip(("F / (p W L)", "V / (W^2 L)"), found, exact, strict=True)
            ]
        free = squeezed(PANELS, 2.0 / math.pi - 1e-12)
        figures.append(Figure("V / (W^2 L), free", "1", free[1], 1.0 / math.pi, 5e-3))
        return tuple(figures)
