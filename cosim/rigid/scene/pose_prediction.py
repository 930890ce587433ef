"""Predicts the motion of bodies over the coming tick with MuJoCo's steps. A tick of one step uses the
accelerations under the present loads, contacts and constraints. A tick of several steps takes these in a
second state of the scene, so contacts that begin within the tick are included, and servos continue at their
last reference speed.
"""

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import unchecked
from cosim.rigid.scene.added_inertia import AddedInertia
from cosim.rigid.scene.body_motion import BodyMotions, add_way

_COPIED = "qpos", "qvel", "qacc_warmstart", "qfrc_applied", "xfrc_applied", "ctrl"


@final
class PosePrediction:
    """Predicts displacements of bodies relative to the flange, whose own bodies do not move in this view.

    `lead` (bodies, 6) is the displacement of each body: translation at the world's origin [m], then rotation
    [rad]. `ahead` (bodies,) says for which pose of a body contacts are computed: 1 at the end of the next
    step; -1 in the middle of the steps in which the load acts, a tick later; 0 at present.

    Args:
        model: compiled scene.
        data: its state.
        flange: index of the body with the flange.
        pace: (2,), see `Bodies`.
        carried: inertia that is added to the arm's joints.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, flange: int, pace: IntArray, carried: AddedInertia
    ) -> None:
        self._model, self._data, self._pace, self._carried = model, data, pace, carried
        self._roots: IntArray = np.asarray(model.body_rootid, dtype=np.int64)
        self._flange = flange
        self.motions = self._motions(data)
        self._diagonal = np.asarray(model.M_rowadr + model.M_rownnz - 1, np.int64)
        self._second = there = mujoco.MjData(model) if pace[0] > 1 else data
        self._motions_then, self._applied = self._motions(there), data.xfrc_applied
        self._copied = [(getattr(there, name), getattr(data, name)) for name in _COPIED]
        self._aims, self._speeds = there.ctrl[0::3], there.ctrl[1::3]
        self.lead: Array = np.zeros((model.nbody, 6))
        self.ahead: IntArray = np.zeros(model.nbody, np.int64)

    def _motions(self, data: mujoco.MjData) -> BodyMotions:
        return BodyMotions(data.cvel, data.subtree_com, self._roots, data.xipos, self._flange)

    @property
    def steps(self) -> int:
        """Number of MuJoCo's steps in the next rigid step."""
        return int(self._pace[0])

    def at_velocities(self, tick_s: float) -> None:
        """Fill `lead` with the displacements after a time [s] at the present velocities."""
        steps = self.steps
        self.lead.fill(0.0)
        unchecked(add_way)(self.motions, self.ahead, 1, tick_s, self.lead)
        if steps > 1:
            add_way(self.motions, self.ahead, -1, tick_s * (steps - 1) / (2 * steps), self.lead)

    def under_loads(self, loads: Array, tick_s: float) -> None:
        """Fill `lead` with the displacements at the end of MuJoCo's next step.

        Args:
            loads: (bodies, 6) [N, N m], about centres of mass, for bodies with `ahead` 1; the others keep
                their present loads.
            tick_s: length of the step [s].
        """
        applied = self._applied
        before, ahead = applied.copy(), self.ahead > 0
        applied[ahead] = loads[ahead]
        if self.steps > 1:
            self._take_steps()
        else:
            self._accelerate(tick_s)
        applied[:] = before

    def _accelerate(self, h: float) -> None:
        model, data = self._model, self._data
        speed, acceleration = data.qvel.copy(), data.qacc.copy()
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)
        # damping is implicit in MuJoCo's step; joints count as if each were alone
        inertia = data.M[self._diagonal]
        data.qvel[:] = speed + h * data.qacc * inertia / (inertia + h * model.dof_damping)
        mujoco.mj_comVel(model, data)
        self.at_velocities(h)
        data.qvel[:], data.qacc[:] = speed, acceleration
        mujoco.mj_comVel(model, data)

    def _take_steps(self) -> None:
        model, there = self._model, self._second
        for then, now in self._copied:
            np.copyto(then, now)
        step_s = float(model.opt.timestep)
        self.lead[self.ahead > 0] = 0.0
        for _ in range(self.steps):
            mujoco.mj_step1(model, there)
            self._carried.follow(there)
            self._aims += step_s * self._speeds
            mujoco.mj_step2(model, there)
            mujoco.mj_comVel(model, there)
            unchecked(add_way)(self._motions_then, self.ahead, 1, step_s, self.lead)
