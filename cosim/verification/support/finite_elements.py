"""What independent finite elements of the films found, and how stacks of film are compared with them.

Quadratic membranes with bending, CalculiX S8R and Kratos thin shells on films of 0.11 mm, 1.3 GPa and
Poisson's ratio 0.2: open holes, first hole ring held, the films of a unit joined at the seam without
stiffness against turning, neither weight nor contact. Bands are as judged from meshes, branches and codes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

from cosim.soft.elements.material import Film
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.verification.support.case import Figure
from cosim.verification.support.open_specimen import OpenSpecimen

FILM: Final = Film(1.3e9, 0.2, 0.11e-3)
FIRST_Pa: Final = (100.0, 250.0, 500.0, 1e3)
"""Pressures on the way to those that are compared."""

MESHES: Final = ("", ", refined", ", refined twice")
"""How figures name the drawn mesh and those refined from it."""


def squares(units: int, hole_side_m: float = 0.004) -> PolygonalStack:
    """Return square units of 60 mm, drawn 2 mm high."""
    to_corner = 1.0 / math.sqrt(2.0)
    return PolygonalStack(
        4, units, 0.06 * to_corner, hole_side_m * to_corner, 0.002, ring_heights=(0.2, 0.5, 0.8)
    )


@final
@dataclass(frozen=True)
class Band:
    """Extension at a pressure, as a band of finite-element values.

    Args:
        pressure_Pa: gauge pressure.
        low_m: its lower edge.
        high_m: its upper edge.
        tolerance: beyond the edges, as a share of the edge.
    """

    pressure_Pa: float
    low_m: float
    high_m: float
    tolerance: float

    def figure(self, extension_m: float, note: str) -> Figure:
        """Return an extension [m] against the value in the band that is nearest."""
        name = f"{1e-3 * self.pressure_Pa:g} kPa{note}"
        if self.high_m > self.low_m:
            name += f", {1e3 * self.low_m:.4g} to {1e3 * self.high_m:.4g} mm"
        nearest = min(max(extension_m, self.low_m), self.high_m)
        return Figure(name, "m", extension_m, nearest, self.tolerance)


def along(sample: OpenSpecimen, bands: Sequence[Band], note: str = "") -> list[Figure]:
    """Return the extensions of a specimen at the pressures of bands, one after the other.

    Raises:
        ConvergenceError: an equilibrium was not found.
    """
    figures = []
    for band in bands:
        sample.load_to(band.pressure_Pa)
        figures.append(band.figure(sample.extension_m, note))
    return figures
