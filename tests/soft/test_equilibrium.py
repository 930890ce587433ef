"""Following equilibria: weight on the flange, halving, friction, branches that do not depend on the way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.errors import ConvergenceError
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.eyelets import BASE_FRACTION
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome
from cosim.soft.solve.pseudo_time import slide
from cosim.soft.solve.search_effort import SearchEffort
from cosim.soft.solve.state import Equilibrium, SoftState
from tests.soft.bodies import HANGING, PRESSURE_Pa, held, hexagon_arm, hung, no_load
from tests.soft.contacts import half_space

TURNED = Pose(rotation_from_vector(np.array([0.2, -0.9, 0.3])) @ HANGING.rotation, np.array([0.4, 0.1, 0.6]))


@pytest.mark.parametrize("closed", [True, False])
def test_the_flange_carries_weight_at_the_centre_of_mass(closed: bool) -> None:
    arm = held(hexagon_arm(4, closed=closed))
    found = arm.equilibrium.follow(
        hung(arm, pressure_Pa=(PRESSURE_Pa,)),
        TURNED,
        no_load(arm.body, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=(1.0, 2.0)),
    )
    weight = arm.body.node_mass[:, None] * np.array([0.0, 0.0, -9.81])
    lever = found.state.positions - TURNED.translation
    if closed:  # an open chamber's net thrust comes on top
        assert found.wrench.force == pytest.approx(weight.sum(axis=0), abs=1e-5)
        assert found.wrench.torque == pytest.approx(np.cross(lever, weight).sum(axis=0), abs=1e-6)
    else:
        assert np.linalg.norm(found.wrench.force - weight.sum(axis=0)) > 0.1
    assert found.residual_N < 1e-6
    assert found.world_from_flange is TURNED


def test_without_gravity_shapes_turn_with_the_flange() -> None:
    arm = held(hexagon_arm(3))
    loads = {"pressure_Pa": (PRESSURE_Pa,), "cable_tension_N": (2.0, 0.0), "gravity": (0.0, 0.0, 0.0)}
    here = hung(arm, **loads)
    there = arm.equilibrium.follow(here, TURNED, here.loads)
    motion = TURNED @ HANGING.inverse()
    assert there.state.positions == pytest.approx(motion.apply(here.state.positions), abs=1e-6)
    assert there.iterations <= 1  # carried rigidly, it is in balance up to rounding
    assert there.wrench.force == pytest.approx(np.zeros(3), abs=1e-5)


def test_a_body_that_cannot_be_followed_to_its_loads_is_filled_before_it_gets_weight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm = held(hexagon_arm(3))
    begin, loads = hung(arm), no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    wanted, follow = arm.equilibrium.load(begin, loads), EquilibriumSolver.follow

    def from_weightless(self: EquilibriumSolver, here: Equilibrium, pose: Pose, there: Loads) -> Equilibrium:
        if any(here.loads.gravity) and not any(here.loads.pressure_Pa):
            raise ConvergenceError("fallen over its base", iterations=7, residual_N=1.0)
        return follow(self, here, pose, there)

    monkeypatch.setattr(EquilibriumSolver, "follow", from_weightless)
    found = arm.equilibrium.load(begin, loads)
    assert found.loads == wanted.loads
    assert found.state.positions == pytest.approx(wanted.state.positions, abs=1e-6)
    with pytest.raises(ConvergenceError, match="fallen"):
        arm.equilibrium.load(begin, no_load(arm.body))


def test_pieces_are_halved_where_needed() -> None:
    plenty, few = held(hexagon_arm(3)), held(hexagon_arm(3), NewtonOptions(iterations_max=6))
    begin, loads = hung(plenty), no_load(plenty.body, pressure_Pa=(PRESSURE_Pa,))
    whole, pieces = (arm.equilibrium.follow(begin, HANGING, loads) for arm in (plenty, few))
    assert whole.iterations > 6  # so six are not enough at once
    assert pieces.iterations > whole.iterations
    assert pieces.loads == whole.loads
    assert pieces.state.positions == pytest.approx(whole.state.positions, abs=1e-6)


def test_halved_pieces_cover_the_way_and_count_what_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = held(hexagon_arm(2))
    begin, loads = hung(arm), no_load(arm.body, pressure_Pa=(8000.0,))
    tried: list[tuple[float, int]] = []
    solve = EquilibriumSolver.solve

    def short_pieces_only(self: EquilibriumSolver, state: Any, pose: Pose, load: Loads) -> Any:
        last = max((pressure for pressure, spent in tried if spent), default=0.0)
        if load.pressure_Pa[0] - last > 2500.0:
            tried.append((load.pressure_Pa[0], 0))
            raise ConvergenceError("too far", 1.0, 100)
        found = solve(self, state, pose, load)
        tried.append((load.pressure_Pa[0], found.iterations))
        return found

    with monkeypatch.context() as patch:
        patch.setattr(EquilibriumSolver, "solve", short_pieces_only)
        found = arm.equilibrium.follow(begin, HANGING, loads)
    assert [pressure for pressure, _ in tried] == [8000.0, 4000.0, 2000.0, 4000.0, 6000.0, 8000.0]
    assert found.iterations == 200 + sum(spent for _, spent in tried)
    assert found.loads is loads


def test_a_state_is_carried_with_its_velocities() -> None:
    body = hexagon_arm(1)
    drawn = SoftState.drawn(body, HANGING)
    spin = np.array([0.0, 0.0, 2.0])
    flying = SoftState(drawn.positions, np.cross(spin, drawn.positions), drawn.memory)
    motion = Pose(rotation_from_vector(np.array([0.4, 0.2, -1.0])), np.array([1.0, 2.0, 3.0]))
    carried = flying.carried(motion)
    turned = motion.rotation @ spin
    assert carried.positions == pytest.approx(motion.apply(drawn.positions))
    assert carried.velocities == pytest.approx(np.cross(turned, carried.positions - motion.translation))


def test_a_way_that_cannot_be_followed_is_an_error() -> None:
    arm = held(hexagon_arm(2))
    begin = hung(arm)
    one = held(hexagon_arm(2), NewtonOptions(iterations_max=1))
    with pytest.raises(ConvergenceError, match="iteration limit") as caught:
        one.equilibrium.follow(begin, HANGING, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,)))
    assert caught.value.residual_N > 1e-6


def test_a_hopeless_way_is_given_up_soon_with_what_was_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = held(hexagon_arm(2))
    begin, loads = hung(arm), no_load(arm.body, pressure_Pa=(8000.0,))
    tried: list[float] = []
    solve = EquilibriumSolver._solve  # what `solve` and the end of `slide` have in common

    def stuck_above_half(
        self: EquilibriumSolver, films: None, guess: Array, memory: Array, pose: Pose, load: Loads
    ) -> Any:
        tried.append(load.pressure_Pa[0])
        if load.pressure_Pa[0] > 4000.0:
            raise ConvergenceError("stuck at node 5", 1.0, 100)
        return solve(self, films, guess, memory, pose, load)

    with monkeypatch.context() as patch:
        patch.setattr(EquilibriumSolver, "_solve", stuck_above_half)
        with pytest.raises(ConvergenceError, match=r"at node 5; followed over 50 % of the way") as caught:
            arm.equilibrium.follow(begin, HANGING, loads)
    # three that led nowhere, the slide's end; down to 1/256 of the way there would be ten
    assert len([pressure for pressure in tried if pressure > 4000.0]) == 4
    assert caught.value.iterations > 400


class Restless:
    """Stands for Newton's method on a body that comes to rest only while it is damped."""

    def __init__(self) -> None:
        self.spent = 0

    def solve(self, start: Array, angles: Array, loads: Loads, options: NewtonOptions, *damped: Any) -> Any:
        outcome = Outcome.CONVERGED if damped else Outcome.ITERATION_LIMIT
        self.spent += options.iterations_max
        return NewtonResult(start, angles, outcome, 1.0, options.iterations_max, 1, 0.0, 0)


def test_a_slide_that_comes_to_rest_nowhere_is_given_up_soon() -> None:
    body: Any = Restless()
    x, options = np.zeros((2, 3)), NewtonOptions(iterations_max=100)
    found = slide(body, x, np.zeros(0), lambda x: Loads(), options, SearchEffort(1000))
    assert not found.converged
    assert found.iterations == body.spent < 520  # all its steps would take 17,000


def test_following_nowhere_stays() -> None:
    arm = held(hexagon_arm(2))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    again = arm.equilibrium.follow(begin, HANGING, begin.loads)
    assert again.iterations == 0
    assert (again.state.positions == begin.state.positions).all()


def test_a_cable_with_friction_settles() -> None:
    # friction has no potential: tensions depend on the shape, which depends on the tensions
    body = hexagon_arm(4)
    cables = tuple(Cable(cable.nodes, 1.0, 0.4) for cable in body.cables)
    arm = held(hexagon_arm(4, cables=cables))
    found = hung(arm, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=(6.0, 2.0))
    x = found.state.positions
    rows = arm.film.losses_at(x, found.loads)
    assert rows[0, BASE_FRACTION] == 1.0
    assert rows[2, BASE_FRACTION] < 0.999
    assert found.iterations > 5  # all rounds, not the last one alone, which takes none
    arm.film.evaluate(x, found.loads, rows, found.state.memory)
    # with the tensions of the shape that was found, not those of the one before
    assert np.abs(arm.film.gradient[arm.newton.free]).max() < 1e-6


def test_energy_does_not_depend_on_the_way() -> None:
    arm = held(hexagon_arm(3))
    first = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    loads = no_load(arm.body, pressure_Pa=(0.7 * PRESSURE_Pa,), cable_tension_N=(1.0, 0.0))
    direct = arm.equilibrium.follow(first, TURNED, loads)
    detour = arm.equilibrium.follow(first, HANGING, loads)
    detour = arm.equilibrium.follow(detour, TURNED, loads)
    assert detour.potential_J == pytest.approx(direct.potential_J, rel=1e-9)
    assert detour.state.positions == pytest.approx(direct.state.positions, abs=1e-5)


def test_rounds_with_a_curved_obstacle_are_extrapolated() -> None:
    # the tip is pressed on a ball, whose tangent planes are found anew in every round
    arm = held(hexagon_arm(2))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    surface, radius, rounds = ContactSurface.of(arm.body, arm.film.pattern), 0.02, []
    center = arm.body.tip_position(begin.state.positions) + np.array([0.01, 0.0, 0.01 - radius])
    plane = half_space(surface, np.zeros(3), 0.0, ContactLaw())

    def ball(x: Array) -> ContactPlanes:
        away = surface.points(x) - center
        normal = away / np.linalg.norm(away, axis=1)[:, None]
        rounds.append(x)
        return plane.changed(normal=normal, offset=normal @ center + radius)

    arm.equilibrium.obstacles = ball
    found = arm.equilibrium.solve(begin.state, HANGING, begin.loads)
    assert found.wrench.force[2] > 10.0
    away = np.linalg.norm(surface.points(found.state.positions) - center, axis=1)
    assert -1.5e-3 < away.min() - radius < 0.0
    assert len(rounds) <= 9  # 13 where each round begins where the last one ended


def test_a_film_that_is_stretched_beyond_any_film_is_given_up_by_name() -> None:
    arm = held(hexagon_arm(1))
    hung(arm, pressure_Pa=(3e7,))  # to four times its length
    told = r"stretched to \d+\.\d times its drawn length \(bound 10\); raise its young_modulus_Pa"
    with pytest.raises(ConvergenceError, match=told):
        hung(arm, pressure_Pa=(3e8,))
