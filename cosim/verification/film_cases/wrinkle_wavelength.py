"""A sheared panel of film that bends: how far apart its wrinkles are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.elements.shell_hinges import shell_stiffness
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import panel
from cosim.verification.support.specimen import UNLOADED, Specimen

HEIGHT_M, LENGTH_M = 0.1, 0.3
SHEAR = 0.01
FILM = Film(3.5e9, 0.31, 1e-4)
ROWS = 25
STARTS = 3
"""Scattered shapes from which the panel is let go; the equilibrium of the least potential is measured."""

_SCATTER = 0.2
"""Height of the scatter over the thickness."""

_MIDDLE = (0.2, 0.8)
"""Of the panel's length: what lies between the fans of its ends."""


def half_wavelength() -> float:
    """Return lambda = sqrt(pi H t) / (3 (1 - nu^2) gamma)^(1/4) [m], across the wrinkles.

    Wrinkles at 45 degrees are l = sqrt(2) H long under the tension T = E t gamma / 2. They bend across and
    are drawn straight along: D (pi / lambda)^2 + T (lambda / l)^2 presses them together, with
    D = E t^3 / (12 (1 - nu^2)). It is least for the lambda above.
    """
    stiffening = 3.0 * (1.0 - FILM.poisson_ratio**2) * SHEAR
    return math.sqrt(math.pi * HEIGHT_M * FILM.thickness_m / math.sqrt(stiffening))


def found_half_wavelength(positions: Array) -> float:
    """Return the mean distance [m] of zero crossings on the middle line, across wrinkles at 45 degrees."""
    middle = positions.reshape(-1, ROWS + 1, 3)[:, ROWS // 2]
    x, z = middle[:, 0], middle[:, 2]
    low, high = _MIDDLE[0] * LENGTH_M, _MIDDLE[1] * LENGTH_M
    before = np.flatnonzero((z[:-1] * z[1:] < 0.0) & (x[:-1] > low) & (x[1:] < high))
    crossings = x[before] + (x[before + 1] - x[before]) * z[before] / (z[before] - z[before + 1])
    return float(np.diff(crossings).mean()) / math.sqrt(2.0) if len(crossings) > 1 else math.inf


@final
@dataclass(frozen=True)
class WrinkleWavelength(Case):
    """Half wavelength of the wrinkles, of shell hinges on plain film, seven triangles' sides to a wave.

    Tolerance 20 %: the formula takes wrinkles to be sines along their length and the panel to be endless, and
    panels of 9 to 12 half waves are in equilibrium side by side.
    """

    name: ClassVar[str] = "wrinkle_wavelength"
    title: ClassVar[str] = "Wavelength of wrinkles in a sheared panel"
    source: ClassVar[str] = "Wong and Pellegrino, J. Mech. Mater. Struct. 1 (2006) 27"

    def run(self) -> tuple[Figure, ...]:
        x, triangles = panel(LENGTH_M, HEIGHT_M, round(LENGTH_M / HEIGHT_M * ROWS), ROWS)
        hinges = interior_hinges(triangles)
        stiffness = shell_stiffness(x, triangles, hinges, FILM.flexural_rigidity_Nm)
        body = SoftBody.from_arrays(x, triangles, FILM, hinge_nodes=hinges, hinge_stiffness=stiffness)
        rails = (x[:, 1] < 1e-9) | (x[:, 1] > HEIGHT_M * (1.0 - 1e-9))
        specimen = Specimen(
            body, rails, NewtonOptions(tolerance_N=1e-4, iterations_max=1000, step_max_m=0.01)
        )
        rng, found = np.random.default_rng(0), []
        for _ in range(STARTS):
            start = x.copy()
            start[:, 0] += SHEAR * x[:, 1]
            start[~rails, 2] = _SCATTER * FILM.thickness_m * rng.normal(size=int((~rails).sum()))
            found.append(specimen.solve(specimen.drawn(start), UNLOADED))
        lowest = min(found, key=lambda equilibrium: equilibrium.potential_J)
        value = found_half_wavelength(lowest.state.positions)
        return (Figure("half wavelength", "m", value, half_wavelength(), 0.2),)
