"""The joints of a cell: they go where they are told, whatever pushes them, as drives without give do.

A drive's rotor is so heavy that no load accelerates it, so contacts feel the speed of what it moves; at the
end of every step its joint is put where it is to be, so that nothing adds up.
"""

from __future__ import annotations

from typing import Final, final

import mujoco
import numpy as np

from cosim.base.frames import Array, Mask
from cosim.rigid.build.cell import CELL

ROTOR: Final = 1e6  # kg, kg m^2


@final
class CellDrives:
    """Moves the joints of a cell; a view into a scene's model and state.

    `names` are those of the joints, in the order of all arrays here; `bodies` (bodies,) says which bodies of
    the scene belong to the cell; `places` and `dofs` are where MuJoCo has the joints, `goal` (2, joints) is
    what `aim` has set.

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
        """Set where joints are at the end of the step to come, and how fast they go on from there.

        Args:
            position: (joints,) [m] or [rad], from where the cell's file has them.
            velocity: (joints,) [m/s] or [rad/s].
        """
        self.goal[:] = position, velocity

    def arrive(self) -> None:
        """Put the joints where they were to be at the end of the step."""
        if self.names:
            self._data.qpos[self.places], self._data.qvel[self.dofs] = self.goal
