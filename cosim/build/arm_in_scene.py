"""The arm of a scenario and everything rigid around it, read and joined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

from cosim.base.arm_file import ArmFile
from cosim.build.arms import placed_arm
from cosim.build.blame import blamed_on
from cosim.build.cells import cell_of, motion_of
from cosim.build.engines_agree import check_engines_agree
from cosim.build.scene_objects import palm_mass, palm_object, rigid_object, rigid_wire
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.faults import Faults
from cosim.coupling.soft_sides.mass import MassProperties
from cosim.errors import ScenarioError, SceneError
from cosim.kinematics.arm import Arm, Payload
from cosim.plan.cell_motion import CellMotion
from cosim.rigid.build.cell import Cell
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene

_FEWEST: Final = 4


@final
@dataclass(frozen=True)
class ArmInScene:
    """An arm in the scene of a scenario, at the scene's start.

    Args:
        arm: kinematics and inverse dynamics.
        scene: the arm, its cell and objects.
        driven: how the phases move joints of the cell; None where it has none.
        mounted: what is fixed to the flange besides the soft robot; None without.
    """

    arm: Arm
    scene: RigidScene
    driven: CellMotion | None
    mounted: MassProperties | None


def arm_in_scene(scenario: Scenario) -> ArmInScene:
    """Return the arm of a scenario in its scene; both engines have read the arm alike.

    Raises:
        ScenarioError: what is wrong with the arm and with the cell, or with an object, by key.
    """
    file, arm, cell, driven = _read(scenario)
    palm = scenario.soft_robot.palm
    description = SceneDescription(
        arm=file,
        tick_s=scenario.clock.tick_s,
        gravity=scenario.gravity_m_s2,
        objects=tuple(rigid_object(entry) for entry in scenario.objects),
        wires=tuple(rigid_wire(entry) for entry in scenario.wires),
        cell=cell,
        mounted=() if palm is None else (palm_object(palm),),
    )
    try:
        scene = RigidScene(description)
    except SceneError as error:
        raise ScenarioError(_body_key(scenario, error.body), str(error)) from error
    mounted = None if palm is None else palm_mass(palm)
    with blamed_on("robot"):
        held = None if mounted is None else Payload(mounted.mass_kg, mounted.center, mounted.inertia)
        check_engines_agree(scene, arm, file.armature, held)
    return ArmInScene(arm, scene, driven, mounted)


def _read(scenario: Scenario) -> tuple[ArmFile, Arm, Cell | None, CellMotion | None]:
    """Return the arm's file, the arm, its cell, and how the phases drive that."""
    faults, cell, driven = Faults(), None, None
    with faults, blamed_on("robot"):
        file = placed_arm(scenario.robot, scenario.arm_base)
        arm = Arm(file, gravity=scenario.gravity_m_s2)
        _check_joints(scenario, arm)
    with faults:
        cell = None if scenario.scene is None else cell_of(scenario.scene)
        driven = motion_of(scenario, cell)
    faults.tell()
    return file, arm, cell, driven


def _body_key(scenario: Scenario, body: str | None) -> str:
    """Return the key of an object or wire of the rigid scene; None: what every scene has."""
    if body is None:
        return "robot" if scenario.soft_robot.palm is None else "soft_robot.palm"
    return f"{'wire' if body in (wire.name for wire in scenario.wires) else 'object'}.{body}"


def _check_joints(scenario: Scenario, arm: Arm) -> None:
    """Check that an arm has as many joints as a scenario asks for.

    With less than 6 joints the flange follows places and directions of its z axis, and rolls as it comes.
    What depends on the roll before the plan is made cannot be asked for.

    Raises:
        ScenarioError: it has less than 4 joints, or does not follow rolls and is to reach a tip target.
    """
    if arm.joint_count < _FEWEST:
        raise ScenarioError(
            "robot",
            f"arm {arm.name!r} has {arm.joint_count} joints ({', '.join(arm.joint_names)}); at least "
            f"{_FEWEST} are needed for places and directions of the flange, 6 for its roll as well",
        )
    for phase in scenario.phases:
        if arm.free_roll and phase.tip_key is not None:
            raise ScenarioError(
                f"phase.{phase.name}.{phase.tip_key}",
                f"arm {arm.name!r} has {arm.joint_count} joints, so its flange rolls as it comes; tip "
                "targets and paths need an arm of 6 joints or more",
            )
