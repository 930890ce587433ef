"""Cables commanded by length: onset, derivatives, tension, statics and dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable, TRANSITION_m, base_tension, onset, stretch_at
from cosim.soft.elements.eyelets import BASE_FRACTION
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import dihedral_angle
from cosim.soft.solve.sensitivity import Sensitivity
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.derivatives import RELATIVE, Evaluate, dense, derivative_errors
from tests.soft.bodies import HANGING, held, hexagon_arm, hung, shapes

UNITS = 3  # two segments a cable: losses differ along it
STIFFNESS = 2e3
SHORTER_m = 4e-3


def arm(**cable: float) -> SoftBody:
    body = hexagon_arm(UNITS)
    given = {"stiffness_N_m": STIFFNESS, **cable}
    return body.with_other(Cable, *(replace(entry, **given) for entry in body.cables))


def bare_cable(points: Array, **cable: float) -> SoftBody:
    """Return a cable through points; the film of one triangle lies beside it."""
    nodes = np.concatenate([points, np.eye(3)])
    triangle = np.array([[0, 1, 2]]) + len(points)
    route = Cable(np.arange(len(points)), **cable)
    return SoftBody.from_arrays(nodes, triangle, Film(1.0, 0.3, 1e-3), cables=(route,))


def evaluation(body: SoftBody, x: Array, loads: Loads) -> Evaluate:
    """Return the evaluation with losses frozen at x, dense terms included."""
    system = FilmPotential(body)
    given, angles = system.losses_at(x, loads), dihedral_angle(x, body.hinges.nodes)

    def evaluate(y: Array) -> tuple[float, Array, Array]:
        energy = system.evaluate(np.ascontiguousarray(y), loads, given, angles)
        hessian = dense(system.pattern, system.blocks)
        if system.tangent.low_rank is not None:
            hessian += system.tangent.low_rank.matrix()
        return energy, system.gradient.copy(), hessian

    return evaluate


def test_onset_is_twice_continuously_differentiable() -> None:
    d, h = TRANSITION_m, 1e-3 * TRANSITION_m
    for s in np.linspace(-0.7, 0.9, 17) * d:
        ahead, behind, here = onset(s + h), onset(s - h), onset(s)
        # differences of third order in h, and of second order where the third derivative jumps
        assert (ahead[0] - behind[0]) / (2.0 * h) == pytest.approx(here[1], abs=1e-3 * d)
        assert (ahead[1] - behind[1]) / (2.0 * h) == pytest.approx(here[2], abs=1e-3)
    assert onset(-0.5 * d) == (0.0, 0.0, 0.0)
    assert onset(3.0 * d)[1:] == (3.0 * d, 1.0)


@pytest.mark.parametrize("tension", [0.0, 1e-3, 0.02, 0.1, 7.0])
def test_stretch_is_the_inverse_of_the_onset(tension: float) -> None:
    assert STIFFNESS * onset(stretch_at(tension, STIFFNESS))[1] == pytest.approx(tension, abs=1e-12)


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("stretch", [2e-3, 0.2 * TRANSITION_m])
@pytest.mark.parametrize("stiffening", [1.0, 2.0])
def test_derivatives_with_a_cable_of_commanded_length(
    stretch: float, friction: float, stiffening: float
) -> None:
    points = 0.03 * np.random.default_rng(0).normal(size=(5, 3)) + (0.3, 0.0, 0.7)
    body = bare_cable(points, loss_factor=0.8, friction_coefficient=friction, stiffness_N_m=STIFFNESS)
    x, length = body.positions, body.cables[0].length(body.positions) - stretch
    q = (stiffening,)
    loads = Loads((), (0.0,), (0.0, 0.0, 0.0), cable_length_m=(length,), cable_stiffening=q)
    # within the transition the stiffness changes over micrometres
    step = 1e-6 if stretch > TRANSITION_m else 1e-7
    assert max(derivative_errors(evaluation(body, x, loads), x, step)) < RELATIVE


def test_a_straight_cable_is_a_linear_spring() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.04, 0.0], [0.06, 0.08, 0.0]])
    body = bare_cable(points, stiffness_N_m=500.0)
    loads = Loads((), (0.0,), (0.0, 0.0, 0.0), cable_length_m=(0.09,))
    energy, gradient, hessian = evaluation(body, body.positions, loads)(body.positions)
    assert np.linalg.norm(gradient[2]) == pytest.approx(500.0 * 0.01, rel=1e-12)
    assert gradient[1] == pytest.approx(np.zeros(3), abs=1e-12)
    assert energy == pytest.approx(0.5 * 500.0 * 0.01**2 + 500.0 * TRANSITION_m**2 / 24.0, rel=1e-9)
    along = np.zeros(18)
    along[6:9] = [0.6, 0.8, 0.0]
    assert along @ hessian @ along == pytest.approx(500.0, rel=1e-9)


def test_losses_divide_the_tension_and_leave_the_length_alone() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.2, 0.0]])
    body = bare_cable(points, loss_factor=0.8, stiffness_N_m=500.0)
    loads = Loads((), (0.0,), (0.0, 0.0, 0.0), cable_length_m=(0.29,))
    _, gradient, _ = evaluation(body, body.positions, loads)(body.positions)
    base = 500.0 * 0.01  # k (L - L_0) with the length of the route itself, 0.3 m
    assert -gradient[0] == pytest.approx([0.8 * base, 0.0, 0.0], rel=1e-12)
    assert -gradient[2] == pytest.approx([0.0, -0.64 * base, 0.0], rel=1e-12)


def test_a_slack_cable_of_commanded_length_does_nothing() -> None:
    x, body = shapes(UNITS)["inflated"], arm()
    lengths = tuple(cable.length(x) + TRANSITION_m for cable in body.cables)
    slack = Loads((30e3,), (0.0, 0.0), cable_length_m=lengths)
    without = Loads((30e3,), (0.0, 0.0))
    found, expected = evaluation(body, x, slack)(x), evaluation(body, x, without)(x)
    assert found[0] == expected[0]
    assert (found[1] == expected[1]).all()


def test_statics_agree_with_the_tension_that_they_find() -> None:
    # in Newton's method length and tension have nothing in common but the gradient at the end
    specimen = held(arm())
    begin = hung(specimen, pressure_Pa=(30e3,))
    x = begin.state.positions
    lengths = tuple(cable.length(x) - SHORTER_m for cable in specimen.body.cables)
    commanded = replace(begin.loads, cable_length_m=lengths)
    found = specimen.equilibrium.follow(begin, HANGING, commanded)
    x = found.state.positions
    pairs = zip(specimen.body.cables, lengths, strict=True)
    tension = tuple(base_tension(cable, x, length) for cable, length in pairs)
    assert min(tension) > 0.5
    again = specimen.equilibrium.follow(begin, HANGING, replace(begin.loads, cable_tension_N=tension))
    assert again.state.positions == pytest.approx(x, abs=1e-8)
    with pytest.raises(InputError, match="command its tension first"):
        Sensitivity(specimen.newton, found).to_tension()


def test_dynamics_come_to_rest_where_statics_are() -> None:
    specimen = held(arm())
    begin = hung(specimen, pressure_Pa=(30e3,))
    lengths = tuple(cable.length(begin.state.positions) - SHORTER_m for cable in specimen.body.cables)
    loads = replace(begin.loads, cable_length_m=lengths)
    stepper = Stepper(specimen.newton, specimen.clamp, StepOptions(damping_per_s=60.0))
    state = begin.state
    for _ in range(400):
        state, _ = stepper.step(state, HANGING, loads, 0.005)
    expected = specimen.equilibrium.follow(begin, HANGING, loads)
    assert state.positions == pytest.approx(expected.state.positions, abs=2e-6)


def test_the_tension_in_a_step_is_that_of_the_length_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    # losses are frozen while a step is solved; left there, the tension is off by k x (change of L_w - L)
    frozen, true = list[Array](), FilmPotential.losses_at

    def recorded(system: FilmPotential, x: Array, loads: Loads, memory: Array) -> Array:
        frozen.append(true(system, x, loads, memory))
        return frozen[-1]

    monkeypatch.setattr(FilmPotential, "losses_at", recorded)
    specimen = held(arm(stiffness_N_m=1e5))
    state = hung(specimen, pressure_Pa=(30e3,)).state
    first = specimen.body.cables[0]
    loads = Loads((30e3,), (0.0, 0.0), cable_length_m=(first.length(state.positions) - SHORTER_m, None))
    stepper = Stepper(specimen.newton, specimen.clamp, StepOptions(integrator="bdf2"))
    for _ in range(5):
        state, _ = stepper.step(state, HANGING, loads, 0.02)
        tension = base_tension(first, state.positions, loads.cable_length_m[0] or 0.0)
        weight, lengths = (
            frozen[-1][: len(first.segments), BASE_FRACTION],
            first.segment_lengths(state.positions),
        )
        force = onset(float(weight @ lengths) - (loads.cable_length_m[0] or 0.0))[1]
        assert first.stiffness_N_m * force == pytest.approx(tension, abs=1e-3)
        assert tension > 0.5


def test_lengths_change_in_proportion_to_the_share() -> None:
    begin = Loads((), (0.0, 3.0), cable_length_m=(0.2, None))
    end = replace(begin, cable_length_m=(0.1, 0.4))
    # what becomes commanded by length is so at once
    assert begin.interpolated(end, 0.25).cable_length_m == pytest.approx((0.175, 0.4))
    assert replace(begin, cable_length_m=()).interpolated(end, 0.25).cable_length_m == (0.1, 0.4)


def test_wrong_lengths_are_refused() -> None:
    with pytest.raises(InputError, match="above 0"):
        Loads((), (0.0,), cable_length_m=(0.0,))
    with pytest.raises(InputError, match=r"stiffness 0\.0"):
        Cable(np.array([0, 1]), stiffness_N_m=0.0)
