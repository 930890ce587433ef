"""The rigid scene: an arm with servos, and objects, stepped in two halves by MuJoCo.

A step of MuJoCo is taken from its middle: accelerations and integration, then positions and velocities of the
new state. So everything readable between two steps belongs to one instant.

What a step of a `RigidScene` depends on.

Where links of the arm are in one another, in an object or in the floor.

The solids of a compiled scene: of the arm's links, and of what they may meet.

MuJoCo's own contacts show no two links: these meet nothing but floor and objects. So contacts are searched
for in a copy of the model in which the arm's links meet everything, and nothing else meets anything.
"""

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Final, cast, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, SixNumbers, Wrench
from cosim.base.solid import BodyShape, FilmInLink, LinkContact, Solid, SolidShape
from cosim.base.state import check_indices
from cosim.errors import InputError
from cosim.rigid.build import compiled_scene, mjcf_files, object_bodies
from cosim.rigid.build.description import SceneDescription, body_names
from cosim.rigid.distance.signed_distance import ContactQuery
from cosim.rigid.scene import bodies, coupled_scene
from cosim.rigid.scene.arm import ArmDynamics, ArmLayout, CellDrives, Flange, Mounting, droop, effort_limit
from cosim.rigid.scene.load_leaves import add_mounted
from cosim.rigid.scene.servos import ArmServos, finish_step

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
    return Solid(body, name, "hull", pose=pose, vertices=object_bodies.mesh_of(model, geom)[0])


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


@final
@dataclass(frozen=True)
class RigidState:
    """Everything that a step depends on or leaves behind.

    Args:
        integration: MuJoCo's own state vector, inputs and warm start included.
        armature: (dofs,) [kg m^2] or [kg].
        acceleration: (dofs,) of the last finished step.
        actuation: (dofs,) [N m] or [N], MuJoCo's actuator forces in the last finished step.
        servo_torque: (joints,) [N m], of the last finished step.
        flange_load: (6,) reading of the flange sensor.
        loaded: bodies that contact loads at present.
        on_arm: (joints, joints) [kg m^2], that the arm's joints carry.
    """

    integration: Array
    armature: Array
    acceleration: Array
    actuation: Array
    servo_torque: Array
    flange_load: Array
    loaded: Annotated[IntArray, ("k",)]
    on_arm: Array


_STATE, _ALIKE = mujoco.mjtState.mjSTATE_INTEGRATION, "bodies and joints must be as many"


@final
class RigidScene(coupled_scene.CoupledScene):
    """An arm on its base with servos, a flange sensor, and objects around it.

    Joint quantities are ordered as `joint_names`; bodies as `body_names`, the world first. `armature`
    (joints,) [kg m^2] is the rotors' inertia, without what is carried.

    Args:
        description: what the scene is made of.
        compiled: of that description, if it has been compiled already.
        shared: model and state of a scene with several arms, of which this is one.

    Raises:
        InputError: MuJoCo refuses the arm's file or an object.
    """

    flange: Flange
    coupled: coupled_scene.CoupledScene
    """As a soft robot exchanges loads with it: itself, unless it is one of several arms."""
    other_arms: tuple[str, ...] = ()
    """What the names of their bodies begin with."""

    def __init__(
        self,
        description: SceneDescription,
        compiled: compiled_scene.CompiledScene | None = None,
        shared: tuple[mujoco.MjModel, mujoco.MjData] | None = None,
    ) -> None:
        self.description = description
        self._compiled = compiled or compiled_scene.CompiledScene(description)
        model = self._compiled.model() if shared is None else shared[0]
        super().__init__(model, mujoco.MjData(model) if shared is None else shared[1], description.tick_s)
        self._scratch = mujoco.MjData(model)
        self.coupled = self
        self._layout = layout = ArmLayout.of(model, description.arm.joint_names, description.prefix)
        self._v = layout.dofs
        # Views: MuJoCo's arrays stay where they are in memory; looking one up costs as much as its copy.
        self._q: Array = self._data.qpos[layout.positions]
        self._speed: Array = self._data.qvel[self._v]
        self._acceleration: Array = self._data.qacc[self._v]
        self._torque: Array = self._data.qfrc_applied[self._v]
        self._warnings = self._data.warning.number
        # Servo inputs are interleaved: position, velocity, feedforward of each joint in turn.
        self._control = self._data.ctrl.reshape(-1, 3)[layout.joints]
        self.armature: Array = self._model.dof_armature[self._v].copy()
        self.armature.setflags(write=False)
        self.flange = Flange(self._model, self._data, layout)
        self._pace: IntArray = np.full(2, description.substeps)
        tick_s, self._step_s = description.tick_s, float(self._model.opt.timestep)
        self._resisting = tick_s * self._model.dof_damping
        # Servos damp by the speed at the end of a step: (M + h K) a = f(q, v). MuJoCo's implicit integrators
        # do so as well but solve contacts with M alone: what a palm clamps slides when the arm accelerates.
        self._servo_inertia = self._step_s * self.servo_damping
        self._resisting[self._v] += (tick_s - self._step_s) * self.servo_damping
        self._model.dof_armature[self._v] += self._servo_inertia
        self._model.jnt_actfrclimited[layout.joints] = 0  # MuJoCo's limit knows nothing of h K a, `servos` do
        self.servos = ArmServos(self._model, self._data, self._v, self.servo_damping, self.effort_limit)
        self.joint_rows = self._q, self._speed, self.servos.torque
        self.others: IntArray = np.zeros(self._model.nbody, np.int64)
        """(bodies,), 1 where the soft robots of other arms press."""
        sensed = self._data.sensordata
        self._flange_load = self._data.xfrc_applied[layout.mount]
        self._flange_sensor = sensed[layout.force], sensed[layout.torque]
        self.cell = CellDrives(self._model, self._data)
        self.bodies = bodies.Bodies(self._model, self._data, layout.mounting, self.cell.bodies, self._pace)
        self.links = LinkContacts(self._model, self._data, layout, self.cell.bodies)
        self.dynamics = ArmDynamics(self._model, self._scratch, layout, self.cell.places, self._servo_inertia)
        self.set_joint_state(description.arm.home)
        self.set_control(description.arm.home)

    @property
    def mounting(self) -> Mounting:
        """Where the soft robot hangs."""
        return self._layout.mounting

    @property
    def carries(self) -> bool:
        """Whether something rigid is mounted on the flange."""
        return self._layout.carries

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints, base to flange."""
        return self.description.arm.joint_names

    @property
    def shapes(self) -> tuple[BodyShape, ...]:
        """What is drawn of the bodies."""
        return self._compiled.shapes

    @property
    def drawn_as(self) -> str:
        """By what the arm is drawn, see `ArmDrawing.note`."""
        return self._compiled.drawings[self.description.prefix].note

    @property
    def objects(self) -> tuple[tuple[int, bool, tuple[float, ...]], ...]:
        """Bodies of objects that can move, whether they are free, and their masses.

        Of these mass [kg], centre (3,) [m] in the body's frame, and inertia xx, yy, zz, xy, xz, yz [kg m^2]
        about that centre, body axes.
        """
        free = set(self._model.jnt_bodyid[self._model.jnt_type == mujoco.mjtJoint.mjJNT_FREE].tolist())
        bodies = self._layout.object_sensors[:, 0].tolist()
        return tuple((body, body in free, _figures(self._model, body)) for body in bodies)

    @property
    def tick_s(self) -> float:
        """Length of a tick [s]: of the clock, or of a fine one, see `go_finely`."""
        return self._step_s if self._pace[0] < self.substeps else self._tick_s

    @property
    def substeps(self) -> int:
        """How many steps MuJoCo takes in a tick of the clock."""
        return self.description.substeps

    def go_finely(self, left: int | None) -> None:
        """Let ticks be single steps of MuJoCo, so many left in a tick of the clock; None: whole ticks."""
        self._pace[:] = self.substeps if left is None else (1, left)

    @property
    def joint_position(self) -> Array:
        """(joints,) [rad]."""
        return self._q.copy()

    @property
    def joint_velocity(self) -> Array:
        """(joints,) [rad/s]."""
        return np.array(self._data.qvel[self._v])

    @property
    def joint_acceleration(self) -> Array:
        """(joints,) [rad/s^2], of the last finished step."""
        return self._acceleration.copy()

    @property
    def servo_torque(self) -> Array:
        """(joints,) [N m] that the servos gave in the last finished step, within the arm's limits."""
        return self.servos.torque.copy()

    @property
    def servo_reference(self) -> Array:
        """(joints,) [rad] that the servos track."""
        return np.array(self._control[:, 0])

    @property
    def effort_limit(self) -> Array:
        """Largest servo torques (joints,) [N m]; infinite where the arm's file names none."""
        return effort_limit(self._model, self._layout)

    @property
    def servo_damping(self) -> Array:
        """(joints,) [N m s/rad]."""
        return np.array(-self._model.actuator_biasprm[self._layout.joints, 2])

    @property
    def mass_matrix(self) -> Array:
        """Joint-space mass matrix (joints, joints) [kg m^2], armature included."""
        full = np.empty((self._model.nv, self._model.nv))
        mujoco.mj_fullM(self._model, self._data, full)
        return np.array(full[self._v, self._v]) - np.diag(self._servo_inertia)

    @property
    def bias_torque(self) -> Array:
        """c(q, v) + g(q) (joints,) [N m]: what the joints need at zero acceleration."""
        return np.array(self._data.qfrc_bias[self._v])

    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        """Return the distances to everything that collides (and is fixed), the arm itself left out."""
        model, made = self._model, self.description
        geoms = bodies.touchable_geoms(model, self._layout.mount, fixed_only=fixed_only)
        names = body_names(model, geoms, [wire.name for wire in made.wires])
        return ContactQuery(
            model, self._data, geoms, made.friction.on_film(names, model.geom_friction[geoms, 0])
        )

    def set_joint_state(self, position: Array, velocity: Array | None = None) -> None:
        """Put the arm at an angle and a speed; everything readable follows.

        Args:
            position: (joints,) [rad].
            velocity: (joints,) [rad/s], zero unless given.
        """
        self._q[:] = position
        self._data.qvel[self._v] = 0.0 if velocity is None else velocity
        self.begin_step()

    def set_control(
        self, position: Array, velocity: Array | None = None, feedforward: Array | None = None
    ) -> None:
        """Set what the servos track from now on.

        Args:
            position: (joints,) [rad].
            velocity: (joints,) [rad/s], zero unless given.
            feedforward: (joints,) [N m], zero unless given.
        """
        self._control[:, 0] = position
        self._control[:, 1] = 0.0 if velocity is None else velocity
        self._control[:, 2] = 0.0 if feedforward is None else feedforward

    def apply_flange_wrench(self, wrench: Wrench) -> None:
        """Set the load on the flange from now on: at the flange origin, world axes."""
        self.flange.apply(wrench)

    def received_wrench(self) -> SixNumbers:
        """Return what acts on the flange now, about the world's origin, read back from MuJoCo."""
        return self.flange.received()

    def set_acceleration(self, acceleration: Array) -> None:
        """Let an acceleration (joints,) [rad/s^2] count as that of the last step."""
        self._acceleration[:] = acceleration

    def apply_joint_torque(self, torque: Array) -> None:
        """Set a torque (joints,) [N m] on the joints from now on, besides servos and flange load."""
        self._torque[:] = torque

    def begin_step(self) -> None:
        """Bring poses, velocities and inertia up to the present joint state (first half of a step)."""
        self.flange.moved()
        mujoco.mj_step1(self._model, self._data)
        self.check()  # it starts anew from a state that is not finite
        self.bodies.carried.follow()

    def step_arm(self, position: Array, velocity: Array, torque: Array) -> None:
        self.set_control(position, velocity, torque)
        self.step()

    def step(self) -> None:
        """Step MuJoCo by a tick; servos continue within it at the speed that they are asked for.

        Raises:
            InstabilityError: the state is no longer finite.
        """
        bodies, control, (steps, left) = self.bodies, self._control, self._pace.tolist()
        began = self._speed.copy() if steps > 1 else None
        presses = bool(np.count_nonzero(bodies.bearing))
        work, power = 0.0, bodies.power_W(bodies.applied) if presses else 0.0
        if self._layout.carries:
            self.mounted[:] = 0.0
        for i in range(steps):
            if i:
                control[:, 0] += self._step_s * control[:, 1]
            self._finish_step(left - i, 1.0 / steps)
            self.begin_step()
            if presses:  # a constant force changes a body's energy by its mean speed
                before, power = power, bodies.power_W(bodies.applied)
                work += 0.5 * self._step_s * (before + power)
        bodies.work_J = work
        self.servos.end()
        if began is not None:  # inertia is given back by the acceleration of the whole tick
            self._acceleration[:] = (self._speed - began) / (steps * self._step_s)

    def _finish_step(self, left: int, share: float) -> None:
        """Find accelerations, integrate and read the flange's sensor.

        Args:
            left: steps until the end of the clock's tick.
            share: of the step in the rigid step.
        """
        finish_step(self._model, self._data, (self.servos,))
        self.flange.read_sensor()  # site axes still belong to the instant of the reading
        if self._layout.carries:
            self.add_mounted(self._flange_load, share)
        self.cell.drive(left, self._step_s)

    def add_mounted(self, load: Array, share: float) -> None:
        """Add to `mounted` a share of the flange sensor's reading beyond a load (6,) of the soft robot."""
        add_mounted(load, self.flange.axes, *self._flange_sensor, share, self.mounted)

    def read_touch(self, touch: Array) -> None:
        layout, sensed = self._layout, self._data.sensordata
        if layout.carries:
            touch[0, 1] = sensed[layout.contacts]
        for body, total, *counted in layout.object_sensors.tolist():
            shown = [float(sensed[place]) for place in counted]
            touch[body, 1], touch[body, 2] = self.others[body] + sum(shown), sensed[total] - sum(shown)

    def check(self) -> None:
        """Raise InstabilityError where MuJoCo has warned: the state is no longer finite."""
        if np.count_nonzero(self._warnings):
            mjcf_files.raise_instability(self._data)

    def static_configuration(
        self, reference: Array, feedforward: Array | None = None, wrench: Wrench | None = None
    ) -> Array:
        """Return the angles (joints,) [rad] at which the servos hold a constant load; nothing changes.

        Solves stiffness (q_ref - q) + feedforward + J(q)^T wrench = g(q).

        Args:
            reference: q_ref (joints,) [rad].
            feedforward: (joints,) [N m], zero unless given.
            wrench: on the flange, at its origin, world axes; none unless given.

        Raises:
            ConvergenceError: no equilibrium, or one that asks for more than the joints' torque.
        """
        np.copyto(self._scratch.qpos, self._data.qpos)
        load = wrench or Wrench()
        return droop(
            self._model, self._scratch, layout=self._layout, joint_names=self.joint_names,
            reference=np.asarray(reference, dtype=np.float64), load=np.concatenate((load.force, load.torque)),
            feedforward=np.zeros(len(self.joint_names)) if feedforward is None else feedforward,
        )  # fmt: skip

    @property
    def state(self) -> RigidState:
        """A copy of all that the next step depends on, MuJoCo's state and edits of its model included."""
        integration = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, integration, _STATE)
        armature, acceleration = np.array(self._model.dof_armature), np.array(self._data.qacc)
        actuation, servo_torque = np.array(self._data.qfrc_actuator), self.servo_torque
        load, on_arm = self.flange.measured, self.bodies.carried.on_arm.copy()
        return RigidState(
            integration, armature, acceleration, actuation, servo_torque, load, self.bodies.loaded, on_arm
        )

    @state.setter
    def state(self, state: RigidState) -> None:
        size = mujoco.mj_stateSize(self._model, _STATE)
        if len(state.integration) != size:
            raise InputError(f"the saved scene has {len(state.integration)} numbers, here {size}: {_ALIKE}")
        check_indices(state.loaded, self.bodies.count, "bodies")
        self._warnings[:] = 0
        self.bodies.loaded = state.loaded
        self.bodies.carried.on_arm[:] = state.on_arm
        self._model.dof_armature[:] = state.armature
        mujoco.mj_setState(self._model, self._data, state.integration, _STATE)
        self.begin_step()
        self._data.qacc[:] = state.acceleration
        self._data.qfrc_actuator[:] = state.actuation
        self.servos.torque[:] = state.servo_torque
        self.flange.measured = state.flange_load


def _figures(model: mujoco.MjModel, body: int) -> tuple[float, ...]:
    turn = Pose.from_quaternion(np.array(model.body_iquat[body]), np.zeros(3)).rotation
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    six = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    return tuple(np.concatenate([[model.body_mass[body]], model.body_ipos[body], six]).tolist())
