"""A pouch motor: two films welded along two edges, which pull together when inflated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from cosim.verification.support.case import Case, Figure
from cosim.verification.support.sheet import PRESSURE_PA, Sheet
from cosim.verification.support.specimen import Specimen

ANGLES_DEG = (30.0, 60.0, 80.0)
PANELS = 40


def pouch(panels: int, angle: float) -> tuple[float, float]:
    """Return (F / (p L D), V / (D L^2)) of a pouch of length L and depth D.

    A quarter of the section: the seam is held at x = (L / 2) sin(angle) / angle, where the arc has the angle.
    """
    sheet = Sheet(panels)
    length = 2.0 * sheet.length_m
    # first guess: an arc that is a little too flat
    positions = sheet.bent(flat=0.0, radius=sheet.length_m / angle * 1.05)
    seam = np.arange(sheet.nodes - 2, sheet.nodes)
    held = sheet.symmetry()
    held[seam, 0] = True
    positions[seam, 0] = sheet.length_m * math.sin(angle) / angle
    specimen = Specimen(sheet.body(), held, sheet.options())
    found = specimen.solve(specimen.drawn(positions), sheet.loads())
    pull = 2.0 * float(specimen.gradient(found)[seam, 0].sum())
    return (
        pull / (PRESSURE_PA * length * sheet.depth_m),
        sheet.section_area(specimen.system.volume) / length**2,
    )


@final
@dataclass(frozen=True)
class PouchMotor(Case):
    """Force and volume at three contractions; inextensible arcs of half angle theta."""

    name: ClassVar[str] = "pouch_motor"
    title: ClassVar[str] = "Pouch motor: force against contraction"
    source: ClassVar[str] = (
        "arcs of length L: F = p L D cos(theta)/theta, V = D L^2 (theta - sin cos)/(2 theta^2)"
    )

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for degrees in ANGLES_DEG:
            a = math.radians(degrees)
            exact = (math.cos(a) / a, 0.5 * (a - math.sin(a) * math.cos(a)) / a**2)
            found, note = pouch(PANELS, a), f"contraction {1.0 - math.sin(a) / a:.4f}"
            figures += [
                Figure(f"{name}, {note}", "1", value, reference, 5e-3)
                for name, value, reference in zip(("F / (p L D)", "V / (D L^2)"), found, exact, strict=True)
            ]
        return tuple(figures)
