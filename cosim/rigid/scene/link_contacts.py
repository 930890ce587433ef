"""Where links of the arm are in one another, in an object or in the floor.

The solids of a compiled scene: of the arm's links, and of what they may meet.

MuJoCo's own contacts show no two links: these meet nothing but floor and objects. So contacts are searched
for in a copy of the model in which the arm's links meet everything, and nothing else meets anything.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Final, cast, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.solid import FilmInLink, LinkContact, Solid, SolidShape
from cosim.rigid.build.object_bodies import mesh_of
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene.arm import ArmLayout
from cosim.rigid.scene.bodies import moved_by_loads

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
    return Solid(body, name, "hull", pose=pose, vertices=mesh_of(model, geom)[0])


_SEEN_M = 0.01  # from here on, distances are known; to know of more costs more than it saves
_IN_LINK_M = 1e-4
_LINK, _OBJECT = 1, 2  # bits: links look for both, objects for links only


@final
class LinkContacts:
    """Finds the contacts of an arm's links; what is mounted on the flange is left out.

    Links that a joint joins do not count as touching, nor does what stands still on both sides.

    Args:
        model: compiled scene.
        data: its state.
        layout: of the arm in the model.
        driven: (bodies,), which no load moves though they have joints.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, layout: ArmLayout, driven: Mask) -> None:
        self._scene, self._live, self._layout = model, data, layout
        self._movable = moved_by_loads(model) & ~driven
        self._model = own = copy.copy(model)
        on_arm = own.body_rootid == own.body_rootid[layout.mount]
        links = on_arm & ~_below(own, layout.mount)
        collides = (own.geom_contype | own.geom_conaffinity) != 0
        link_geom, object_geom = (collides & chosen[own.geom_bodyid] for chosen in (links, ~on_arm))
        own.geom_contype[:] = np.where(link_geom, _LINK | _OBJECT, 0)
        own.geom_conaffinity[:] = np.where(link_geom, _LINK, np.where(object_geom, _OBJECT, 0))
        for bits, of_geoms in (
            (own.body_contype, own.geom_contype), (own.body_conaffinity, own.geom_conaffinity)
        ):  # fmt: skip
            bits[:] = 0
            np.bitwise_or.at(bits, own.geom_bodyid, of_geoms)
        self._of_links = links
        self._is_link = links.tolist()
        self._names = [own.body(i).name for i in range(own.nbody)]
        self._found = mujoco.MjData(own)
        self._joined = _joined_pairs(own)
        near = [body for body in range(own.nbody) if frozenset((body, layout.mount)) in self._joined]
        self._far = np.flatnonzero(link_geom & ~np.isin(own.geom_bodyid, near))
        # MuJoCo adds the margins of both
        own.geom_margin[:], own.body_margin[:] = 0.5 * _SEEN_M, 0.5 * _SEEN_M
        # where nothing else moves, an arm that has hardly moved since it was clear is clear
        self._arm_alone = model.nv == len(model.jnt_dofadr[layout.joints])
        self._reach_m = max(
            1.0, float(np.linalg.norm(own.body_pos[links], axis=1).sum() + _size(own, link_geom))
        )
        self._seen_at, self._clearance_m = (
            np.full(layout.positions.stop - layout.positions.start, np.inf),
            0.0,
        )
        self._free = np.flatnonzero(own.jnt_type == mujoco.mjtJoint.mjJNT_FREE)

    def at(
        self, joints: Array, places: Array | None = None, quaternions: Array | None = None
    ) -> tuple[LinkContact, ...]:
        """Return what touches with the arm at some angles; nothing changes in the scene.

        Args:
            joints: (joints,) [rad].
            places: (bodies, 3) [m], world: where free bodies are; as in the scene unless given.
            quaternions: (bodies, 4), (w, x, y, z), the same.
        """
        if self._arm_alone and np.abs(joints - self._seen_at).sum() * self._reach_m < self._clearance_m:
            return ()
        model, data = self._model, self._found
        self._pose(joints)
        if places is not None and quaternions is not None:
            for joint in self._free:
                first, body = model.jnt_qposadr[joint], model.jnt_bodyid[joint]
                data.qpos[first : first + 3] = places[body]
                data.qpos[first + 3 : first + 7] = quaternions[body]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        self._seen_at, self._clearance_m = joints.copy(), self._smallest_distance(data)
        return self._read(data) if self._clearance_m <= 0.0 else ()

    def _pose(self, joints: Array) -> None:
        self._found.qpos[:] = self._live.qpos
        self._found.qpos[self._layout.positions] = joints

    def with_film(self, points: Array, joints: Array) -> tuple[FilmInLink, ...]:
        """Return in which links a film on the flange is by more than 0.1 mm, but for those next to it.

        Args:
            points: (n, 3) [m], its nodes, world.
            joints: (joints,) [rad].
        """
        self._pose(joints)
        mujoco.mj_kinematics(self._model, self._found)
        places, sizes = self._found.geom_xpos[self._far], self._model.geom_rbound[self._far]
        off = places - np.clip(places, points.min(axis=0), points.max(axis=0))
        if not (np.linalg.norm(off, axis=1) < sizes).any():
            return ()
        query = self._query
        query.update()
        low, high = points.min(axis=0), points.max(axis=0)
        hits = query.distances(points, 0.0, query.near(low, high, 0.0))
        deepest: dict[int, int] = {}
        for row in np.argsort(hits.distance)[::-1].tolist():
            deepest[int(query.body[hits.shape[row]])] = row
        return tuple(
            FilmInLink(self._names[body], -float(hits.distance[row]), int(hits.point[row]))
            for body, row in sorted(deepest.items())
            if hits.distance[row] < -_IN_LINK_M
        )

    @cached_property
    def _query(self) -> ContactQuery:
        return ContactQuery(self._model, self._found, self._far)

    def _smallest_distance(self, data: mujoco.MjData) -> float:
        """Return how near links are to touching [m], `_SEEN_M` at most."""
        if not data.ncon:
            return _SEEN_M
        pairs = self._model.geom_bodyid[data.contact.geom].tolist()
        distances = zip(pairs, data.contact.dist.tolist(), strict=True)
        near = [distance for pair, distance in distances if frozenset(pair) not in self._joined]
        return min(near, default=_SEEN_M)

    def solids(self) -> SceneSolids:
        """Return the solids between which the contacts are searched for."""
        return scene_solids(self._scene, self._layout, self._of_links, self._joined, self._movable)

    def with_objects(self) -> tuple[LinkContact, ...]:
        """Return which links touch floor or objects in the scene's present state; hardly costs anything."""
        return self._read(self._live) if self._live.ncon else ()

    def _read(self, data: mujoco.MjData) -> tuple[LinkContact, ...]:
        is_link, movable = self._is_link, self._movable
        deepest: dict[tuple[int, int], float] = {}
        pairs = self._model.geom_bodyid[data.contact.geom].tolist()
        for (a, b), distance in zip(pairs, data.contact.dist.tolist(), strict=True):
            link, other = (a, b) if is_link[a] and (a < b or not is_link[b]) else (b, a)
            if is_link[link] and distance < 0.0 and frozenset((a, b)) not in self._joined:
                deepest[link, other] = max(-distance, deepest.get((link, other), 0.0))
        return tuple(
            LinkContact(
                self._names[link], self._names[other], depth, bool(movable[other] and not is_link[other])
            )
            for (link, other), depth in deepest.items()
        )


def _size(model: mujoco.MjModel, geoms: Mask) -> float:
    """Return how far the farthest point of geoms (g,) is from its body's origin, at most [m]."""
    return float((np.linalg.norm(model.geom_pos[geoms], axis=1) + model.geom_rbound[geoms]).max(initial=0.0))


def _below(model: mujoco.MjModel, top: int) -> Mask:
    """Return which bodies are a body or hang on it (bodies,)."""
    below = np.zeros(model.nbody, dtype=bool)
    below[top] = True
    for body in range(top + 1, model.nbody):
        below[body] |= below[model.body_parentid[body]]
    return below


def _joined_pairs(model: mujoco.MjModel) -> frozenset[frozenset[int]]:
    """Return the pairs of bodies between which there is one joint or none."""
    weld = model.body_weldid
    above = [int(weld[model.body_parentid[weld[body]]]) for body in range(model.nbody)]
    return frozenset(
        frozenset((a, b))
        for a in range(1, model.nbody)
        for b in range(a)
        if weld[a] == weld[b] or above[a] == weld[b] or above[b] == weld[a]
        if model.body_rootid[a] == model.body_rootid[b]
    )
