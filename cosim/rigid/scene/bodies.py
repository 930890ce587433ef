"""The bodies of a compiled scene as contact sees them: places, loads, and inertia carried for a while."""

from __future__ import annotations

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Mask, cross
from cosim.rigid.scene.added_inertia import AddedInertia


@final
class Bodies:
    """Loads on bodies and armature of free ones; a view into a scene's model and state.

    `applied` (bodies, 6) are MuJoCo's loads about `mass_centers` (bodies, 3) [m]; `loaded` names the bodies
    that bear a load of `apply`, and `bearing` (bodies,) is 1 for these; `carried` is the inertia of those on
    joints.

    Args:
        model: compiled scene.
        data: its state.
        arm: degrees of freedom of the arm's joints.
        driven: (bodies,), which no load moves though they have joints.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: slice, driven: Mask) -> None:
        self._model, self._data = model, data
        joints = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        self.free: IntArray = np.asarray(model.jnt_bodyid[joints], dtype=np.int64)
        self._dofs = model.jnt_dofadr[joints][:, None] + np.arange(6)
        self._movable: Mask = (model.body_weldid != 0) & ~driven
        self._on_joints: Mask = self._movable.copy()
        self._on_joints[self.free] = False
        self.applied: Array = data.xfrc_applied
        self.mass_centers: Array = data.xipos
        self.bearing: IntArray = np.zeros(model.nbody, np.int64)
        self._own_armature = model.dof_armature[self._dofs].copy()
        self.carried = AddedInertia(model, data, arm)

    @property
    def loaded(self) -> IntArray:
        """The bodies (b,) that bear a load of `apply`."""
        return np.flatnonzero(self.bearing)

    @loaded.setter
    def loaded(self, bodies: IntArray) -> None:
        self.bearing[:] = 0
        self.bearing[bodies] = 1

    @property
    def count(self) -> int:
        """How many bodies the scene has, the world counted."""
        return int(self._model.nbody)

    def names(self, bodies: IntArray) -> tuple[str, ...]:
        """Return the names of bodies (b,)."""
        return tuple(self._model.body(int(body)).name for body in bodies)

    def movable(self, bodies: IntArray) -> Mask:
        """Return which of bodies (b,) loads can move (b,) bool."""
        return np.asarray(self._movable[bodies])

    def centers(self, bodies: IntArray) -> Array:
        """Return where the centres of mass of bodies (b,) are (b, 3) [m], world."""
        return np.array(self._data.xipos[bodies])

    def origins(self, bodies: IntArray) -> Array:
        """Return where the frames of bodies (b,) are (b, 3) [m], world."""
        return np.array(self._data.xpos[bodies])

    def rotations(self, bodies: IntArray) -> Array:
        """Return world from body (b, 3, 3)."""
        return np.array(self._data.xmat[bodies]).reshape(-1, 3, 3)

    def free_speeds(self) -> Array:
        """Return how fast the free bodies are (free bodies,) [m/s]."""
        return np.asarray(np.linalg.norm(self._data.qvel[self._dofs[:, :3]], axis=1))

    def free_loaded(self) -> Mask:
        """Return which of the free bodies bear a load of `apply` (free bodies,) bool."""
        return np.asarray(self.bearing[self.free] != 0)

    def inertia(self, bodies: IntArray) -> Array:
        """Return mass three times [kg], then the inertia about the body axes' origin (b, 6) [kg m^2]."""
        mass = self._model.body_mass[bodies]
        offset = self._model.body_ipos[bodies]
        turn = np.empty((len(bodies), 9))
        for k, quaternion in enumerate(self._model.body_iquat[bodies]):
            mujoco.mju_quat2Mat(turn[k], quaternion)
        axes = turn.reshape(-1, 3, 3)
        own = np.einsum("brs,bs,brs->br", axes, self._model.body_inertia[bodies], axes)
        away = mass[:, None] * ((offset**2).sum(axis=1)[:, None] - offset**2)
        return np.concatenate([np.repeat(mass[:, None], 3, axis=1), own + away], axis=1)

    def apply(self, bodies: IntArray, force: Array, torque: Array) -> None:
        """Set the loads on bodies from now on; those that were loaded before and are not named get none.

        Args:
            bodies: (b,) different indices.
            force: (b, 3) [N], world axes.
            torque: (b, 3) [N m], about the world's origin, world axes.
        """
        before = self.loaded
        if not len(bodies) + len(before):
            return
        applied = self._data.xfrc_applied
        applied[before] = 0.0
        # MuJoCo takes torques about the centre of mass
        applied[bodies, :3] = force
        applied[bodies, 3:] = torque - cross(self._data.xipos[bodies], force)
        self.loaded = bodies

    def received(self, bodies: IntArray) -> Array:
        """Return what acts on bodies (b,) now (b, 6): force, and torque about the world's origin, world axes.

        Read back from MuJoCo, so it holds whatever has been applied by whomever.
        """
        loads = np.array(self._data.xfrc_applied[bodies])
        loads[:, 3:] += cross(self._data.xipos[bodies], loads[:, :3])
        return loads

    def set_added_armature(self, added: Array) -> None:
        """Carry an algorithmic mass on the free bodies, from the step in progress on.

        Args:
            added: (free bodies, 6), along world axes [kg], then about body axes [kg m^2].
        """
        self._model.dof_armature[self._dofs] = self._own_armature + added
        self.carried.renew()

    def on_joints(self, bodies: IntArray) -> IntArray:
        """Return those of bodies (b,) that move, but not freely: hinged ones, segments of a wire."""
        return np.asarray(bodies[self._on_joints[bodies]])


def touchable_geoms(model: mujoco.MjModel, mount: int, *, fixed_only: bool = False) -> IntArray:
    """Return the geoms that a soft body on the mount may touch: all that collide, but the arm's own.

    Args:
        model: compiled scene.
        mount: body that carries the soft body.
        fixed_only: whether to leave out what can move as well.
    """
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    own = model.body_rootid[model.geom_bodyid] == model.body_rootid[mount]
    if fixed_only:
        collides &= model.body_weldid[model.geom_bodyid] == 0
    return np.asarray(np.flatnonzero(collides & ~own), dtype=np.int64)
