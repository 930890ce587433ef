"""A long thin-walled tube under outer pressure: where its section buckles."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED, Specimen
from cosim.verification.support.strip import PANEL_FACTOR

COARSE, FINE = 48, 96
RADIUS_M, DEPTH_M = 0.1, 0.02
FILM = Film(1e9, 0.0, 1e-3)


def critical_pressure() -> float:
    """Return 3 D / R^3 [Pa], D = E t^3 / 12 the bending stiffness per width."""
    return 3.0 * FILM.bending_stiffness_Nm / RADIUS_M**3


def ring(panels: int) -> tuple[Array, IntArray]:
    """Return positions (n, 3) [m] and outward triangles; nodes 2 s and 2 s + 1 are line s, the axis is y.

    The polygon has the circle's circumference.
    """
    angle = 2.0 * math.pi * np.arange(panels) / panels
    radius = math.pi * RADIUS_M / (panels * math.sin(math.pi / panels))
    positions = np.zeros((2 * panels, 3))
    positions[:, 0], positions[:, 2] = np.repeat(radius * np.array([np.cos(angle), np.sin(angle)]), 2, axis=1)
    positions[1::2, 1] = DEPTH_M
    a = 2 * np.arange(panels)
    b = (a + 2) % (2 * panels)
    triangles = np.stack([np.stack([a, a + 1, b], 1), np.stack([a + 1, b + 1, b], 1)], 1).reshape(-1, 3)
    return positions, triangles


def pressed(panels: int) -> Specimen:
    """Return the ring, its lines kept at their depth and three components held against rigid motion."""
    positions, triangles = ring(panels)
    hinges = interior_hinges(triangles)
    across = hinges[:, 1] // 2 == hinges[:, 2] // 2
    between = FILM.bending_stiffness_Nm * DEPTH_M * panels / (2.0 * math.pi * RADIUS_M)
    body = SoftBody.from_arrays(
        positions, triangles, FILM, hinge_nodes=hinges,
        hinge_stiffness=np.where(across, between, PANEL_FACTOR * between),
    )  # fmt: skip
    held = np.zeros(positions.shape, dtype=bool)
    held[:, 1] = True
    held[0, [0, 2]] = True
    held[panels, 2] = True  # opposite: no turn about the axis
    return Specimen(body, held, NewtonOptions(tolerance_N=1e-7, iterations_max=100))


def outer(pressure_Pa: float) -> Loads:
    """Return the loads of a pressure from outside.

    No film stands for the ends, so the model measures two thirds of the volume, see `Sheet.loads`.
    """
    return replace(UNLOADED, pressure_Pa=(-1.5 * pressure_Pa,))


def found_pressure(panels: int) -> float:
    """Return the pressure [Pa] at which the round ring's tangent stiffness ceases to be positive definite."""
    specimen = pressed(panels)
    low, high = 0.5 * critical_pressure(), 1.5 * critical_pressure()
    while high - low > 1e-7 * high:
        middle = 0.5 * (low + high)
        round_one = specimen.solve(specimen.drawn(), outer(middle))
        low, high = (middle, high) if specimen.stable(round_one) else (low, middle)
    return 0.5 * (low + high)


@final
@dataclass(frozen=True)
class PressedRing(Case):
    """The pressure at which the tangent stiffness becomes singular is 3 EI / R^3.

    That number belongs to a pressure that stays normal to the wall; a load that kept its direction would
    give 4 EI / R^3, one towards the centre 4.5 EI / R^3. So the tangent of the pressure is tested, which is
    as large as that of the hinges. The error falls with the square of the panels' length.
    """

    name: ClassVar[str] = "pressed_ring"
    title: ClassVar[str] = "Long tube under outer pressure: where its section buckles"
    source: ClassVar[str] = "Lévy 1884; Timoshenko and Gere, Theory of Elastic Stability, 7.3: p = 3 EI / R^3"

    def run(self) -> tuple[Figure, ...]:
        coarse, fine = found_pressure(COARSE), found_pressure(FINE)
        return (Figure.refined("critical pressure", "Pa", coarse, fine, critical_pressure()),)
