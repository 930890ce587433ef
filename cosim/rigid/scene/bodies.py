"""Bodies of a scene as contact with the film sees them: loads, power, masses, sizes, and their response to
impulses.
"""

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Mask, cross
from cosim.rigid.scene.added_inertia import AddedInertia
from cosim.rigid.scene.arm_layout import Mounting
from cosim.rigid.scene.load_leaves import power_on_bodies
from cosim.rigid.scene.mobility import active_constraints, jacobian_of, mobility
from cosim.rigid.scene.pose_prediction import PosePrediction


@final
class Bodies:
    """Loads on bodies and their response; a view into a scene's model and state.

    `applied` (bodies, 6) are MuJoCo's loads about `mass_centers` (bodies, 3) [m]; `loaded` are the bodies
    with a load of `apply`, and `bearing` (bodies,) is 1 for these. `spins` (bodies, 6) are MuJoCo's
    velocities, angular then linear, at the centres of mass `tree_centers` (bodies, 3) [m] of their trees,
    each in row `roots` (bodies,); `positions` (bodies, 3) [m] and `axes` (bodies, 9) are the bodies' frames;
    `flange` is the body of the flange, `prediction` the predicted motion. `carried` is the inertia that the
    arm's joints carry, `work_J` the work of contacts on bodies in the last rigid step.

    Args:
        model: compiled scene.
        data: its state.
        mounting: of the soft robot.
        driven: (bodies,), mask of bodies with driven joints, which no load moves.
        pace: (2,), number of MuJoCo's steps in the next rigid step, and until its tick of the clock ends.
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
        self.prediction = PosePrediction(model, data, mounting.body, pace, self.carried)

    @property
    def loaded(self) -> IntArray:
        """The bodies (b,) with a load of `apply`."""
        return np.flatnonzero(self.bearing)

    @loaded.setter
    def loaded(self, bodies: IntArray) -> None:
        self.bearing[:] = 0
        self.bearing[bodies] = 1

    @property
    def count(self) -> int:
        """Number of bodies, the world included."""
        return int(self._model.nbody)

    def names(self, bodies: IntArray) -> tuple[str, ...]:
        """Return the names of bodies (b,)."""
        return tuple(self._model.body(int(body)).name for body in bodies)

    def masses_kg(self, bodies: IntArray) -> list[float]:
        """Return the masses of bodies (b,) [kg]."""
        return [float(mass) for mass in self._model.body_mass[bodies]]

    def sizes_m(self, bodies: IntArray) -> Array:
        """Return the thickness (b,) [m] of bodies (b,): the smallest extent of the shape that is thickest."""
        thin = 2.0 * self._model.geom_aabb.reshape(-1, 6)[:, 3:].min(axis=1, initial=np.inf)
        sizes = np.zeros(self.count)
        np.maximum.at(sizes, self._model.geom_bodyid, thin)
        return np.asarray(sizes[bodies])

    def movable(self, bodies: IntArray) -> Mask:
        """Return a mask (b,) of the bodies (b,) that loads can move."""
        return np.asarray(self._movable[bodies])

    def power_W(self, loads: Array) -> float:
        """Return the power of contacts on bodies.

        Args:
            loads: (bodies, 6) [N, N m], of which those of loaded bodies are used.
        """
        if not np.count_nonzero(self.bearing):
            return 0.0
        return power_on_bodies(
            loads, self.bearing, self.spins, self.tree_centers, self.roots, self.mass_centers
        )

    def apply(self, bodies: IntArray, force: Array, torque: Array) -> None:
        """Set the loads on bodies; other bodies get none.

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
        # MuJoCo's torques are about the centre of mass
        applied[bodies, :3] = force
        applied[bodies, 3:] = torque - cross(self._data.xipos[bodies], force)
        self.loaded = bodies

    def way_s2(self, tick_s: float) -> float:
        """Return the displacement [m] of a body by 1 m/s^2 over a tick of n steps: h^2 (n + 1) / (2 n)."""
        steps = self.prediction.steps
        return tick_s**2 * (steps + 1) / (2 * steps)

    def mobility(self, bodies: IntArray, *, held: bool) -> Array:
        """Return J M^-1 J^T (6 b, 6 b): accelerations of bodies (b,) per load on them.

        Linear then angular, world axes, at the centre of mass. M includes the joints' damping over a step.

        Args:
            bodies: (b,) indices.
            held: whether M includes the constraints that are active under the present loads.
        """
        resisting = self._damping()
        if held:
            self._hold(resisting)
        return mobility(self._model, self._data, jacobian_of(self._model, self._data, bodies), resisting)

    def mobilities(self, bodies: IntArray) -> tuple[Array, Array]:
        """Return the mobilities (6 b, 6 b) of bodies (b,) with active constraints, and without."""
        model, data = self._model, self._data
        jacobian, resisting = jacobian_of(model, data, bodies), self._damping()
        free = mobility(model, data, jacobian, resisting)
        if not self._hold(resisting):
            return free, free
        return mobility(model, data, jacobian, resisting), free

    def _damping(self) -> Array:
        """Return the joints' damping over a step (nv, nv) [kg m^2 or kg]."""
        return np.diag(self._model.opt.timestep * self._model.dof_damping)

    def _hold(self, resisting: Array) -> bool:
        """Add the active constraints under the present loads to (nv, nv); return whether there are any."""
        model, data = self._model, self._data
        if not data.nefc:
            return False
        before = np.array(data.qacc)
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)
        data.qacc[:] = before
        resisting += active_constraints(model, data)
        return True


def moved_by_loads(model: mujoco.MjModel) -> Mask:
    """Return a mask (bodies,) of bodies that loads can move: not welded to the world or a mocap body."""
    weld = model.body_weldid
    return np.asarray((weld != 0) & (model.body_mocapid[weld] < 0))


def touchable_geoms(model: mujoco.MjModel, mount: int, *, fixed_only: bool = False) -> IntArray:
    """Return the geoms that a soft body on the mount may touch: all that collide, but those of the arm.

    Args:
        model: compiled scene.
        mount: body that carries the soft body.
        fixed_only: whether only fixed bodies count.
    """
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    of_arm = model.body_rootid[model.geom_bodyid] == model.body_rootid[mount]
    if fixed_only:
        collides &= model.body_weldid[model.geom_bodyid] == 0
    return np.asarray(np.flatnonzero(collides & ~of_arm), dtype=np.int64)
