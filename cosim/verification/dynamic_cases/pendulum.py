"""A pendulum that swings far, and a heavy chain that swings a little."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.linalg import eigh
from scipy.special import ellipk, jn_zeros

from cosim.base.frames import Array, Pose
from cosim.soft.solve.time_step import ImplicitStepper
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import NO_CLAMP, UNLOADED, exact_steps
from cosim.verification.support.strip import Strip

AMPLITUDES_DEG = (10.0, 90.0, 150.0)
STEPS_PER_PERIOD = 400
COARSE, FINE = 30, 60
_GRAVITY = 9.81


def released(amplitude: float, steps_per_period: int) -> float:
    """Return the period [s] of one stiff panel on a hinge without stiffness, its mass at its end.

    It hangs along x, which is down, and is released at an angle [rad]; a quarter of the period is the time
    of the first passage, half of it lies between the first two.
    """
    strip = Strip(1, density=1.0, hinged=False)
    specimen = strip.specimen()
    start = strip.body().positions
    start[strip.tip, 0] = strip.length_m * math.cos(amplitude)
    start[strip.tip, 2] = strip.length_m * math.sin(amplitude)
    state = specimen.drawn(start)
    stepper = ImplicitStepper(specimen.newton, NO_CLAMP, exact_steps("bdf2", 1e-9))
    step = period(amplitude, strip.length_m) / steps_per_period
    loads = replace(UNLOADED, gravity=(_GRAVITY, 0.0, 0.0))
    heights = [float(start[strip.tip, 2].mean())]
    for _ in range(math.ceil(0.9 * steps_per_period)):
        state, _ = stepper.step(state, Pose(), loads, step)
        heights.append(float(state.positions[strip.tip, 2].mean()))
    h = np.array(heights)
    before = np.flatnonzero(h[:-1] * h[1:] < 0.0)
    crossings = before + h[before] / (h[before] - h[before + 1])
    return float(2.0 * (crossings[1] - crossings[0]) * step)


def period(amplitude: float, length_m: float) -> float:
    """Return T = 4 sqrt(L / g) K(k) [s], k = sin(amplitude / 2), amplitude [rad]."""
    return 4.0 * math.sqrt(length_m / _GRAVITY) * float(ellipk(math.sin(0.5 * amplitude) ** 2))


@final
@dataclass(frozen=True)
class Pendulum(Case):
    """Periods of three amplitudes, stepped by BDF2; the last one takes 1.8 times as long as a small swing.

    Steps are 1 / 400 of the period; the tolerance is some (omega h)^2 where the swing is fastest.
    """

    name: ClassVar[str] = "pendulum"
    title: ClassVar[str] = "Period of a pendulum that swings far"
    source: ClassVar[str] = "T = 4 sqrt(L / g) K(sin(amplitude / 2)), Legendre's complete elliptic integral"

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for degrees in AMPLITUDES_DEG:
            angle = math.radians(degrees)
            exact = period(angle, Strip(1).length_m)
            coarse, fine = (released(angle, n) for n in (STEPS_PER_PERIOD // 2, STEPS_PER_PERIOD))
            figures.append(Figure.refined(f"period, {degrees:g} deg", "s", coarse, fine, exact, 2e-3))
        return tuple(figures)


def chain_frequencies(links: int) -> Array:
    """Return the three lowest frequencies [rad/s] of a hanging strip without bending stiffness, sideways."""
    strip = Strip(links, density=1.0, hinged=False)
    specimen = strip.specimen()
    hung = specimen.solve(specimen.drawn(), replace(UNLOADED, gravity=(_GRAVITY, 0.0, 0.0)))
    stiffness = specimen.stiffness(hung)
    sections = np.arange(2, links + 2)
    together = np.zeros((3 * strip.nodes, links))
    for side in (0, 1):
        together[3 * (2 * sections + side) + 2, np.arange(links)] = 1.0
    mass = strip.node_mass().reshape(-1, 2).sum(axis=1)[sections]
    squares = eigh(together.T @ stiffness @ together, np.diag(mass), eigvals_only=True)
    return np.asarray(np.sqrt(squares[:3]))


@final
@dataclass(frozen=True)
class SwingingChain(Case):
    """Three frequencies of a chain hung at its upper end, from stiffness and mass.

    All stiffness is that of the weight's tension: the film's geometric stiffness, and nothing else. The error
    falls with the square of the links' length.
    """

    name: ClassVar[str] = "swinging_chain"
    title: ClassVar[str] = "Natural frequencies of a hanging chain"
    source: ClassVar[str] = "Daniel Bernoulli 1733: omega = (j / 2) sqrt(g / L), J_0(j) = 0"

    def run(self) -> tuple[Figure, ...]:
        exact = 0.5 * jn_zeros(0, 3) * math.sqrt(_GRAVITY / Strip(FINE).length_m)
        coarse, fine = chain_frequencies(COARSE), chain_frequencies(FINE)
        return tuple(
            Figure.refined(f"omega_{k + 1}", "rad/s", float(coarse[k]), float(fine[k]), float(exact[k]))
            for k in range(3)
        )
