"""A clamped-free strip under an axial load: where it buckles, and its shape beyond."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

from scipy.special import ellipe, ellipk

from cosim.soft.body.loads import Loads
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED
from cosim.verification.support.strip import Strip

COARSE, FINE = 8, 16
ELASTICA_PANELS = 40
TIP_ANGLES_DEG = (40.0, 80.0, 120.0)
_NUDGE = 0.02
"""Lateral force in units of the critical load that decides the side; removed before anything is read."""


def euler_load(strip: Strip) -> float:
    """Return pi^2 EI / (4 L^2) [N]."""
    return math.pi**2 * strip.bending_stiffness / (4.0 * strip.length_m**2)


def axial(strip: Strip, load: float, lateral: float = 0.0) -> Loads:
    """Return the loads of an axial compression and a lateral force [N] at the tip."""
    return replace(UNLOADED, nodal_force=strip.tip_force((-load, 0.0, lateral)))


def critical_load(panels: int) -> float:
    """Return the load [N] at which the straight strip's tangent stiffness ceases to be positive definite."""
    strip = Strip(panels)
    specimen = strip.specimen()
    low, high = 0.5 * euler_load(strip), 2.0 * euler_load(strip)
    while high - low > 1e-7 * high:
        middle = 0.5 * (low + high)
        straight = specimen.solve(specimen.drawn(), axial(strip, middle))
        low, high = (middle, high) if specimen.stable(straight) else (low, middle)
    return 0.5 * (low + high)


def elastica(tip_angle: float) -> tuple[float, float, float]:
    """Return (P / P_cr, x / L, z / L) of the tip; k = sin(angle / 2), moduli K and E.

    P / P_cr = (2 K / pi)^2,  x / L = 2 E / K - 1,  z / L = 2 k / K.
    """
    k = math.sin(0.5 * tip_angle)
    first, second = float(ellipk(k * k)), float(ellipe(k * k))
    return (2.0 * first / math.pi) ** 2, 2.0 * second / first - 1.0, 2.0 * k / first


@final
@dataclass(frozen=True)
class EulerBuckling(Case):
    """The load at which the tangent stiffness becomes singular is Euler's."""

    name: ClassVar[str] = "euler_buckling"
    title: ClassVar[str] = "Buckling load of a strip, from the tangent stiffness"
    source: ClassVar[str] = "Euler 1744: P = pi^2 EI / (4 L^2)"

    def run(self) -> tuple[Figure, ...]:
        exact = euler_load(Strip(FINE))
        return (Figure.refined("critical load", "N", critical_load(COARSE), critical_load(FINE), exact),)


@final
@dataclass(frozen=True)
class PostBuckling(Case):
    """The tip of the buckled strip lies on the elastica."""

    name: ClassVar[str] = "post_buckling"
    title: ClassVar[str] = "Shape of the buckled strip"
    source: ClassVar[str] = "elastica; Timoshenko and Gere, Theory of Elastic Stability, section 2.7"

    def run(self) -> tuple[Figure, ...]:
        strip = Strip(ELASTICA_PANELS)
        specimen, euler = strip.specimen(), euler_load(strip)
        here = specimen.solve(specimen.drawn(), UNLOADED)
        here = specimen.follow(here, axial(strip, 0.0, _NUDGE * euler), 1)
        figures = []
        for degrees in TIP_ANGLES_DEG:
            ratio, x, z = elastica(math.radians(degrees))
            if degrees == TIP_ANGLES_DEG[0]:
                here = specimen.follow(here, axial(strip, ratio * euler, _NUDGE * euler), 4)
            here = specimen.follow(here, axial(strip, ratio * euler), 4)
            found_x, found_z, _ = strip.deflection(here.state.positions)
            note = f"P / P_cr = {ratio:.4f}"
            figures += [
                Figure(f"tip x / L, {note}", "1", found_x / strip.length_m, x, 5e-3, absolute=True),
                Figure(f"tip z / L, {note}", "1", found_z / strip.length_m, z, 5e-3),
            ]
        return tuple(figures)
