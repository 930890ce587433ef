"""Whether MuJoCo and Pinocchio have the same arm: both are asked at random angles before anything runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.errors import InputError

if TYPE_CHECKING:  # a scene without an arm waits for neither engine
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.scene import RigidScene

STATES: Final = 100
POSE_BOUND: Final = 1e-9
"""Of the flange's place [m] and of its turn, as a difference of rotation matrices."""

RELATIVE_BOUND: Final = 1e-6
"""Of the mass matrix and of the torques that hold the weight."""


def check_engines_agree(scene: RigidScene, arm: Arm, armature: Array, payload: Payload | None = None) -> None:
    """Check limits, then flange pose, mass matrix and gravity torque at random angles.

    M_ij may differ by 1e-6 sqrt(M_ii M_jj), torques by 1e-6 of the largest. What one link weighs more is felt
    by all joints before it, so the last joint that feels a difference is named.

    Args:
        scene: with the arm, MuJoCo's.
        arm: Pinocchio's.
        armature: (joints,) [kg m^2], as the arm's file has it.
        payload: what the scene has mounted on the flange.

    Raises:
        InputError: they differ; the message names a joint.
    """
    _check_limits(scene, arm)
    rng = np.random.default_rng(0)
    for _ in range(STATES):
        q = rng.uniform(*arm.drawn_from)
        here, pose = scene.dynamics.at(q), arm.forward(q)
        away = float(np.abs(here.flange.translation - pose.translation).max())
        turned = float(np.abs(here.flange.rotation - pose.rotation).max())
        if max(away, turned) > POSE_BOUND:
            places = np.abs(here.places - arm.joint_places(q)).max(axis=1) > POSE_BOUND
            _refuse(arm, places, f"the flange {1e3 * away:.3g} mm and {turned:.3g} apart", first=True)
        mass = arm.mass_matrix(q, payload) + np.diag(armature)
        scale = np.sqrt(np.diag(mass))
        excess = np.diag(np.abs(here.mass_matrix - mass) / np.outer(scale, scale))
        if (np.abs(here.mass_matrix - mass) > RELATIVE_BOUND * np.outer(scale, scale)).any():
            what = f"the mass matrix {excess.max():.3g} of its size apart"
            _refuse(arm, excess > RELATIVE_BOUND, what)
        torque = arm.gravity_torque(q, payload)
        apart = np.abs(here.gravity_torque - torque)
        if (bound := RELATIVE_BOUND * np.abs(torque).max()) < apart.max() > POSE_BOUND:
            _refuse(arm, apart > bound, f"the torque against gravity {apart.max():.3g} N m apart")


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
    found = np.flatnonzero(differs)
    joint = arm.joint_names[int(found[0 if first else -1]) if len(found) else -1]
    raise InputError(
        f"arm {arm.name!r}: MuJoCo and Pinocchio read joint {joint!r}, or what it moves, differently: {what}"
    )
