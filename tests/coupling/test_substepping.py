"""Ticks of several steps of MuJoCo, and substeps where the film comes on to what can move."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.base.state import restore_states, states_of
from cosim.build.arms import find_arm
from cosim.build.scene_objects import rigid_substeps
from cosim.config.loading import load_scenario
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.ticks import ServoCommands
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene
from tests.coupling.pads import CoupledGrasp
from tests.coupling.test_light_bodies import bounce

TABLE = SceneObject("table", "box", (0.4, 0.4, 0.1), (0.5, 0.0, 0.95))
BALL = SceneObject("ball", "sphere", (0.02,), (0.5, 0.0, 1.03), mass_kg=0.1)


def dropped(tick_s: float, substeps: int) -> RigidScene:
    """Return a scene in which a ball drops on a table."""
    return RigidScene(
        SceneDescription(find_arm("ur5e"), tick_s=tick_s, substeps=substeps, objects=(TABLE, BALL))
    )


def test_a_tick_of_several_steps_is_these_steps() -> None:
    long, short = dropped(4e-3, 4), dropped(1e-3, 1)
    assert (long.tick_s, long.substeps, short.tick_s) == (4e-3, 4, 1e-3)
    for _ in range(30):
        long.step()
        for _ in range(4):
            short.step()
        assert np.array_equal(long.body_poses()[0], short.body_poses()[0])
    assert long.body_poses()[0][long.body_names.index("ball"), 2] < 1.021  # it has come down


def test_servos_go_on_within_a_tick() -> None:
    long, short, speed = dropped(4e-3, 4), dropped(1e-3, 1), np.full(6, 0.3)
    place = long.joint_position
    long.step_arm(place, speed, np.zeros(6))
    for k in range(4):
        short.step_arm(place + k * 1e-3 * speed, speed, np.zeros(6))
    assert long.joint_position == pytest.approx(short.joint_position, abs=1e-13)
    assert np.abs(long.joint_position - place).max() > 1e-5


@pytest.mark.parametrize("mass_kg", [0.05, 0.1])
def test_a_ball_bounces_as_with_short_ticks(mass_kg: float) -> None:
    whole, fine, short = (bounce(mass_kg, h, 0.16, substeps=n) for h, n in ((4e-3, 1), (4e-3, 4), (1e-3, 1)))
    low, high = (found.height.min() for found in (short, fine))
    assert fine.height[-1] == pytest.approx(short.height[-1], abs=3e-4)
    assert low == pytest.approx(high, abs=3e-4)
    assert abs(whole.height[-1] - short.height[-1]) > 1e-3


def hit() -> Any:
    """Return a light cube between pads that press on it all of a sudden."""
    return CoupledGrasp(0.05, 4e-3, StaggeredCoupling, "bdf2", substeps=4)


def ticks_of(grasp: Any, count: int) -> list[Array]:
    """Return where the cube is after each of some ticks."""
    found = []
    for _ in range(count):
        entry = grasp.tick()
        assert entry.momentum_error < 1e-10
        found.append(np.concatenate([grasp.grasp.cube_position, grasp.grasp.soft.state.positions.ravel()]))
    return found


def test_a_run_that_is_resumed_among_fine_ticks_repeats() -> None:
    grasp = hit()
    seen: list[Any] = []
    fine = []
    for _ in range(12):
        ticks_of(grasp, 1)
        state = states_of(grasp.coupling.parts())
        fine.append(state["substeps"] > 0)
        seen.append((grasp.grasp.scene.state, grasp.grasp.soft.full_state, state))
    assert any(fine)
    assert not all(fine)
    k = fine.index(True)
    again = hit()
    for one in (grasp, again):
        scene, soft, state = seen[k]
        one.grasp.scene.state = scene
        one.grasp.soft.full_state = soft
        restore_states(one.coupling.parts(), state)
    first, second = ticks_of(grasp, 10), ticks_of(again, 10)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_the_force_shown_of_a_tick_is_the_impulse_in_it() -> None:
    mass_kg, tick_s, shown, changes = 0.05, 4e-3, np.zeros(3), 0
    here = CoupledGrasp(mass_kg, tick_s, StaggeredCoupling, "bdf2", substeps=2)
    scene, cube = here.grasp.scene, here.grasp.scene.body_names.index("cube")
    servos = ServoCommands.without_payload(
        *np.stack([scene.joint_position, np.zeros(6), np.zeros(6)])[:, None]
    )
    for k in range(150):
        fine = here.coupling.substepping.state
        taken = here.coupling.advance(servos, [here.grasp.loads])
        shown += tick_s * (taken.body_contact_force[0, cube] + [0.0, 0.0, -9.81 * mass_kg])
        momentum = mass_kg * scene.bodies.spins[cube, 3:]
        assert shown == pytest.approx(momentum, abs=1e-12), k
        loaded = scene.bodies.applied[cube].any()
        changes += bool(fine) != bool(here.coupling.substepping.state) and bool(loaded)
    assert changes > 1  # the force that is left acts through a piece, or through a whole tick


def test_the_force_on_a_body_at_rest_is_even_where_substeps_begin_and_end() -> None:
    # it fell to a quarter in the last whole tick, and rose to nearly twice as much in the last with substeps
    here = CoupledGrasp(0.05, 4e-3, StaggeredCoupling, "bdf2", substeps=4)
    scene, cube = here.grasp.scene, here.grasp.scene.body_names.index("cube")
    servos = ServoCommands.without_payload(
        *np.stack([scene.joint_position, np.zeros(6), np.zeros(6)])[:, None]
    )

    def forces(ticks: int) -> list[float]:
        taken = [here.coupling.advance(servos, [here.grasp.loads]) for _ in range(ticks)]
        return [float(np.linalg.norm(each.body_contact_force[0, cube])) for each in taken]

    forces(150)
    held = forces(1)
    assert held[0] > 0.4  # most of its weight
    here.coupling.substepping.state = 3
    held += forces(6)
    assert not here.coupling.substepping.state
    assert held == pytest.approx([held[0]] * len(held), rel=0.02)


def test_servos_go_on_in_pieces_as_in_whole_ticks() -> None:
    joints, speed = [], np.full((1, 6), 0.3)
    for fine in (False, True):
        grasp = hit()
        grasp.coupling.substepping.state = int(fine)
        place = grasp.grasp.scene.joint_position[None]
        servos = ServoCommands.without_payload(place, speed, 0.0 * speed)
        joints.append(grasp.coupling.advance(servos, [grasp.grasp.loads]).joint_position[0] - place[0])
    assert joints[1] == pytest.approx(joints[0], rel=1e-9)  # nothing acts on the arm but its servos
    assert np.abs(joints[0]).min() > 1e-6


def test_the_first_whole_tick_looks_back_over_a_whole_one() -> None:
    grasp, fine = hit(), False
    soft = grasp.grasp.soft
    before = soft.state.positions
    while not fine or grasp.coupling.substepping.state:  # the pads ring for some 0.2 s
        assert grasp.coupling.interface.state.ticks < 200
        fine, before = grasp.coupling.substepping.state, soft.state.positions
        grasp.tick()
    assert soft.state.earlier is not None
    assert np.array_equal(soft.state.earlier[0], before)


def test_how_many_steps_a_tick_has_follows_from_the_lightest_free_object() -> None:
    def steps(**changes: Any) -> int:
        keys = {name.replace("__", "."): value for name, value in changes.items()}
        return rigid_substeps(load_scenario("gripper_lifts_roll", keys))

    assert steps() == 4
    assert steps(clock__tick_s=1e-3) == 2
    assert steps(clock__tick_s=5e-4) == 1
    assert steps(object__roll__mass_kg=0.02) == 4
    assert steps(object__roll__mass_kg=0.5) == 4
    assert steps(object__roll__mass_kg=1.0) == 3
    assert steps(object__roll__mass_kg=20.0) == 1
    assert steps(contact__enabled=False) == 1
    assert steps(coupling__scheme="iterated") == 1
    assert rigid_substeps(load_scenario("gripper_lifts_bridge")) == 1  # its plank hangs on a hinge
    assert rigid_substeps(load_scenario("gripper_pulls_wire")) == 1
