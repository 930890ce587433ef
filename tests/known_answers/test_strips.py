"""Strips and rings that bend, hang, buckle, swing and whirl: panels joined by hinges, cables beside them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk, jn_zeros

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.bench.known_answers import UNLOADED, Specimen, Strip, exact_steps
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.time_step import Stepper

GRAVITY = 9.81
MESH = 5e-3
"""Tolerance where the mesh decides: its error of 0.1 to 0.4 % falls with the square of the panels' length."""


def tip_of(strip: Strip, here: Equilibrium) -> tuple[float, float, float]:
    """Return x, z [m] of the tip and the slope [rad] of the last panel."""
    before, end = (here.state.positions[nodes].mean(axis=0) for nodes in (strip.tip - 2, strip.tip))
    run = end - before
    return float(end[0]), float(end[2]), float(np.arctan2(run[2], run[0]))


def sideways(strip: Strip, specimen: Specimen, here: Equilibrium) -> Array:
    """Return the three lowest frequencies [rad/s] of a straight strip across its plane.

    Bending decouples: both nodes of a section move along z together.
    """
    specimen.gradient(here, hessian=True)
    pattern, z = specimen.film.pattern, np.zeros((strip.nodes, strip.nodes))
    z[pattern.row, pattern.column] = z[pattern.column, pattern.row] = specimen.film.blocks[:, 2, 2]
    z = z.reshape(strip.panels + 2, 2, strip.panels + 2, 2).sum(axis=(1, 3))[2:, 2:]
    mass = specimen.body.node_mass.reshape(-1, 2).sum(axis=1)[2:]
    return np.asarray(np.sqrt(eigh(z, np.diag(mass), subset_by_index=[0, 2], eigvals_only=True)))


@pytest.mark.parametrize("weight", [1.0, 5.0, 20.0])
def test_a_heavy_cantilever_bends_as_an_elastica(weight: float) -> None:
    # from the tip at u = s / L: theta'' = -w u cos theta, theta'(0) = 0, theta(1) = 0, w = weight L^3 / EI
    def shape(slope: float) -> tuple[float, float]:
        def rates(u: float, y: Array) -> list[float]:
            return [y[1], -weight * u * math.cos(y[0]), math.sin(y[0])]

        end = solve_ivp(rates, (0.0, 1.0), [slope, 0.0, 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
        return float(end[0]), float(end[2])

    slope = float(brentq(lambda angle: shape(angle)[0], 0.0, 0.5 * math.pi, xtol=1e-13))
    strip = Strip(32, density=1.0)
    specimen = strip.specimen()
    gravity = weight * strip.bending_stiffness / (strip.width_m * strip.density)
    begin = specimen.solve(specimen.drawn(), UNLOADED)
    _, z, found = tip_of(strip, specimen.follow(begin, replace(UNLOADED, gravity=(0.0, 0.0, -gravity)), 8))
    assert (-z, -found) == pytest.approx((shape(slope)[1], slope), rel=MESH)


def test_an_end_moment_rolls_a_strip_up() -> None:
    # curvature M / EI. Panels under a constant moment form a regular polygon: at 2 pi EI / L it closes
    # exactly, the half polygon is within O(1 / panels^2) of the half circle
    strip, steps = Strip(40), 16
    specimen = strip.specimen()
    here, heights = specimen.solve(specimen.drawn(), UNLOADED), []
    for k in range(1, steps + 1):
        moment = 2.0 * math.pi * strip.bending_stiffness * k / steps
        for _ in range(12):  # the couple's forces are dead loads, turned until they are normal to the panel
            run = (here.state.positions[strip.tip] - here.state.positions[strip.tip - 2]).mean(axis=0)
            force = 0.5 * moment / (run @ run) * np.array([-run[2], 0.0, run[0]])
            forces, before = np.zeros((strip.nodes, 3)), here.loads.nodal_force
            forces[strip.tip], forces[strip.tip - 2] = force, -force
            if before is not None and np.abs(forces - before).max() < 1e-8 * moment * strip.panels:
                break
            here = specimen.follow(here, replace(UNLOADED, nodal_force=forces))
        heights.append(tip_of(strip, here)[1])
    assert heights[steps // 2 - 1] == pytest.approx(2.0 / math.pi, rel=MESH)
    assert math.hypot(*tip_of(strip, here)[:2]) < 1e-3
    assert np.abs(here.state.memory - math.pi).max() == pytest.approx(2.0 * math.pi / 40, rel=1e-3)


@pytest.mark.parametrize("degrees", [40.0, 80.0, 120.0])
def test_a_buckled_strip_is_an_elastica(degrees: float) -> None:
    # Timoshenko and Gere, Theory of Elastic Stability, 2.7, k = sin(angle / 2): P / P_cr = (2 K / pi)^2,
    # x / L = 2 E / K - 1, z / L = 2 k / K
    k = math.sin(0.5 * math.radians(degrees))
    first, second = float(ellipk(k * k)), float(ellipe(k * k))
    strip = Strip(40)
    specimen, euler = strip.specimen(), math.pi**2 * strip.bending_stiffness / 4.0
    here = specimen.solve(specimen.drawn(), UNLOADED)
    push = -euler * (2.0 * first / math.pi) ** 2
    for force in ((0.0, 0.0, 0.02 * euler), (push, 0.0, 0.02 * euler), (push, 0.0, 0.0)):  # to one side
        here = specimen.follow(here, replace(UNLOADED, nodal_force=strip.tip_force(force)), 4)
    x, z, _ = tip_of(strip, here)
    assert x == pytest.approx(2.0 * second / first - 1.0, abs=MESH)
    assert z == pytest.approx(2.0 * k / first, rel=MESH)


def test_a_long_tube_buckles_under_outer_pressure() -> None:
    # Levy 1884: 3 D / R^3 of a pressure that stays normal to the wall; of one that keeps its direction 4, of
    # one towards the centre 4.5 D / R^3. So the pressure's tangent is tested, as large as that of the hinges
    panels, radius_m, depth_m, film = 96, 0.1, 0.02, Film(1e9, 0.0, 1e-3)
    angle = 2.0 * math.pi * np.arange(panels) / panels
    chord = math.pi * radius_m / (panels * math.sin(math.pi / panels))  # of the circle's circumference
    positions = np.zeros((2 * panels, 3))
    positions[:, 0], positions[:, 2] = np.repeat(chord * np.array([np.cos(angle), np.sin(angle)]), 2, axis=1)
    positions[1::2, 1] = depth_m
    a = 2 * np.arange(panels)
    b = (a + 2) % (2 * panels)
    triangles = np.stack([a, a + 1, b, a + 1, b + 1, b], 1).reshape(-1, 3)
    hinges = interior_hinges(triangles)
    between = film.bending_stiffness_Nm * depth_m * panels / (2.0 * math.pi * radius_m)
    stiffness = np.where(hinges[:, 1] // 2 == hinges[:, 2] // 2, between, 1e4 * between)
    body = SoftBody.from_arrays(positions, triangles, film, hinge_nodes=hinges, hinge_stiffness=stiffness)
    held = np.zeros(positions.shape, dtype=bool)
    held[:, 1] = held[0, [0, 2]] = held[panels, 2] = True
    specimen = Specimen(body, held, NewtonOptions(tolerance_N=1e-7, iterations_max=100))
    exact = 3.0 * film.bending_stiffness_Nm / radius_m**3
    # no film represents the ends, so the model measures two thirds of the volume
    found = specimen.critical(exact, lambda p: replace(UNLOADED, pressure_Pa=(-1.5 * p,)))
    assert found == pytest.approx(exact, rel=MESH)


@pytest.mark.parametrize("length_over_span", [1.05, 1.2, 2.0])
def test_a_chain_hangs_as_a_catenary(length_over_span: float) -> None:
    # Leibniz, Huygens, Johann Bernoulli 1691: sinh u / u = l / s, sag / s = (cosh u - 1) / 2u, H = w s / 2u.
    # Cables of the model weigh nothing, so this is a strip without hinges that hardly stretches (1e-6)
    u = float(brentq(lambda v: math.sinh(v) / v - length_over_span, 1e-6, 20.0, xtol=1e-14))
    strip, span = Strip(32, film=Film(1e9, 0.0, 1e-3), density=1.0, hinged=False), 1.0 / length_over_span
    clamped, start, weight = strip.clamped(), strip.body().positions, strip.width_m * GRAVITY
    clamped[strip.tip] = True
    specimen = Specimen(
        strip.body(), clamped, NewtonOptions(1e-7 * weight, iterations_max=400, step_max_m=0.2)
    )
    share = np.maximum(start[:, 0], 0.0)
    start[:, 2] = -4.0 * math.sqrt(0.375 * span * (1.0 - span)) * share * (1.0 - share)
    start[:, 0] = np.where(start[:, 0] > 0.0, span * start[:, 0], start[:, 0])
    found = specimen.solve(specimen.drawn(start), replace(UNLOADED, gravity=(0.0, 0.0, -GRAVITY)))
    pull = float(specimen.gradient(found)[strip.tip, 0].sum())
    assert -found.state.positions[:, 2].min() / span == pytest.approx(
        (math.cosh(u) - 1.0) / (2.0 * u), rel=MESH
    )
    assert pull / (weight * span) == pytest.approx(1.0 / (2.0 * u), rel=MESH)


HINGES, PANEL_M, OFFSET_M, HINGE_Nm = 8, 0.04, 0.01, 0.02


@pytest.fixture(scope="module")
def bowed() -> Specimen:
    """Return panels along x, hinged to one another, with a cable below them; the first is clamped.

    Each panel is a pyramid of stiff film: four corners in the plane z = 0, and below their middle the eyelet.
    """
    count = HINGES + 1
    lines = PANEL_M * np.arange(count + 1)
    edge = np.zeros((2 * (count + 1), 3))
    edge[:, 0] = np.repeat(lines, 2)
    edge[1::2, 1] = PANEL_M
    eyelets = np.stack([lines[:-1], np.zeros(count), np.full(count, -OFFSET_M)], axis=1)
    eyelets[:, :2] += 0.5 * PANEL_M
    a, e, line = 2 * np.arange(count), len(edge) + np.arange(count), 2 * np.arange(1, HINGES + 1)
    quarters = [(a, a + 2, a + 1), (a + 1, a + 2, a + 3)]
    quarters += [(a, e, a + 2), (a + 2, e, a + 3), (a + 3, e, a + 1), (a + 1, e, a)]
    body = SoftBody.from_arrays(
        np.concatenate([edge, eyelets]), np.concatenate([np.stack(quarter, axis=1) for quarter in quarters]),
        Film(1e9, 0.3, 1e-3), hinge_nodes=np.stack([line - 1, line, line + 1, line + 2], axis=1),
        hinge_stiffness=HINGE_Nm, cables=(Cable(e),),
    )  # fmt: skip
    return Specimen(body, np.arange(body.nodes) < 4, NewtonOptions(1e-6, iterations_max=400, step_max_m=0.3))


@pytest.mark.parametrize("pull", [0.1, 0.3, 0.5])
def test_a_cable_beside_a_strip_bows_it(bowed: Specimen, pull: float) -> None:
    # two eyelets of panels of length 2 h are 2 (h cos(theta / 2) - a sin(theta / 2)) apart, so
    # k theta = T (a cos(theta / 2) + h sin(theta / 2)) at each hinge; the film's yielding leaves 1e-3
    def off(theta: float) -> float:
        lever = math.cos(0.5 * theta) + 0.5 * PANEL_M / OFFSET_M * math.sin(0.5 * theta)
        return theta - pull * lever

    begin = bowed.solve(bowed.drawn(), replace(UNLOADED, cable_tension_N=(0.0,)))
    loads = replace(UNLOADED, cable_tension_N=(pull * HINGE_Nm / OFFSET_M,))
    x = bowed.follow(begin, loads, 8).state.positions
    run = np.diff(x[: 2 * (HINGES + 2) : 2], axis=0)
    turns = -np.diff(np.unwrap(np.arctan2(run[:, 2], run[:, 0])))
    assert turns == pytest.approx(np.full(HINGES, float(brentq(off, 0.0, math.pi, xtol=1e-14))), rel=MESH)


def test_a_cantilever_has_the_frequencies_of_a_beam() -> None:
    # cos x cosh x = -1, omega = x^2 sqrt(EI / rho A L^4)
    strip = Strip(60, density=5.0)
    specimen = strip.specimen()
    found = sideways(strip, specimen, specimen.solve(specimen.drawn(), UNLOADED))
    roots = np.array([1.8751040687, 4.6940911330, 7.8547574382])
    exact = roots**2 * math.sqrt(strip.bending_stiffness / (strip.density * strip.width_m))
    assert found == pytest.approx(exact, rel=MESH)


def test_a_hanging_chain_swings_by_its_weight_alone() -> None:
    # Daniel Bernoulli 1733: omega = (j / 2) sqrt(g / L), J_0(j) = 0
    strip = Strip(60, density=1.0, hinged=False)
    specimen = strip.specimen()
    hung = specimen.solve(specimen.drawn(), replace(UNLOADED, gravity=(GRAVITY, 0.0, 0.0)))
    assert sideways(strip, specimen, hung) == pytest.approx(
        0.5 * jn_zeros(0, 3) * math.sqrt(GRAVITY), rel=MESH
    )


def test_a_whirling_strip_pulls_and_flaps() -> None:
    # Southwell and Gough, ARC R&M 766 (1921): rho A omega^2 (L^2 - r^2) / 2 pulls; with it heights obey
    # Legendre's equation, so frequencies are omega sqrt(n (2 n - 1)): the second is released. BDF2
    speed, steps = 20.0, 400
    strip = Strip(40, density=1.0, hinged=False)
    specimen, held = strip.specimen(), np.flatnonzero(strip.clamped())
    drawn, mass = strip.body().positions, specimen.body.node_mass
    clamp = Clamp(held, drawn[held], np.ones((len(held), 3), dtype=bool))
    middle = np.array([0.0, 0.5 * strip.width_m, 0.0])

    def flange_at(angle: float) -> Pose:
        turn = rotation_from_vector(np.array([0.0, 0.0, angle]))
        return Pose(turn, -turn @ middle)

    x = drawn.copy()
    for _ in range(4):  # centrifugal forces depend on the stretch
        force = speed**2 * mass[:, None] * (x - middle) * (1.0, 1.0, 0.0)
        x = specimen.solve(specimen.drawn(x), replace(UNLOADED, nodal_force=force)).state.positions.copy()
    u = np.maximum(x[:, 0], 0.0)
    x[:, 2] = 0.5e-3 * (5.0 * u**3 - 3.0 * u)
    world = flange_at(0.0).apply(x)
    state = replace(specimen.drawn(world), velocities=np.cross([0.0, 0.0, speed], world))
    stepper, pulls, heights = Stepper(specimen.newton, clamp, exact_steps("bdf2", 1e-7)), [], []
    step = 2.0 * math.pi / (speed * steps)
    for k in range(1, steps + 1):
        flange = flange_at(speed * k * step)
        heights.append(float(state.positions[strip.tip, 2].mean()))
        state, _ = stepper.step(state, flange, UNLOADED, step)
        acting = clamp.wrench(specimen.film.gradient, state.positions, flange).force
        pulls.append(float(acting @ flange.rotation[:, 0]))
    h = np.array(heights)
    before = np.flatnonzero(h[:-1] * h[1:] < 0.0)
    passages = before + h[before] / (h[before] - h[before + 1])
    assert np.mean(pulls) == pytest.approx(0.5 * strip.width_m * speed**2, rel=MESH)
    assert math.pi / ((passages[1] - passages[0]) * step) == pytest.approx(math.sqrt(6.0) * speed, rel=MESH)
