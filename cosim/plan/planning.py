"""Makes the plan of a run: checks that the arm reaches it, and solves the phases that depend on the soft
body.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.config.gas_rules import gas_rules
from cosim.config.schema.phase import TipTargetTable
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError, UnreachableError
from cosim.plan.flange_motion import pose_of
from cosim.plan.joint_path import JointPath
from cosim.plan.plan import PhasePlan, Plan
from cosim.plan.static_plan import (
    SolvedPhases,
    all_drafts,
    flange_key,
    given_motion,
    solved_count,
    start_command,
)
from cosim.plan.tip_paths import AnyFlangeMotion
from cosim.soft.body.body import SoftBody

JointPlanner: TypeAlias = Callable[[Pose, list[AnyFlangeMotion], Callable[[int], str]], tuple[JointPath, ...]]
"""Start pose, flange motions of all phases, and the key of phase k (-1: the start) -> joint paths."""


def make_plan(
    scenario: Scenario, plan_joints: JointPlanner, body: SoftBody, solve: Callable[[], SolvedPhases]
) -> Plan:
    """Return the plan of a scenario.

    Args:
        scenario: checked.
        plan_joints: returns joint paths for the flange's motion.
        body: of the soft robot.
        solve: returns `solved_phases` of the scenario; called only if the plan depends on the statics.

    Raises:
        ScenarioError: a pose or target cannot be reached; `path` names the key.
    """
    start = pose_of(scenario.start.flange)
    check_given_motions(scenario, plan_joints)  # before the statics, which take longer
    drafts = all_drafts(scenario, solve() if solved_count(scenario) else None, body)
    joints = _joints_along(scenario, plan_joints, start, [draft.way for draft in drafts])
    plans = tuple(
        PhasePlan(
            phase, path, draft.begin.unsealed(), draft.end.unsealed(), rule,
            draft.holding, _target_point(phase.tip_target), draft.way.end, draft.path,
        )
        for phase, draft, path, rule in zip(
            scenario.phases, drafts, joints, gas_rules(scenario), strict=True
        )
    )  # fmt: skip
    command = start_command(scenario.start, body)
    return Plan(start, joints[0].first, command, scenario.gravity_m_s2, plans)


def check_given_motions(scenario: Scenario, plan_joints: JointPlanner) -> Array:
    """Check that the arm reaches its start, and the phases before the first that depends on the soft body.

    Returns the joint angles (joints,) [rad] at the start.

    Raises:
        ScenarioError: a pose cannot be reached; `path` names the key.
    """
    start = pose_of(scenario.start.flange)
    ways = _given_motions(scenario, start) or [given_motion(start, scenario.phases[0])]
    return _joints_along(scenario, plan_joints, start, ways)[0].first


def _joints_along(
    scenario: Scenario, plan_joints: JointPlanner, start: Pose, ways: list[AnyFlangeMotion]
) -> tuple[JointPath, ...]:
    keys = ["start.flange", *(flange_key(phase) for phase in scenario.phases)]
    try:
        return plan_joints(start, ways, lambda k: keys[k + 1])
    except UnreachableError as error:
        key, _, reason = str(error).partition(": ")  # the planner puts the key in front
        raise ScenarioError(key, reason) from error


def _given_motions(scenario: Scenario, start: Pose) -> list[AnyFlangeMotion]:
    """Return the flange's motions of the phases before the first whose end depends on the soft body."""
    ways: list[AnyFlangeMotion] = []
    for phase in scenario.phases:
        if phase.tip_path or (phase.tip_target is not None and phase.tip_target.reach_with != "cables"):
            break
        ways.append(given_motion(start if not ways else ways[-1].end, phase))
    return ways


def _target_point(target: TipTargetTable | None) -> Array | None:
    if target is None:
        return None
    if target.position_m is not None:
        return np.array(target.position_m)
    return np.array([np.nan, np.nan, target.height_m])
