"""A film lowered onto an object of every shape: it is carried, and action equals reaction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.base.resources import object_mesh_path
from cosim.base.triangle_mesh import TriangleMesh, read_mesh
from cosim.build.arms import find_arm
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.rigid.build.description import Geometry, SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.element import Sums
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from tests.soft.bodies import icosphere

RADIUS_M, TICK_S, PRESSURE_PA = 0.05, 2e-3, 5e3
PLACE = (0.0, 0.0, 1.0)


def octahedron(size_m: float) -> TriangleMesh:
    """Return an octahedron with its corners on the axes."""
    corners = size_m * np.concatenate([np.eye(3), -np.eye(3)])
    around = [(0, 1), (1, 3), (3, 4), (4, 0)]
    return TriangleMesh(corners, np.array([(a, b, 2) for a, b in around] + [(b, a, 5) for a, b in around]))


def leaves() -> tuple[Geometry, ...]:
    turned = tuple(Pose.from_quaternion(np.array([0.99, 0.05, 0.1, 0.0]), np.zeros(3)).quaternion.tolist())
    leaf = Geometry("ellipsoid", (0.03, 0.02, 0.005), (0.0, 0.0, 0.018), turned)
    return (Geometry("capsule", (0.01, 0.02), (0.0, 0.0, -0.01)), leaf)


# name -> what is given of the object, and how high its top is above its origin [m]
SHAPES: dict[str, tuple[dict[str, object], float]] = {
    "box": ({"shape": "box", "size_m": (0.04, 0.05, 0.03)}, 0.015),
    "sphere": ({"shape": "sphere", "size_m": (0.03,)}, 0.03),
    "cylinder": ({"shape": "cylinder", "size_m": (0.02, 0.04)}, 0.02),
    "capsule": ({"shape": "capsule", "size_m": (0.02, 0.03)}, 0.035),
    "ellipsoid": ({"shape": "ellipsoid", "size_m": (0.03, 0.02, 0.025)}, 0.025),
    "mesh of hulls": ({"shape": "mesh", "mesh": read_mesh(object_mesh_path("spool.obj"))}, 0.044),
    "mesh by distances": ({"shape": "mesh", "mesh": octahedron(0.03), "convex": False}, 0.03),
    "compound": ({"parts": leaves()}, 0.026),
}


@pytest.mark.parametrize("name", SHAPES)
def test_action_equals_reaction_on_every_shape(name: str) -> None:
    values, top = SHAPES[name]
    item = SceneObject("thing", position_m=PLACE, mass_kg=0.1, **values)
    description = SceneDescription(find_arm("ur5e"), tick_s=TICK_S, objects=(item,), gravity=(0.0, 0.0, 0.0))
    scene = RigidScene(description)
    x, triangles = icosphere(3, RADIUS_M)
    held = np.flatnonzero(x[:, 2] > 0.7 * RADIUS_M)
    body = SoftBody.from_arrays(x, triangles, Film(1e9, 0.3, 5e-5), node_mass=3e-5, base=held, tip=held)
    start = np.array(PLACE) + np.array([0.003, 0.002, top + RADIUS_M + 2e-4])
    options = StepOptions(tolerance_N=1e-6, damping_per_s=5.0)
    soft = FilmRobot(body, Pose(np.eye(3), start), NewtonOptions(), options)
    exchange = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface())
    loads = Loads((PRESSURE_PA,), (), (0.0, 0.0, 0.0))
    pressed = 0.0
    for tick in range(15):
        scene.step()
        planes = exchange.find(soft.state, TICK_S)
        flange = Pose(np.eye(3), start - np.array([0.0, 0.0, 2e-4 * (tick + 1)]))
        soft.advance(flange, replace(loads, contact=planes), TICK_S)
        report = exchange.commit(soft.state.positions, soft.state.positions)
        if planes is None or not report.count:
            continue
        gradient = np.zeros_like(x)
        planes.add(soft.state.positions, Sums(gradient), hessian=False)
        scale = np.abs(gradient).sum()
        total = report.force.sum(axis=0)
        assert np.abs(total - gradient.sum(axis=0)).max() < 1e-10 * scale
        about = np.cross(soft.state.positions - start, gradient).sum(axis=0)
        torque = report.torque.sum(axis=0) - np.cross(start, total)
        assert np.abs(torque - about).max() < 1e-10 * scale
        pressed = max(pressed, report.normal_force_N)
        assert report.depth_m < 1e-3
    assert pressed > 0.1
    moved = scene.body_poses()[0][scene.body_names.index("thing")] - PLACE
    assert moved[2] < -1e-6  # what is pushed goes away
