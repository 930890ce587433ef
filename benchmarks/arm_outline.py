"""How far the drawn and the touched shapes of the UR5e are from the public meshes of the same arm.

    MENAGERIE_ROOT=mujoco_menagerie python benchmarks/arm_outline.py

The folder is a checkout of MuJoCo Menagerie; nothing of it is copied here. The meshes lie on our links as in
recordings. Of each link: how far its mesh is out of our shapes (negative: inside), and how far our surface,
where no other link hides it, is from the meshes.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial import cKDTree

from cosim.build.arms import find_arm
from cosim.rigid.build.compiled_scene import compile_model
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.build.mjcf_arm import drawing_of

ARM = find_arm("ur5e")
LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")


def outside_m(model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], points: np.ndarray) -> np.ndarray:
    """Return the distances (n,) of points (n, 3) to the union of cylinders and boxes, negative inside."""
    found = np.full(len(points), np.inf)
    for geom in geoms:
        local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            across, along = np.hypot(local[:, 0], local[:, 1]), np.abs(local[:, 2])
            beyond = np.column_stack([across - size[0], along - size[1]])
        else:
            beyond = np.abs(local) - size
        away = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
        found = np.minimum(found, away)
    return found


def surface(model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], count: int = 4000) -> np.ndarray:
    """Return points (n, 3) on cylinders and boxes that are in none of the others."""
    rng, found = np.random.default_rng(0), []
    for geom in geoms:
        size, kind = model.geom_size[geom], model.geom_type[geom]
        if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            angle = rng.uniform(0.0, 2.0 * np.pi, count)
            on_side = rng.random(count) < 2.0 * size[1] / (2.0 * size[1] + size[0])
            radius = np.where(on_side, size[0], size[0] * np.sqrt(rng.random(count)))
            z = np.where(
                on_side, rng.uniform(-size[1], size[1], count), size[1] * rng.choice([-1.0, 1.0], count)
            )
            local = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
        else:
            local = rng.uniform(-size, size, (count, 3))
            side = rng.integers(0, 3, count)
            local[np.arange(count), side] = size[side] * rng.choice([-1.0, 1.0], count)
        points = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        others = [other for other in geoms if other != geom]
        found.append(points[outside_m(model, data, others, points) > 0.0] if others else points)
    return np.concatenate(found)


def mesh_points(model: mujoco.MjModel, data: mujoco.MjData, body: int, count: int = 60000) -> np.ndarray:
    """Return points (n, 3) spread evenly over the meshes that a body is drawn by."""
    turn, place = data.xmat[body].reshape(3, 3), data.xpos[body]
    meshes = [shape for shape in drawing_of(ARM, model).shapes if shape.body == body]
    triangles = np.concatenate([(shape.vertices @ turn.T + place)[shape.triangles] for shape in meshes])
    edges = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    area = np.linalg.norm(np.cross(*edges), axis=1)
    rng = np.random.default_rng(1)
    chosen = rng.choice(len(area), count, p=area / area.sum())
    s, t = rng.random((2, count))
    s, t = np.where(s + t > 1.0, 1.0 - s, s), np.where(s + t > 1.0, 1.0 - t, t)
    return triangles[chosen, 0] + s[:, None] * edges[0][chosen] + t[:, None] * edges[1][chosen]


def main() -> None:
    """Print the errors of each link [mm]."""
    model = compile_model(SceneDescription(ARM, floor_height_m=None))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    drawing = drawing_of(ARM, model)
    if not drawing.shapes:
        raise SystemExit(drawing.note)
    print(drawing.note)
    print("mesh out of our shapes: median, 95 %, most; our surface to the mesh: median, 95 %, most [mm]")
    meshes = {name: mesh_points(model, data, model.body(name).id) for name in LINKS}
    near = cKDTree(np.concatenate(list(meshes.values())))
    for what, touched in (("drawn", False), ("touched", True)):
        geoms = np.flatnonzero((model.geom_contype != 0) == touched)
        for name in LINKS:
            out = outside_m(model, data, geoms.tolist(), meshes[name])
            own = geoms[model.geom_bodyid[geoms] == model.body(name).id].tolist()
            points = surface(model, data, own)
            others = [geom for geom in geoms.tolist() if geom not in own]
            apart, _ = near.query(points[outside_m(model, data, others, points) > 0.0])
            found = [*np.percentile(out, [50, 95, 100]), *np.percentile(apart, [50, 95, 100])]
            print(f"{what} {name}: " + ", ".join(f"{1e3 * number:.1f}" for number in found))


if __name__ == "__main__":
    main()
