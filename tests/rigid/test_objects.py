"""Objects of several solids and of meshes: mass, centre, drawing, and distances."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cosim.base.frames import Array, Pose
from cosim.base.resources import object_mesh_path
from cosim.base.triangle_mesh import TriangleMesh, read_mesh
from cosim.build.arms import find_arm
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import Geometry, SceneDescription, SceneObject
from cosim.rigid.distance.surfaces import surface_distance
from cosim.rigid.scene.scene import RigidScene

ARM = find_arm("ur5e")


def scene_of(*objects: SceneObject) -> RigidScene:
    return RigidScene(SceneDescription(ARM, objects=objects, floor_height_m=None))


def spool() -> TriangleMesh:
    return read_mesh(Path(object_mesh_path("spool.obj")))


def around(mesh: TriangleMesh, count: int, margin: float = 0.01) -> Array:
    low, high = mesh.vertices.min(axis=0) - margin, mesh.vertices.max(axis=0) + margin
    return np.random.default_rng(4).uniform(low, high, size=(count, 3))


def test_parts_share_the_mass_by_volume_and_density() -> None:
    pot = Geometry("cylinder", (0.03, 0.04), (0.0, 0.0, -0.05), relative_density=2.0)
    leaf = Geometry("ellipsoid", (0.03, 0.01, 0.002), (0.02, 0.0, 0.05))
    plant = SceneObject("plant", position_m=(1.0, 0.0, 1.0), mass_kg=0.2, parts=(pot, leaf))
    scene = scene_of(plant)
    body = np.array([scene.body_names.index("plant")])
    assert np.diag(scene.bodies.mobility(body, held=True))[:3] == pytest.approx(1.0 / 0.2, rel=1e-12)
    weight = np.array([2.0 * np.pi * 0.03**2 * 0.04, 4.0 / 3.0 * np.pi * 0.03 * 0.01 * 0.002])
    center = (weight @ np.array([pot.position_m, leaf.position_m])) / weight.sum()
    # gravity alone, no torque about the centre of mass: the centre falls, and nothing turns
    for _ in range(20):
        scene.step()
    positions, quaternions = scene.body_poses()
    fallen = Pose.from_quaternion(quaternions[body[0]], positions[body[0]]).apply(center[None])[0]
    steps = 0.5 * 20 * 21 * 9.81 * scene.tick_s**2  # of the semi-implicit rule
    np.testing.assert_allclose(fallen, np.array([1.0, 0.0, 1.0 - steps]) + center, atol=1e-9)


def test_every_part_is_drawn_where_it_is() -> None:
    leaf = Geometry("ellipsoid", (0.03, 0.01, 0.002), (0.2, 0.0, 0.5), rgba=(0.0, 1.0, 0.0, 1.0))
    plant = SceneObject("plant", "sphere", (0.1,), (1.0, 0.0, 1.0), parts=(leaf,))
    scene = scene_of(plant)
    drawn = [shape for shape in scene.shapes if scene.body_names[shape.body] == "plant"]
    assert len(drawn) == 2
    np.testing.assert_allclose(drawn[1].vertices.mean(axis=0), leaf.position_m, atol=1e-3)
    np.testing.assert_allclose(np.ptp(drawn[1].vertices, axis=0), (0.06, 0.02, 0.004), rtol=0.01)
    assert drawn[1].rgba == pytest.approx(leaf.rgba)


@pytest.mark.parametrize("quaternion", [(1.0, 0.0, 0.0, 0.0), (0.3, 0.5, -0.2, 0.8)])
def test_the_distance_to_convex_shells_is_exact(quaternion: tuple[float, float, float, float]) -> None:
    mesh = spool()
    item = SceneObject("spool", "mesh", (), (0.8, 0.1, 0.9), quaternion, mass_kg=0.1, mesh=mesh)
    scene = scene_of(item)
    points = around(mesh, 2000)
    exact = np.min(
        [surface_distance(points, shell.vertices[shell.triangles]) for shell in mesh.shells()], axis=0
    )
    query = scene.contact_query()
    world = Pose.from_quaternion(np.array(quaternion), np.array(item.position_m)).apply(points)
    hits = query.distances(world, 1.0)
    found = np.full(len(points), np.inf)
    np.minimum.at(found, hits.point, hits.distance)
    assert (exact < 0.0).sum() > 200
    np.testing.assert_allclose(found, exact, atol=1e-7)
    # and the corners of the rims are tested against the film
    rims = query.feature_positions(np.arange(len(query.features.shape)))
    assert len(rims) > 200


def test_a_hollow_mesh_is_touched_inside_its_hull() -> None:
    mesh = spool()
    scene = scene_of(SceneObject("spool", "mesh", mass_kg=0.1, mesh=mesh, convex=False))
    points = around(mesh, 2000, 0.004)
    outside = np.min(
        [surface_distance(points, shell.vertices[shell.triangles]) for shell in mesh.shells()], axis=0
    )
    hits = scene.contact_query().distances(points, 1.0)
    found = np.full(len(points), np.inf)
    found[hits.point] = hits.distance
    near = (outside > 0.0) & (outside < 4e-3)
    in_the_hull = (ConvexHull(mesh.vertices).equations @ np.c_[points, np.ones(len(points))].T).max(
        axis=0
    ) < 0
    assert (near & in_the_hull).sum() > 100
    # cells of 1.8 mm: blunt at the rims, good in the median
    assert np.abs(found - outside)[near].max() < 0.8e-3
    assert np.median(np.abs(found - outside)[near]) < 0.05e-3


def test_the_inertia_of_a_mesh_is_that_of_its_solid() -> None:
    mesh = spool()
    cylinders = (
        Geometry("cylinder", (0.024, 0.082)),
        Geometry("cylinder", (0.036, 0.004), (0.0, 0.0, -0.042)),
        Geometry("cylinder", (0.036, 0.004), (0.0, 0.0, 0.042)),
    )
    round_one = SceneObject("round", mass_kg=0.1, parts=cylinders, position_m=(1.0, 0.0, 0.0))
    scene = scene_of(
        SceneObject("spool", "mesh", mass_kg=0.1, mesh=mesh, position_m=(1.0, 1.0, 0.0)), round_one
    )
    bodies = np.array([scene.body_names.index(name) for name in ("spool", "round")])
    of_mesh, of_cylinders = np.diag(scene.bodies.mobility(bodies, held=True)).reshape(2, 6)
    # a 32-gon has 0.6 % less inertia per area than its circle
    np.testing.assert_allclose(of_mesh, of_cylinders, rtol=0.01)


def test_both_mobilities_are_those_of_a_held_and_of_a_free_body() -> None:
    table = SceneObject("table", "box", (0.2, 0.2, 0.1), (1.0, 0.0, -0.05))
    block = SceneObject("block", "box", (0.02, 0.02, 0.02), (1.0, 0.0, 0.01), mass_kg=0.2)
    scene = scene_of(table, block)
    for _ in range(50):
        scene.step()
    bodies = np.array([scene.body_names.index("block")])
    held, free = scene.bodies.mobilities(bodies)
    np.testing.assert_allclose(held, scene.bodies.mobility(bodies, held=True), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(free, scene.bodies.mobility(bodies, held=False))
    assert held[2, 2] < 0.1 * free[2, 2]


def test_one_object_of_a_gripper_moves_alike_with_and_without_islands_of_constraints() -> None:
    table = SceneObject("table", "box", (0.2, 0.2, 0.1), (1.0, 0.0, -0.05))
    block = SceneObject("block", "box", (0.02, 0.02, 0.02), (1.0, 0.0, 0.015), mass_kg=0.2)
    palm = SceneObject("palm", "cylinder", (0.05, 0.01))
    model = CompiledScene(SceneDescription(ARM, mounted=(palm,), objects=(table, block))).model()
    islands = mujoco.mjtDisableBit.mjDSBL_ISLAND
    ends = []
    assert model.opt.disableflags & islands
    for disabled in (islands, 0):
        model.opt.disableflags = disabled
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 100)
        ends.append(np.concatenate([data.qpos, data.qvel]))
        assert data.ncon
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)


def corners_of(mesh: TriangleMesh) -> Array:
    """Return the corners (n, 3) [m] by which a mesh touches a palm."""
    palm = SceneObject("palm", "cylinder", (0.05, 0.01))
    held = SceneObject("held", "mesh", mesh=mesh, position_m=(1.0, 0.0, 1.0), mass_kg=0.1)
    model = CompiledScene(SceneDescription(ARM, mounted=(palm,), objects=(held,))).model()
    geoms = [g for g in range(model.ngeom) if "/corner" in model.geom(g).name]
    assert model.npair == len(geoms)
    return np.array(model.geom_pos[geoms])


def hull_mesh(points: Array) -> TriangleMesh:
    """Return the convex hull of points (n, 3) [m], its triangles counter-clockwise seen from outside."""
    triangles = ConvexHull(points).simplices
    first, second, third = points[triangles].transpose(1, 0, 2)
    inward = np.einsum("kr,kr->k", np.cross(second - first, third - first), first - points.mean(axis=0)) < 0.0
    return TriangleMesh(points, np.where(inward[:, None], triangles[:, ::-1], triangles))


@pytest.mark.parametrize(("radius", "height"), [(0.03, 0.004), (0.005, 0.2)])
def test_a_mesh_with_many_corners_touches_a_palm_with_no_more_than_a_cylinder(
    radius: float, height: float
) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    rim = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.concatenate([np.column_stack([rim, np.full(64, z)]) for z in (-0.5 * height, 0.5 * height)])
    corners = corners_of(hull_mesh(points))
    assert 20 <= len(corners) <= 32  # of 128; a cylinder has 24
    ways = np.random.default_rng(0).normal(size=(2000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    lacking = (points @ ways.T).max(axis=0) - (corners @ ways.T).max(axis=0)
    assert lacking.max() < 0.045 * radius  # 0.034 in the directions that are looked at


def test_a_mesh_with_few_corners_keeps_them_all() -> None:
    box = 0.5 * np.array(list(np.ndindex(2, 2, 2))) * (0.04, 0.03, 0.002)
    assert len(corners_of(hull_mesh(box))) == 8
