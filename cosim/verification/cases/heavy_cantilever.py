"""A cantilever strip that bends under its own weight."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED
from cosim.verification.support.strip import Strip

WEIGHTS = (1.0, 5.0, 20.0)
COARSE, FINE = 16, 32


def exact_tip(weight: float) -> tuple[float, float]:
    """Return (drop / L, slope) of the tip for weight = w L^3 / EI.

    From the tip, at the arc length u = s / L:  theta'' = -weight u cos theta, theta'(0) = 0, theta(1) = 0.
    """

    def shape(tip_slope: float) -> tuple[float, float]:
        def rates(u: float, y: np.ndarray) -> list[float]:
            return [y[1], -weight * u * math.cos(y[0]), math.sin(y[0])]

        end = solve_ivp(rates, (0.0, 1.0), [tip_slope, 0.0, 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
        return float(end[0]), float(end[2])

    slope = float(brentq(lambda angle: shape(angle)[0], 0.0, 0.5 * math.pi, xtol=1e-13))
    return shape(slope)[1], slope


def computed_tips(panels: int) -> list[tuple[float, float]]:
    """Return (drop / L, slope) of the tip for each of WEIGHTS; the slope is that of the last panel."""
    strip = Strip(panels, density=1.0)
    specimen = strip.specimen()
    here = specimen.solve(specimen.drawn(), UNLOADED)
    tips = []
    for weight in WEIGHTS:
        gravity = weight * strip.bending_stiffness / (strip.length_m**3 * strip.width_m * strip.density)
        here = specimen.follow(here, replace(UNLOADED, gravity=(0.0, 0.0, -gravity)), 4)
        _, z, slope = strip.deflection(here.state.positions)
        tips.append((-z / strip.length_m, -slope))
    return tips


@final
@dataclass(frozen=True)
class HeavyCantilever(Case):
    """Drop and slope of the tip under the strip's weight."""

    name: ClassVar[str] = "heavy_cantilever"
    title: ClassVar[str] = "Cantilever strip under its own weight, large deflection"
    source: ClassVar[str] = "EI theta'' = -w (L - s) cos theta, integrated numerically by shooting"

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for weight, coarse, fine in zip(WEIGHTS, computed_tips(COARSE), computed_tips(FINE), strict=True):
            names = (("tip drop / L", "1"), ("tip slope", "rad"))
            figures += [
                Figure.refined(f"{name}, w L^3/EI = {weight:g}", unit, c, f, r)
                for (name, unit), c, f, r in zip(names, coarse, fine, exact_tip(weight), strict=True)
            ]
        return tuple(figures)
