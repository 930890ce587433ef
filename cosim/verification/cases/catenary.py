"""A hanging chain: a strip without bending stiffness between two supports."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.optimize import brentq

from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED, Specimen
from cosim.verification.support.strip import Strip

SPANS = (1.0 / 1.05, 1.0 / 1.2, 0.5)
COARSE, FINE = 16, 32
_GRAVITY = 9.81


def exact(span: float) -> tuple[float, float]:
    """Return (sag / s, H / (w s)) for a chain of length 1 over a span s.

    sinh u / u = 1 / s, a = s / (2 u):  sag = a (cosh u - 1), H = w a.
    """
    u = float(brentq(lambda v: math.sinh(v) / v - 1.0 / span, 1e-6, 20.0, xtol=1e-14))
    return (math.cosh(u) - 1.0) / (2.0 * u), 1.0 / (2.0 * u)


def hanging(panels: int, span: float) -> tuple[float, float]:
    """Return (sag / s, H / (w s)) of a strip of length 1 m; H is the support's reaction."""
    strip = Strip(panels, film=Film(1e9, 0.0, 1e-3), density=1.0, hinged=False)
    clamped = strip.clamped()
    clamped[strip.tip] = True
    weight = strip.density * strip.width_m * _GRAVITY  # per length
    specimen = Specimen(
        strip.body(), clamped, NewtonOptions(1e-7 * weight, iterations_max=400, step_max_m=0.2)
    )
    start = strip.body().positions
    fraction = np.maximum(start[:, 0], 0.0)
    start[:, 2] = -4.0 * math.sqrt(0.375 * span * (1.0 - span)) * fraction * (1.0 - fraction)
    start[:, 0] = np.where(start[:, 0] > 0.0, span * start[:, 0], start[:, 0])
    found = specimen.solve(specimen.drawn(start), replace(UNLOADED, gravity=(0.0, 0.0, -_GRAVITY)))
    pull = float(specimen.gradient(found)[strip.tip, 0].sum())
    return -float(found.state.positions[:, 2].min()) / span, pull / (weight * span)


@final
@dataclass(frozen=True)
class Catenary(Case):
    """Sag and horizontal pull of a chain for three lengths.

    Cables of the model have a given tension and no weight, so the chain is a strip of film without hinges,
    stiff enough to keep its length within 1e-6.
    """

    name: ClassVar[str] = "catenary"
    title: ClassVar[str] = "Hanging chain: sag and horizontal pull"
    source: ClassVar[str] = "Leibniz, Huygens, Johann Bernoulli 1691"

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for span in SPANS:
            reference, coarse, fine = exact(span), hanging(COARSE, span), hanging(FINE, span)
            figures += [
                Figure.refined(f"{name}, l / s = {1.0 / span:g}", "1", c, f, r)
                for name, c, f, r in zip(("sag / s", "H / (w s)"), coarse, fine, reference, strict=True)
            ]
        return tuple(figures)
