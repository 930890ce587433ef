"""Natural frequencies of a cantilever strip: from stiffness and mass, and from its motion in time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.linalg import eigh

from cosim.base.frames import Array, Pose
from cosim.soft.solve.time_step import ImplicitStepper
from cosim.verification.support.case import Case, Figure, observed_order
from cosim.verification.support.specimen import NO_CLAMP, UNLOADED, exact_steps
from cosim.verification.support.strip import Strip

ROOTS = (1.8751040687, 4.6940911330, 7.8547574382)
"""Solutions of cos x cosh x = -1."""

COARSE, FINE = 30, 60
DYNAMIC_PANELS = 20
STEPS_PER_PERIOD = 200
_DENSITY = 5.0


def exact_frequencies(strip: Strip) -> Array:
    """Return omega = x^2 sqrt(EI / (rho A L^4)) [rad/s]."""
    mass = strip.density * strip.width_m
    return np.array(ROOTS) ** 2 * math.sqrt(strip.bending_stiffness / (mass * strip.length_m**4))


def bending_modes(strip: Strip) -> tuple[Array, Array]:
    """Return the three lowest (omega [rad/s], height of each section) of plane bending.

    In the straight strip bending decouples: both nodes of a section move along z together.
    """
    specimen = strip.specimen()
    stiffness = specimen.stiffness(specimen.solve(specimen.drawn(), UNLOADED))
    sections = np.arange(2, strip.panels + 2)
    together = np.zeros((3 * strip.nodes, len(sections)))
    for side in (0, 1):
        together[3 * (2 * sections + side) + 2, np.arange(len(sections))] = 1.0
    mass = strip.node_mass().reshape(-1, 2).sum(axis=1)[sections]
    squares, shapes = eigh(together.T @ stiffness @ together, np.diag(mass), subset_by_index=[0, 2])
    heights = np.zeros((strip.panels + 2, 3))
    heights[sections] = shapes
    return np.sqrt(squares), heights


def frequency_in_time(strip: Strip, steps_per_period: int) -> float:
    """Return omega [rad/s] of the first mode released at rest, stepped by BDF2, from its zero crossings."""
    omega, shapes = bending_modes(strip)
    specimen = strip.specimen()
    bent = strip.body().positions
    bent[:, 2] = 1e-4 * strip.length_m * np.repeat(shapes[:, 0] / shapes[-1, 0], 2)
    state = specimen.drawn(bent)
    # forces are of the order of 1e-4 EI / L^2
    tolerance = 1e-9 * strip.bending_stiffness / strip.length_m**2
    stepper = ImplicitStepper(specimen.newton, NO_CLAMP, exact_steps("bdf2", tolerance))
    step = 2.0 * math.pi / omega[0] / steps_per_period
    heights = []
    for _ in range(math.ceil(1.4 * steps_per_period)):
        heights.append(float(state.positions[strip.tip, 2].mean()))
        state, _ = stepper.step(state, Pose(), UNLOADED, step)
    h = np.array(heights)
    before = np.flatnonzero(h[:-1] * h[1:] < 0.0)
    crossings = before + h[before] / (h[before] - h[before + 1])
    return float(2.0 * math.pi / ((crossings[2] - crossings[0]) * step))


@final
@dataclass(frozen=True)
class CantileverModes(Case):
    """Three bending frequencies from K and M; the first one also from a motion in time."""

    name: ClassVar[str] = "cantilever_modes"
    title: ClassVar[str] = "Natural frequencies of a cantilever strip"
    source: ClassVar[str] = "cos x cosh x = -1, omega = x^2 sqrt(EI / rho A L^4)"

    def run(self) -> tuple[Figure, ...]:
        strip = replace(Strip(FINE), density=_DENSITY)
        exact = exact_frequencies(strip)
        coarse, fine = bending_modes(replace(strip, panels=COARSE))[0], bending_modes(strip)[0]
        figures = [
            Figure.refined(f"omega_{k + 1} from K and M", "rad/s", coarse[k], fine[k], exact[k])
            for k in range(3)
        ]
        moving = replace(strip, panels=DYNAMIC_PANELS)
        own = bending_modes(moving)[0][0]
        half, full = (frequency_in_time(moving, n) for n in (STEPS_PER_PERIOD // 2, STEPS_PER_PERIOD))
        order = observed_order(half - own, full - own)
        figures.append(Figure("omega_1 in time, BDF2", "rad/s", full, exact[0], 5e-3, observed_order=order))
        return tuple(figures)
