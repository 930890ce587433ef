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


def flange_at_home(file: ArmFile) -> str:
    """Return in words where an arm's flange is at home, as `start.flange` of a scenario asks for it."""
    pose = Arm(file).forward(file.home)
    numbers = [", ".join(f"{x + 0.0:.3f}" for x in v) for v in (pose.translation, pose.rotation[:, 2])]
    return f"at home the flange is at [{numbers[0]}] m, its direction [{numbers[1]}]"
