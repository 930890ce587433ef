"""Makes the plan of a run: refuses what the arm cannot reach, solves what depends on the soft body."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.config.rules.gas_rules import gas_rules
from cosim.config.schema.phase import TipTargetTable
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError, UnreachableError
from cosim.plan.flange_path import pose_of
from cosim.plan.joint_path import JointPath
from cosim.plan.paths.phase_drafts import SolvedPhases, all_drafts, solved_count, start_command
from cosim.plan.paths.phase_motion import AnyWay, flange_key, given_way
from cosim.plan.plan import PhasePlan, Plan
from cosim.soft.body.body import SoftBody

JointPlanner: TypeAlias = Callable[[Pose, list[AnyWay], Callable[[int], str]], tuple[JointPath, ...]]
"""Start pose, ways of all phases, and the key to blame for phase k (-1: the start) -> joint paths."""


def make_plan(
    scenario: Scenario, plan_joints: JointPlanner, body: SoftBody, solve: Callable[[], SolvedPhases]
) -> Plan:
    """Return the plan of a scenario.

    Args:
        scenario: checked.
        plan_joints: finds the joint angles for the flange's motion.
        body: of the soft robot.
        solve: returns `solved_phases` of the scenario, if its plan depends on the statics.

    Raises:
        ScenarioError: a pose or target cannot be reached; `path` names the key.
    """
    start = pose_of(scenario.start.flange)
    check_given_ways(scenario, plan_joints)  # the statics take longer: what does not depend on them first
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


def check_given_ways(scenario: Scenario, plan_joints: JointPlanner) -> None:
    """Check the arm's start, and the phases before the first whose end depends on the soft body, if any.

    Raises:
        ScenarioError: a pose cannot be reached; `path` names the key.
    """
    start = pose_of(scenario.start.flange)
    ways = _given_ways(scenario, start) or [given_way(start, scenario.phases[0])]
    _joints_along(scenario, plan_joints, start, ways)


def _joints_along(
    scenario: Scenario, plan_joints: JointPlanner, start: Pose, ways: list[AnyWay]
) -> tuple[JointPath, ...]:
    keys = ["start.flange", *(flange_key(phase) for phase in scenario.phases)]
    try:
        return plan_joints(start, ways, lambda k: keys[k + 1])
    except UnreachableError as error:
        key, _, reason = str(error).partition(": ")  # as the planner blames it
        raise ScenarioError(key, reason) from error


def _given_ways(scenario: Scenario, start: Pose) -> list[AnyWay]:
    """Return the flange's way through the phases before the first whose end depends on the soft body."""
    ways: list[AnyWay] = []
    for phase in scenario.phases:
        if phase.tip_path or (phase.tip_target is not None and phase.tip_target.reach_with != "cables"):
            break
        ways.append(given_way(start if not ways else ways[-1].end, phase))
    return ways


def _target_point(target: TipTargetTable | None) -> Array | None:
    if target is None:
        return None
    if target.position_m is not None:
        return np.array(target.position_m)
    return np.array([np.nan, np.nan, target.height_m])
