"""Arms by name and by file, read so that both engines are given the same one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Pose
from cosim.config.arms.arm_files import arm_source
from cosim.config.arms.arm_reading import read_urdf
from cosim.config.arms.arm_table import BaseTable


def placed_arm(robot: str, base: BaseTable | None) -> ArmFile:
    """Return an arm where a scenario puts it.

    Args:
        robot: see `find_arm`.
        base: where its root link stands; None: as its own file says.

    Raises:
        InputError: see `find_arm`.
    """
    arm = find_arm(robot)
    if base is None:
        return arm
    placed = Pose.from_quaternion(np.array(base.quaternion), np.array(base.position_m))
    return replace(arm, world_from_base=placed)


def find_arm(robot: str) -> ArmFile:
    """Return an arm.

    Args:
        robot: one of `cosim.base.resources.list_arms()`, or the path of a URDF, an MJCF or an `arm.toml`.

    Raises:
        InputError: there is none, or its files are not usable.
        ScenarioError: keys or values of an `arm.toml` are wrong.
    """
    source = arm_source(robot)
    if source.is_mjcf:
        from cosim.rigid.build.mjcf_arm import read_mjcf  # here: a URDF waits for no engine

        arm = read_mjcf(source)
    else:
        arm = read_urdf(source)
    if arm.home_known:
        return arm
    from cosim.kinematics.arm import Arm  # here: an arm with a home waits for no engine
    from cosim.kinematics.home import far_from_singularities

    notes = (*arm.notes, "home found far from singularities")
    return replace(arm, home=far_from_singularities(Arm(arm, Pose())), notes=notes)
