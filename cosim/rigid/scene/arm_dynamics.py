"""The arm of a scene at angles where it need not be: flange, joints, inertia and weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.rigid.scene.layout import ArmLayout


@final
@dataclass(frozen=True)
class ArmAtRest:
    """An arm that stands still.

    Args:
        flange: world_from_flange.
        places: (joints, 3) [m], of the joints, world.
        mass_matrix: (joints, joints) [kg m^2], armature included.
        gravity_torque: (joints,) [N m], which hold it.
    """

    flange: Pose
    places: Array
    mass_matrix: Array
    gravity_torque: Array


@final
class ArmDynamics:
    """Asks MuJoCo about the arm of a scene, which does not move.

    Args:
        model: of the scene.
        scratch: a state of it that is overwritten.
        layout: of the arm.
        driven: (d,) places of the cell's joints in the state.
        servo_inertia: (joints,) [kg m^2], of the model's armature what stands for the servos' damping.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        scratch: mujoco.MjData,
        layout: ArmLayout,
        driven: IntArray,
        servo_inertia: Array,
    ) -> None:
        self._model, self._scratch, self._layout, self._driven = model, scratch, layout, driven
        self._servo_inertia = servo_inertia

    @property
    def limits(self) -> tuple[Array, Array]:
        """Smallest and largest angles (joints,), (joints,) [rad]; infinite where a joint has none."""
        joints = self._layout.joints
        bounded, between = self._model.jnt_limited[joints] != 0, self._model.jnt_range[joints]
        return np.where(bounded, between[:, 0], -np.inf), np.where(bounded, between[:, 1], np.inf)

    def places(self, joints: Array, cell: Array | None = None) -> tuple[Array, Array]:
        """Return where bodies are (bodies, 3) [m], world, and their axes (bodies, 3, 3), world from body.

        Args:
            joints: (joints,) [rad]; objects stay where they are.
            cell: (d,) [m] or [rad], where its joints are; as in its file unless given.
        """
        model, data = self._model, self._scratch
        data.qpos[self._layout.positions] = joints
        data.qpos[self._driven] = 0.0 if cell is None else cell
        mujoco.mj_kinematics(model, data)
        return data.xpos.copy(), data.xmat.reshape(-1, 3, 3).copy()

    def at(self, joints: Array) -> ArmAtRest:
        """Return the arm at angles (joints,) [rad]; objects do not matter."""
        model, data, layout = self._model, self._scratch, self._layout
        data.qpos[layout.positions], data.qvel[:] = joints, 0.0
        mujoco.mj_fwdKinematics(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_makeM(model, data)
        full, weight, v = np.empty((model.nv, model.nv)), np.empty(model.nv), layout.dofs
        mujoco.mj_fullM(model, data, full)
        mujoco.mj_rne(model, data, 0, weight)
        flange = Pose(data.site_xmat[layout.site].reshape(3, 3), data.site_xpos[layout.site])
        mass = full[v, v] - np.diag(self._servo_inertia)
        return ArmAtRest(flange, data.xanchor[layout.joints].copy(), mass, weight[v].copy())
