"""A square unit whose film is pinned to a frame of beams, against finite elements of both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Final, final

import numpy as np

from cosim.soft.beams.beam_rings import BeamRings
from cosim.soft.beams.rectangular_section import RectangularSection
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.finite_elements import FILM, MESHES, Band, along, squares
from cosim.verification.support.open_specimen import OpenSpecimen, film_stack

SECTION: Final = RectangularSection(2e-3, 2e-3, 2e9)
_FIRST_Pa = (100.0, 500.0, 1e3)


def framed(level: int) -> OpenSpecimen:
    """Return one square unit with beams along its seam."""
    body = film_stack(squares(1), level, replace(FILM, law="wrinkling"))
    rims = np.stack([ring for name, ring in body.rings.items() if name.endswith(".outer")])
    return OpenSpecimen(body.with_elements(BeamRings.from_shape(body.positions, rims, SECTION)))


@final
@dataclass(frozen=True)
class FramedSquare(Case):
    """A frame of 2 x 2 mm and 2 GPa keeps the seam from being drawn in: a third of the extension at 2 kPa.

    Nothing of the wrinkling law was fitted to a framed film. Tolerance 7 %, and 12 % at 10 and 20 kPa: the
    sides of the frame, two beams each on the drawn mesh, bow unequally above 7 kPa, which the drawn mesh does
    10 % late; refined meshes are within 6 % there.
    """

    name: ClassVar[str] = "framed_square"
    title: ClassVar[str] = "Extension of one square unit in a frame of beams, wrinkling law"
    source: ClassVar[str] = "finite elements: quadratic membranes with bending, beams, energies minimised"
    bands: ClassVar[tuple[Band, ...]] = (
        Band(2e3, 4.47e-3, 4.51e-3, 0.07),
        Band(5e3, 6.72e-3, 6.76e-3, 0.07),
        Band(10e3, 10.0e-3, 10.4e-3, 0.12),
        Band(20e3, 15.0e-3, 15.6e-3, 0.12),
        Band(40e3, 19.4e-3, 19.8e-3, 0.07),
    )

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for level, note in enumerate(MESHES):
            sample = framed(level)
            for pressure in _FIRST_Pa:
                sample.load_to(pressure)
            figures += along(sample, self.bands, note)
        return tuple(figures)
