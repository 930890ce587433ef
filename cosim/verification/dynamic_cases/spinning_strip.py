"""A strip without bending stiffness that whirls about an axis: its pull, and how it flaps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.soft.solve.state import Clamp
from cosim.soft.solve.time_step import ImplicitStepper
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.specimen import UNLOADED, Specimen, exact_steps
from cosim.verification.support.strip import Strip

PANELS = 30
SPEED = 20.0
"""Of the axis [rad/s]."""

STEPS_PER_TURN = 400
_FLAP = 1e-3
"""Height of the tip over the strip's length."""


def flange_at(strip: Strip, angle: float) -> Pose:
    """Return the clamp's pose at an angle [rad] about z, the strip's middle line on the axis."""
    rotation = rotation_from_vector(np.array([0.0, 0.0, angle]))
    return Pose(rotation, rotation @ np.array([0.0, -0.5 * strip.width_m, 0.0]))


def stretched(strip: Strip, specimen: Specimen) -> Array:
    """Return positions (n, 3) [m] in the clamp's frame under m omega^2 r, from the last shape's r."""
    here, middle = specimen.solve(specimen.drawn(), UNLOADED), np.array([0.0, 0.5 * strip.width_m, 0.0])
    for _ in range(3):
        arm = (here.state.positions - middle) * (1.0, 1.0, 0.0)
        force = SPEED**2 * strip.node_mass()[:, None] * arm
        here = specimen.follow(here, replace(UNLOADED, nodal_force=force))
    return here.state.positions


def whirled(steps_per_turn: int) -> tuple[float, float]:
    """Return (mean pull on the clamp [N], frequency of flapping [rad/s]) over a bit more than a turn.

    Released with the height (5 u^3 - 3 u) / 2 along u = x / L: the second mode, the first one being the
    strip's whirl in an oblique plane.
    """
    strip = Strip(PANELS, density=1.0, hinged=False)
    specimen = strip.specimen()
    x = stretched(strip, specimen)
    held = np.flatnonzero(strip.clamped())
    clamp = Clamp(held, specimen.body.positions[held], np.ones((len(held), 3), dtype=bool))
    stepper = ImplicitStepper(specimen.newton, clamp, exact_steps("bdf2", 1e-7))
    u = np.maximum(x[:, 0], 0.0) / strip.length_m
    x[:, 2] = 0.5 * _FLAP * strip.length_m * (5.0 * u**3 - 3.0 * u)
    world = flange_at(strip, 0.0).apply(x)
    velocity = np.cross(np.array([0.0, 0.0, SPEED]), world)
    state = replace(specimen.drawn(world), velocities=velocity)
    step = 2.0 * math.pi / (SPEED * steps_per_turn)
    pulls, heights = [], []
    for k in range(1, steps_per_turn + 1):
        flange = flange_at(strip, SPEED * k * step)
        heights.append(float(state.positions[strip.tip, 2].mean()))
        state, _ = stepper.step(state, flange, UNLOADED, step)
        force = clamp.wrench(specimen.system.gradient, state.positions, flange).force
        pulls.append(float(force @ flange.rotation[:, 0]))
    h = np.array(heights)
    before = np.flatnonzero(h[:-1] * h[1:] < 0.0)
    crossings = before + h[before] / (h[before] - h[before + 1])
    return float(np.mean(pulls)), float(math.pi / ((crossings[1] - crossings[0]) * step))


@final
@dataclass(frozen=True)
class SpinningStrip(Case):
    """Pull at the axis and frequency of the second flapping mode, stepped by BDF2 with a clamp that turns.

    The tension is rho A omega^2 (L^2 - r^2) / 2. With it the height w(r) of a strip that flaps obeys
    Legendre's equation, so frequencies are omega sqrt(n (2 n - 1)): omega, 2.449 omega, 3.873 omega.
    """

    name: ClassVar[str] = "spinning_strip"
    title: ClassVar[str] = "Strip that whirls about an axis: pull and flapping"
    source: ClassVar[str] = "T = rho A omega^2 (L^2 - r^2) / 2; Southwell and Gough, ARC R&M 766 (1921)"

    def run(self) -> tuple[Figure, ...]:
        strip = Strip(PANELS, density=1.0)
        pull = 0.5 * strip.density * strip.width_m * (SPEED * strip.length_m) ** 2
        flapping = math.sqrt(6.0) * SPEED
        found_pull, found_flapping = whirled(STEPS_PER_TURN)
        return (
            Figure("pull at the axis", "N", found_pull, pull, 5e-3),
            Figure("second flapping frequency", "rad/s", found_flapping, flapping, 5e-3),
        )
