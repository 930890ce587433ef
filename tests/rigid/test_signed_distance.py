"""Signed distances to every kind of geom, at every depth."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.signed_distance import Hits
from cosim.rigid.distance.surfaces import surface_distance
from tests.rigid.shapes import SIZES, compiled, level, surface_samples, to_world

FAR_M = 1.0


def asked(name: str, points: Array, reach_m: float = FAR_M) -> Hits:
    """Return the hits of points (n, 3) [m], world, on one geom."""
    model, data = compiled()
    return ContactQuery(model, data, [model.geom(name).id]).distances(points, reach_m)


def scattered(name: str, count: int = 1500) -> Array:
    """Return points in and around a shape, body frame: a cloud, its axes, its middle."""
    rng = np.random.default_rng(7)
    cloud = rng.uniform(-0.05, 0.05, size=(count, 3))
    axes = np.concatenate([np.outer(np.linspace(-0.05, 0.05, 41), axis) for axis in np.eye(3)])
    flat = rng.uniform(-0.03, 0.03, size=(100, 3)) * (1.0, 1.0, 0.0)
    return np.concatenate([cloud, axes, flat, surface_samples(name, 50)])


@pytest.mark.parametrize("name", SIZES)
def test_the_foot_of_the_normal_is_the_nearest_surface_point(name: str) -> None:
    points = scattered(name)
    world = to_world(name, points)
    hits = asked(name, world)
    np.testing.assert_array_equal(hits.point, np.arange(len(points)))
    np.testing.assert_allclose(np.linalg.norm(hits.normal, axis=1), 1.0, rtol=1e-12)
    inside = level(name, points) < -1e-9
    assert inside.sum() > 20
    assert (hits.distance[inside] < 0.0).all()
    assert (hits.distance[level(name, points) > 1e-9] > 0.0).all()
    # the foot lies on the surface: |d| is not too small ...
    _, data = compiled()
    turn, place = data.body(name).xmat.reshape(3, 3), data.body(name).xpos
    foot = (world - hits.distance[:, None] * hits.normal - place) @ turn
    # MuJoCo keeps mesh vertices in single precision
    assert np.abs(level(name, foot)).max() < (2e-8 if name == "hull" else 1e-10)
    # ... and no surface point is nearer: it is not too large
    samples = surface_samples(name, 20000)
    some = np.arange(0, len(points), 7)
    nearest = np.array([np.linalg.norm(samples - points[k], axis=1).min() for k in some])
    assert (np.abs(hits.distance[some]) < nearest + 1e-8).all()


def test_points_beyond_the_reach_are_left_out() -> None:
    for name in ("box", "hull", "ellipsoid"):
        world = to_world(name, scattered(name))
        everything, near = asked(name, world), asked(name, world, 0.003)
        kept = everything.distance < 0.003
        np.testing.assert_array_equal(near.point, everything.point[kept])
        np.testing.assert_allclose(near.distance, everything.distance[kept], rtol=1e-12)
        assert 20 < len(near) < len(everything)


def test_the_broad_phase_keeps_every_shape_that_has_a_hit() -> None:
    model, data = compiled()
    query = ContactQuery(model, data, np.arange(model.ngeom))
    rng = np.random.default_rng(2)
    dropped = 0
    for _ in range(200):
        points = rng.normal(scale=0.15, size=3) + rng.uniform(-0.02, 0.02, size=(50, 3))
        near = query.near(points.min(axis=0), points.max(axis=0), 0.002)
        touched = np.unique(query.distances(points, 0.002).shape)
        assert set(touched) <= set(near)
        dropped += len(query) - len(near)
    assert dropped > 200 * 0.5 * len(query)  # and it does drop shapes


def test_a_closed_surface_knows_its_inside() -> None:
    half = np.array([0.02, 0.03, 0.01])
    corners = np.array(list(np.ndindex(2, 2, 2))) * 2.0 * half - half
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
         [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    points = np.random.default_rng(0).uniform(-0.05, 0.05, size=(500, 3))
    beyond = np.abs(points) - half
    wanted = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
    assert (wanted < 0.0).sum() > 10
    np.testing.assert_allclose(surface_distance(points, corners[faces]), wanted, atol=1e-15)


@pytest.mark.parametrize("kind", [mujoco.mjtGeom.mjGEOM_TRIANGLE, mujoco.mjtGeom.mjGEOM_HFIELD])
def test_a_geom_without_surface_is_refused(kind: mujoco.mjtGeom) -> None:
    model, data = compiled()
    kinds = model.geom_type.copy()
    try:
        model.geom_type[model.geom("box").id] = kind
        with pytest.raises(InputError, match=r"'box'.*no surface"):
            ContactQuery(model, data, [model.geom("box").id])
    finally:
        model.geom_type[:] = kinds


def test_a_geom_of_distances_serves_a_hollow_shape() -> None:
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="ring", needsdf=True)
    corners, faces = ring_of_boxes()
    mesh.uservert, mesh.userface = corners.ravel().tolist(), faces.ravel().tolist()
    spec.worldbody.add_geom(name="ring", type=mujoco.mjtGeom.mjGEOM_SDF, meshname="ring")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    query = ContactQuery(model, data, [0])
    shapes = query.shapes
    end = shapes.origin[0] + shapes.spacing[0] * (shapes.table[0, 1:] - 1)
    np.testing.assert_allclose(end, -shapes.origin[0], atol=1e-9)  # the same rim on all sides
    points = np.random.default_rng(0).uniform(-0.05, 0.05, size=(2000, 3))
    wanted = surface_distance(points, corners[faces])
    near = np.abs(wanted) < 0.004
    hits = query.distances(points, FAR_M)
    found = np.full(len(points), np.nan)
    found[hits.point] = hits.distance
    assert near.sum() > 200
    # trilinear cells of 2 mm: what a cell with an edge in it can err
    assert np.abs(found - wanted)[near].max() < 0.6e-3
    assert np.median(np.abs(found - wanted)[near]) < 0.05e-3
    in_the_hole = np.linalg.norm(points[:, :2], axis=1) < 0.01
    assert in_the_hole.any()
    assert not (found[in_the_hole] < 0.0).any()


def ring_of_boxes() -> tuple[Array, IntArray]:
    """Return vertices and triangles of a square ring: edges 80 mm outside, 40 mm inside, 20 mm high."""
    turn = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    rings = [(0.04, -0.01), (0.04, 0.01), (0.02, 0.01), (0.02, -0.01)]
    corners = np.concatenate([np.column_stack([r * turn, np.full(4, z)]) for r, z in rings])
    faces = []
    for ring in range(4):
        for k in range(4):
            a, b = 4 * ring + k, 4 * ring + (k + 1) % 4
            c, d = 4 * ((ring + 1) % 4) + (k + 1) % 4, 4 * ((ring + 1) % 4) + k
            faces += [[a, b, c], [a, c, d]]
    return corners, np.array(faces)
