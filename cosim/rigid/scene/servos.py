"""Steps MuJoCo with servos whose damping is implicit and whose torque is limited. A servo's torque is u - h K
a, with u the torque at the speed at the step's begin, K its damping, h the step and a the acceleration. The
joints carry h K as armature, so MuJoCo solves (M + h K) a = u + ..., and its actuator force is u. A joint at
its limit gets the limit as torque, and its armature is then without h K.
"""

from collections.abc import Sequence
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array
from cosim.base.kernels import unchecked
from cosim.rigid.scene.load_leaves import fill_servo_torque, near_limit


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
        self._step_s, self._damping, self._limit = step_s, np.array(damping), np.array(limit)
        self._carried: Array = step_s * self._damping  # h K
        # MuJoCo's arrays stay where they are in memory; looking one up costs as much as its copy
        self._force, self._speed, self._acceleration = (
            data.qfrc_actuator[dofs],
            data.qvel[dofs],
            data.qacc[dofs],
        )
        self._friction, self._mass = model.dof_damping[dofs], data.M
        self._diagonal = (model.M_rowadr + model.M_rownnz - 1)[dofs].tolist()
        self._asked, self._began = np.zeros(len(limit)), np.zeros(len(limit))
        self._side = [0] * len(limit)  # 1 or -1 for a joint at its upper or lower limit, else 0

    def begin(self) -> None:
        """Read the torques u that MuJoCo has computed; no joint is at its limit yet."""
        self._asked[:], self._began[:] = self._force, self._speed
        if any(self._side):
            self._side = [0] * len(self._side)

    def limit(self) -> bool:
        """Decide which joints are at their limits; return whether that has changed for any.

        Then MuJoCo's mass matrix must be factorised, and accelerations must be computed again.
        """
        near = unchecked(near_limit)(self._asked, self._carried, self._acceleration, self._limit)
        return (near or any(self._side)) and self._change_sides()

    def _change_sides(self) -> bool:
        changed, h, given = False, self._step_s, (self._asked, self._limit, self._acceleration)
        for j, (asked, limit, a) in enumerate(zip(*(row.tolist() for row in given), strict=True)):
            # friction of joints is implicit in MuJoCo's step; joints count as if each were alone
            inertia, carried = float(self._mass[self._diagonal[j]]), float(self._carried[j])
            torque = asked - carried * a * inertia / (inertia + h * float(self._friction[j]))
            side = 1 if torque > limit else -1 if torque < -limit else 0
            if side != self._side[j]:
                self._mass[self._diagonal[j]] += carried * (abs(self._side[j]) - abs(side))
                self._force[j] = side * limit if side else asked
                self._side[j], changed = side, True
        return changed

    def end(self) -> None:
        """Compute the torques of the last step from the speeds at its ends."""
        unchecked(fill_servo_torque)(
            self._asked, self._damping, self._speed, self._began, self._limit, self.torque
        )
        for j, side in enumerate(self._side):
            if side:
                self.torque[j] = side * self._limit[j]


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
