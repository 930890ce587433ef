"""An upright strip that buckles under its own weight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

from scipy.optimize import brentq
from scipy.special import jv

from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED
from cosim.verification.support.strip import Strip

COARSE, FINE = 12, 24


def critical_weight() -> float:
    """Return w L^3 / EI at which an upright clamped column buckles, w its weight per length.

    The slope obeys EI theta'' = -w s theta, s from the top, which Bessel's functions of order 1/3 solve;
    free at the top and clamped at the bottom ask for J_{-1/3}((2 / 3) sqrt(w L^3 / EI)) = 0.
    """
    root = float(brentq(lambda z: float(jv(-1.0 / 3.0, z)), 1.0, 2.5, xtol=1e-14))
    return 2.25 * root**2


def found_weight(panels: int) -> float:
    """Return w L^3 / EI at which the upright strip's tangent stiffness ceases to be positive definite."""
    strip = Strip(panels, density=1.0)
    specimen = strip.specimen()
    unit = strip.bending_stiffness / (strip.length_m**3 * strip.width_m * strip.density)
    low, high = 0.5 * critical_weight(), 2.0 * critical_weight()
    while high - low > 1e-7 * high:
        middle = 0.5 * (low + high)
        # the strip lies along x: this gravity presses it against its clamp
        upright = specimen.solve(specimen.drawn(), replace(UNLOADED, gravity=(-middle * unit, 0.0, 0.0)))
        low, high = (middle, high) if specimen.stable(upright) else (low, middle)
    return 0.5 * (low + high)


@final
@dataclass(frozen=True)
class SelfBuckling(Case):
    """The weight at which the tangent stiffness becomes singular is Greenhill's, 7.837 EI / L^3.

    Weight is compression that grows along the strip: the load's distribution is tested besides the hinges.
    The error falls with the square of the panels' length; 24 panels leave 0.1 %.
    """

    name: ClassVar[str] = "self_buckling"
    title: ClassVar[str] = "Upright strip under its own weight: where it buckles"
    source: ClassVar[str] = (
        "Greenhill, Proc. Camb. Phil. Soc. 4 (1881) 65: J_{-1/3}((2/3) sqrt(w L^3/EI)) = 0"
    )

    def run(self) -> tuple[Figure, ...]:
        coarse, fine = found_weight(COARSE), found_weight(FINE)
        return (Figure.refined("critical w L^3 / EI", "1", coarse, fine, critical_weight()),)
