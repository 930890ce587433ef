"""Implicit time steps: order, free flight, damping, rest, and what happens when a step fails."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.errors import ConvergenceError, InputError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.branching import MODES
from cosim.soft.solve.clamp import Clamp, fill_flange_velocity, flange_axes
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.stability import assess_stability
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_prediction import fill_inertia_target
from cosim.soft.solve.step_scheme import Integrator, StepOptions, mode_decay
from cosim.soft.solve.time_step import Stepper
from tests.derivatives import differences
from tests.soft.bodies import HANGING, Held, PRESSURE_Pa, held, hexagon_arm, hung, no_load

INTEGRATORS: tuple[Integrator, ...] = ("implicit_euler", "bdf2")
X = np.array([1.0, 0.0, 0.0])
TIGHT = NewtonOptions(tolerance_N=1e-10, start_tolerance_N=1e-12)


def stepper(arm: Held, integrator: Integrator = "implicit_euler", **changes: Any) -> Stepper:
    """Return a stepper that solves every step nearly to rounding, unless told otherwise."""
    given = {"tolerance_N": 1e-8, "iterations": 50, "residual_bound_N": 0.0, "newton": TIGHT, **changes}
    return Stepper(arm.newton, arm.clamp, StepOptions(integrator, **given))


def afloat(units: int = 1) -> Held:
    """Return a chamber that nothing holds."""
    return held(hexagon_arm(units, base=()))


def flying(arm: Held, velocity: Array) -> SoftState:
    """Return the drawn shape, all nodes at one velocity (3,) [m/s]."""
    drawn = arm.body.positions
    return SoftState(drawn.copy(), np.tile(velocity, (len(drawn), 1)), arm.film.memory.copy())


def shifted(time_s: float) -> Pose:
    """Return the flange on its way: 20 mm along x within 0.1 s, minimum jerk, then at rest."""
    u = min(time_s / 0.1, 1.0)
    way = 0.02 * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    return Pose(HANGING.rotation, HANGING.translation + way * X)


def swung(arm: Held, start: SoftState, integrator: Integrator, steps: int) -> Array:
    """Return the positions after 0.12 s of the flange's motion."""
    step_s, state, move = 0.12 / steps, start, stepper(arm, integrator)
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    for k in range(1, steps + 1):
        state, _ = move.step(state, shifted(k * step_s), loads, step_s)
    return state.positions


def test_order_of_convergence() -> None:
    arm = held(hexagon_arm(2))
    start = hung(arm, pressure_Pa=(PRESSURE_Pa,)).state
    exact = swung(arm, start, "bdf2", 1920)
    orders = {}
    for integrator, coarse in (("implicit_euler", 480), ("bdf2", 240)):
        errors = [np.abs(swung(arm, start, integrator, n) - exact).max() for n in (coarse, 2 * coarse)]
        orders[integrator] = np.log2(errors[0] / errors[1])
    assert orders["implicit_euler"] == pytest.approx(1.0, abs=0.15)
    assert orders["bdf2"] == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_free_fall(integrator: Integrator) -> None:
    arm, h, steps = afloat(), 0.002, 50
    gravity = np.array([1.0, -2.0, -9.81])
    state = SoftState(
        arm.body.positions.copy(), np.full_like(arm.body.positions, 0.3), arm.film.memory.copy()
    )
    move = stepper(arm, integrator)
    for k in range(1, steps + 1):
        state, _ = move.step(state, Pose(), Loads((), (), tuple(gravity.tolist())), h)
        if integrator == "implicit_euler":  # v_n = v_0 + n h g, x_n = x_0 + n h v_0 + n (n + 1) h^2 g / 2
            fall = 0.3 * k * h + 0.5 * k * (k + 1) * h * h * gravity
            assert state.positions - arm.body.positions == pytest.approx(np.tile(fall, (48, 1)), abs=1e-10)
    # both are exact for a velocity that grows evenly
    assert state.velocities == pytest.approx(np.tile(0.3 + steps * h * gravity, (48, 1)), abs=1e-8)
    if integrator == "bdf2":  # exact after its first step, whose error h^2 g / 2 carries on as a shift of h v
        fall = 0.3 * steps * h + 0.5 * gravity * (steps * h) ** 2
        moved = state.positions - arm.body.positions
        assert moved == pytest.approx(np.tile(fall, (48, 1)), abs=h * h * 9.81)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_even_acceleration_needs_no_iteration(integrator: Integrator) -> None:
    arm, loads = afloat(), Loads((), (), (1.0, -2.0, -9.81))
    state = flying(arm, np.full(3, 0.3))
    move = stepper(arm, integrator, newton=NewtonOptions(tolerance_N=1e-10, start_tolerance_N=1e-7))
    # what BDF2's first step is off fades by three in every step
    spent = []
    for _ in range(25):
        state, result = move.step(state, Pose(), loads, 0.002)
        spent.append(result.iterations)
    assert spent[0] > 0
    assert spent[-1] == 0


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_momentum_of_a_floating_chamber_stays(integrator: Integrator) -> None:
    # gas and cables pull only inwards: pressure and tension put on at once move no centre of mass
    arm = afloat(2)
    state = flying(arm, np.zeros(3))
    loads = Loads((PRESSURE_Pa,), (3.0, 5.0), (0.0, 0.0, 0.0))
    move, mass = stepper(arm, integrator), arm.body.node_mass
    speed = 0.0
    for _ in range(20):
        state, _ = move.step(state, Pose(), loads, 0.001)
        speed = max(speed, np.abs(state.velocities).max())
        momentum = mass @ state.velocities
        # each step leaves residuals below 1e-8 N on 90 nodes
        assert np.abs(momentum).max() < 20 * 0.001 * 90 * 1e-8
    assert speed > 0.1


@pytest.mark.parametrize(("integrator", "alpha"), [("implicit_euler", 30.0), ("bdf2", 30.0)])
def test_damping_slows_free_flight_by_its_formula(integrator: Integrator, alpha: float) -> None:
    arm, h = afloat(), 0.004
    state = SoftState(arm.body.positions.copy(), np.tile([1.0, 0.0, -0.5], (48, 1)), arm.film.memory.copy())
    move = stepper(arm, integrator, damping_per_s=alpha)
    speeds = [1.0]
    for _ in range(10):
        state, _ = move.step(state, Pose(), Loads((), (), (0.0, 0.0, 0.0)), h)
        speeds.append(float(state.velocities[7, 0]))
        assert state.velocities[7, 2] == pytest.approx(-0.5 * speeds[-1], abs=1e-8)
    expected = [1.0, 1.0 / (1.0 + alpha * h)]
    for _ in range(9):
        s = 2.0 * h / 3.0
        before = (4.0 * expected[-1] - expected[-2]) / 3.0
        expected.append(
            before / (1.0 + alpha * s) if integrator == "bdf2" else expected[-1] / (1.0 + alpha * h)
        )
    assert speeds == pytest.approx(expected, abs=1e-7)


def test_damping_acts_on_the_whole_against_outer_loads() -> None:
    # free fall with drag alpha m v: v_n+1 = (v_n + h g) / (1 + alpha h), towards g / alpha
    arm, h, alpha, speed = afloat(), 0.004, 30.0, 0.0
    state, move = flying(arm, np.zeros(3)), stepper(arm, damping_per_s=alpha)
    for _ in range(100):
        state, _ = move.step(state, Pose(), Loads(), h)
        speed = (speed + h * 9.81) / (1.0 + alpha * h)
        assert state.velocities == pytest.approx(np.tile([0.0, 0.0, -speed], (48, 1)), abs=1e-7)
    assert speed == pytest.approx(9.81 / alpha, rel=1e-4)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_motion_dies_out_in_the_static_equilibrium(integrator: Integrator) -> None:
    arm = held(hexagon_arm(2))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    loads = no_load(arm.body, pressure_Pa=(0.8 * PRESSURE_Pa,), cable_tension_N=(1.0, 0.0))
    rest = arm.equilibrium.follow(begin, HANGING, loads)
    move, state = stepper(arm, integrator, damping_per_s=40.0), begin.state
    for _ in range(200):
        state, _ = move.step(state, HANGING, loads, 0.005)
    assert np.abs(begin.state.positions - rest.state.positions).max() > 1e-3
    assert state.positions == pytest.approx(rest.state.positions, abs=1e-7)
    assert np.abs(state.velocities).max() < 1e-6
    # the flange feels the static wrench
    wrench = arm.clamp.wrench(arm.film.gradient, state.positions, HANGING)
    assert wrench.force == pytest.approx(rest.wrench.force, abs=1e-5)
    assert wrench.torque == pytest.approx(rest.wrench.torque, abs=1e-6)


def test_the_flange_feels_the_inertia_it_accelerates() -> None:
    # one step of a rigid shift: the wrench is what the momentum gained, and weight, ask for
    arm, h = held(hexagon_arm(2)), 0.002
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    pose = Pose(HANGING.rotation, HANGING.translation + 0.001 * X)
    state, _ = stepper(arm).step(begin.state, pose, begin.loads, h)
    gained = arm.body.node_mass @ state.velocities / h
    wrench = arm.clamp.wrench(arm.film.gradient, state.positions, pose)
    weight = np.array([0.0, 0.0, -9.81 * arm.body.mass_kg])
    assert wrench.force == pytest.approx(weight - gained, abs=1e-7)
    turning = np.cross(
        state.positions - pose.translation, arm.body.node_mass[:, None] * state.velocities
    ).sum(0)
    lever = arm.body.node_mass @ (state.positions - pose.translation)
    assert wrench.torque == pytest.approx(np.cross(lever, [0.0, 0.0, -9.81]) - turning / h, abs=1e-7)


def turning(time_s: float) -> Pose:
    """Return a flange that turns at 3 rad/s about an axis beside it, and moves along that at 0.25 m/s."""
    turn = Pose(rotation_from_vector(np.array([0.0, 0.0, 3.0 * time_s])), np.array([0.0, 0.0, 0.25 * time_s]))
    return turn @ Pose(HANGING.rotation, HANGING.translation + 0.3 * X)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_damping_leaves_rigid_motion_alone(integrator: Integrator) -> None:
    # a flange that turns and moves evenly: nodes that go along with it feel no damping at all
    arm, h = held(hexagon_arm(2)), 0.002
    move = stepper(arm, integrator, damping_per_s=10.0)
    carried = [np.ascontiguousarray(turning(k * h).apply(arm.body.positions)) for k in range(3)]
    first = SoftState(carried[0], np.zeros_like(carried[0]), arm.body.first_memory())
    coefficients = move.scheme_of(first, h).coefficients
    state = replace(first, positions=carried[1], earlier=(carried[0], first.velocities))
    if integrator == "bdf2":
        coefficients = move.scheme_of(state, h).coefficients
    base, along = np.empty_like(carried[0]), np.empty_like(carried[0])
    x, v = state.positions, state.velocities
    earlier_x, earlier_v = state.earlier or (x, v)
    fill_flange_velocity(arm.clamp.held, flange_axes(turning(2.0 * h)), x, earlier_x, coefficients, along)
    fill_inertia_target(x, v, earlier_x, earlier_v, along, coefficients, base, np.empty_like(base))
    due = (carried[2] - base) / coefficients.span
    assert along == pytest.approx(due, abs=1e-11)
    assert np.abs(due).max() > 0.5


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_steady_motion_feels_weight_alone(integrator: Integrator) -> None:
    arm, h, speed = held(hexagon_arm(2)), 0.002, 0.25
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    move = stepper(arm, integrator, damping_per_s=10.0)
    state = replace(begin.state, velocities=np.tile(speed * X, (arm.body.nodes, 1)))
    for k in range(1, 51):
        flange = Pose(HANGING.rotation, HANGING.translation + speed * k * h * X)
        state, _ = move.step(state, flange, begin.loads, h)
    wrench = move.wrench(state, flange)
    assert wrench.force == pytest.approx(begin.wrench.force, abs=1e-6)
    # in the world damping would lean the tip by some millimetres
    still = begin.state.positions + (flange.translation - HANGING.translation)
    assert state.positions == pytest.approx(still, abs=1e-8)


def test_damping_is_an_inner_loss_and_drag_an_outer_one() -> None:
    # momentum's balance: the flange feels what weight and inertia leave, and drag
    arm, h, drag = held(hexagon_arm(2)), 0.002, 3.0
    begin, mass = hung(arm, pressure_Pa=(PRESSURE_Pa,)), arm.body.node_mass
    move = stepper(arm, damping_per_s=20.0, air_drag_per_s=drag)
    turned = HANGING @ Pose(rotation_from_vector(np.array([0.01, 0.02, 0.0])), np.zeros(3))
    pose = Pose(turned.rotation, HANGING.translation + 0.001 * X)
    state, _ = move.step(begin.state, pose, begin.loads, h)
    load = mass[:, None] * (np.array([0.0, 0.0, -9.81]) - (1.0 / h + drag) * state.velocities)
    wrench = move.wrench(state, pose)
    assert wrench.force == pytest.approx(load.sum(axis=0), abs=1e-7)
    lever = state.positions - pose.translation
    assert wrench.torque == pytest.approx(np.cross(lever, load).sum(axis=0), abs=1e-7)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_modes_ring_and_decay_as_their_complex_eigenvalues_say(integrator: Integrator) -> None:
    arm, h, damping, drag = held(hexagon_arm(2)), 0.001, 20.0, 10.0
    begin, mass = hung(arm, pressure_Pa=(PRESSURE_Pa,)), np.repeat(arm.body.node_mass, 3)
    x, free = begin.state.positions, arm.newton.free
    share = arm.film.losses_at(x, begin.loads)

    def gradient(at: Array) -> Array:
        arm.film.evaluate(at, begin.loads, share, begin.state.memory, hessian=False)
        return arm.film.gradient[free]

    tangent, root = differences(gradient, x, 1e-7)[free.ravel()], np.sqrt(mass[free.ravel()])
    squares, vectors = np.linalg.eigh(0.5 * (tangent + tangent.T) / np.outer(root, root))
    exact = np.sqrt(squares[:MODES]) / (2.0 * np.pi)
    tested = NewtonSolver(arm.film, arm.newton.clamped, symmetric=True)
    found = assess_stability(tested, begin.state, begin.loads, HANGING.rotation).frequencies_Hz
    assert found == pytest.approx(exact, rel=1e-3)
    for frequency, vector in zip(exact, vectors.T, strict=False):
        mode = np.zeros(x.shape)
        mode[free] = vector / root
        move = stepper(arm, integrator, damping_per_s=damping, air_drag_per_s=drag)
        state, ringing = replace(begin.state, positions=x + 1e-6 * mode / np.abs(mode).max()), []
        for _ in range(80):
            state, _ = move.step(state, HANGING, begin.loads, h)
            ringing.append(float(mass @ (mode * (state.positions - x)).ravel()))
        q = np.array(ringing[10:])  # by then what a two-step scheme begins with is gone
        (a, b), *_ = np.linalg.lstsq(np.column_stack([q[1:-1], q[:-2]]), q[2:], rcond=None)
        declared, numerical = mode_decay(integrator, h, damping + drag, float(frequency))
        assert declared == 0.5 * (damping + drag)
        assert -0.5 * np.log(-b) / h == pytest.approx(declared + numerical, rel=0.02)
        circular = np.arccos(0.5 * a / np.sqrt(-b)) / h
        # steps of either scheme lag behind by (w h)^2 / 3, those of implicit Euler by c h / 2 as well
        due = np.sqrt((2.0 * np.pi * frequency) ** 2 - declared**2)
        assert circular == pytest.approx(due, rel=0.02 + (due * h) ** 2)


def test_a_step_that_is_left_far_from_balance_goes_on() -> None:
    arm = held(hexagon_arm(2))
    begin = hung(arm)
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    newton = NewtonOptions()
    free = {"residual_bound_N": 1e9, "left_m_s2": np.inf}
    loose = stepper(arm, iterations=1, newton=newton, **free)
    _, first = loose.step(begin.state, HANGING, loads, 0.002)
    assert first.iterations == 1
    bound = 0.01 * first.residual_N
    _, result = stepper(arm, iterations=1, residual_bound_N=bound, newton=newton).step(
        begin.state, HANGING, loads, 0.002
    )
    assert result.iterations > 1
    assert result.residual_N < 1e-8
    left = 0.1 * first.residual_N / float(arm.body.node_mass.min())
    _, light = stepper(arm, iterations=1, newton=newton, **free | {"left_m_s2": left}).step(
        begin.state, HANGING, loads, 0.002
    )
    assert light.residual_N < 0.1 * first.residual_N, "the lightest node would be thrown"


def test_a_failed_step_names_itself_and_leaves_the_state() -> None:
    arm = held(hexagon_arm(2))
    begin = hung(arm)
    before = begin.state.positions.copy()
    hopeless = stepper(arm, iterations=1, newton=NewtonOptions(iterations_max=1))
    with pytest.raises(ConvergenceError, match="iteration limit") as caught:
        hopeless.step(begin.state, HANGING, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,)), 0.02)
    assert caught.value.residual_N > 0.0
    assert caught.value.iterations >= 1
    assert (begin.state.positions == before).all()


@pytest.mark.parametrize("step_s", [0.0, -0.001, float("nan")])
def test_steps_must_be_positive(step_s: float) -> None:
    arm = held(hexagon_arm(1))
    with pytest.raises(InputError, match="must be positive"):
        stepper(arm).step(SoftState.drawn(arm.body, HANGING), HANGING, no_load(arm.body), step_s)


def test_free_flight_that_would_cross_films_begins_where_it_is() -> None:
    # the films of two units fly at each other, further in a step than the gap between them
    arm = held(hexagon_arm(2))
    begin = hung(arm)
    speed = np.zeros_like(begin.state.positions)
    speed[arm.body.rings["unit_1.upper"]] = (0.0, 0.0, -2.0)
    speed[arm.body.rings["unit_2.lower"]] = (0.0, 0.0, 2.0)
    state = SoftState(begin.state.positions, speed, begin.state.memory)
    after, result = stepper(arm, newton=NewtonOptions()).step(state, HANGING, begin.loads, 0.002)
    assert result.converged
    assert after.memory.min() > 0.0
    assert after.memory.max() < 2.0 * np.pi


def test_clamp_places_and_weighs_its_nodes() -> None:
    body = hexagon_arm(1)
    clamp = Clamp.of_base(body)
    pose = Pose(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 2.0, 3.0]))
    placed = clamp.place(np.zeros_like(body.positions), pose)
    x, y, z = body.positions[body.base].T
    assert placed[body.base] == pytest.approx(np.stack([1.0 - y, 2.0 + x, 3.0 + z], axis=1))
    assert not placed[~clamp.mask(body.nodes)].any()
    gradient = np.zeros_like(placed)
    gradient[body.base[0]] = (0.0, 0.0, 5.0)  # the flange holds this node up with 5 N
    gradient[-1] = 100.0  # a free node's imbalance is not the flange's
    wrench = clamp.wrench(gradient, placed, pose)
    arm = placed[body.base[0]] - pose.translation
    assert wrench.force == pytest.approx([0.0, 0.0, -5.0])
    assert wrench.torque == pytest.approx([-5.0 * arm[1], 5.0 * arm[0], 0.0])


def test_extended_clamp_holds_further_nodes_where_they_are() -> None:
    body = hexagon_arm(1)
    clamp, rim = Clamp.of_base(body), body.rings["unit_1.outer"]
    positions = HANGING.apply(body.positions) + 0.01 * X
    wider = clamp.extended(np.concatenate([rim, body.base]), positions, HANGING)
    assert sorted(wider.nodes.tolist()) == sorted([*body.base.tolist(), *rim.tolist()])
    turned = Pose(np.eye(3), np.zeros(3))
    placed = wider.place(np.zeros_like(positions), turned)
    assert placed[body.base] == pytest.approx(body.positions[body.base])
    assert placed[rim] == pytest.approx(HANGING.inverse().apply(positions[rim]))


@pytest.mark.parametrize("angle", [0.3, 0.6, 1.0])
def test_a_spinning_body_starts_where_the_flange_carries_it(angle: float) -> None:
    # free flight along tangents stretches the film; the state before the step is a chord away
    arm, h = held(hexagon_arm(2)), 0.01
    start, turn = hung(arm, pressure_Pa=(PRESSURE_Pa,)).state, np.array([0.0, angle, 0.0])
    spin = np.cross(turn / h, start.positions - HANGING.translation)
    turned = Pose(rotation_from_vector(turn) @ HANGING.rotation, HANGING.translation)
    state, loads = (
        SoftState(start.positions, spin, start.memory),
        no_load(arm.body, pressure_Pa=(PRESSURE_Pa,)),
    )
    carried, blind = (
        stepper(arm).step(state, turned, loads, h, before)[1].iterations for before in (HANGING, None)
    )
    assert carried < blind
