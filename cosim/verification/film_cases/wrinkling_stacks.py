"""Stacks of film with the wrinkling law on coarse meshes, against finite elements fine enough to wrinkle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final, final

from cosim.soft.elements.material import Film
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.finite_elements import FILM, MESHES, Band, FIRST_Pa, along, squares
from cosim.verification.support.open_specimen import OpenSpecimen, film_stack

SNAPPING: Final = 0.15
"""Tolerance at 2 and 5 kPa: films snap there, and what they hold depends on their history."""

FOLDED: Final = 0.07
"""Tolerance from 10 kPa on."""

VOLUME_M3: Final = 42.4e-6
"""Of one square unit at 10 kPa."""


def stack(shape: PolygonalStack, level: int, film: Film = FILM) -> OpenSpecimen:
    """Return a stack of wrinkling film under the last pressure before those that are compared.

    Raises:
        ConvergenceError: an equilibrium was not found.
    """
    sample = OpenSpecimen(film_stack(shape, level, replace(film, law="wrinkling")))
    for pressure in FIRST_Pa:
        sample.load_to(pressure)
    return sample


def on_meshes(shape: PolygonalStack, bands: Sequence[Band], levels: int, film: Film = FILM) -> list[Figure]:
    """Return the extensions on the drawn mesh and on those refined from it.

    Raises:
        ConvergenceError: an equilibrium was not found.
    """
    return [
        figure for level in range(levels) for figure in along(stack(shape, level, film), bands, MESHES[level])
    ]


@final
@dataclass(frozen=True)
class ThreeSquares(Case):
    """Three square units; nothing of the law was fitted to them.

    At 2 kPa the band runs from the extension while the film is loaded, 34.5 mm, to three times that of one
    unit while it is unloaded, 67.2 mm: refined meshes fold between 0.5 and 2 kPa, finite elements later.
    """

    name: ClassVar[str] = "three_squares"
    title: ClassVar[str] = "Extension of three square units, wrinkling law"
    source: ClassVar[str] = "finite elements: CalculiX S8R, Kratos thin shells, own quadratic membranes"
    bands: ClassVar[tuple[Band, ...]] = (
        Band(2e3, 34.5e-3, 67.2e-3, SNAPPING),
        Band(5e3, 58e-3, 66e-3, SNAPPING),
        Band(10e3, 68e-3, 74e-3, FOLDED),
        Band(20e3, 74e-3, 77e-3, FOLDED),
        Band(40e3, 79e-3, 81e-3, FOLDED),
    )

    def run(self) -> tuple[Figure, ...]:
        return tuple(on_meshes(squares(3), self.bands, 3))


@final
@dataclass(frozen=True)
class OneSquare(Case):
    """One square unit against finer finite elements, with the volume at 10 kPa.

    The band at 2 kPa runs from loading to unloading. At 10 kPa the tolerance is 8 %: the mesh that is refined
    once is 7.2 % short, the others 4 %. The volume's is 15 % on the drawn mesh, whose chords under-fill the
    bulging film, and 6 % on finer ones.
    """

    name: ClassVar[str] = "one_square"
    title: ClassVar[str] = "Extension and volume of one square unit, wrinkling law"
    source: ClassVar[str] = "finite elements: quadratic membranes with bending, energies minimised"
    bands: ClassVar[tuple[Band, ...]] = (
        Band(2e3, 11.2e-3, 22.4e-3, SNAPPING),
        Band(5e3, 22.6e-3, 24.2e-3, SNAPPING),
        Band(10e3, 24.5e-3, 25.5e-3, 0.08),
        Band(20e3, 25.7e-3, 26.5e-3, FOLDED),
        Band(40e3, 26.8e-3, 27.2e-3, FOLDED),
    )

    def run(self) -> tuple[Figure, ...]:
        figures = on_meshes(squares(1), self.bands, 3)
        for level, tolerance in enumerate((0.15, 0.06, 0.06)):
            sample = stack(squares(1), level)
            along(sample, self.bands[:3])
            name = f"volume at {1e-3 * self.bands[2].pressure_Pa:g} kPa{MESHES[level]}"
            figures.append(Figure(name, "m^3", sample.volume_m3, VOLUME_M3, tolerance))
        return tuple(figures)


@final
@dataclass(frozen=True)
class StiffSquare(Case):
    """One square unit of film that bends three times as stiffly and stretches as before.

    That is sqrt(3) times the thickness and 1 / sqrt(3) of Young's modulus. The finite elements are of one
    mesh (4 mm, 2 mm at the seam). Tolerance at 5 kPa 20 %, just above the snap of the film.
    """

    name: ClassVar[str] = "stiff_square"
    title: ClassVar[str] = "Extension of one square unit that bends three times as stiffly, wrinkling law"
    source: ClassVar[str] = "own finite elements: quadratic membranes with bending"
    bands: ClassVar[tuple[Band, ...]] = (
        Band(2e3, 9.2e-3, 9.2e-3, SNAPPING),
        Band(5e3, 14.3e-3, 14.3e-3, 0.2),
        Band(10e3, 19.6e-3, 19.6e-3, FOLDED),
    )

    def run(self) -> tuple[Figure, ...]:
        thick = math.sqrt(3.0)
        film = replace(
            FILM, young_modulus_Pa=FILM.young_modulus_Pa / thick, thickness_m=FILM.thickness_m * thick
        )
        return tuple(on_meshes(squares(1), self.bands, 3, film))


@final
@dataclass(frozen=True)
class FiveHexagons(Case):
    """Five hexagonal units, each 0.95 as wide as the one below; nothing of the law was fitted to them.

    The finite elements are of one mesh (4 mm, 2 mm at the seam) but at 40 kPa, where there are three. The
    stack is kept upright, as it is there: it leans over by itself.
    """

    name: ClassVar[str] = "five_hexagons"
    title: ClassVar[str] = "Extension of five hexagonal units, wrinkling law"
    source: ClassVar[str] = "own finite elements: quadratic membranes with bending"
    bands: ClassVar[tuple[Band, ...]] = (
        Band(5e3, 111.7e-3, 111.7e-3, SNAPPING),
        Band(20e3, 143.3e-3, 143.3e-3, FOLDED),
        Band(40e3, 151.2e-3, 153.7e-3, FOLDED),
    )

    def run(self) -> tuple[Figure, ...]:
        return tuple(on_meshes(PolygonalStack(6, 5, 0.05, 0.01, 0.002, 0.95), self.bands, 2))


@final
@dataclass(frozen=True)
class TenSquares(Case):
    """Ten square units with holes of 5 mm; finite elements of such meshes are 2 to 5 % short on one unit."""

    name: ClassVar[str] = "ten_squares"
    title: ClassVar[str] = "Extension of ten square units, wrinkling law"
    source: ClassVar[str] = "own finite elements: quadratic membranes with bending"
    bands: ClassVar[tuple[Band, ...]] = (Band(20e3, 235e-3, 244e-3, FOLDED),)

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for level in range(2):
            sample = stack(squares(10, 0.005), level)
            for pressure in (2e3, 5e3, 10e3):
                sample.load_to(pressure)
            figures += along(sample, self.bands, MESHES[level])
        return tuple(figures)
