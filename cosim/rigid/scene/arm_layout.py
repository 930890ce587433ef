"""Indices of an arm in a compiled MuJoCo model: joints, degrees of freedom, flange, sensors."""

from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.rigid.build.scene_names import (
    FLANGE_CONTACTS,
    FLANGE_SITE,
    FORCE_SENSOR,
    OBJECT_CONTACTS,
    TORQUE_SENSOR,
)

SITE, BODY = int(mujoco.mjtObj.mjOBJ_SITE), int(mujoco.mjtObj.mjOBJ_XBODY)
NO_OBJECT = int(mujoco.mjtObj.mjOBJ_UNKNOWN)


@final
@dataclass(frozen=True)
class Mounting:
    """The frame of a compiled model that a soft robot is mounted on, its flange.

    Args:
        kind: SITE or BODY.
        index: of the site or body.
        body: that the frame is fixed to.
        dofs: degrees of freedom that move it, from the root on.
    """

    kind: int
    index: int
    body: int
    dofs: slice | IntArray

    def frame(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return views of the frame's origin (3,) [m] and of its axes (3, 3), world from frame."""
        places, axes = (data.site_xpos, data.site_xmat) if self.kind == SITE else (data.xpos, data.xmat)
        return places[self.index], axes[self.index].reshape(3, 3)


@dataclass(frozen=True)
class ArmLayout:
    """Indices of the arm; joints are consecutive, so slices (views, no copies) are enough.

    Args:
        joints: of the arm among joints and actuators.
        positions: in qpos.
        dofs: in qvel.
        site: the flange.
        mount: massless body at the flange.
        force: of the flange's force sensor in sensordata.
        torque: of the flange's torque sensor in sensordata.
        contacts: in sensordata, the number of contacts of bodies mounted on the flange.
        carries: whether a rigid body is mounted on the flange.
        object_sensors: (o, 2 + k), for each free object: its body, the address in sensordata of its number of
            contacts with rigid bodies, and those with bodies on each flange, this arm's first.
    """

    joints: slice
    positions: slice
    dofs: slice
    site: int
    mount: int
    force: slice
    torque: slice
    contacts: int
    carries: bool
    object_sensors: IntArray

    @property
    def mounting(self) -> Mounting:
        """The frame that the soft robot is mounted on."""
        return Mounting(SITE, self.site, self.mount, self.dofs)

    @classmethod
    def of(cls, model: mujoco.MjModel, joint_names: tuple[str, ...], prefix: str = "") -> "ArmLayout":
        """Return the layout of an arm.

        Args:
            model: compiled scene.
            joint_names: base to flange.
            prefix: of all names of the arm.
        """
        joints = np.array([model.joint(prefix + name).id for name in joint_names])
        site = int(model.site(prefix + FLANGE_SITE).id)
        force, torque = (int(model.sensor(prefix + name).adr[0]) for name in (FORCE_SENSOR, TORQUE_SENSOR))
        return cls(
            joints=_consecutive(joints),
            positions=_consecutive(model.jnt_qposadr[joints]),
            dofs=_consecutive(model.jnt_dofadr[joints]),
            site=site,
            mount=int(model.site_bodyid[site]),
            force=slice(force, force + 3),
            torque=slice(torque, torque + 3),
            contacts=int(model.sensor(prefix + FLANGE_CONTACTS).adr[0]),
            carries=bool((model.body_parentid == model.site_bodyid[site]).any()),
            object_sensors=_object_sensors(model, int(model.site_bodyid[site])),
        )


def _object_sensors(model: mujoco.MjModel, mount: int) -> IntArray:
    """Return the bodies and sensors of free objects, see `ArmLayout.object_sensors`."""
    rows: dict[int, list[int]] = {}
    for sensor in range(model.nsensor):
        if model.sensor(sensor).name.startswith(OBJECT_CONTACTS):
            body, with_all = int(model.sensor_objid[sensor]), model.sensor_reftype[sensor] == NO_OBJECT
            row, address = rows.setdefault(body, [body]), int(model.sensor_adr[sensor])
            first = not with_all and model.sensor_refid[sensor] == mount
            row.insert(2 if first else len(row), address)
    return np.array(list(rows.values()), np.int64).reshape(len(rows), -1 if rows else 3)


def effort_limit(model: mujoco.MjModel, layout: ArmLayout) -> Array:
    """Return the largest servo torques (joints,) [N m]; infinite if the arm's file gives none."""
    largest = model.jnt_actfrcrange[layout.joints, 1]
    return np.where(largest > 0.0, largest, np.inf)


def _consecutive(addresses: IntArray) -> slice:
    first, count = int(addresses[0]), len(addresses)
    if not np.array_equal(addresses, np.arange(first, first + count)):
        raise AssertionError(f"the arm's joints are not consecutive in the compiled model: {addresses}")
    return slice(first, first + count)
