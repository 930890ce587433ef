"""Finds the arm and the cell of a scenario by name or path, and reads them. MuJoCo and Pinocchio are imported
only if needed.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Pose
from cosim.config import arm_files, arm_table
from cosim.config.schema.objects import SceneTable
from cosim.config.schema.phase import CELL_KEYS
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.rules import errors_at
from cosim.plan.cell_motion import CellMotion, cell_motion
from cosim.rigid.build import mounting

if TYPE_CHECKING:
    from cosim.rigid.build.description import Cell


def placed_arm(robot: str, base: arm_table.BaseTable | None) -> ArmFile:
    """Return an arm at its base in a scenario.

    Args:
        robot: see `find_arm`.
        base: pose of its root link, and the rails and turntables under it; None: those of the arm's file.

    Raises:
        InputError: see `find_arm`.
    """
    arm = find_arm(robot)
    if base is None:
        return arm
    placed = Pose.from_quaternion(np.array(base.quaternion), np.array(base.position_m))
    return mounting.on_moving_base(replace(arm, world_from_base=placed), base)


def find_arm(robot: str) -> ArmFile:
    """Return an arm, with a home if its file has none.

    Args:
        robot: one of `cosim.base.resources.list_arms()`, or the path of a URDF, an MJCF or an `arm.toml`.

    Raises:
        InputError: there is no such arm, or its files are not usable.
        ScenarioError: keys or values of an `arm.toml` are wrong.
    """
    from cosim.rigid.build.arm_reader import read_arm  # imported here so that no arm means no MuJoCo

    arm = read_arm(arm_files.arm_source(robot))
    if arm.home_known:
        return arm
    from cosim.kinematics.arm import Arm  # imported here: an arm with a home needs no Pinocchio
    from cosim.kinematics.inverse_kinematics import far_from_singularities

    notes = (*arm.notes, "home found far from singularities")
    return replace(arm, home=far_from_singularities(Arm(arm, Pose())), notes=notes)


def cell_of(scene: SceneTable) -> "Cell":
    """Return the cell of a scene.

    Raises:
        ScenarioError: its file is not usable.
    """
    from cosim.rigid.build.cell import read_cell

    with errors_at("scene.mjcf"):
        return read_cell(Path(scene.mjcf))


def motion_of(scenario: Scenario, cell: "Cell | None") -> CellMotion | None:
    """Return the motion of a cell's joints that the phases prescribe; None for a cell without joints.

    Raises:
        ScenarioError: a phase names an unknown joint, or a position beyond its limits.
    """
    joints, tick_s = () if cell is None else cell.joints, scenario.clock.tick_s
    asked = any(getattr(phase, key) is not None for phase in scenario.phases for key in CELL_KEYS)
    if not joints and not asked:
        return None
    lengths = [tick_s * max(1, round((p.duration_s + p.settle_s) / tick_s)) for p in scenario.phases]
    return cell_motion(scenario.phases, joints, lengths)
