"""Where the arm sits in a compiled MuJoCo model."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.rigid.build.description import FLANGE_SITE, FORCE_SENSOR, TORQUE_SENSOR


@dataclass(frozen=True)
class ArmLayout:
    """Indices of the arm; joints are consecutive, so slices (views, no copies) serve.

    Args:
        joints: of the arm among joints and actuators.
        positions: in qpos.
        dofs: in qvel.
        site: the flange.
        mount: massless body at the flange.
        force: of the flange's force sensor in sensordata.
        torque: of the flange's torque sensor in sensordata.
    """

    joints: slice
    positions: slice
    dofs: slice
    site: int
    mount: int
    force: slice
    torque: slice

    @classmethod
    def of(cls, model: mujoco.MjModel, joint_names: tuple[str, ...]) -> ArmLayout:
        """Return the layout of the arm with the named joints, base to flange."""
        joints = np.array([model.joint(name).id for name in joint_names])
        site = int(model.site(FLANGE_SITE).id)
        force, torque = (int(model.sensor(name).adr[0]) for name in (FORCE_SENSOR, TORQUE_SENSOR))
        return cls(
            joints=_consecutive(joints),
            positions=_consecutive(model.jnt_qposadr[joints]),
            dofs=_consecutive(model.jnt_dofadr[joints]),
            site=site,
            mount=int(model.site_bodyid[site]),
            force=slice(force, force + 3),
            torque=slice(torque, torque + 3),
        )


def effort_limit(model: mujoco.MjModel, layout: ArmLayout) -> Array:
    """Return the largest servo torques (joints,) [N m]; infinite where the arm's file names none."""
    limited = model.jnt_actfrclimited[layout.joints]
    return np.where(limited, model.jnt_actfrcrange[layout.joints, 1], np.inf)


def _consecutive(addresses: IntArray) -> slice:
    first, count = int(addresses[0]), len(addresses)
    if not np.array_equal(addresses, np.arange(first, first + count)):
        raise AssertionError(f"the arm's joints are not consecutive in the compiled model: {addresses}")
    return slice(first, first + count)
