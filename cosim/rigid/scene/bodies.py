"""The bodies of a compiled scene as contact sees them.

Inertia that the arm carries for a while is added to the joint-space mass matrix, M + A. Unlike extra mass of
the bodies it weighs nothing and knows no gyroscopic forces.

How bodies of a compiled scene answer impulses.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import final

import mujoco
import numpy as np
from scipy.linalg import lapack

from cosim.base.frames import Array, IntArray, Mask, cross
from cosim.errors import InputError, SceneError
from cosim.rigid.scene.arm import Mounting
from cosim.rigid.scene.foresight import Foresight
from cosim.rigid.scene.load_leaves import power_on_bodies


@final
class AddedInertia:
    """Keeps MuJoCo's mass matrix up to date with what is carried.

    `on_arm` (joints, joints) is A, at `square` of a matrix of all degrees of freedom.

    Args:
        model: compiled scene.
        data: its state.
        mounting: whose degrees of freedom carry it.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting) -> None:
        self._model, self._data = model, data
        places = mass_places(model, mounting)
        self.square = np.ix_(*[np.arange(model.nv)[mounting.dofs]] * 2)
        self._lower = np.tril_indices(len(places))
        self._entries: IntArray = places[self._lower]
        self.on_arm: Array = np.zeros(places.shape)

    def carry_on_arm(self, inertia: Array) -> None:
        """Set what the arm's joints carry (joints, joints) [kg m^2] from the step in progress on."""
        if (self._entries < 0).any():
            raise InputError(
                "the soft robot is heavy for the free body that it hangs on, whose whole mass matrix MuJoCo "
                "does not keep; give the body a child before it is compiled, or attach to the MjSpec"
            )
        self.on_arm[:] = inertia
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

    @property
    def _carries(self) -> bool:
        return bool(np.count_nonzero(self.on_arm))

    def _add(self, on_arm: Array) -> None:
        self._data.M[self._entries] += on_arm[self._lower]


def jacobian_of(model: mujoco.MjModel, data: mujoco.MjData, bodies: IntArray) -> Array:
    """Return J (6 b, nv) of bodies (b,): each linear then angular, world axes, at the centre of mass.

    A massless body counts at its origin.
    """
    jacobian = np.zeros((6 * len(bodies), model.nv))
    for k, body in enumerate(bodies.tolist()):
        block = jacobian[6 * k : 6 * k + 6]
        mujoco.mj_jac(model, data, block[:3], block[3:], data.xipos[body], body)
    return jacobian


def mobility(model: mujoco.MjModel, data: mujoco.MjData, jacobian: Array, added: Array) -> Array:
    """Return W = J (M + D)^-1 J^T (k, k): velocity changes per impulse.

    What presses on something within the scene is not counted.

    Args:
        model: compiled scene.
        data: its state, positions and inertia up to date.
        jacobian: J (k, nv).
        added: D (nv, nv) [kg m^2 or kg]: damping over a step, less what is not to be counted in M.
    """
    if not model.nv:
        return np.zeros((len(jacobian), len(jacobian)))
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    inertia += added
    _, moved, failure = lapack.dposv(inertia, jacobian.T)
    if failure:  # not positive definite; whatever comes of it
        moved = np.linalg.solve(inertia, jacobian.T)
    return np.asarray(jacobian.dot(moved))


@final
class Bodies:
    """Loads on bodies, and how they answer; a view into a scene's model and state.

    `applied` (bodies, 6) are MuJoCo's loads about `mass_centers` (bodies, 3) [m]; `loaded` names the
    bodies that bear a load of `apply`, and `bearing` (bodies,) is 1 for these. `spins` (bodies, 6) are
    MuJoCo's velocities, angular then linear, at the centres of mass `tree_centers` (bodies, 3) [m] of
    their trees, each in row `roots` (bodies,); `positions` (bodies, 3) [m] and `axes` (bodies, 9) are the
    bodies' frames; `flange` is the body that goes with it, `foresight` how all will move.
    `carried` is what the arm's joints carry, `work_J` the work of contacts on bodies in the last rigid step.

    Args:
        model: compiled scene.
        data: its state.
        mounting: of the soft robot.
        driven: (bodies,), which no load moves though they have joints.
        pace: (2,), how many steps of MuJoCo the next rigid step takes, and how many are left until its tick
            of the clock ends.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting, driven: Mask, pace: IntArray
    ) -> None:
        self._model, self._data, self.flange = model, data, mounting.body
        self.work_J = 0.0
        self._movable: Mask = moved_by_loads(model) & ~driven
        self.applied: Array = data.xfrc_applied
        self.mass_centers: Array = data.xipos
        self.positions: Array = data.xpos
        self.axes: Array = data.xmat
        self.bearing: IntArray = np.zeros(model.nbody, np.int64)
        self.spins: Array = data.cvel
        self.tree_centers: Array = data.subtree_com
        self.roots: IntArray = np.asarray(model.body_rootid, dtype=np.int64)
        self.carried = AddedInertia(model, data, mounting)
        on_arm = self.carried.on_arm, mass_places(model, mounting)
        self.foresight = Foresight(model, data, mounting.body, pace, on_arm)

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

    def masses_kg(self, bodies: IntArray) -> list[float]:
        """Return the masses of bodies (b,) [kg]."""
        return [float(mass) for mass in self._model.body_mass[bodies]]

    def sizes_m(self, bodies: IntArray) -> Array:
        """Return how thin bodies (b,) are (b,) [m]: the smallest extent of each one's largest shape."""
        thin = 2.0 * self._model.geom_aabb.reshape(-1, 6)[:, 3:].min(axis=1, initial=np.inf)
        sizes = np.zeros(self.count)
        np.maximum.at(sizes, self._model.geom_bodyid, thin)
        return np.asarray(sizes[bodies])

    def movable(self, bodies: IntArray) -> Mask:
        """Return which of bodies (b,) loads can move (b,) bool."""
        return np.asarray(self._movable[bodies])

    def centers(self, bodies: IntArray) -> Array:
        """Return where the centres of mass of bodies (b,) are (b, 3) [m], world."""
        return np.array(self._data.xipos[bodies])

    def power_W(self, loads: Array) -> float:
        """Return the power of contacts on bodies.

        Args:
            loads: (bodies, 6), of which those of loaded bodies count.
        """
        if not np.count_nonzero(self.bearing):
            return 0.0
        return power_on_bodies(
            loads, self.bearing, self.spins, self.tree_centers, self.roots, self.mass_centers
        )

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

    def way_s2(self, tick_s: float) -> float:
        """Return how far [m] an acceleration of 1 m/s^2 brings a body in a tick: h^2 (n + 1) / 2 n."""
        steps = self.foresight.steps
        return tick_s**2 * (steps + 1) / (2 * steps)

    def mobility(self, bodies: IntArray, *, held: bool) -> Array:
        """Return J M^-1 J^T (6 b, 6 b): accelerations of bodies (b,) per load on them.

        Each linear then angular, world axes, at the centre of mass. What the joints' damping resists with is
        counted in M.

        Args:
            bodies: (b,).
            held: whether constraints that act under the present loads count as well.
        """
        resisting = self._damping()
        if held:
            self._hold(resisting)
        return mobility(self._model, self._data, jacobian_of(self._model, self._data, bodies), resisting)

    def mobilities(self, bodies: IntArray) -> tuple[Array, Array]:
        """Return both mobilities (6 b, 6 b) of bodies (b,): with what holds them, and without it."""
        model, data = self._model, self._data
        jacobian, resisting = jacobian_of(model, data, bodies), self._damping()
        free = mobility(model, data, jacobian, resisting)
        if not self._hold(resisting):
            return free, free
        return mobility(model, data, jacobian, resisting), free

    def _damping(self) -> Array:
        """Return by how much the joints' damping resists in a step (nv, nv)."""
        return np.diag(self._model.opt.timestep * self._model.dof_damping)

    def _hold(self, resisting: Array) -> bool:
        """Add what constraints resist with under the present loads (nv, nv); return whether there are any."""
        model, data = self._model, self._data
        if not data.nefc:
            return False
        before = np.array(data.qacc)
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)
        data.qacc[:] = before
        resisting += active_constraints(model, data)
        return True


def active_constraints(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return J^T D J (nv, nv) of the constraints that act, forces up to date.

    Of a contact that slides, what is along its surface does not count.
    """
    jacobian = np.empty((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        jacobian[:] = data.efc_J.reshape(data.nefc, model.nv)
    state, kind = data.efc_state, data.efc_type
    acts = state == mujoco.mjtConstraintState.mjCNSTRSTATE_QUADRATIC
    slides = state == mujoco.mjtConstraintState.mjCNSTRSTATE_CONE
    first = np.concatenate([[True], np.diff(data.efc_id) != 0]) | np.append(True, np.diff(kind) != 0)
    acts |= slides & first  # a contact's rows follow its normal one
    rows = jacobian[acts]
    return np.asarray((rows.T * data.efc_D[acts]) @ rows)


def moved_by_loads(model: mujoco.MjModel) -> Mask:
    """Return which bodies (bodies,) loads can move: not what goes rigidly with the world or a mocap body."""
    weld = model.body_weldid
    return np.asarray((weld != 0) & (model.body_mocapid[weld] < 0))


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


def mass_places(model: mujoco.MjModel, mounting: Mounting) -> IntArray:
    """Return where MuJoCo keeps M_ij, j <= i, of what moves a mount: each is moved by all before it.

    -1 where it keeps the diagonal alone, of a free body without children.
    """
    joints = np.arange(model.nv)[mounting.dofs]
    places = np.full((len(joints), len(joints)), -1, dtype=np.int64)
    for i, dof in enumerate(joints):
        last = int(model.M_rowadr[dof] + model.M_rownnz[dof])
        if model.M_rownnz[dof] > i:
            places[i, : i + 1] = np.arange(last - i - 1, last)
    return places


@cache
def addresses(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the addresses of functions of MuJoCo's library.

    Raises:
        SceneError: MuJoCo's library cannot be found.
    """
    folder = Path(mujoco.__file__).parent
    for path in sorted(folder.glob("*mujoco*")):
        if path.suffix in (".dll", ".dylib") or ".so." in path.name:
            library = ctypes.CDLL(str(path))  # it is loaded already: this finds it
            return tuple(ctypes.cast(library[name], ctypes.c_void_p).value or 0 for name in names)
    raise SceneError(f"MuJoCo's library is not in {folder}: install its package (`pip install mujoco`)", None)
