"""Moves the joints of a cell along their targets, whatever force acts on them, as ideal drives do."""

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, Mask
from cosim.rigid.build.scene_names import CELL


@final
class CellDrives:
    """Moves the joints of a cell; a view into a scene's model and state.

    `names` are those of the joints, in the order of all arrays; `bodies` (bodies,) is a mask of the cell's
    bodies; `places` and `dofs` are the joints' addresses in qpos and qvel; `goal` (2, joints) has the target
    positions and velocities that `aim` sets.

    Args:
        model: compiled scene.
        data: its state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        cell = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, CELL)
        self.bodies: Mask = (model.body_rootid == cell) & (cell > 0)
        joints = np.flatnonzero(self.bodies[model.jnt_bodyid])
        self.names = tuple(model.joint(int(joint)).name.removeprefix(f"{CELL}/") for joint in joints)
        self._data = data
        self.places, self.dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.goal = np.zeros((2, len(joints)))

    def aim(self, position: Array, velocity: Array) -> None:
        """Set positions and velocities of the joints at the end of the coming tick.

        Args:
            position: (joints,) [m] or [rad], from the positions in the cell's file.
            velocity: (joints,) [m/s] or [rad/s].
        """
        self.goal[:] = position, velocity

    def drive(self, left: int, step_s: float) -> None:
        """Correct the joints after a step, so that they reach their targets at the end of the tick.

        Args:
            left: MuJoCo's steps until the end of the tick, the one just integrated included.
            step_s: length of a step [s].
        """
        if not self.names:
            return
        position, velocity = self._data.qpos, self._data.qvel
        if left == 1:
            position[self.places], velocity[self.dofs] = self.goal
            return
        integrated = step_s * velocity[self.dofs]
        step = (self.goal[0] - position[self.places] + integrated) / left
        position[self.places] += step - integrated
        velocity[self.dofs] = step / step_s
