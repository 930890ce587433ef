"""Finds contacts of the arm's links with one another, with objects, the floor and the film. MuJoCo's model
has no contacts between links, so they are searched in a copy of the model in which only links collide, with
everything. Also lists the solids of links and of their surroundings, for clearances.
"""

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Final, cast, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.solid import FilmInLink, LinkContact, Solid, SolidShape
from cosim.rigid.build import object_bodies
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene import bodies
from cosim.rigid.scene.arm_layout import ArmLayout

_SHAPES: Final[dict[int, SolidShape]] = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")): shape
    for shape in cast(tuple[SolidShape, ...], ("box", "sphere", "capsule", "cylinder", "ellipsoid", "plane"))
}
_SEEN_M = 0.01  # distance below which MuJoCo reports contacts; a larger one costs more than it saves
_IN_LINK_M = 1e-4  # depth from which the film counts as within a link
_LINK, _OBJECT = 1, 2  # contact bits: links collide with both, objects with links only


@final
@dataclass(frozen=True)
class SceneSolids:
    """Solids that collide, of bodies whose motion is planned or that are fixed, without movable objects.

    Args:
        solids: of all bodies but objects that can move.
        links: (l,) indices of solids of links that move.
        among_links: (p, 2) indices of pairs of different links that no joint joins.
        carried: (c,) indices of solids that are mounted on the flange.
        others: (o,) indices of solids that do not belong to the arm.
        flange: body with the flange's frame.
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
        of_links: (bodies,), mask of the arm's links.
        joined: pairs of bodies whose contacts are ignored.
        movable: (bodies,), mask of bodies that loads can move.
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
    return Solid(body, name, "hull", pose=pose, vertices=object_bodies.mesh_of(model, geom)[0])


@final
class LinkContacts:
    """Finds the contacts of an arm's links; bodies mounted on the flange are left out.

    Contacts of links that a joint joins are ignored, and those of two fixed bodies.

    Args:
        model: compiled scene.
        data: its state.
        layout: of the arm in the model.
        driven: (bodies,), mask of bodies with driven joints, which no load moves.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, layout: ArmLayout, driven: Mask) -> None:
        self._scene, self._live, self._layout = model, data, layout
        self._movable = bodies.moved_by_loads(model) & ~driven
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
        # if nothing else moves, an arm that has moved less than its last clearance has no contact
        self._arm_alone = model.nv == len(model.jnt_dofadr[layout.joints])
        self._reach_m = max(
            1.0, float(np.linalg.norm(own.body_pos[links], axis=1).sum() + _size(own, link_geom))
        )
        self._seen_at = np.full(layout.positions.stop - layout.positions.start, np.inf)
        self._clearance_m = 0.0
        self._free = np.flatnonzero(own.jnt_type == mujoco.mjtJoint.mjJNT_FREE)

    def at(
        self, joints: Array, places: Array | None = None, quaternions: Array | None = None
    ) -> tuple[LinkContact, ...]:
        """Return the contacts of links with the arm at some angles; the scene does not change.

        Args:
            joints: (joints,) [rad].
            places: (bodies, 3) [m], world: positions of free bodies; None: those of the scene.
            quaternions: (bodies, 4), (w, x, y, z), world from body; None: those of the scene.
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
        """Return the links that a film on the flange penetrates by more than 0.1 mm, but not the last ones.

        Args:
            points: (n, 3) [m], nodes of the film, world.
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
        """Return the smallest distance of links from a contact [m], at most `_SEEN_M`."""
        if not data.ncon:
            return _SEEN_M
        pairs = self._model.geom_bodyid[data.contact.geom].tolist()
        distances = zip(pairs, data.contact.dist.tolist(), strict=True)
        near = [distance for pair, distance in distances if frozenset(pair) not in self._joined]
        return min(near, default=_SEEN_M)

    def solids(self) -> SceneSolids:
        """Return the solids between which contacts are searched."""
        return scene_solids(self._scene, self._layout, self._of_links, self._joined, self._movable)

    def with_objects(self) -> tuple[LinkContact, ...]:
        """Return the contacts of links with floor and objects that MuJoCo has found in the present state."""
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
    """Return an upper bound [m] for the distance of a point of geoms (g,) from its body's origin."""
    return float((np.linalg.norm(model.geom_pos[geoms], axis=1) + model.geom_rbound[geoms]).max(initial=0.0))


def _below(model: mujoco.MjModel, top: int) -> Mask:
    """Return a mask (bodies,) of a body and its descendants."""
    below = np.zeros(model.nbody, dtype=bool)
    below[top] = True
    for body in range(top + 1, model.nbody):
        below[body] |= below[model.body_parentid[body]]
    return below


def _joined_pairs(model: mujoco.MjModel) -> frozenset[frozenset[int]]:
    """Return the pairs of bodies with at most one joint between them."""
    weld = model.body_weldid
    above = [int(weld[model.body_parentid[weld[body]]]) for body in range(model.nbody)]
    return frozenset(
        frozenset((a, b))
        for a in range(1, model.nbody)
        for b in range(a)
        if weld[a] == weld[b] or above[a] == weld[b] or above[b] == weld[a]
        if model.body_rootid[a] == model.body_rootid[b]
    )
