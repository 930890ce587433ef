"""Steps by the kernel are the steps that are summed term by term, whatever is touched in them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import SoftBody
from cosim.soft.body.copies import copies
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.element import Sums
from cosim.soft.linear.kept_factor import EXTRA_MAX
from cosim.soft.solve import time_step
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.state import Clamp, Integrator, SoftState, StepOptions
from cosim.soft.solve.time_step import ImplicitStepper
from tests.soft.bodies import FILM, HANGING, held, hexagon_arm, hung, no_load
from tests.soft.contacts import half_space

STEP_S, STEPS = 0.002, 24
REUSING = NewtonOptions(reuse_max=6, start_tolerance_N=1e-6)


@dataclass(frozen=True)
class Nothing:
    """A further potential that is zero: with it, steps are summed term by term."""

    def add(self, positions: Array, sums: Sums, hessian: bool) -> float:
        """Add nothing."""
        return 0.0


def two_films() -> SoftBody:
    """Return an arm of a plain and a wrinkling film, its hinges without stiffness."""
    body = hexagon_arm(2, hinge_stiffness=0.0, fold_barrier_rad=0.0)
    lower = np.arange(len(body.triangles)) < len(body.triangles) // 2
    groups = {"lower": np.flatnonzero(lower), "upper": np.flatnonzero(~lower)}
    films = {"lower": FILM, "upper": replace(FILM, law="wrinkling", wrinkle_panel_m=0.02)}
    return SoftBody.from_arrays(
        body.positions, body.triangles, films, face_groups=groups, hinge_nodes=body.hinges.nodes,
        caps=body.caps, cables=body.cables, node_mass=body.node_mass, base=body.base, tip=body.tip,
    )  # fmt: skip


def two_chambers() -> SoftBody:
    """Return two arms side by side, each with its own gas."""
    beside = Pose(np.eye(3), np.array([0.2, 0.0, 0.0]))
    return copies(hexagon_arm(2), [Pose(), beside])


def with_beams() -> SoftBody:
    """Return an arm with a printed frame of twelve nodes and one of six."""
    body = hexagon_arm(2)
    rings = [
        BeamRings.from_shape(body.positions, body.rings[name][None], RectangularSection(width_m, 1e-3, 2e9))
        for name, width_m in (("unit_1.outer", 1e-3), ("unit_2.hole", 2e-3))
    ]
    return body.with_elements(*rings)


BODIES = {
    "arm": hexagon_arm(2), "two films": two_films(), "two chambers": two_chambers(), "beams": with_beams(),
}  # fmt: skip


def beside(body: SoftBody, state: SoftState) -> ContactPlanes:
    """Return a plane that presses into one side of a hanging body by 0.05 mm and holds on to it."""
    surface = ContactSurface.of(body, SoftSystem(body).pattern)
    points = surface.points(state.positions)
    across = np.array([-1.0, 0.0, 0.0])
    return half_space(surface, across, float((points @ across).min()) + 5e-5, ContactLaw(), 0.02, points)


def moved(
    body: SoftBody, integrator: Integrator, *, touches: bool = False, **loads: Any
) -> tuple[list[SoftState], list[int], list[Array]]:
    """Return states, iterations and wrenches of some steps in which flange, pressures and tensions change."""
    arm = held(body)
    options = StepOptions(integrator, newton=REUSING, damping_per_s=2.0)
    move, state = ImplicitStepper(arm.newton, arm.clamp, options), hung(arm).state
    states, iterations, wrenches, flange = [], [], [], HANGING
    contact = beside(body, state) if touches else None
    for k in range(1, STEPS + 1):
        turn = rotation_from_vector(np.array([0.0, 2e-6 * k * k, 0.0]))
        before, flange = flange, Pose(turn @ HANGING.rotation, HANGING.translation + 2e-7 * k * k)
        chambers = len(body.gas_chambers)
        acting = no_load(
            body, pressure_Pa=tuple(20.0 * k * (c + 1) for c in range(chambers)),
            cable_tension_N=tuple(2e-3 * k * (c + 1) for c in range(len(body.cables))), contact=contact,
            **loads,
        )  # fmt: skip
        state, result = move.step(state, flange, acting, STEP_S, before)
        wrench = arm.clamp.wrench(arm.system.gradient, state.positions, flange)
        states.append(state)
        iterations.append(result.iterations)
        wrenches.append(np.concatenate([wrench.force, wrench.torque]))
    return states, iterations, wrenches


@pytest.mark.parametrize("touches", [False, True], ids=["free", "touching"])
@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
@pytest.mark.parametrize("name", list(BODIES))
def test_quick_steps_are_those_summed_term_by_term(
    name: str, integrator: Integrator, touches: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    true, taken = time_step.QuickStepper.take, list[bool]()

    def counted(*given: Any) -> Any:
        found = true(*given)
        taken.append(found is not None)
        return found

    monkeypatch.setattr(time_step.QuickStepper, "take", counted)
    quick, counts, wrenches = moved(BODIES[name], integrator, touches=touches)
    assert all(taken)
    slow, others, by_terms = moved(BODIES[name], integrator, touches=touches, extra=Nothing())
    assert counts == others
    for one, other in zip(quick, slow, strict=True):
        # the same sums in another order: rounding, and what Newton's method makes of it
        assert np.abs(one.positions - other.positions).max() < 1e-12
        assert np.abs(one.velocities - other.velocities).max() < 1e-9
        # factors of the turns, part of what rings of beams remember, are large where a ring is near buckling
        size = np.abs(other.memory).max(initial=1.0)
        assert np.abs(one.memory - other.memory).max(initial=0.0) < 1e-9 * size
    assert np.abs(np.array(wrenches) - np.array(by_terms)).max() < 1e-9


@pytest.mark.parametrize("extra", [None, Nothing()], ids=["in the kernel", "term by term"])
def test_a_factorisation_that_has_cost_as_much_as_a_new_one_is_dropped(extra: Nothing | None) -> None:
    arm = held(hexagon_arm(2))
    options = StepOptions("bdf2", 1e-9, newton=replace(REUSING, start_tolerance_N=1e-9))
    move, state = ImplicitStepper(arm.newton, arm.clamp, options), hung(arm).state
    due, dropped = False, 0
    for k in range(1, 60):
        acting = no_load(arm.body, pressure_Pa=(100.0 * k,), extra=extra)
        state, result = move.step(state, HANGING, acting, STEP_S)
        kept = arm.newton.kept[0]
        assert kept is not None
        if due:
            assert result.factorisations > 0
        dropped += due
        due = kept.extra >= EXTRA_MAX
    assert dropped > 1


def jumped(iterations: int, tolerance_N: float, **loads: Any) -> tuple[SoftState, NewtonResult]:
    """Return the end of a step of 10 ms in which the flange jumps by 0.2 mm from rest, under gas."""
    arm, jump = held(with_beams()), np.array([2e-4, 1e-4, -5e-5])
    newton = replace(REUSING, start_tolerance_N=min(1e-6, tolerance_N))
    options = StepOptions("bdf2", tolerance_N, iterations, newton=newton)
    move, acting = (
        ImplicitStepper(arm.newton, arm.clamp, options),
        no_load(arm.body, pressure_Pa=(2e4,), **loads),
    )
    state = hung(arm, pressure_Pa=(2e4,)).state
    for _ in range(2):
        state, _ = move.step(state, HANGING, acting, 0.01, HANGING)
    return move.step(state, Pose(HANGING.rotation, HANGING.translation + jump), acting, 0.01, HANGING)


def test_where_the_flange_jumps_the_film_begins_beside_it_and_is_solved() -> None:
    state, result = jumped(1, 1e-4)
    assert result.residual_N < 1e-4  # not just near enough, as after one new tangent in an ordinary step
    # from free flight, with held nodes alone where the flange has them, it takes 3 of them
    assert result.factorisations <= 2
    by_terms, others = jumped(1, 1e-4, extra=Nothing())
    assert others.factorisations == result.factorisations
    assert np.abs(by_terms.positions - state.positions).max() < 1e-12
    exact, _ = jumped(100, 1e-8)
    assert np.abs(exact.positions - state.positions).max() < 1e-7


def collided(**loads: Any) -> list[SoftState]:
    """Return the states of two cushions that fly at each other, touch and part."""
    one = hexagon_arm(1, cables=(), base=np.zeros(0, np.int64))
    body = copies(one, [Pose(), Pose(np.diag([1.0, -1.0, -1.0]), np.array([4e-3, 0.0, 0.035]))])
    system, clamp = SoftSystem(body), Clamp.of_base(body)
    films = SelfContact(body, FilmContactLaw(ContactLaw(), 0.5))
    options = StepOptions(tolerance_N=1e-8, newton=REUSING)
    stepper = ImplicitStepper(NewtonSolver(system, clamp.mask(body.nodes)), clamp, options, films)
    speed = np.where(np.arange(body.nodes) < one.nodes, 0.5, -0.5)
    state = replace(SoftState.drawn(body, Pose()), velocities=speed[:, None] * [0.2, 0.0, 1.0])
    states, acting = [], Loads((5e3, 5e3), gravity=(0.0, 0.0, 0.0), **loads)
    for _ in range(40):
        state, _ = stepper.step(state, Pose(), acting, 1e-3)
        states.append(state)
    return states


def test_quick_steps_of_films_that_touch_one_another_are_those_summed_term_by_term() -> None:
    quick, slow = collided(), collided(extra=Nothing())
    touched = [state.touching for state in quick if state.touching is not None]
    assert max(memory.normal_force_N for memory in touched) > 5.0
    for one, other in zip(quick, slow, strict=True):
        assert np.abs(one.positions - other.positions).max() < 1e-10
        assert (one.touching is None) is (other.touching is None)
