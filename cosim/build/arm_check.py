"""Checks an arm's file all by itself."""

from __future__ import annotations

from cosim.base.arm_file import ArmFile
from cosim.build.arms import find_arm
from cosim.build.engines_agree import check_engines_agree
from cosim.kinematics.arm import Arm
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene


def checked_arm(robot: str) -> ArmFile:
    """Return an arm that both engines have read, and read alike.

    Args:
        robot: see `find_arm`.

    Raises:
        InputError: its files are not usable; see `find_arm` and `check_engines_agree`.
    """
    file = find_arm(robot)
    check_engines_agree(RigidScene(SceneDescription(file)), Arm(file), file.armature)
    return file
