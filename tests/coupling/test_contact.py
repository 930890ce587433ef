"""Contact between film and rigid bodies: balance, corners, held objects, light objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import InputError, SolverError
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.film_distance import FilmReach, FilmTriangles
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.obstacle_contact import evaluate
from cosim.soft.elements.element import Sums
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from tests.coupling.nearest_film import nearest_film
from tests.coupling.pads import GRASP, Grasp
from tests.soft.bodies import icosphere


def nodal_contact_force(grasp: Grasp) -> Array:
    """Return what the contacts put on the film's nodes (n, 3) [N] at the end of the last tick."""
    planes, x = grasp.exchange.planes, grasp.soft.state.positions
    assert planes is not None
    gradient = np.zeros_like(x)
    planes.add(x, Sums(gradient), hessian=False)
    return -gradient


def test_action_equals_reaction_at_every_tick() -> None:
    grasp = Grasp(0.02, 2e-3)
    for _ in range(60):
        report = grasp.tick()
        assert report.count > 10
        x, force = grasp.soft.state.positions, nodal_contact_force(grasp)
        scale = np.abs(force).sum()
        assert np.abs(force.sum(axis=0) + report.force.sum(axis=0)).max() < 1e-10 * scale
        torque = np.cross(x, force).sum(axis=0) + report.torque.sum(axis=0)
        # about the grasp: the world's origin is far away
        about = torque - np.cross(GRASP, force.sum(axis=0) + report.force.sum(axis=0))
        assert np.abs(about).max() < 1e-10 * scale


def test_a_step_leaves_the_law_evaluated_at_its_end() -> None:
    grasp = Grasp(0.02, 2e-3, light=False)
    for _ in range(5):
        grasp.tick()
    planes = grasp.exchange.find(grasp.soft.state, 2e-3)
    assert planes is not None
    grasp.soft.advance(grasp.flange, replace(grasp.loads, contact=planes), 2e-3)
    x = grasp.soft.state.positions
    assert evaluate(x, planes) == 0
    assert evaluate(x + 1e-6, planes) == len(planes.nodes)


def test_mujoco_gets_the_reported_load() -> None:
    grasp = Grasp(0.02, 2e-3)
    for _ in range(20):
        report = grasp.tick()
    twin = Grasp(0.02, 2e-3)
    before = grasp.cube_position
    del twin
    cube = list(report.bodies).index(grasp.scene.body_names.index("cube"))
    velocity = []
    for _ in range(2):
        velocity.append(grasp.cube_position)
        grasp.scene.step()
    # the load stays while nobody changes it: second difference of the position
    change = grasp.cube_position - 2.0 * velocity[1] + velocity[0]
    expected = (report.force[cube] + np.array([0.0, 0.0, -9.81 * 0.02])) / 0.02 * (2e-3) ** 2
    np.testing.assert_allclose(change, expected, atol=1e-9)
    np.testing.assert_array_equal(before, velocity[0])


def test_a_load_that_grows_steadily_is_met_where_it_will_be_and_one_that_alternates_is_not() -> None:
    grasp = Grasp(0.02, 2e-3)
    for _ in range(20):
        grasp.tick()
    bodies, exchange = grasp.exchange.bodies, grasp.exchange
    cube = int(bodies.loaded[0])
    assert exchange.past[cube].any()  # kept at the ends of ticks
    force, change = np.array([1.0, -2.0, 3.0]), np.array([0.1, 0.2, -0.3])
    torque, turned = 1e-2 * force, 1e-3 * change
    bodies.applied[cube] = np.concatenate([force, torque])
    exchange.past[cube] = np.concatenate([force - change, torque - turned, force - 2.0 * change, torque])
    exchange.find(grasp.soft.state, 2e-3)
    np.testing.assert_allclose(exchange.assumed[cube, :3], force + change)
    np.testing.assert_allclose(exchange.assumed[cube, 3:], torque)  # it has gone there and back
    np.testing.assert_allclose(bodies.applied[cube, :3], force)  # the load that acts stays
    again = exchange.state
    exchange.past[:] = 0.0
    exchange.state = again
    assert exchange.past[cube, 0] == force[0] - change[0]


def test_a_cube_is_held_without_creep() -> None:
    grasp = Grasp(0.02, 2e-3)
    heights = []
    for _ in range(1000):
        grasp.tick()
        heights.append(grasp.cube_position[2])
    creep = (heights[-1] - heights[499]) / (500 * 2e-3)
    assert abs(creep) < 1e-3 / 60.0
    assert -1e-3 < heights[-1] - GRASP[2] < 0.0
    report = grasp.tick()
    weight = 0.02 * 9.81
    assert report.force.sum(axis=0) == pytest.approx([0.0, 0.0, weight], abs=0.01 * weight)


@pytest.mark.parametrize("tick_s", [5e-4, 1e-3, 2e-3, 5e-3])
def test_ten_grams_between_pads_are_stable_at_every_tick_length(tick_s: float) -> None:
    grasp = Grasp(0.01, tick_s)
    path = []
    for _ in range(round(0.5 / tick_s)):  # at 1 ms it gives way aside by 0.1 mm before it lies still
        grasp.tick()
        path.append(grasp.cube_position - GRASP)
    assert np.abs(path).max() < 2e-3
    assert np.ptp(path[-len(path) // 5 :], axis=0).max() < 1e-4


def test_a_tick_late_ten_grams_are_thrown_out() -> None:
    grasp = Grasp(0.01, 5e-3, light=False)
    furthest = 0.0
    for _ in range(60):
        try:
            grasp.tick()
        except SolverError:
            return
        furthest = max(furthest, float(np.abs(grasp.cube_position - GRASP).max()))
    assert furthest > 0.01


def ball() -> SoftBody:
    """Return an inflatable ball of 50 mm radius, 7.6 mm between nodes, its upper cap held."""
    x, triangles = icosphere(3, 0.05)
    held = np.flatnonzero(x[:, 2] > 0.035)
    return SoftBody.from_arrays(x, triangles, Film(1e9, 0.3, 5e-5), node_mass=3e-5, base=held, tip=held)


def scene_with(*objects: SceneObject) -> RigidScene:
    return RigidScene(
        SceneDescription(find_arm("ur5e"), tick_s=2e-3, objects=objects, gravity=(0.0, 0.0, 0.0))
    )


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.004, 0.002), (-0.003, 0.011)])
def test_a_corner_does_not_slip_in_between_the_nodes(shift: tuple[float, float]) -> None:
    edges = np.linalg.norm(np.diff(ball().positions[ball().triangles], axis=1), axis=2)
    assert edges.mean() == pytest.approx(7.6e-3, rel=0.1)
    edge = 0.06
    # standing on a corner, with another one pointing up
    upright = rotation_from_vector(np.arccos(1.0 / np.sqrt(3.0)) * np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0))
    block = SceneObject("block", "box", (edge,) * 3, (*shift, 1.0), tuple(Pose(upright).quaternion.tolist()))
    scene = scene_with(block)
    top = 1.0 + edge * np.sqrt(3.0) / 2.0
    flange = Pose(np.eye(3), np.array([0.0, 0.0, top + 0.0505]))
    soft = FilmRobot(ball(), flange, NewtonOptions(), StepOptions(tolerance_N=1e-5, damping_per_s=5.0))
    exchange = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface())
    loads = Loads((5e3,), (), (0.0, 0.0, 0.0))
    corner = np.array([[*shift, top]])
    worst, pressed = 0.0, 0.0
    brushing = []
    for tick in range(120):
        height = top + 0.0505 - 0.01 * min(1.0, tick / 100)
        planes = exchange.find(soft.state, 2e-3)
        soft.advance(Pose(np.eye(3), np.array([0.0, 0.0, height])), replace(loads, contact=planes), 2e-3)
        report = exchange.commit(soft.state.positions, soft.state.positions)
        film = FilmTriangles(soft.state.positions, soft.body.triangles)
        found = nearest_film(corner, film, FilmReach(0.02, 0.02))
        worst, pressed = max(worst, -float(found.distance[0])), max(pressed, report.normal_force_N)
        if report.count and found.distance[0] > -0.4 * exchange.law.smoothing_m:
            brushing.extend(exchange.memory.triangle.tolist())
    assert pressed > 0.5
    assert worst < 1e-3
    # the corner is a feature, and remembers the triangle that holds it back, not one that it only brushes
    assert set(brushing) == {-1}
    held = exchange.memory.triangle[exchange.memory.triangle >= 0]
    assert int(found.triangle[0]) in held.tolist()
    state = exchange.state
    exchange.state = state
    triangle = np.where(state.memory.triangle >= 0, 10**6, -1)
    wrong = replace(state, memory=state.memory._replace(triangle=triangle))
    with pytest.raises(InputError, match="triangles"):
        exchange.state = wrong


def test_far_from_everything_nothing_is_found_or_remembered() -> None:
    scene = scene_with(SceneObject("far", "sphere", (0.05,), (0.0, 1.0, 1.0)))
    soft = FilmRobot(ball(), Pose(np.eye(3), np.array([0.0, 0.0, 1.0])), NewtonOptions(), StepOptions())
    exchange = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface())
    assert exchange.find(soft.state, 2e-3) is None
    assert exchange.commit(soft.state.positions, soft.state.positions).count == 0
    assert len(exchange.memory.key) == 0


def test_what_the_film_can_get_to_in_a_tick_is_found_before_it_is_there() -> None:
    tick_s, speed, smoothing = 2e-3, 4.0, ContactLaw().smoothing_m
    gap = 1.5 * speed * tick_s  # half as much again: it may get faster within the tick
    scene = scene_with(SceneObject("block", "box", (0.2, 0.2, 0.02), (0.0, 0.0, 1.0)))
    flange = Pose(np.eye(3), np.array([0.0, 0.0, 1.01 + 0.05 + gap]))
    soft = FilmRobot(ball(), flange, NewtonOptions(), StepOptions(tolerance_N=1e-5, damping_per_s=5.0))
    exchange = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface())
    assert gap > 4.0 * smoothing
    assert exchange.find(soft.state, tick_s) is None  # at rest it is out of reach
    falling = np.tile([0.0, 0.0, -speed], (soft.body.nodes, 1))
    assert exchange.find(replace(soft.state, velocities=falling), tick_s) is not None
    # what is found holds it back at twice that speed: its lowest node stays above the block
    soft.state = replace(soft.state, velocities=2.0 * falling)
    planes = exchange.find(soft.state, tick_s)
    below = Pose(np.eye(3), flange.translation - np.array([0.0, 0.0, 2.0 * speed * tick_s]))
    soft.advance(below, replace(Loads((5e3,), (), (0.0, 0.0, 0.0)), contact=planes), tick_s)
    assert exchange.commit(soft.state.positions, soft.state.positions).count > 0
    assert soft.state.positions[:, 2].min() > 1.01 - 1e-3


def test_the_arm_is_no_obstacle_to_what_it_carries() -> None:
    scene = scene_with(SceneObject("ball", "sphere", (0.05,), (0.0, 1.0, 1.0)))
    query: ContactQuery = scene.contact_query()
    assert set(scene.bodies.names(query.body)) == {"floor", "ball"}


def test_a_cube_too_heavy_to_be_held_slides_under_coulombs_force() -> None:
    grasp, shares = Grasp(1.2, 1e-3), []
    for _ in range(48):
        report = grasp.tick()
        shares.append(report.force[:, 2].sum() / report.normal_force_N)
    assert grasp.cube_position[2] - GRASP[2] < -5e-3
    # every contact slides downwards by now; the coefficient of the cube is 0.8
    assert np.mean(shares[24:]) == pytest.approx(0.8, rel=0.01)
