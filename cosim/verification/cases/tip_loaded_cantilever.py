"""A cantilever strip under a dead load at its tip: large deflections."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED
from cosim.verification.support.strip import Strip

LOADS = (0.5, 1.0, 2.0, 5.0, 10.0)
COARSE, FINE = 12, 24


def exact_tip(alpha: float) -> tuple[float, float]:
    """Return (drop / L, x / L) of the tip under P = alpha EI / L^2.

    With k^2 = (1 + sin phi) / 2 and sin theta = 1 / (k sqrt 2):  sqrt alpha = K(k) - F(k, theta),
    drop / L = 1 - 2 (E(k) - E(k, theta)) / sqrt alpha,  x / L = sqrt(2 sin phi / alpha).
    """

    def parts(phi: float) -> tuple[float, float]:
        m = 0.5 * (1.0 + math.sin(phi))
        return m, math.asin(1.0 / math.sqrt(2.0 * m))

    def length(phi: float) -> float:
        m, theta = parts(phi)
        return float(ellipk(m) - ellipkinc(theta, m)) - math.sqrt(alpha)

    phi = float(brentq(length, 1e-9, 0.5 * math.pi - 1e-9, xtol=1e-14))
    m, theta = parts(phi)
    drop = 1.0 - 2.0 * float(ellipe(m) - ellipeinc(theta, m)) / math.sqrt(alpha)
    return drop, math.sqrt(2.0 * math.sin(phi) / alpha)


def computed_tips(panels: int) -> list[tuple[float, float]]:
    """Return (drop / L, x / L) of the tip for each of LOADS."""
    strip = Strip(panels)
    specimen = strip.specimen()
    here = specimen.solve(specimen.drawn(), UNLOADED)
    tips = []
    for alpha in LOADS:
        force = (0.0, 0.0, -alpha * strip.bending_stiffness / strip.length_m**2)
        here = specimen.follow(here, replace(UNLOADED, nodal_force=strip.tip_force(force)), 2)
        x, z, _ = strip.deflection(here.state.positions)
        tips.append((-z / strip.length_m, x / strip.length_m))
    return tips


@final
@dataclass(frozen=True)
class TipLoadedCantilever(Case):
    """Bisshopp and Drucker's cantilever for five loads, to 0.5 % in both coordinates of the tip."""

    name: ClassVar[str] = "tip_loaded_cantilever"
    title: ClassVar[str] = "Cantilever strip under a tip load, large deflection"
    source: ClassVar[str] = "Bisshopp and Drucker, Q. Appl. Math. 3 (1945) 272"

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for alpha, coarse, fine in zip(LOADS, computed_tips(COARSE), computed_tips(FINE), strict=True):
            figures += [
                Figure.refined(f"tip {name} / L, P L^2/EI = {alpha:g}", "1", c, f, r)
                for name, c, f, r in zip(("drop", "reach"), coarse, fine, exact_tip(alpha), strict=True)
            ]
        return tuple(figures)
