"""Checks files by building what they describe (`cosim check`), without solving statics or running."""

import math
from typing import Any

from cosim.base import arm_file, kept_parts
from cosim.base.frames import Array
from cosim.build import arm_parts, arms, engine_agreement, options
from cosim.config import loading, several_arms, studies
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.settings import ModelTable
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.rules import Faults
from cosim.errors import MOST_LINES, InputError, ScenarioError
from cosim.kinematics.arm import Arm
from cosim.plan import flange_motion, planning
from cosim.plan.start_checks import checked_start, drawn_payload
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene


def checked_arm(robot: str) -> arm_file.ArmFile:
    """Return an arm after both engines have read it and agree.

    Args:
        robot: see `find_arm`.

    Raises:
        InputError: its files are not usable; see `find_arm` and `check_engines_agree`.
    """
    file = arms.find_arm(robot)
    engine_agreement.check_engines_agree(RigidScene(SceneDescription(file)), Arm(file), file.armature)
    return file


def flange_at_home(file: arm_file.ArmFile) -> str:
    """Return the flange's pose at home, as the line `start.flange = {...}` of a scenario."""
    pose = Arm(file).forward(file.home)
    direction = pose.rotation[:, 2].round(4)
    rolled = flange_motion.rotation_from_direction(direction).T @ pose.rotation
    place, way = (", ".join(f"{x + 0.0:.4f}" for x in v) for v in (pose.translation, direction))
    roll = f"{math.atan2(rolled[1, 0], rolled[0, 0]) + 0.0:.4f}"
    return f"at home: start.flange = {{ position_m = [{place}], direction = [{way}], roll_rad = {roll} }}"


def check_robot(robot: SoftRobotTable) -> None:
    """Check that the film of a soft robot's file can be built.

    Args:
        robot: checked by `load_soft_robot`.

    Raises:
        ScenarioError: it cannot; with faults by key, see `build_soft_body`.
    """
    options.described_body(robot, ModelTable())


def check_built(scenario: Scenario, kept: kept_parts.KeptParts | None = None) -> None:
    """Check a scenario's film, arm, cell and objects, and that the arm reaches its start and planned motions.

    Checks that need statics or take minutes are left to the run: see `left_to_runs`.

    Args:
        scenario: checked by `load_scenario`.
        kept: cache of parts that similar scenarios share; None for none.

    Raises:
        ScenarioError: with faults by key; see `build_soft_body`, `ArmParts`, `check_start` and
            `check_given_motions`.
    """
    _start_of(scenario, kept_parts.KeptParts() if kept is None else kept)


def _start_of(scenario: Scenario, kept: kept_parts.KeptParts) -> Array | None:
    """Return the joint angles (joints,) at which a scenario's arm starts; None without an arm."""
    faults = Faults()
    with faults:
        body = kept.made("body", options.body_name(scenario), lambda: options.fidelity_body(scenario))
    if scenario.robot != NO_ARM:
        with faults:
            built = arm_parts.ArmParts(scenario, kept)
    faults.raise_all()
    if scenario.robot == NO_ARM:
        return None
    planner = checked_start(built.plan_joints, built.arm, built.scene, drawn_payload(body, built.mounted))
    return planning.check_given_motions(scenario, planner)


def check_arms(scenario: several_arms.ArmsScenario) -> None:
    """Check each of several arms as `check_built` does, and that no arm penetrates another at the start.

    Raises:
        ScenarioError: with faults by key.
    """
    kept, faults, starts = kept_parts.KeptParts(), Faults(), dict[str, Array]()
    for name, one in scenario.arms.items():
        with faults, several_arms.of_arm(name):
            start = _start_of(one, kept)
            assert start is not None, "each of several arms needs a robot"
            starts[name] = start
    faults.raise_all()
    arm_parts.check_starts(arm_parts.scene_of_arms(scenario.arms, kept)[1], starts)


def left_to_runs(scenario: Scenario) -> tuple[str, ...]:
    """Return the checks that are left to the run because they need statics or take minutes."""
    aimed = [repr(phase.name) for phase in scenario.phases if phase.tip_key is not None]
    found = [f"whether the tip can follow phase {', '.join(aimed)}"] if aimed else []
    if scenario.plan.collision == "refuse" and scenario.robot != NO_ARM:
        found.append("whether the planned motion is free of collisions (plan.collision)")
    if scenario.fidelity == "section":
        found.append("whether the film has a section model (fidelity)")
    return tuple(found)


def check_designs(study: studies.StudyTable) -> None:
    """Check that each design of a study can be loaded and built; nothing is run.

    Args:
        study: checked by `load_study`.

    Raises:
        ScenarioError: with faults by design and key; a fault of several designs is listed once.
    """

    designs, kept, found = studies.designs_of(study), kept_parts.KeptParts(), dict[str, list[int]]()
    for number, varied in enumerate(designs, 1):
        try:
            check_built(loading.load_scenario(study.scenario, {**study.set, **varied}), kept)
        except InputError as error:
            for place, problem in getattr(error, "faults", (("", str(error)),)):
                found.setdefault(f"{place}: {problem}" if place else problem, []).append(number)
    if not found:
        return
    faults = [(_named(numbers, designs), problem) for problem, numbers in found.items()]
    if len(faults) > MOST_LINES:
        faults[MOST_LINES:] = [("", f"... and {len(faults) - MOST_LINES} more")]
    raise ScenarioError(*faults[0], further=tuple(faults[1:]))


def _named(numbers: list[int], designs: list[dict[str, Any]]) -> str:
    """Return text for a message: the number and values of the first design, and how many more there are."""
    if len(numbers) == len(designs):
        return f"all {len(designs)} designs"
    values = ", ".join(f"{key} = {value!r}" for key, value in designs[numbers[0] - 1].items())
    others = f", and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"design {numbers[0]} of {len(designs)} ({values}){others}"
