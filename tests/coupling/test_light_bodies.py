"""A ball dropped on an inflated cushion bounces no higher than it was, however light it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.build.arms import find_arm
from cosim.coupling.contact.added_mass import BodyMass
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import StepOptions
from tests.coupling.pads import EDGE_M, Grasp
from tests.soft.bodies import icosphere

GRAVITY, RADIUS_M, BALL_M, DROP_M = 9.81, 0.025, 0.01, 0.02
HERE = np.array([0.0, 0.0, 1.5])  # above everything else in the scene


def energy_heights(mass_kg: float, tick_s: float, seconds: float) -> Array:
    """Return how far above its start the energy of a dropped ball could lift it, after each tick (n,) [m]."""
    x, triangles = icosphere(2, RADIUS_M)
    turn = np.array([[np.cos(0.3), 0.0, np.sin(0.3)], [0.0, 1.0, 0.0], [-np.sin(0.3), 0.0, np.cos(0.3)]])
    x = x @ turn.T
    held = np.flatnonzero(x[:, 2] < -0.6 * RADIUS_M)
    film = Film(1e8, 0.3, 1e-4)
    body = SoftBody.from_arrays(x, triangles, film, node_mass=1.2e-4, base=held, tip=held)
    start = HERE + np.array([0.004, 0.0, RADIUS_M + BALL_M + DROP_M])
    a, b, c = start.tolist()
    ball = SceneObject("ball", "sphere", (BALL_M,), (a, b, c), mass_kg=mass_kg)
    scene = RigidScene(SceneDescription(find_arm("ur5e"), tick_s=tick_s, objects=(ball,)))
    scene.set_control(scene.joint_position)
    flange = Pose(np.eye(3), HERE)
    options = StepOptions(tolerance_N=1e-6, damping_per_s=5.0)
    soft = SoftArm(body, flange, NewtonOptions(), options)
    exchange = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface())
    mass, loads = BodyMass(exchange, soft, tick_s), Loads((5e3,), (), (0.0, 0.0, -GRAVITY))
    index, found = scene.body_names.index("ball"), []
    for _ in range(round(seconds / tick_s)):
        scene.finish_step()
        scene.begin_step()
        soft.advance(flange, replace(loads, contact=exchange.find(soft.state, tick_s)), tick_s)
        exchange.settle(soft.state.positions)
        mass.update()
        height = scene.body_poses()[0][index, 2] - start[2]
        found.append(height + scene.bodies.free_speeds()[0] ** 2 / (2.0 * GRAVITY))
    return np.array(found)


@pytest.mark.parametrize("tick_s", [1e-3, 2e-3, 5e-3])
@pytest.mark.parametrize("mass_kg", [1e-6, 1e-4, 1e-3, 1e-2, 1.0])
def test_a_ball_bounces_no_higher_than_it_was(mass_kg: float, tick_s: float) -> None:
    # 0.1 g left with 23 m/s, 1 mg with 2.3 km/s, 1 g came 0.36 m high
    bounced = energy_heights(mass_kg, tick_s, 0.16)
    assert bounced.max() < 1e-9  # [m], rounding of a height of 1.5 m
    assert bounced[-1] < -5e-4  # and it has touched: a bounce costs at least that much of 20 mm


def test_a_body_carries_what_it_lacks() -> None:
    # with all of the film's answer on top of its own inertia, a body that lacks a little is twice as heavy
    grasp = Grasp(0.04, 2e-3)
    own = grasp.scene.save_state().armature
    for _ in range(40):
        grasp.tick()
    assert grasp.mass is not None
    carried = (grasp.scene.save_state().armature - own)[-6:]
    inertia = np.array([1.0, 1.0, 1.0, *[EDGE_M**2 / 6.0] * 3]) * 0.04
    assert 1.1 < grasp.mass.ratio < 4.0
    assert ((inertia + carried) / inertia).max() == pytest.approx(grasp.mass.ratio, rel=1e-9)
