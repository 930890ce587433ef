"""A compiled scene with one geom of every kind, and surface samples to test distances against."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from cosim.base.frames import Array

KINDS = mujoco.mjtGeom
SIZES = {
    "plane": (KINDS.mjGEOM_PLANE, (1.0, 1.0, 0.1)),
    "sphere": (KINDS.mjGEOM_SPHERE, (0.02, 0.0, 0.0)),
    "capsule": (KINDS.mjGEOM_CAPSULE, (0.015, 0.02, 0.0)),
    "cylinder": (KINDS.mjGEOM_CYLINDER, (0.02, 0.012, 0.0)),
    "box": (KINDS.mjGEOM_BOX, (0.02, 0.015, 0.03)),
    "ellipsoid": (KINDS.mjGEOM_ELLIPSOID, (0.03, 0.02, 0.01)),
    "round ellipsoid": (KINDS.mjGEOM_ELLIPSOID, (0.02, 0.02, 0.005)),
    "hull": (KINDS.mjGEOM_MESH, (0.0, 0.0, 0.0)),
}


@cache
def hull_vertices() -> Array:
    """Return 60 points on an ellipsoid (60, 3) [m], far from the origin of their frame."""
    points = np.random.default_rng(3).normal(size=(60, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return np.asarray(points * (0.03, 0.02, 0.025) + np.array([0.01, 0.0, -0.02]))


@cache
def compiled() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the scene: bodies named as in `SIZES`, turned and moved."""
    rng = np.random.default_rng(1)
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="hull")
    mesh.uservert = hull_vertices().ravel().tolist()
    for name, (kind, size) in SIZES.items():
        body = spec.worldbody.add_body(name=name, pos=0.1 * rng.normal(size=3), quat=rng.normal(size=4))
        geom = body.add_geom(name=name, type=kind, size=size)
        if name == "hull":
            geom.meshname = "hull"
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def to_world(name: str, points: Array) -> Array:
    """Map points (n, 3) [m] from a body's frame to the world."""
    model, data = compiled()
    body = model.body(name).id
    return np.asarray(points @ data.xmat[body].reshape(3, 3).T + data.xpos[body])


def level(name: str, p: Array) -> Array:
    """Return an implicit function (n,) of a shape at points (n, 3) [m] of its body: negative inside."""
    size = np.array(SIZES[name][1])
    rho = np.hypot(p[:, 0], p[:, 1])
    match name.split()[-1]:
        case "plane":
            return np.asarray(p[:, 2])
        case "sphere":
            return np.asarray(np.linalg.norm(p, axis=1) - size[0])
        case "capsule":
            return np.asarray(np.hypot(rho, np.maximum(np.abs(p[:, 2]) - size[1], 0.0)) - size[0])
        case "cylinder":
            return np.asarray(np.maximum(rho - size[0], np.abs(p[:, 2]) - size[1]))
        case "box":
            return np.asarray((np.abs(p) - size).max(axis=1))
        case "ellipsoid":
            return np.asarray((np.sqrt(((p / size) ** 2).sum(axis=1)) - 1.0) * size.min())
        case _:
            hull = ConvexHull(hull_vertices())
            return np.asarray((p @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1))


def surface_samples(name: str, count: int) -> Array:
    """Return points (n, 3) [m] on the surface, body frame: rays from the middle, cut at the surface."""
    rng = np.random.default_rng(5)
    if name == "plane":
        return np.column_stack([rng.uniform(-0.2, 0.2, size=(count, 2)), np.zeros(count)])
    middle = hull_vertices().mean(axis=0) if name == "hull" else np.zeros(3)
    ray = rng.normal(size=(count, 3))
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    low, high = np.zeros(count), np.full(count, 0.2)
    for _ in range(50):
        half = 0.5 * (low + high)
        inside = level(name, middle + half[:, None] * ray) < 0.0
        low, high = np.where(inside, half, low), np.where(inside, high, half)
    return np.asarray(middle + low[:, None] * ray)
