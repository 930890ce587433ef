"""Losses at eyelets that oppose the way a cable slides: closed forms, derivatives, work, stick and slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable, base_tension
from cosim.soft.elements.eyelets import tensions
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.sensitivity import Sensitivity
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.derivatives import RELATIVE, dense, derivative_errors
from tests.soft.bodies import HANGING, held, hexagon_arm, hung, no_load

CORNERS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.2, 0.1, 0.05]])
NO_WEIGHT = (0.0, 0.0, 0.0)


def through(points: Array, **cable: float) -> SoftBody:
    """Return a cable with directed losses through points; the film of one triangle lies beside it."""
    nodes, triangle = np.concatenate([points, np.eye(3)]), np.array([[0, 1, 2]]) + len(points)
    route = Cable(np.arange(len(points)), directed=True, **cable)
    return SoftBody.from_arrays(nodes, triangle, Film(1.0, 0.3, 1e-3), cables=(route,))


class Route:
    """A cable whose eyelets are moved, with what they remember."""

    def __init__(self, points: Array, **cable: float) -> None:
        self.body = through(points, **cable)
        self.film, self.cable = FilmPotential(self.body), self.body.cables[0]
        self.x, self.memory = self.body.positions.copy(), self.body.first_memory()
        self.lost = 0.0

    def take(self, points: Array, loads: Loads) -> Array:
        """Accept a shape and return the tensions there."""
        x = self.x.copy()
        x[: len(points)] = points
        rows = self.film.losses_at(x, loads, self.memory)
        self.film.evaluate(x, loads, rows, self.memory, hessian=False)
        before, after = self.memory, self.film.memory.copy()
        self.lost = self.film.lost_at_eyelets(x, before, after)
        self.x, self.memory = x, after
        return self.tension(loads.cable_tension_N[0])

    def tension(self, pull_N: float) -> Array:
        own = self.body.memory_slices[self.body.elements.index(self.cable)]
        return tensions(pull_N, self.cable, self.x, self.memory[own])


def pulled(tension_N: float) -> Loads:
    return Loads((), (tension_N,), NO_WEIGHT)


def along(points: Array, share: float) -> Array:
    """Return the route made shorter by a share, with the same angles."""
    return points[0] + (1.0 - share) * (points - points[0])


@pytest.mark.parametrize("loss_N", [0.0, 0.3])
@pytest.mark.parametrize(("factor", "friction"), [(0.8, 0.0), (1.0, 0.2), (0.9, 0.1)])
def test_three_eyelets_lose_as_the_closed_form_says_in_both_directions(
    factor: float, friction: float, loss_N: float
) -> None:
    step = np.diff(CORNERS, axis=0) / np.linalg.norm(np.diff(CORNERS, axis=0), axis=1)[:, None]
    turn = np.concatenate([[0.0], np.arccos((step[1:] * step[:-1]).sum(axis=1))])
    each = factor * np.exp(-friction * turn)
    route = Route(CORNERS, loss_factor=factor, friction_coefficient=friction, loss_N=loss_N)
    to_base, to_tip = [10.0], [10.0]
    for f in each:
        to_base.append(f * to_base[-1] - loss_N)
        to_tip.append((to_tip[-1] + loss_N) / f)
    for share, expected in ((0.05, to_base), (0.1, to_base), (0.02, to_tip), (0.0, to_tip), (0.1, to_base)):
        found = route.take(along(CORNERS, share), pulled(10.0))
        assert found == pytest.approx(expected[1:], rel=1e-9)
        assert -route.film.gradient[3] == pytest.approx(-expected[3] * step[2], rel=1e-9, abs=1e-12)


def test_a_cable_without_losses_is_the_same_with_and_without_direction() -> None:
    route, one_way = Route(CORNERS), Route(CORNERS)
    one_way.body = replace(one_way.body)
    assert not route.cable.remembers
    assert len(route.memory) == len(SoftBody.from_arrays(
        one_way.body.positions, np.array([[4, 5, 6]]), Film(1.0, 0.3, 1e-3)
    ).first_memory())  # fmt: skip
    assert (route.take(along(CORNERS, 0.1), pulled(7.0)) == 7.0).all()


def test_between_the_limits_a_cable_sticks_with_its_own_stiffness() -> None:
    route = Route(CORNERS, loss_factor=0.8, stiffness_N_m=3e4)
    slipping = route.take(along(CORNERS, 0.1), pulled(10.0))
    # 10 um at the tip are less than 2 N over 3e4 N/m: nothing slides, and nothing is lost
    back = along(CORNERS, 0.1)
    back[3] += 1e-5 * (back[3] - back[2]) / np.linalg.norm(back[3] - back[2])
    held_back = route.take(back, pulled(10.0))
    assert route.lost == pytest.approx(0.0, abs=1e-12)
    # each eyelet gives by the same: the last segment has gained three times that
    assert held_back - slipping == pytest.approx(3e4 * 1e-5 * np.array([1.0, 2.0, 3.0]), rel=1e-6)


@pytest.mark.parametrize("length", [False, True])
def test_derivatives_where_some_eyelets_stick_and_some_slip(length: bool) -> None:
    route = Route(CORNERS, loss_factor=0.8, friction_coefficient=0.1, loss_N=0.2, stiffness_N_m=6e3)
    route.take(along(CORNERS, 0.1), pulled(10.0))
    x, back = route.x.copy(), along(CORNERS, 0.1)
    back[2, 1] += 1e-3  # the cable slides to the tip through the first eyelet, and sticks at the others
    x[:4] = back
    commanded = (route.cable.length(x) - 10.0 / 6e3,) if length else ()
    loads = Loads((), (10.0,), NO_WEIGHT, cable_length_m=commanded)
    system, rows = route.film, route.film.losses_at(x, loads, route.memory)

    def evaluate(y: Array) -> tuple[float, Array, Array]:
        energy = system.evaluate(np.ascontiguousarray(y), loads, rows, route.memory)
        hessian = dense(system.pattern, system.blocks)
        if system.tangent.low_rank is not None:
            hessian += system.tangent.low_rank.matrix()
        return energy, system.gradient.copy(), hessian

    evaluate(x)
    slid = np.abs(system.memory - route.memory)[system.eyelets.places]
    assert (slid > 1e-9).tolist() == [True, False, False]
    # steps that stay on the same side of every limit
    assert max(derivative_errors(evaluate, x, 2e-7)) < RELATIVE


def test_work_lost_is_never_negative_and_all_that_is_missing() -> None:
    """Work put in at base and eyelets = what is stored where cables stick + what is lost."""
    rng = np.random.default_rng(3)
    route = Route(CORNERS, loss_factor=0.85, friction_coefficient=0.1, loss_N=0.1)
    route.take(CORNERS, pulled(5.0))
    points, speed, tension = CORNERS.copy(), np.zeros_like(CORNERS), 5.0
    lost, least = 0.0, np.inf
    for _ in range(20_000):
        speed = 0.95 * speed + 2e-5 * rng.normal(size=points.shape)
        points = points + speed - 1e-3 * (points - CORNERS)
        tension = abs(tension + 0.2 * rng.normal() - 0.02 * (tension - 5.0))
        route.take(points, pulled(tension))
        lost, least = lost + route.lost, min(least, route.lost)
    assert least >= 0.0
    assert lost > 1.0


def bent(body: SoftBody, tensions_N: list[float]) -> tuple[Array, Array, float]:
    """Return tension, length of the first cable and work lost so far, step by step, in statics."""
    specimen = held(body)
    here = hung(specimen, pressure_Pa=(30e3,))
    rows, lost = [], 0.0
    for tension in tensions_N:
        before = here.state.memory
        here = specimen.equilibrium.follow(here, HANGING, replace(here.loads, cable_tension_N=(tension, 0.0)))
        state = here.state
        lost += specimen.film.lost_at_eyelets(state.positions, before, state.memory)
        rows.append((tension, body.cables[0].length(state.positions), lost))
    tension, length, total = np.array(rows).T
    return tension, length, total


def directed(units: int, **changes: float) -> SoftBody:
    body = hexagon_arm(units)
    return body.with_other(Cable, *(replace(cable, directed=True, **changes) for cable in body.cables))


def test_the_loop_of_a_pull_and_a_release_holds_the_work_lost() -> None:
    up = np.linspace(4.0, 12.0, 33)
    cycle = [*up[1:], *up[::-1][1:]]
    tension, length, lost = bent(directed(3), [4.0, *cycle, *cycle])
    first = len(cycle)
    # the second loop is closed: what goes in at the base end is what is lost
    assert length[first] == pytest.approx(length[-1], abs=2e-6)
    middle, step = 0.5 * (tension[first + 1 :] + tension[first:-1]), np.diff(length[first:])
    area = -float(middle @ step)
    assert area > 0.1 * 4.0 * (length.max() - length.min())
    assert lost[-1] - lost[first] == pytest.approx(area, rel=1e-2)
    assert (np.diff(lost) >= 0.0).all()


def test_a_cable_let_out_by_its_length_loses_on_the_way_back() -> None:
    body = directed(3, stiffness_N_m=2e4)
    specimen = held(body)
    here = hung(specimen, pressure_Pa=(30e3,))
    length = [cable.length(here.state.positions) for cable in body.cables]
    found = dict[float, tuple[float, float]]()
    for shorter in (2e-3, 4e-3, 6e-3, 3.9e-3, 2e-3):
        before, lengths = here.state.memory, tuple(each - shorter for each in length)
        here = specimen.equilibrium.follow(here, HANGING, replace(here.loads, cable_length_m=lengths))
        x = here.state.positions
        found[shorter] = (
            base_tension(body.cables[0], x, lengths[0]),
            specimen.film.lost_at_eyelets(x, before, here.state.memory),
        )
    assert min(lost for _, lost in found.values()) > 0.0
    # two eyelets at 0.8: what is felt at the base end is far less as the cable is let out
    assert found[3.9e-3][0] < 0.8 * found[4e-3][0]


def test_a_shape_alone_is_a_start_whose_cables_have_slid_to_the_base() -> None:
    body = directed(3)
    specimen, pull = held(body), no_load(body, pressure_Pa=(30e3,), cable_tension_N=(8.0, 0.0))
    here = specimen.equilibrium.follow(hung(specimen, pressure_Pa=(30e3,)), HANGING, pull)
    arm = FilmRobot(body, HANGING, NewtonOptions(), StepOptions())
    shape = here.state.positions
    again = arm.find_rest(arm.state_at_rest(shape, HANGING), HANGING, pull, 100)
    assert again.state.positions == pytest.approx(shape, abs=1e-6)
    cable = body.cables[0]
    anchors = again.state.memory[body.memory_slices[body.elements.index(cable)]]
    assert tensions(8.0, cable, shape, anchors) == pytest.approx(8.0 * cable.tension_ratio(shape), rel=1e-6)


def test_the_tip_follows_a_change_of_tension_as_sensitivities_say() -> None:
    specimen = held(directed(3))
    here = hung(specimen, pressure_Pa=(30e3,))
    here = specimen.equilibrium.follow(here, HANGING, replace(here.loads, cable_tension_N=(8.0, 0.0)))
    slope = Sensitivity(specimen.newton, here).to_tension()[:3, 0]
    more = specimen.equilibrium.follow(here, HANGING, replace(here.loads, cable_tension_N=(8.02, 0.0)))
    body = specimen.body
    moved = body.tip_position(more.state.positions) - body.tip_position(here.state.positions)
    assert moved / 0.02 == pytest.approx(slope, rel=2e-2, abs=1e-2 * np.abs(slope).max())


def swing(loss_N: float) -> tuple[Array, float]:
    """Return how a mass on a film swings that a taut cable holds (ticks,) [m], and the film's stiffness."""
    nodes = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -0.2, 0.0]])
    cable = Cable(np.array([3, 2]), loss_N=loss_N, directed=True, stiffness_N_m=1e5)
    body = SoftBody.from_arrays(
        nodes, np.array([[0, 1, 2]]), Film(1e6, 0.0, 1e-3), cables=(cable,), node_mass=np.full(4, 0.5)
    )
    fixed = np.array([0, 1, 2, 3])
    components = np.ones((4, 3), dtype=bool)
    components[2, 1] = False
    clamp, system = Clamp(fixed, nodes, components), FilmPotential(body)
    newton = NewtonSolver(system, clamp.mask(4))
    loads = Loads((), (4.0,), NO_WEIGHT)
    stepper = Stepper(newton, clamp, StepOptions("bdf2", tolerance_N=1e-8, iterations=20))
    state = SoftState.drawn(body, Pose())
    velocity = state.velocities.copy()
    velocity[2, 1] = 0.5
    state = replace(state, velocities=velocity)
    height = []
    for _ in range(800):
        state, _ = stepper.step(state, Pose(), loads, 1e-3)
        height.append(state.positions[2, 1])
    rows = system.losses_at(nodes, loads, state.memory)
    system.evaluate(nodes, loads, rows, state.memory)
    stiffness = dense(system.pattern, system.blocks)[7, 7]
    return np.array(height), float(stiffness)


def test_a_taut_swing_dies_away_as_coulombs_law_says() -> None:
    free, stiffness = swing(0.0)
    rubbed, _ = swing(0.4)

    def peaks(height: Array) -> Array:
        inner = height[1:-1]
        return inner[(inner > height[:-2]) & (inner >= height[2:])]

    assert np.ptp(peaks(free)) < 0.02 * np.ptp(free)  # nothing else dampens it
    drop = -np.diff(peaks(rubbed))[:4]
    assert drop == pytest.approx(np.full(len(drop), 4.0 * 0.4 / stiffness), rel=0.05)


def test_wrong_losses_are_refused() -> None:
    with pytest.raises(InputError, match=r"loss -0\.1 N"):
        Cable(np.array([0, 1]), loss_N=-0.1, directed=True)
