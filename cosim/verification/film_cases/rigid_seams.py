"""Stacks whose films are joined stiffly at the seam, against finite elements that turn as one there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

from cosim.verification.support.case import Case, Figure
from cosim.verification.support.finite_elements import FILM, MESHES, Band, FIRST_Pa, along, squares
from cosim.verification.support.open_specimen import OpenSpecimen, film_stack


@final
@dataclass(frozen=True)
class RigidSeams(Case):
    """Three square units and one, with hinges along the seams that bend like the film around them.

    Three units: 15 % at 2 kPa, where films snap, 7 % above. One unit at 10 kPa: 10 %, as its finite elements
    are of coarse meshes. Below 1 kPa the film bends within few millimetres of the seam, which these meshes do
    not resolve: at 0.5 kPa one unit comes to 4.6 mm, refined twice, and to 4.02 mm in finite elements.
    """

    name: ClassVar[str] = "rigid_seams"
    title: ClassVar[str] = "Extension of square units with rigid seams, wrinkling law"
    source: ClassVar[str] = "finite elements: CalculiX S8R, Kratos thin shells, own quadratic membranes"
    bands: ClassVar[tuple[Band, ...]] = (
        Band(2e3, 31e-3, 43e-3, 0.15),
        Band(10e3, 62e-3, 72e-3, 0.07),
        Band(20e3, 72.5e-3, 77.5e-3, 0.07),
    )
    one_unit: ClassVar[Band] = Band(10e3, 21.35e-3, 21.82e-3, 0.1)

    def run(self) -> tuple[Figure, ...]:
        film, figures = replace(FILM, law="wrinkling"), []
        for level, note in enumerate(MESHES):
            three, one = (
                OpenSpecimen(film_stack(squares(units), level, film, rigid_seam=True)) for units in (3, 1)
            )
            for pressure in FIRST_Pa:
                three.load_to(pressure)
                one.load_to(pressure)
            for pressure in (2e3, 5e3):
                one.load_to(pressure)
            figures += along(three, self.bands, f"{note}, three")
            figures += along(one, (self.one_unit,), f"{note}, one")
        return tuple(figures)
