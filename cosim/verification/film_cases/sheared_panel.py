"""A panel of film between two rails that are sheared: Mansfield's tension field."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import panel
from cosim.verification.support.specimen import UNLOADED, Specimen

HEIGHT_M = 0.1
LENGTHS = (2.0, 3.0)
"""Of the panel, over its height."""

SHEAR = 1e-4
"""Displacement of the rail over the height: small, as the formula asks for."""

FILM = Film(1e9, 0.3, 1e-4, "tension_field")
COARSE, FINE = 24, 48
"""Squares over the height."""

_FRACTIONS = (1.0, 0.1, 0.01, 1e-3, 1e-4)
"""Compressive stiffness on the way to the tension field; the last one keeps slack triangles in place."""


def mansfield(length: float) -> float:
    """Return F / (E t gamma H), the force that shears a panel of L / H = `length` with free ends.

    Film that wrinkles carries tension along straight rays from rail to rail. A pencil of rays between da on
    the lower and db on the upper rail, at m = (b - a) / H, the cotangent of its angle, resists with
        dF = E t gamma f(m) (db - da) / ln(db / da),   f = (m / (1 + m^2))^2.
    The rays lie so that the energy is the largest. With s = (a + b) / H and u = artanh(dm/ds) that is the
    largest int f tanh(u) / (2 u) ds, 0 < s < 2 L / H, from corner to corner (m = 0). Its first integral is
        f(m) = f(m_0) (u / sinh u)^2,
    m_0 in the middle (u = 0), found from  int coth(u) dm = L / H  over 0 < m < m_0. Then
        F / (E t gamma H) = int f / u dm.
    An endless panel has rays at 45 degrees (m_0 = 1) and F = E t gamma L / 4; the ends take off 0.152 H.
    """

    def part(u: float, middle: float) -> tuple[float, float]:
        """Return f and -dm/du."""
        top = middle / (1.0 + middle**2)
        root = top * u / math.sinh(u)
        m = 2.0 * root / (1.0 + math.sqrt(1.0 - 4.0 * root**2))
        fall = top * (u * math.cosh(u) - math.sinh(u)) / math.sinh(u) ** 2
        return root**2, fall * (1.0 + m * m) ** 2 / (1.0 - m * m)

    def half_length(middle: float) -> float:
        return float(quad(lambda u: part(u, middle)[1] / math.tanh(u), 1e-6, 60.0, limit=200)[0])

    def force(u: float) -> float:
        f, fall = part(u, middle)
        return f / u * fall

    middle = float(brentq(lambda m: half_length(m) - length, 0.05, 1.0 - 1e-4, xtol=1e-13))
    return float(quad(force, 1e-6, 60.0, limit=200)[0])


def sheared(length: float, rows: int) -> float:
    """Return F / (E t gamma H) of a panel with so many squares over its height, kept flat."""
    x, triangles = panel(length * HEIGHT_M, HEIGHT_M, round(length * rows), rows)
    held = np.zeros(x.shape, dtype=bool)
    held[:, 2] = True
    upper = x[:, 1] > HEIGHT_M * (1.0 - 1e-9)
    held[upper | (x[:, 1] < 1e-9)] = True
    options = NewtonOptions(tolerance_N=1e-9, iterations_max=400)
    drawn, moved = x, x.copy()
    moved[:, 0] += SHEAR * x[:, 1]
    for fraction in _FRACTIONS:
        body = SoftBody.from_arrays(drawn, triangles, replace(FILM, compressive_fraction=fraction))
        specimen = Specimen(body, held, options)
        found = specimen.solve(specimen.drawn(moved), UNLOADED)
        moved = found.state.positions
    force = float(specimen.gradient(found)[upper, 0].sum())
    return force / (FILM.young_modulus_Pa * FILM.thickness_m * SHEAR * HEIGHT_M)


@final
@dataclass(frozen=True)
class ShearedPanel(Case):
    """Force on the rails of panels twice and three times as long as high, within 1 %.

    With the plain law the panel is 1.5 times as stiff (G t against E t / 4). The field is singular in the
    corners where the rays end, which leaves the mesh an error of first order.
    """

    name: ClassVar[str] = "sheared_panel"
    title: ClassVar[str] = "Sheared panel of wrinkling film"
    source: ClassVar[str] = "Mansfield, Proc. R. Soc. Lond. A 316 (1970) 269: rays of largest energy, solved"

    def run(self) -> tuple[Figure, ...]:
        return tuple(
            Figure.refined(
                f"F / (E t gamma H), L / H = {length:g}", "1",
                sheared(length, COARSE), sheared(length, FINE), mansfield(length), 1e-2,
            )
            for length in LENGTHS
        )  # fmt: skip
