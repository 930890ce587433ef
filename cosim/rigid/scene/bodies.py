"""The bodies of a compiled scene as contact sees them: places, loads, mobility, added inertia.

Inertia that the arm and bodies on joints carry for a while, added to the joint-space mass matrix.

M + A + sum_b J_b^T D_b J_b, with A on the arm's joints, and D_b in the axes of body b, about its origin.
Unlike extra mass of the bodies it weighs nothing and knows no gyroscopic forces; unlike armature of the
joints it costs a chain no more inertia than its bodies carry.

How bodies of a compiled scene answer impulses.
"""

from __future__ import annotations

from typing import final

import mujoco
import numpy as np
from scipy.linalg import lapack

from cosim.base.frames import Array, IntArray, Mask, cross


@final
class AddedInertia:
    """Keeps MuJoCo's mass matrix up to date with what is carried.

    `on_arm` (joints, joints) is A, `bodies` (b,) and `inertia` (b, 6, 6) say what bodies carry.

    Args:
        model: compiled scene.
        data: its state.
        arm: degrees of freedom of the arm's joints.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: slice) -> None:
        self._model, self._data = model, data
        # entries of the sparse matrix: each row holds the ancestors of its degree of freedom and itself
        self._rows: IntArray = np.repeat(np.arange(model.nv), model.M_rownnz)
        starts = np.repeat(model.M_rowadr, model.M_rownnz)
        firsts = np.repeat(np.cumsum(model.M_rownnz) - model.M_rownnz, model.M_rownnz)
        self._entries: IntArray = starts + np.arange(len(self._rows)) - firsts
        self._columns: IntArray = model.M_colind[self._entries]
        self._arm = arm
        joints = arm.stop - arm.start
        self.on_arm: Array = np.zeros((joints, joints))
        self.bodies: IntArray = np.zeros(0, np.int64)
        self.inertia: Array = np.zeros((0, 6, 6))

    def carry(self, bodies: IntArray, inertia: Array) -> None:
        """Set what bodies carry from the step in progress on.

        Args:
            bodies: (b,), on joints.
            inertia: (b, 6, 6), linear then angular, about the bodies' origins, body axes.
        """
        self.bodies, self.inertia = np.array(bodies), np.array(inertia)
        self.renew()

    def carry_on_arm(self, inertia: Array) -> None:
        """Set what the arm's joints carry (joints, joints) [kg m^2] from the step in progress on."""
        self.on_arm = np.array(inertia)
        self.renew()

    def renew(self) -> None:
        """Compute and factorise the mass matrix again, for model edits."""
        mujoco.mj_makeM(self._model, self._data)
        if self._carries:
            self._add(self.on_arm)
        mujoco.mj_factorM(self._model, self._data)

    def follow(self) -> None:
        """Add what is carried to a mass matrix that MuJoCo has computed for new positions."""
        if self._carries:
            self._add(self.on_arm)
            mujoco.mj_factorM(self._model, self._data)

    def follow_bodies(self) -> None:
        """Add what bodies carry, after a kernel has added what the arm's joints do."""
        if len(self.bodies):
            self._add(np.zeros_like(self.on_arm))
            mujoco.mj_factorM(self._model, self._data)

    def mobility(self, bodies: IntArray) -> Array:
        """Return J M^-1 J^T (6 b, 6 b) of bodies (b,) without what they carry; about origins, body axes."""
        mujoco.mj_makeM(self._model, self._data)
        mujoco.mj_factorM(self._model, self._data)
        jacobian = np.concatenate([self._jacobian(int(body)) for body in bodies])
        solved = np.empty_like(jacobian)
        mujoco.mj_solveM(self._model, self._data, solved, jacobian)
        self.follow()
        return np.asarray(jacobian @ solved.T)

    @property
    def _carries(self) -> bool:
        return len(self.bodies) > 0 or bool(np.count_nonzero(self.on_arm))

    def _add(self, on_arm: Array) -> None:
        added = np.zeros((self._model.nv, self._model.nv))
        added[self._arm, self._arm] = on_arm
        for body, inertia in zip(self.bodies, self.inertia, strict=True):
            jacobian = self._jacobian(int(body))
            added += jacobian.T @ inertia @ jacobian
        self._data.M[self._entries] += added[self._rows, self._columns]

    def _jacobian(self, body: int) -> Array:
        """Return J (6, dofs), linear then angular, at the body's origin, body axes."""
        world = np.empty((6, self._model.nv))
        mujoco.mj_jacBody(self._model, self._data, world[:3], world[3:], body)
        turn = self._data.xmat[body].reshape(3, 3)
        return np.concatenate([turn.T @ world[:3], turn.T @ world[3:]])


def mobility(model: mujoco.MjModel, data: mujoco.MjData, bodies: IntArray, added: Array) -> Array:
    """Return W = J (M + D)^-1 J^T (6 b, 6 b): velocity changes of bodies (b,) per impulse on them.

    Each linear then angular, world axes, at the centre of mass; what bodies press on within the scene is not
    counted.

    Args:
        model: compiled scene.
        data: its state, positions and inertia up to date.
        bodies: (b,) indices; a massless one counts at its origin.
        added: D (nv, nv) [kg m^2 or kg]: damping over a step, less what is not to be counted in M.
    """
    jacobian = np.zeros((6 * len(bodies), model.nv))
    for k, body in enumerate(bodies.tolist()):
        block = jacobian[6 * k : 6 * k + 6]
        mujoco.mj_jac(model, data, block[:3], block[3:], data.xipos[body], body)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    inertia += added
    _, moved, failure = lapack.dposv(inertia, jacobian.T)
    if failure:  # not positive definite; whatever comes of it
        moved = np.linalg.solve(inertia, jacobian.T)
    return np.asarray(jacobian.dot(moved))


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
