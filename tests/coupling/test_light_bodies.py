"""A ball dropped on an inflated cushion takes the impulse that the film gives it, however light it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from cosim.app.preparation import build_simulation
from cosim.base.frames import Array, Pose, Wrench
from cosim.build.arms import find_arm
from cosim.config.loading import load_scenario
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.iterated import IteratedCoupling
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.ticks import ServoCommands
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from tests.coupling.one_tick import one_tick
from tests.coupling.pads import CoupledGrasp, FixedFlange
from tests.soft.bodies import icosphere

GRAVITY, RADIUS_M, BALL_M, DROP_M = 9.81, 0.025, 0.01, 0.02
HERE = np.array([0.0, 0.0, 1.5])  # above everything else in the scene


class Bounce(NamedTuple):
    """What a ball does, tick by tick.

    Args:
        height: (n,) [m], above where it began.
        velocity: (n, 3) [m/s], mean of the tick.
        force: (n, 3) [N], of the film on it, which acts in the next tick.
        ratio: (n,), contact ratio.
        momentum: (n, 3) [N s], at the end of the tick.
        impulse: (n, 3) [N s], of the film up to then, as a run shows the forces.
        fine: (n,), whether a tick had substeps.
    """

    height: Array
    velocity: Array
    force: Array
    ratio: Array
    momentum: Array
    impulse: Array
    fine: Array

    @property
    def energy_height(self) -> Array:
        """(n,) [m], how far above its start the ball's energy could lift it."""
        return np.asarray(self.height + (self.velocity**2).sum(axis=1) / (2.0 * GRAVITY))


def bounce(
    mass_kg: float,
    tick_s: float,
    seconds: float,
    scheme: Callable[[Interface], Coupling] = StaggeredCoupling,
    beside_m: tuple[float, ...] = (),
    substeps: int = 1,
) -> Bounce:
    """Drop a ball on a cushion, with another one beside it or none."""
    x, triangles = icosphere(2, RADIUS_M)
    turn = np.array([[np.cos(0.3), 0.0, np.sin(0.3)], [0.0, 1.0, 0.0], [-np.sin(0.3), 0.0, np.cos(0.3)]])
    x = x @ turn.T
    held = np.flatnonzero(x[:, 2] < -0.6 * RADIUS_M)
    film = Film(1e8, 0.3, 1e-4)
    body = SoftBody.from_arrays(x, triangles, film, node_mass=1.2e-4, base=held, tip=held)
    start = HERE + np.array([0.004, 0.0, RADIUS_M + BALL_M + DROP_M])
    balls = []
    for name, way in (("ball", np.zeros(3)), *([("other", np.array(beside_m))] if beside_m else [])):
        a, b, c = (start + way).tolist()
        balls.append(SceneObject(name, "sphere", (BALL_M,), (a, b, c), mass_kg=mass_kg))
    scene = RigidScene(
        SceneDescription(find_arm("ur5e"), tick_s=tick_s, substeps=substeps, objects=tuple(balls))
    )
    flange = Pose(np.eye(3), HERE)
    options = StepOptions(tolerance_N=1e-6, damping_per_s=5.0)
    soft = FilmRobot(body, flange, NewtonOptions(), options)
    exchange = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface())
    holder: Any = FixedFlange(scene, flange)
    coupling = scheme(Interface(holder, soft, Wrench(), exchange))
    loads, joints = Loads((5e3,), (), (0.0, 0.0, -GRAVITY)), scene.joint_position
    index, places, seen, shown = scene.body_names.index("ball"), [start], [], np.zeros(3)
    servos = ServoCommands.without_payload(joints[None], 0.0 * joints[None], np.zeros((1, 6)))
    for _ in range(round(seconds / tick_s)):
        fine, taken = scene.tick_s < tick_s, coupling.advance(servos, [loads])
        entry = taken.last()
        places.append(scene.body_poses()[0][index])
        shown = shown + tick_s * taken.body_contact_force[0, index]
        ball = mass_kg * scene.bodies.spins[index, 3:], shown
        force = exchange.report.on_each(len(scene.body_names))[index]
        seen.append((force, entry.contact_ratio, *ball, fine))
        assert entry.momentum_error < 1e-10
    velocity = np.diff(np.array(places), axis=0) / tick_s
    columns = map(np.array, zip(*seen, strict=True))
    return Bounce(np.array(places)[1:, 2] - start[2], velocity, *columns)


CASES = [(1e-6, 2e-3), (1e-4, 1e-3), (1e-4, 8e-3), (1e-3, 4e-3), (1e-2, 2e-3), (0.1, 4e-3), (1.0, 1e-3)]


@pytest.mark.parametrize(("mass_kg", "tick_s", "substeps"), [*((m, h, 1) for m, h in CASES), (0.1, 8e-3, 4)])
def test_the_films_impulse_is_the_balls_momentum(mass_kg: float, tick_s: float, substeps: int) -> None:
    # 1 g at 4 ms took up 700 times its momentum while it carried an algorithmic mass
    found = bounce(mass_kg, tick_s, 0.16, substeps=substeps)
    weight = mass_kg * np.array([0.0, 0.0, -GRAVITY]) * tick_s
    given = found.impulse + np.arange(1, len(found.impulse) + 1)[:, None] * weight
    assert found.force.any()
    assert found.fine.any() == (substeps > 1)
    assert given == pytest.approx(found.momentum, abs=1e-12 * mass_kg)


@pytest.mark.parametrize(("mass_kg", "tick_s"), CASES)
def test_a_ball_bounces_no_higher_than_it_was(mass_kg: float, tick_s: float) -> None:
    bounced = bounce(mass_kg, tick_s, 0.16).energy_height
    # rounding of a height of 1.5 m; a ball that is met a tick ahead of where it is may seem to keep its speed
    assert bounced.max() < 1e-9
    assert bounced[-1] < -5e-4  # and it has touched: a bounce costs at least that much of 20 mm


def test_both_schemes_agree_on_a_light_ball() -> None:
    # where the flange is held, nothing is left to iterate; staggered, 2 um a tick count as agreed
    plain, iterated = (bounce(1e-3, 4e-3, 0.12, scheme) for scheme in (StaggeredCoupling, IteratedCoupling))
    assert iterated.height == pytest.approx(plain.height, abs=2e-4)
    assert plain.ratio.max() > 10.0


def test_two_light_balls_give_way_at_once() -> None:
    # 22 mm beside the first, and as far above the film
    alone, beside = (bounce(1e-3, 4e-3, 0.1, IteratedCoupling, at) for at in ((), (-0.022, 0.0, -0.0047)))
    gained = 1e-3 * (beside.velocity[-1] - beside.velocity[0])
    weight = 1e-3 * np.array([0.0, 0.0, -GRAVITY]) * 4e-3 * (len(beside.force) - 1)
    assert 4e-3 * beside.force[:-1].sum(axis=0) + weight == pytest.approx(gained, abs=1e-12)
    # the film is pushed from two sides: it is not the same bounce, but one of that kind
    assert beside.force.any()
    assert np.abs(beside.height - alone.height).max() < 2e-3


def test_a_light_cube_between_pads_comes_to_rest() -> None:
    grasp = CoupledGrasp(0.03, 4e-3, StaggeredCoupling, "bdf2")
    force = []
    for _ in range(60):
        grasp.tick()
        force.append(grasp.grasp.exchange.report.force.sum(axis=0))
    assert force[-1][2] == pytest.approx(0.03 * GRAVITY, abs=0.01)  # the pads carry it
    # what film and body may disagree on in a tick comes back with the other sign in the next one
    to_and_fro = np.linalg.norm(np.diff(force[-12:], n=2, axis=0), axis=1) / 4.0
    assert to_and_fro.mean() < 2e-3


def test_a_light_cube_swings_in_pieces_of_ticks_as_in_short_ones() -> None:
    kept = []  # share of a swing after 0.16 s more
    for tick_s, pieces in ((4e-3, 8), (5e-4, 1)):
        grasp, height = CoupledGrasp(0.03, tick_s, StaggeredCoupling, "bdf2", substeps=pieces), []
        for _ in range(round(0.32 / tick_s)):
            grasp.tick()
            height.append(grasp.grasp.cube_position[2])
        _, before, _, after = np.array(height).reshape(4, -1)
        kept.append(np.ptp(after) / np.ptp(before))
    # whole ticks between pieces would damp it: each first step of another length is one of implicit Euler
    assert kept[0] == pytest.approx(kept[1], rel=0.1)


def test_a_load_of_several_steps_that_acts_late_adds_no_energy() -> None:
    grasp = CoupledGrasp(0.6, 4e-3, StaggeredCoupling, "bdf2", substeps=8)
    height, fine = [], []
    for _ in range(260):
        grasp.tick()
        height.append(grasp.grasp.cube_position[2])
        fine.append(grasp.coupling.substepping.state > 0)
    assert grasp.interface.contact_ratio < 0.5  # it bears its load a tick late
    assert not any(fine[110:])  # and ticks are whole again
    first, last = np.ptp(height[110:160]), np.ptp(height[210:])
    assert 0.85 * first < last < first  # it swings on the film, damped by 5 per s


def test_what_a_light_ball_does_hangs_on_its_mass_no_longer() -> None:
    # the film hardly feels either: both are thrown back alike
    gram, milligram = (bounce(mass, 2e-3, 0.1) for mass in (1e-4, 1e-6))
    assert milligram.height == pytest.approx(gram.height, abs=1e-3)
    strongest = [float(np.linalg.norm(found.force, axis=1).max()) for found in (gram, milligram)]
    assert strongest[0] / strongest[1] == pytest.approx(100.0, rel=0.1)


@pytest.mark.parametrize(
    ("shape", "size_m", "mass_kg", "tick_s"),
    [("sphere", (0.015,), 1e-3, 4e-3), ("box", (0.03, 0.03, 0.03), 1e-4, 2e-3)],
)
def test_what_is_pressed_on_a_table_is_not_thrown_as_it_gets_loose(
    shape: str, size_m: tuple[float, ...], mass_kg: float, tick_s: float
) -> None:
    # 50 and 900 times its weight; the box left with 8 m/s, as MuJoCo's contact gave way to it by 10 mm
    half = size_m[0] if shape == "sphere" else 0.5 * size_m[0]
    table = SceneObject("table", "box", (0.4, 0.4, 0.05), (0.0, 0.0, 0.975))
    item = SceneObject("item", shape, size_m, (0.0, 0.0, 1.0 + half), mass_kg=mass_kg)
    scene = RigidScene(SceneDescription(find_arm("ur5e"), tick_s=tick_s, objects=(table, item)))
    x, triangles = icosphere(2, RADIUS_M)
    x = x @ np.array([[np.cos(0.3), 0.0, -np.sin(0.3)], [0.0, 1.0, 0.0], [np.sin(0.3), 0.0, np.cos(0.3)]])
    held = np.flatnonzero(x[:, 2] > 0.6 * RADIUS_M)
    body = SoftBody.from_arrays(x, triangles, Film(1e8, 0.3, 1e-4), node_mass=1.2e-4, base=held, tip=held)
    high = np.array([0.0, 0.0, 1.002 + 2.0 * half + RADIUS_M])
    soft = FilmRobot(
        body, Pose(np.eye(3), high), NewtonOptions(), StepOptions(tolerance_N=1e-6, damping_per_s=5.0)
    )
    exchange = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface())
    holder: Any = FixedFlange(scene, Pose(np.eye(3), high))
    coupling = StaggeredCoupling(Interface(holder, soft, Wrench(), exchange))
    index, places, forces = scene.body_names.index("item"), [], []
    for time_s in np.arange(0.0, 0.5, tick_s):  # 1 mm deep after 0.15 s, until 0.3 s, and up again
        deep = min(time_s / 0.15, 1.0, max(0.0, (0.4 - time_s) / 0.1))
        holder.flange_pose = Pose(np.eye(3), high - np.array([0.0, 0.0, 0.003 * deep]))
        one_tick(coupling, scene.joint_position, np.zeros(6), Loads((5e3,), (), (0.0, 0.0, -GRAVITY)))
        places.append(scene.body_poses()[0][index] - item.position_m)
        forces.append(-exchange.report.on_each(len(scene.body_names))[index, 2])
    way = np.array(places)
    assert max(forces) > 0.4
    assert np.abs(np.diff(way, axis=0)).max() / tick_s < 0.5
    assert np.abs(way[:, 2]).max() < 1e-3
    assert np.abs(way[-1]).max() < 1e-3


def test_a_light_spool_is_not_thrown_between_fingers_and_palm() -> None:
    # 6,000 N, and an error, as the film met it where it had gone on as before, though the palm held it up
    changes = {"object.spool.mass_kg": 0.02, "model.published": True}
    simulation = build_simulation(load_scenario("gripper_lifts_spool", changes))
    last = simulation.stage.phase_names.index("close")
    strongest, path = 0.0, []
    for snapshot in simulation.steps():
        if snapshot.phase > last:
            break
        strongest = max(strongest, snapshot.contact_force_N)
        path.append(snapshot.body_position[simulation.stage.body_names.index("spool")])
    assert 5.0 < strongest < 30.0  # the fingers close with 12 N
    assert np.ptp(path[-25:], axis=0).max() < 1e-4
