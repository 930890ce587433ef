"""Known answers in time: natural frequencies, motions, orders of convergence, free flight.

Natural frequencies of a cantilever strip: from stiffness and mass, and from its motion in time.

A pendulum that swings far, and a heavy chain that swings a little.

A strip without bending stiffness that whirls about an axis: its pull, and how it flaps.

A cantilever strip whose clamp is shaken up and down.

Order of convergence in time of every integrator.

Order of convergence in time of the coupled tick: a rigid carriage and the soft strip it carries.

A soft body that tumbles and pulsates freely: momentum and energy.
"""

import cmath
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import ellipk, jn_zeros

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Array, Mask, Pose, rotation_from_vector
from cosim.coupling.schemes import iterated, staggered
from cosim.coupling.schemes.interface import Coupling, Interface
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.ticks import Servos
from cosim.rigid.build.description import SceneDescription, ServoGains
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements import cable, material
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve import assembly, newton
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Integrator, SoftState
from cosim.soft.solve.time_step import ImplicitStepper
from cosim.verification.case import (
    NO_CLAMP,
    UNLOADED,
    Figure,
    Specimen,
    case,
    exact_steps,
    observed_order,
    panel,
)
from cosim.verification.strips import Strip

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
    """Return the three lowest (omega [rad/s], height of each section) of plane bending."""
    specimen = strip.specimen()
    stiffness = specimen.stiffness(specimen.solve(specimen.drawn(), UNLOADED))
    squares, heights = strip.sideways(stiffness, 3)
    return np.sqrt(squares), heights


def zero_crossings(heights: list[float]) -> Array:
    """Return when heights change sign, in steps between them."""
    h = np.array(heights)
    before = np.flatnonzero(h[:-1] * h[1:] < 0.0)
    return before + h[before] / (h[before] - h[before + 1])


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
    crossings = zero_crossings(heights)
    return float(2.0 * math.pi / ((crossings[2] - crossings[0]) * step))


@case(
    "cantilever_modes",
    "Natural frequencies of a cantilever strip",
    "cos x cosh x = -1, omega = x^2 sqrt(EI / rho A L^4)",
)
def cantilever_modes() -> tuple[Figure, ...]:
    """Three bending frequencies from K and M; the first one also from a motion in time."""
    strip = replace(Strip(FINE), density=_DENSITY)
    exact = exact_frequencies(strip)
    coarse, fine = bending_modes(replace(strip, panels=COARSE))[0], bending_modes(strip)[0]
    names = {f"omega_{k} from K and M": "rad/s" for k in (1, 2, 3)}
    figures = Figure.all_refined(names, coarse, fine, exact)
    moving = replace(strip, panels=DYNAMIC_PANELS)
    own = bending_modes(moving)[0][0]
    half, full = (frequency_in_time(moving, n) for n in (STEPS_PER_PERIOD // 2, STEPS_PER_PERIOD))
    order = observed_order(half - own, full - own)
    figures.append(Figure("omega_1 in time, BDF2", "rad/s", full, exact[0], 5e-3, observed_order=order))
    return tuple(figures)


AMPLITUDES_DEG = (10.0, 90.0, 150.0)
PENDULUM_STEPS_PER_PERIOD = 400

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
    crossings = zero_crossings(heights)
    return float(2.0 * (crossings[1] - crossings[0]) * step)


def period(amplitude: float, length_m: float) -> float:
    """Return T = 4 sqrt(L / g) K(k) [s], k = sin(amplitude / 2), amplitude [rad]."""
    return 4.0 * math.sqrt(length_m / _GRAVITY) * float(ellipk(math.sin(0.5 * amplitude) ** 2))


@case(
    "pendulum",
    "Period of a pendulum that swings far",
    "T = 4 sqrt(L / g) K(sin(amplitude / 2)), Legendre's complete elliptic integral",
)
def pendulum() -> tuple[Figure, ...]:
    """Periods of three amplitudes, stepped by BDF2; the last one takes 1.8 times as long as a small swing.

    Steps are 1 / 400 of the period; the tolerance is some (omega h)^2 where the swing is fastest.
    """
    figures = []
    for degrees in AMPLITUDES_DEG:
        angle = math.radians(degrees)
        exact = period(angle, Strip(1).length_m)
        coarse, fine = (
            released(angle, n) for n in (PENDULUM_STEPS_PER_PERIOD // 2, PENDULUM_STEPS_PER_PERIOD)
        )
        figures.append(Figure.refined(f"period, {degrees:g} deg", "s", coarse, fine, exact, 2e-3))
    return tuple(figures)


def chain_frequencies(links: int) -> Array:
    """Return the three lowest frequencies [rad/s] of a hanging strip without bending stiffness, sideways."""
    strip = Strip(links, density=1.0, hinged=False)
    specimen = strip.specimen()
    hung = specimen.solve(specimen.drawn(), replace(UNLOADED, gravity=(_GRAVITY, 0.0, 0.0)))
    return np.asarray(np.sqrt(strip.sideways(specimen.stiffness(hung), 3)[0]))


@case(
    "swinging_chain",
    "Natural frequencies of a hanging chain",
    "Daniel Bernoulli 1733: omega = (j / 2) sqrt(g / L), J_0(j) = 0",
)
def swinging_chain() -> tuple[Figure, ...]:
    """Three frequencies of a chain hung at its upper end, from stiffness and mass.

    All stiffness is that of the weight's tension: the film's geometric stiffness, and nothing else. The error
    falls with the square of the links' length.
    """
    exact = 0.5 * jn_zeros(0, 3) * math.sqrt(_GRAVITY / Strip(FINE).length_m)
    names = {f"omega_{k}": "rad/s" for k in (1, 2, 3)}
    return tuple(Figure.all_refined(names, chain_frequencies(COARSE), chain_frequencies(FINE), exact))


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
    x, clamp = stretched(strip, specimen), strip.clamp()
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
    crossings = zero_crossings(heights)
    return float(np.mean(pulls)), float(math.pi / ((crossings[1] - crossings[0]) * step))


@case(
    "spinning_strip",
    "Strip that whirls about an axis: pull and flapping",
    "T = rho A omega^2 (L^2 - r^2) / 2; Southwell and Gough, ARC R&M 766 (1921)",
)
def spinning_strip() -> tuple[Figure, ...]:
    """Pull at the axis and frequency of the second flapping mode, stepped by BDF2 with a clamp that turns.

    The tension is rho A omega^2 (L^2 - r^2) / 2. With it the height w(r) of a strip that flaps obeys
    Legendre's equation, so frequencies are omega sqrt(n (2 n - 1)): omega, 2.449 omega, 3.873 omega.
    """
    strip = Strip(PANELS, density=1.0)
    pull = 0.5 * strip.density * strip.width_m * (SPEED * strip.length_m) ** 2
    flapping = math.sqrt(6.0) * SPEED
    found_pull, found_flapping = whirled(STEPS_PER_TURN)
    return (
        Figure("pull at the axis", "N", found_pull, pull, 5e-3),
        Figure("second flapping frequency", "rad/s", found_flapping, flapping, 5e-3),
    )


SHAKEN_PANELS = 20
RATIOS = (0.5, 0.8)
"""Frequencies over the strip's first."""

SHAKEN_STEPS_PER_PERIOD, PERIODS = 120, 6
_STROKE = 1e-3
"""Amplitude of the clamp over the strip's length: small, as the formula asks for."""

_DAMPING = 0.3
"""Of a mass in motion, per second, over the first frequency: what the start leaves has gone after PERIODS."""


def tip_ratio(strip: Strip, omega: float, damping_per_s: float) -> complex:
    """Return the tip's motion over the clamp's, as a complex amplitude, at a frequency [rad/s].

    Damping acts on the motion relative to the clamp u: EI w'''' + rho A (w_tt + alpha (w_t - u_t)) = 0 with
    w = W(x) exp(i omega t), W(0) = 1, W'(0) = 0 and a free end:
        W(L) = s + (1 - s) (cos b + cosh b) / (1 + cos b cosh b),
        b^4 = rho A L^4 (omega^2 - i omega alpha) / EI,   s = -i alpha / (omega - i alpha).
    """
    mass = strip.density * strip.width_m
    weight = mass * strip.length_m**4 / strip.bending_stiffness
    b = (weight * (omega**2 - 1j * omega * damping_per_s)) ** 0.25
    share = -1j * damping_per_s / (omega - 1j * damping_per_s)
    return share + (1.0 - share) * (cmath.cos(b) + cmath.cosh(b)) / (1.0 + cmath.cos(b) * cmath.cosh(b))


def found_ratio(strip: Strip, omega: float, damping_per_s: float) -> complex:
    """Return the same from a motion that begins at rest, read from its last period."""
    specimen = strip.specimen()
    # the strip's stretch rounds to some 2e-9 N, 4e-9 of this force
    tolerance = 1e-8 * strip.bending_stiffness / strip.length_m**2
    options = replace(exact_steps("bdf2", tolerance), damping_per_s=damping_per_s)
    stepper = ImplicitStepper(specimen.newton, strip.clamp(), options)
    state, step = specimen.drawn(), 2.0 * math.pi / omega / SHAKEN_STEPS_PER_PERIOD
    stroke, heights = _STROKE * strip.length_m, []
    for k in range(1, PERIODS * SHAKEN_STEPS_PER_PERIOD + 1):
        flange = Pose(np.eye(3), np.array([0.0, 0.0, stroke * math.sin(omega * k * step)]))
        state, _ = stepper.step(state, flange, UNLOADED, step)
        heights.append(float(state.positions[strip.tip, 2].mean()))
    last = np.array(heights[-SHAKEN_STEPS_PER_PERIOD:])
    phase = omega * step * np.arange(len(heights) - SHAKEN_STEPS_PER_PERIOD + 1, len(heights) + 1)
    # of sin(omega t): the imaginary part of exp(i omega t)
    return complex(2.0j * np.mean(last * np.exp(-1j * phase)) / stroke)


@case(
    "shaken_beam",
    "Cantilever strip on a shaken clamp: amplitude and lag of the tip",
    "steady motion of a damped Euler-Bernoulli beam on a moving clamp, closed form",
)
def shaken_beam() -> tuple[Figure, ...]:
    """Amplitude and lag of the tip at two frequencies below resonance, stepped by BDF2.

    Tolerance: 20 panels leave the frequencies 0.2 % low, which near resonance (0.8) makes 1 % of the
    amplitude; the steps, (omega h)^2 = 3e-3, as much in the lag.
    """
    strip = Strip(SHAKEN_PANELS, density=5.0)
    first = float(exact_frequencies(strip)[0])
    damping, figures = _DAMPING * first, []
    for ratio in RATIOS:
        found = found_ratio(strip, ratio * first, damping)
        exact = tip_ratio(strip, ratio * first, damping)
        note = f"omega / omega_1 = {ratio:g}"
        lags = (-cmath.phase(found), -cmath.phase(exact))
        figures += [
            Figure(f"tip over clamp, {note}", "1", abs(found), abs(exact), 1e-2),
            Figure(f"lag, {note}", "rad", *lags, 1e-2, absolute=True),
        ]
    return tuple(figures)


THEORY: Mapping[str, float] = {"implicit_euler": 1.0, "bdf2": 2.0}
SPAN_S = 0.1
STEPS = (400, 800)
_LOADS = Loads(gravity=(0.0, 0.0, -9.81))


def swinging_sheet() -> tuple[SoftBody, Mask]:
    """Return a soft sheet of 2 x 2 squares with hinges, and the edge that holds it.

    Its fastest oscillation, near 350 rad/s, is resolved by every step used here.
    """
    positions, triangles = panel(0.1, 0.1, 2, 2)
    body = SoftBody.from_arrays(
        positions, triangles, material.Film(1e5, 0.3, 2e-4), hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=1e-4, node_mass=1e-3,
    )  # fmt: skip
    return body, np.abs(positions[:, 0]) < 1e-9


def exact_end(body: SoftBody, clamped: Mask) -> Array:
    """Return positions (n, 3) [m] at SPAN_S by an explicit Runge-Kutta method of order 8."""
    system = assembly.SoftSystem(body)
    n = body.nodes

    def rates(_t: float, y: Array) -> Array:
        x = np.ascontiguousarray(y[: 3 * n].reshape(n, 3))
        system.evaluate(x, _LOADS, np.zeros(0), system.memory.copy(), hessian=False)
        acceleration = -system.gradient / body.node_mass[:, None]
        acceleration[clamped] = 0.0
        return np.concatenate([y[3 * n :], acceleration.ravel()])

    start = np.concatenate([body.positions.ravel(), np.zeros(3 * n)])
    end = solve_ivp(rates, (0.0, SPAN_S), start, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return np.asarray(end[: 3 * n].reshape(n, 3))


def stepped_end(body: SoftBody, clamped: Mask, integrator: Integrator, steps: int) -> Array:
    """Return positions (n, 3) [m] at SPAN_S after equal steps, each solved to 1e-10 N."""
    options = exact_steps(integrator, 1e-10)
    # a start that is nearly right is not taken as it is either
    options = replace(options, newton=replace(options.newton, start_tolerance_N=1e-10))
    stepper = ImplicitStepper(newton.NewtonSolver(assembly.SoftSystem(body), clamped), NO_CLAMP, options)
    state = SoftState.drawn(body, Pose())
    for _ in range(steps):
        state, _ = stepper.step(state, Pose(), _LOADS, SPAN_S / steps)
    return state.positions


@case(
    "time_order",
    "Order of convergence in time of every integrator",
    "Hairer and Wanner, Solving ODEs II; reference solution by SciPy's DOP853",
)
def time_order() -> tuple[Figure, ...]:
    """A hinged sheet falls from rest about one edge; its end position against a Runge-Kutta solution."""
    body, clamped = swinging_sheet()
    exact = exact_end(body, clamped)
    figures = []
    for integrator in get_args(Integrator):
        errors = [
            float(np.abs(stepped_end(body, clamped, integrator, steps) - exact).max()) for steps in STEPS
        ]
        order = observed_order(*errors)
        figures.append(
            Figure(f"order of {integrator}", "1", order, THEORY[integrator], 0.15, absolute=True,
                   observed_order=order)
        )  # fmt: skip
    return tuple(figures)


TICK_SPAN_S, PUSH_N = 0.1, 1.0
TICKS = (400, 800)
EXCHANGES: tuple[tuple[str, float, Callable[[Interface], Coupling]], ...] = (
    ("staggered, ratio 0.4", 0.4, staggered.StaggeredCoupling),
    ("staggered, ratio 2", 2.0, staggered.StaggeredCoupling),
    ("iterated, ratio 0.4", 0.4, iterated.IteratedCoupling),
    ("iterated, ratio 2", 2.0, iterated.IteratedCoupling),
)
"""Name, mass of the strip over that of the carriage, scheme; above 0.5 the staggered one carries a mass."""

_STRIP_kg, _LEVELS, _PITCH_M, _HALF_WIDTH_M = 0.17, 8, 0.02, 0.01
_STILL = np.zeros((64, 1))
_URDF = """<robot name="slide"><link name="rail"/><link name="carriage"><inertial><mass value="{mass}"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="along" type="prismatic"><parent link="rail"/><child link="carriage"/><axis xyz="0 0 1"/>
<limit lower="-10" upper="10" effort="1000" velocity="100"/></joint></robot>"""


def strip() -> SoftBody:
    """Return a strip of soft film that hangs along -z from its first node."""
    rows = [
        (side, 0.0, -k * _PITCH_M) for k in range(1, _LEVELS + 1) for side in (-_HALF_WIDTH_M, _HALF_WIDTH_M)
    ]
    pairs = [(1 + 2 * k, 2 + 2 * k) for k in range(_LEVELS)]
    triangles = [(0, 1, 2)]
    for (a, b), (c, d) in pairwise(pairs):
        triangles += [(a, c, b), (b, c, d)]
    return SoftBody.from_arrays(
        np.array([(0.0, 0.0, 0.0), *rows]), np.array(triangles), material.Film(1e7, 0.0, 1e-4),
        node_mass=_STRIP_kg / (1 + len(rows)), base=np.array([0]), tip=np.array(pairs[-1]),
    )  # fmt: skip


def exact_rise(ratio: float) -> float:
    """Return how far [m] carriage and strip have risen after SPAN_S, as one system by an explicit method."""
    body = strip()
    system, n = assembly.SoftSystem(body), body.nodes
    mass = body.node_mass.copy()
    mass[0] += _STRIP_kg / ratio
    push = np.zeros(n)
    push[0] = PUSH_N

    def rates(_t: float, y: Array) -> Array:
        x = body.positions.copy()
        x[:, 2] += y[:n]
        system.evaluate(x, UNLOADED, np.zeros(0), system.memory.copy(), hessian=False)
        return np.concatenate([y[n:], (push - system.gradient[:, 2]) / mass])

    found = solve_ivp(rates, (0.0, TICK_SPAN_S), np.zeros(2 * n), method="DOP853", rtol=1e-11, atol=1e-13)
    return float(found.y[0, -1])


def ticked_rise(ratio: float, scheme: Callable[[Interface], Coupling], ticks: int) -> float:
    """Return the same after ticks of both sides: MuJoCo moves the carriage, the soft side the strip."""
    body = strip()
    urdf = _URDF.format(mass=_STRIP_kg / ratio)
    slide = ArmFile("slide", Path("slide.urdf"), urdf, "carriage", ("along",), np.zeros(1))
    scene = RigidScene(
        SceneDescription(
            slide, tick_s=TICK_SPAN_S / ticks, gravity=(0.0, 0.0, 0.0), floor_height_m=None, armature=0.0,
            gains=ServoGains(np.zeros(1), np.zeros(1)),
        )
    )  # fmt: skip
    pose = scene.flange_pose
    soft = SoftArm(body, pose, NewtonOptions(tolerance_N=1e-9), exact_steps("implicit_euler", 1e-10))
    soft.hold_also(np.tile([True, True, False], (body.nodes, 1)), pose)
    found = soft.solve(soft.state, pose, UNLOADED)
    soft.settle(found)
    coupling = scheme(Interface(scene, soft, found.wrench))
    servos, done = Servos.knowing_no_payload(_STILL, _STILL, _STILL + PUSH_N), 0
    while done < ticks:
        done += coupling.advance(servos, [UNLOADED] * min(len(_STILL), ticks - done)).done
    return float(scene.joint_position[0])


@case(
    "coupled_tick",
    "Order of convergence in time of the coupled tick",
    "one system of rigid and soft masses, reference solution by SciPy's DOP853",
)
def coupled_tick() -> tuple[Figure, ...]:
    """A push on the carriage sets strip and carriage in motion; how far the carriage gets, of every exchange.

    Both sides take first-order steps, and an exchange that is one tick late is of first order too: the order
    is 1. The strip's waves are resolved, and cross it a few times. A mass that is carried may cost a tick's
    impulse where the acceleration jumps, at the start: of first order as well. The finer ticks leave 0.4 %
    of the rise at most.
    """
    figures = []
    for name, ratio, scheme in EXCHANGES:
        exact = exact_rise(ratio)
        rises = [ticked_rise(ratio, scheme, ticks) for ticks in TICKS]
        order = observed_order(*(rise - exact for rise in rises))
        figures += [
            Figure(f"rise, {name}", "m", rises[-1], exact, 5e-3, observed_order=order),
            Figure(f"order, {name}", "1", order, 1.0, 0.15, absolute=True),
        ]
    return tuple(figures)


FLIGHT_SPAN_S = 0.2
FLIGHT_STEPS = (800, 1600)
_FLIGHT_LOADS = Loads(pressure_Pa=(50.0,), cable_tension_N=(0.05,), gravity=(0.0, 0.0, 0.0))


def octahedron() -> SoftBody:
    """Return a closed octahedron of soft film with hinges, gas, a cable through it and unequal masses."""
    positions = 0.05 * np.array(
        [[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.3], [0, 0, -1.0]]
    )
    triangles = np.array(
        [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]]
    )
    return SoftBody.from_arrays(
        positions, triangles, material.Film(1e5, 0.3, 2e-4), hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=1e-4, cables=(cable.Cable(np.array([0, 2, 4])),),
        node_mass=1e-3 * np.array([1.0, 2.0, 1.5, 1.0, 3.0, 2.0]),
    )  # fmt: skip


def motion(body: SoftBody, state: SoftState, system: assembly.SoftSystem) -> tuple[Array, Array, float]:
    """Return momentum (3,) [kg m/s], moment of momentum about the origin (3,) [kg m^2/s], energy [J]."""
    mass, x, v = body.node_mass[:, None], state.positions, state.velocities
    tension = system.segment_share(x, _FLIGHT_LOADS)
    potential = system.evaluate(x, _FLIGHT_LOADS, tension, state.memory, hessian=False)
    return (mass * v).sum(0), np.cross(x, mass * v).sum(0), potential + 0.5 * float((mass * v * v).sum())


def drifts(steps: int) -> tuple[float, float, float]:
    """Return the relative drift of momentum, moment of momentum and energy over the flight.

    Energy is compared with the kinetic energy at the start.
    """
    body = octahedron()
    system, probe = assembly.SoftSystem(body), assembly.SoftSystem(body)
    solver = newton.NewtonSolver(system, NO_CLAMP.mask(body.nodes))
    stepper = ImplicitStepper(solver, NO_CLAMP, exact_steps("bdf2", 1e-11))
    state = SoftState.drawn(body, Pose())
    spin, flight = np.array([20.0, 5.0, 30.0]), np.array([0.5, -0.2, 0.3])
    state = SoftState(state.positions, np.cross(spin, state.positions) + flight, state.memory)
    begin = motion(body, state, probe)
    kinetic = 0.5 * float((body.node_mass[:, None] * state.velocities**2).sum())
    for _ in range(steps):
        state, _ = stepper.step(state, Pose(), _FLIGHT_LOADS, FLIGHT_SPAN_S / steps)
    end = motion(body, state, probe)
    linear, angular = (float(np.linalg.norm(end[k] - begin[k]) / np.linalg.norm(begin[k])) for k in (0, 1))
    return linear, angular, abs(end[2] - begin[2]) / kinetic


@case(
    "free_flight",
    "Momentum and energy of a free, tumbling body (BDF2)",
    "Newton's laws: no outer force, conservative inner ones",
)
def free_flight() -> tuple[Figure, ...]:
    """Momentum is kept to the solver's tolerance, moment of momentum and energy to the order of BDF2."""
    coarse, fine = drifts(FLIGHT_STEPS[0]), drifts(FLIGHT_STEPS[1])
    angular, energy = (observed_order(coarse[k], fine[k]) for k in (1, 2))
    return (
        Figure("drift of momentum", "1", fine[0], 0.0, 1e-7, absolute=True),
        Figure(
            "drift of the moment of momentum", "1", fine[1], 0.0, 1e-3, absolute=True, observed_order=angular
        ),
        Figure("drift of energy", "1", fine[2], 0.0, 5e-3, absolute=True, observed_order=energy),
    )
