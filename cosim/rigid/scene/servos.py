"""A step of MuJoCo with servos that damp implicitly and give no more torque than their joints bear.

A servo's torque is u - h K a, where u is the torque at the speed at which the step begins, K its damping, h
the step and a the acceleration. The joints carry h K as armature, so MuJoCo solves (M + h K) a = u + ..., and
its own actuator force is u, which depends on the step. A joint at its limit gets the limit itself instead,
and its armature is then without h K.
"""

from collections.abc import Sequence
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array


@final
class ArmServos:
    """Servos of an arm's joints; a view into a scene's model and state.

    `torque` (joints,) [N m] is that of the last step. The armature of the joints contains h K, and MuJoCo
    itself does not limit their forces.

    Args:
        model: compiled scene.
        data: its state.
        dofs: of the joints among all degrees of freedom.
        damping: K (joints,) [N m s/rad].
        limit: (joints,) [N m], largest torque; infinite for none.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, dofs: slice, damping: Array, limit: Array
    ) -> None:
        self.torque: Array = np.zeros(len(limit))
        step_s = float(model.opt.timestep)
        self._step_s, self._damping, self._limit = step_s, damping.tolist(), limit.tolist()
        self._carried: list[float] = (step_s * damping).tolist()  # h K
        self._limited = bool(np.isfinite(limit).any())
        # MuJoCo's arrays stay where they are in memory; looking one up costs as much as its copy
        self._force, self._speed, self._acceleration = (
            data.qfrc_actuator[dofs],
            data.qvel[dofs],
            data.qacc[dofs],
        )
        self._friction, self._mass = model.dof_damping[dofs], data.M
        self._diagonal = (model.M_rowadr + model.M_rownnz - 1)[dofs].tolist()
        self._asked: list[float] = []
        self._began: list[float] = []
        self._side: list[int] = []
        self._near = False  # whether any joint was near its limit

    def begin(self) -> None:
        """Take the torques u that MuJoCo has found, with no joint at its limit."""
        self._asked, self._began = self._force.tolist(), self._speed.tolist()
        self._side, self._near = [0] * len(self._asked), False

    def limit(self) -> bool:
        """Put joints at their limits, or take them off; return whether that has changed any.

        MuJoCo's mass matrix is then to be factorised, and accelerations are to be found again.
        """
        acceleration = self._acceleration.tolist() if self._limited else ()
        for asked, carried, a, limit in zip(
            self._asked, self._carried, acceleration, self._limit, strict=self._limited
        ):
            self._near |= abs(asked) + carried * abs(a) > limit
        return self._near and self._change_sides(acceleration)

    def _change_sides(self, acceleration: Sequence[float]) -> bool:
        changed, h = False, self._step_s
        for j, (asked, limit, a) in enumerate(zip(self._asked, self._limit, acceleration, strict=True)):
            # friction of joints is implicit in MuJoCo's step; joints count as if each were alone
            inertia, carried = float(self._mass[self._diagonal[j]]), self._carried[j]
            torque = asked - carried * a * inertia / (inertia + h * float(self._friction[j]))
            side = 1 if torque > limit else -1 if torque < -limit else 0
            if side != self._side[j]:
                self._mass[self._diagonal[j]] += carried * (abs(self._side[j]) - abs(side))
                self._force[j] = side * limit if side else asked
                self._side[j], changed = side, True
        return changed

    def end(self) -> None:
        """Find the torques of the last step from the speeds at its ends."""
        ends = zip(self._asked, self._damping, self._speed.tolist(), self._began, strict=True)
        torques = [asked - damping * (speed - began) for asked, damping, speed, began in ends]
        if self._near:
            rows = zip(torques, self._limit, self._side, strict=True)
            torques = [
                side * limit if side else min(max(torque, -limit), limit) for torque, limit, side in rows
            ]
        self.torque[:] = torques


def finish_step(model: mujoco.MjModel, data: mujoco.MjData, servos: Sequence[ArmServos]) -> None:
    """Take the second half of a step: accelerations, sensors, and the state at its end.

    Args:
        model: compiled scene.
        data: its state after `mujoco.mj_step1`.
        servos: of all its arms.
    """
    mujoco.mj_fwdActuation(model, data)
    _accelerate(model, data)
    for each in servos:
        each.begin()
    for _ in range(2 * model.nv):
        changed = [each.limit() for each in servos]
        if not any(changed):
            break
        mujoco.mj_factorM(model, data)
        _accelerate(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    mujoco.mj_sensorAcc(model, data)
    mujoco.mj_checkAcc(model, data)
    mujoco.mj_Euler(model, data)


def _accelerate(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    mujoco.mj_fwdAcceleration(model, data)
    mujoco.mj_fwdConstraint(model, data)
