"""Elements that the package does not know: a dashpot with a memory, in all that loops over elements."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray, Pose
from cosim.base.identity import content_name
from cosim.errors import InputError, MeshError
from cosim.reduced.section_model import RingFrames
from cosim.soft.body.body import SoftBody
from cosim.soft.body.copies import Plate, around_axis, attached, copies
from cosim.soft.body.loads import Loads
from cosim.soft.elements.element import NODES, STILL, DirectElement, Element, Instant
from cosim.soft.elements.hinge import Hinges
from cosim.soft.elements.material import Film
from cosim.soft.elements.membrane import Membranes
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.derivatives import RELATIVE, dense, derivative_errors
from tests.soft.bodies import HANGING, held, hexagon_arm, hung, no_load, random_rotation, shapes
from tests.soft.dashpot import Dashpots

STEP_S = 2e-3
PAIRS = np.array([[0, 40], [30, 2]])


def damped(body: SoftBody, damping_Ns_m: float = 0.5) -> SoftBody:
    return body.with_elements(Dashpots(PAIRS, np.array([damping_Ns_m, 2.0 * damping_Ns_m])))


def gradient_of(body: SoftBody, x: Array, memory: Array, loads: Loads, step_s: float = STEP_S) -> Array:
    system = FilmPotential(body)
    bed = Inertia(np.zeros(body.nodes), np.zeros_like(x), step_s)
    system.evaluate(x, loads, system.losses_at(x, loads), memory, inertia=bed)
    return system.gradient.copy()


def test_its_derivatives_are_summed_with_the_others() -> None:
    body = damped(hexagon_arm(1), 50.0)
    system, loads = FilmPotential(body), no_load(body, gravity=(0.0, 0.0, 0.0))
    memory, bed = body.first_memory(), Inertia(np.zeros(body.nodes), np.zeros((body.nodes, 3)), STEP_S)

    def evaluate(y: Array) -> tuple[float, Array, Array]:
        energy = system.evaluate(np.ascontiguousarray(y), loads, np.zeros(0), memory, inertia=bed)
        return energy, system.gradient.copy(), dense(system.pattern, system.blocks)

    x = shapes(1)["random"]
    assert max(derivative_errors(evaluate, x, 5e-7)) < 20.0 * RELATIVE
    plain = gradient_of(hexagon_arm(1), x, memory[:-2], loads)
    assert np.abs(evaluate(x)[1] - plain).max() > 1.0


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
def test_two_masses_lose_the_speed_that_a_dashpot_takes(integrator: Any) -> None:
    # m dv/dt = -2 c v of each of two masses, which each know the length that the last step left
    mass, damping, steps, step_s = 0.1, 0.3, 40, 5e-4
    x = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.1, 0.1, 0.0]])
    body = SoftBody.from_arrays(x, np.array([[0, 1, 2]]), Film(1e-9, 0.3, 1e-6), node_mass=mass)
    body = body.with_elements(Dashpots(np.array([[0, 1]]), np.array([damping])))
    nobody = Clamp(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), dtype=bool))
    options = StepOptions(integrator, tolerance_N=1e-9, newton=NewtonOptions(tolerance_N=1e-9, reuse_max=6))
    stepper = Stepper(NewtonSolver(FilmPotential(body), nobody.mask(3)), nobody, options)
    speed = np.array([[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.0]])
    state = SoftState(x, speed, body.first_memory())
    for _ in range(steps):
        state, _ = stepper.step(state, Pose(), Loads((), (), (0.0, 0.0, 0.0)), step_s)
    if integrator == "implicit_euler":  # exact: m (v - v_n) / h = -2 c v in each step
        expected, within = 0.2 / (1.0 + 2.0 * damping * step_s / mass) ** steps, 1e-6
    else:
        expected, within = 0.2 * np.exp(-2.0 * damping * steps * step_s / mass), 1e-2
    assert state.velocities[1, 0] == pytest.approx(expected, rel=within)
    assert state.memory == pytest.approx([np.linalg.norm(state.positions[1] - state.positions[0])])


def test_statics_does_not_feel_it_and_starts_its_memory_anew() -> None:
    plain, arm = held(hexagon_arm(2)), held(damped(hexagon_arm(2)))
    there, here = hung(plain, pressure_Pa=(2e4,)), hung(arm, pressure_Pa=(2e4,))
    np.testing.assert_allclose(here.state.positions, there.state.positions, atol=1e-9)
    lengths = arm.body.of_kind(Dashpots)[0].first_memory(here.state.positions)
    np.testing.assert_array_equal(here.state.memory[-2:], lengths)
    assert np.abs(lengths - arm.body.first_memory()[-2:]).max() > 1e-3


def test_it_resists_no_rigid_motion() -> None:
    body = damped(hexagon_arm(2))
    state = SoftState.drawn(body, HANGING).carried(Pose(random_rotation(1), np.array([0.1, 0.2, 0.3])))
    still = no_load(body, gravity=(0.0, 0.0, 0.0))
    moved = gradient_of(body, state.positions, state.memory, still)
    assert np.abs(moved).max() < 1e-6
    stretched = gradient_of(body, 1.01 * state.positions, state.memory, still)
    bare = gradient_of(hexagon_arm(2), 1.01 * state.positions, state.memory[:-2], still)
    assert np.abs(stretched - bare).max() > 1e-2


def test_copies_and_attachments_carry_it_along() -> None:
    single, x = damped(hexagon_arm(2)), shapes(2)["inflated"]
    still = (0.0, 0.0, 0.0)
    alone = gradient_of(single, x, single.first_memory(), no_load(single, gravity=still))
    poses = around_axis(3, 0.1, 0.4)
    triple = copies(single, poses)
    moved = np.concatenate([pose.apply(x) for pose in poses])
    whole = gradient_of(triple, moved, triple.first_memory(), no_load(triple, gravity=still))
    turned = np.concatenate([alone @ pose.rotation.T for pose in poses])
    np.testing.assert_allclose(whole, turned, atol=1e-8 * np.abs(alone).max())
    assert len(triple.of_kind(Dashpots)) == 1
    arm = hexagon_arm(2)
    both = attached(arm, "arm", single, "hand", Pose(np.eye(3), np.array([0.0, 0.0, 0.02])), Plate(0.1, 1e6))
    np.testing.assert_array_equal(both.of_kind(Dashpots)[0].nodes, PAIRS + arm.nodes)


def test_constants_that_differ_are_not_joined() -> None:
    arm = hexagon_arm(1)
    other = arm.with_other(Hinges, replace(arm.hinges, fold_barrier_rad=0.5))
    with pytest.raises(MeshError, match="hand cannot be attached: hinges differ in fold_barrier_rad"):
        attached(arm, "arm", other, "hand", Pose(), Plate(0.1, 1e6))
    with pytest.raises(MeshError, match="hinges are given 2 times"):
        arm.with_elements(arm.hinges)


def test_nodes_that_are_not_there_are_refused() -> None:
    with pytest.raises(MeshError, match=r"dashpots .* refers to node 99; there are nodes 0 to"):
        hexagon_arm(1).with_elements(Dashpots(np.array([[0, 99]]), np.ones(1)))


def test_a_body_without_a_film_or_hinges_says_so() -> None:
    body = hexagon_arm(1)
    for kind, text in ((Membranes, "needs its triangles"), (Hinges, "needs its hinges")):
        kept = tuple(element for element in body.elements if not isinstance(element, kind))
        with pytest.raises(MeshError, match=text):
            replace(body, elements=kept)


def test_a_section_model_without_it_is_refused() -> None:
    RingFrames.of(hexagon_arm(2))
    with pytest.raises(InputError, match="dashpots"):
        RingFrames.of(damped(hexagon_arm(2)))


def changed(value: Any) -> Any:
    """Return something that differs from a value in one place."""
    if isinstance(value, np.ndarray):
        other = value.copy()
        other.flat[0] = other.flat[0] + 1
        return other
    if isinstance(value, bool):
        return not value
    if isinstance(value, float):
        return 0.25 + 0.5 * value
    if isinstance(value, Film):
        return replace(value, thickness_m=2.0 * value.thickness_m)
    if isinstance(value, dict):
        return {**value, "another": np.zeros(1, np.int64)}
    return value[1:]


def test_every_field_of_a_body_and_of_its_elements_changes_its_name() -> None:
    one = copies(hexagon_arm(2), (Pose(),))
    body = replace(damped(hexagon_arm(2)), chambers=one.chambers, copies=one.copies, tip_along=np.ones(3))
    names = {content_name(body)}
    bodies = [
        replace(body, **{field.name: changed(getattr(body, field.name))})
        for field in fields(body)
        if field.name not in ("elements", "chambers", "caps")
    ]
    bodies += [replace(body, chambers=()), replace(body, chambers=(), caps=body.caps[1:])]
    for element in body.elements:
        parts: Any = element
        for field in fields(parts):
            other = replace(parts, **{field.name: changed(getattr(element, field.name))})
            elements = tuple(other if entry is element else entry for entry in body.elements)
            bodies.append(replace(body, elements=elements))
    names |= {content_name(entry) for entry in bodies}
    assert len(names) == 1 + len(bodies)


@dataclass(frozen=True)
class Springs(DirectElement):
    """Nothing yet, but for its nodes."""

    label: ClassVar[str] = "springs"
    nodes: Annotated[IntArray, NODES]

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        return 0.0


@dataclass(frozen=True)
class StrongSprings(Springs):
    strength: float = 1.0


@dataclass(frozen=True)
class UnmarkedSprings(Springs):
    strength: Array | None = None


def test_a_field_more_changes_the_name_or_is_refused() -> None:
    body = hexagon_arm(1)
    weak, strong, stronger = (
        content_name(body.with_elements(element))
        for element in (Springs(PAIRS[:1]), StrongSprings(PAIRS[:1]), StrongSprings(PAIRS[:1], 2.0))
    )
    assert len({weak, strong, stronger}) == 3
    with pytest.raises(TypeError, match=r"UnmarkedSprings\.strength is an array; mark it"):
        body.with_elements(UnmarkedSprings(PAIRS[:1]))


def test_kinds_stay_together_in_the_order_of_the_first() -> None:
    body = hexagon_arm(2)
    mixed = replace(body, elements=(body.cables[0], body.hinges, *body.membranes, body.cables[1]))
    kinds: list[type[Element]] = [type(element) for element in mixed.elements]
    assert kinds == [type(body.cables[0])] * 2 + [Hinges, Membranes]
    assert mixed.cables == body.cables
