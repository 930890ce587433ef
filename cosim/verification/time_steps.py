"""Known answers: orders of convergence in time, momentum and energy of free flight.

Order of convergence in time of every integrator.

Order of convergence in time of the coupled tick: a rigid carriage and the soft strip it carries.

A soft body that tumbles and pulsates freely: momentum and energy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
from scipy.integrate import solve_ivp

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Array, Mask, Pose
from cosim.coupling.schemes.interface import Coupling, Interface
from cosim.coupling.schemes.iterated import IteratedCoupling
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.ticks import Servos
from cosim.rigid.build.description import SceneDescription, ServoGains
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Integrator, SoftState
from cosim.soft.solve.time_step import ImplicitStepper
from cosim.verification.case import NO_CLAMP, UNLOADED, Figure, case, exact_steps, observed_order, panel

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
        positions, triangles, Film(1e5, 0.3, 2e-4), hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=1e-4, node_mass=1e-3,
    )  # fmt: skip
    return body, np.abs(positions[:, 0]) < 1e-9


def exact_end(body: SoftBody, clamped: Mask) -> Array:
    """Return positions (n, 3) [m] at SPAN_S by an explicit Runge-Kutta method of order 8."""
    system = SoftSystem(body)
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
    stepper = ImplicitStepper(NewtonSolver(SoftSystem(body), clamped), NO_CLAMP, options)
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
    ("staggered, ratio 0.4", 0.4, StaggeredCoupling),
    ("staggered, ratio 2", 2.0, StaggeredCoupling),
    ("iterated, ratio 0.4", 0.4, IteratedCoupling),
    ("iterated, ratio 2", 2.0, IteratedCoupling),
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
        np.array([(0.0, 0.0, 0.0), *rows]), np.array(triangles), Film(1e7, 0.0, 1e-4),
        node_mass=_STRIP_kg / (1 + len(rows)), base=np.array([0]), tip=np.array(pairs[-1]),
    )  # fmt: skip


def exact_rise(ratio: float) -> float:
    """Return how far [m] carriage and strip have risen after SPAN_S, as one system by an explicit method."""
    body = strip()
    system, n = SoftSystem(body), body.nodes
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
        positions, triangles, Film(1e5, 0.3, 2e-4), hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=1e-4, cables=(Cable(np.array([0, 2, 4])),),
        node_mass=1e-3 * np.array([1.0, 2.0, 1.5, 1.0, 3.0, 2.0]),
    )  # fmt: skip


def motion(body: SoftBody, state: SoftState, system: SoftSystem) -> tuple[Array, Array, float]:
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
    system, probe = SoftSystem(body), SoftSystem(body)
    solver = NewtonSolver(system, NO_CLAMP.mask(body.nodes))
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
