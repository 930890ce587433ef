"""The solids of a compiled scene: of the arm's links, and of what they may meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, cast, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.solid import Solid, SolidShape
from cosim.rigid.scene.layout import ArmLayout

_SHAPES: Final[dict[int, SolidShape]] = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")): shape
    for shape in cast(tuple[SolidShape, ...], ("box", "sphere", "capsule", "cylinder", "ellipsoid", "plane"))
}


@final
@dataclass(frozen=True)
class SceneSolids:
    """Solids that collide, of what moves by plan or not at all; what objects will do is not known.

    Args:
        solids: of all bodies but objects that can move.
        links: (l,) indices of solids of links that move.
        among_links: (p, 2) indices of pairs of different links that no joint joins.
        carried: (c,) indices of solids that are mounted on the flange.
        others: (o,) indices of solids that are no part of the arm.
        flange: body whose frame is that of the flange.
    """

    solids: tuple[Solid, ...]
    links: IntArray
    among_links: IntArray
    carried: IntArray
    others: IntArray
    flange: int


def scene_solids(
    model: mujoco.MjModel, layout: ArmLayout, of_links: Mask, joined: frozenset[frozenset[int]], movable: Mask
) -> SceneSolids:
    """Return the solids of a scene.

    Args:
        model: compiled scene.
        layout: of the arm in the model.
        of_links: (bodies,), which are links of the arm.
        joined: pairs of bodies that do not count as touching.
        movable: (bodies,), which loads can move.
    """
    body, weld = model.geom_bodyid, model.body_weldid
    on_arm = model.body_rootid[body] == model.body_rootid[layout.mount]
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    geoms = np.flatnonzero(collides & (on_arm | ~movable[body]))
    solids = tuple(_solid(model, int(geom)) for geom in geoms)
    link, arm, moves = of_links[body[geoms]], on_arm[geoms], weld[body[geoms]] != 0
    pairs = [
        (a, b)
        for a in np.flatnonzero(link)
        for b in np.flatnonzero(link)
        if a < b and solids[a].body != solids[b].body
        if frozenset((solids[a].body, solids[b].body)) not in joined
    ]
    return SceneSolids(
        solids, np.flatnonzero(link & moves), np.array(pairs, dtype=np.int64).reshape(-1, 2),
        np.flatnonzero(arm & ~link), np.flatnonzero(~arm), layout.mount,
    )  # fmt: skip


def _solid(model: mujoco.MjModel, geom: int) -> Solid:
    body = int(model.geom_bodyid[geom])
    kind, name = int(model.geom_type[geom]), model.body(body).name
    pose = Pose.from_quaternion(np.array(model.geom_quat[geom]), np.array(model.geom_pos[geom]))
    if kind in _SHAPES:
        return Solid(body, name, _SHAPES[kind], np.array(model.geom_size[geom]), pose)
    return Solid(body, name, "hull", pose=pose, vertices=_vertices(model, geom))


def _vertices(model: mujoco.MjModel, geom: int) -> Array:
    mesh = int(model.geom_dataid[geom])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return np.array(model.mesh_vert[first : first + count], dtype=np.float64)
