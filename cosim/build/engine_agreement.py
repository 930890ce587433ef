"""Checks that MuJoCo and Pinocchio have read the same arm: limits, and flange pose, mass matrix and gravity
torque at random angles.
"""

from typing import Final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.errors import InputError
from cosim.kinematics.arm import Arm, Payload
from cosim.rigid.scene.scene import RigidScene

STATES: Final = 100
POSE_BOUND: Final = 1e-9
"""Of the flange's position [m] and of the entries of its rotation matrix."""
RELATIVE_BOUND: Final = 1e-6
"""Of the mass matrix and of the gravity torques."""


def check_engines_agree(scene: RigidScene, arm: Arm, armature: Array, payload: Payload | None = None) -> None:
    """Check limits, then flange pose, mass matrix and gravity torque at random angles.

    M_ij may differ by 1e-6 sqrt(M_ii M_jj), torques by 1e-6 of the largest. A difference in a link's mass
    affects all joints before it, so the message names the last affected joint.

    Args:
        scene: of MuJoCo, with the arm.
        arm: of Pinocchio.
        armature: (joints,) [kg m^2], from the arm's file.
        payload: mass that the scene has mounted on the flange.

    Raises:
        InputError: the engines differ; the message names a joint.
    """
    _check_limits(scene, arm)
    rng = np.random.default_rng(0)
    for _ in range(STATES):
        q = rng.uniform(*arm.drawn_from)
        mujoco, pose = scene.dynamics.at(q), arm.forward(q)
        offset_m = float(np.abs(mujoco.flange.translation - pose.translation).max())
        turn = float(np.abs(mujoco.flange.rotation - pose.rotation).max())
        if max(offset_m, turn) > POSE_BOUND:
            displaced = np.abs(mujoco.places - arm.joint_places(q)).max(axis=1) > POSE_BOUND
            _refuse(arm, displaced, f"the flange {1e3 * offset_m:.3g} mm and {turn:.3g} apart", first=True)
        mass = arm.mass_matrix(q, payload) + np.diag(armature)
        scale = np.sqrt(np.diag(mass))
        excess = np.diag(np.abs(mujoco.mass_matrix - mass) / np.outer(scale, scale))
        if (np.abs(mujoco.mass_matrix - mass) > RELATIVE_BOUND * np.outer(scale, scale)).any():
            what = f"the mass matrix {excess.max():.3g} of its size apart"
            _refuse(arm, excess > RELATIVE_BOUND, what)
        torque = arm.gravity_torque(q, payload)
        difference = np.abs(mujoco.gravity_torque - torque)
        if (bound := RELATIVE_BOUND * np.abs(torque).max()) < difference.max() > POSE_BOUND:
            _refuse(arm, difference > bound, f"the torque against gravity {difference.max():.3g} N m apart")


def _check_limits(scene: RigidScene, arm: Arm) -> None:
    lower, upper = scene.dynamics.limits
    effort = np.where(arm.effort_limit > 0.0, arm.effort_limit, np.inf)
    pairs = {
        "lower limits": (lower, arm.lower),
        "upper limits": (upper, arm.upper),
        "torque limits": (scene.effort_limit, effort),
    }
    for what, (one, other) in pairs.items():
        differs = ~np.isclose(one, other, rtol=RELATIVE_BOUND, atol=POSE_BOUND)
        if differs.any():
            k = int(np.argmax(differs))
            _refuse(arm, differs, f"{what} {one[k]:g} and {other[k]:g}", first=True)


def _refuse(arm: Arm, differs: Mask, what: str, *, first: bool = False) -> None:
    joints = np.flatnonzero(differs)
    joint = arm.joint_names[int(joints[0 if first else -1]) if len(joints) else -1]
    raise InputError(
        f"arm {arm.name!r}: MuJoCo and Pinocchio read joint {joint!r}, or its links, differently: {what}"
    )
