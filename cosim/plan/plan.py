"""The plan of a run: for every phase where flange, pressure and tensions begin and end.

Targets of the tip are solved here, on the static model, before anything runs: an unreachable one is an
input error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.config.rules.gas_rules import GasRule, gas_rules
from cosim.config.schema.per_chamber import values_after
from cosim.config.schema.phase import PhaseTable, StartTable, TipTargetTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import ScenarioError, SolverError, UnreachableError
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.flange_path import pose_of
from cosim.plan.joint_path import JointPath
from cosim.plan.node_groups import SidesOf, held_components, nodal_force, nodes_of
from cosim.plan.paths.phase_motion import AnyWay, flange_key, given_way, solved_phase
from cosim.plan.paths.tip_path import PlannedTipPath
from cosim.plan.robot_command import SoftCommand, loads_of
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium

_LEAK_PIECES = 8


JointPlanner: TypeAlias = Callable[[Pose, list[AnyWay], Callable[[int], str]], tuple[JointPath, ...]]
"""Start pose, ways of all phases, and the key to blame for phase k (-1: the start) -> joint paths."""


@final
@dataclass(frozen=True)
class Holding:
    """What is held otherwise from the start of a phase on.

    Args:
        release: (m,) nodes let go.
        hold: (n, 3) bool, components held from then on.
    """

    release: IntArray
    hold: Mask

    def apply(self, soft: SoftSide, world_from_flange: Pose) -> None:
        """Change what a soft body is held by, where it is now."""
        if len(self.release):
            soft.let_go(self.release)
        if self.hold.any():
            soft.hold_also(self.hold, world_from_flange)


@final
@dataclass(frozen=True)
class PhasePlan:
    """One phase, ready to run.

    Args:
        phase: as in the scenario.
        joints: joint angles along it.
        begin: asked of the soft robot at its start, as if no gas was sealed.
        end: at its end, the same.
        gas: how the gas of each chamber is given.
        holding: what is held otherwise from its start on.
        tip_target: (3,) [m]; components that are free are NaN; None without a target.
        flange: where it is to be at its end.
        tip_path: that the tip follows; None without one.
    """

    phase: PhaseTable
    joints: JointPath
    begin: SoftCommand
    end: SoftCommand
    gas: tuple[GasRule, ...]
    holding: Holding
    tip_target: Array | None
    flange: Pose
    tip_path: PlannedTipPath | None = None


@final
@dataclass(frozen=True)
class Plan:
    """All phases of a run, and where it starts.

    Args:
        start: pose of the flange.
        joints: (joints,) [rad] at the start.
        command: to the soft robot at the start.
        gravity: (3,) [m/s^2], world.
        phases: in order.
    """

    start: Pose
    joints: Array
    command: SoftCommand
    gravity: tuple[float, float, float]
    phases: tuple[PhasePlan, ...]


def start_command(start: StartTable, body: SoftBody) -> SoftCommand:
    """Return what is asked of the soft robot before the first phase; what is left out is zero."""
    names = _chamber_names(body)
    nothing, slack = (0.0,) * len(names), (0.0,) * len(body.cables)
    return SoftCommand(
        pressure_Pa=values_after(nothing, start.pressure_Pa, names, "pressure_Pa"),
        gas=(None,) * len(names),
        cable_tension_N=tuple(start.cable_tension_N or slack),
        cable_length_m=(None,) * len(body.cables),
    )


def _chamber_names(body: SoftBody) -> list[str]:
    return [chamber.name for chamber in body.gas_chambers]


def start_equilibrium(soft: SoftSide, flange: Pose, loads: Loads) -> Equilibrium:
    """Return the equilibrium before the first phase: hung up without pressure, then loaded.

    Raises:
        ConvergenceError: there is none near the drawn shape.
    """
    return soft.start(flange, loads)


def make_plan(scenario: Scenario, plan_joints: JointPlanner, soft: SoftSide) -> Plan:
    """Return the plan of a scenario.

    Args:
        scenario: checked.
        plan_joints: finds the joint angles for the flange's motion.
        soft: a soft side to try the phases on, statically, up to the last one with a tip target; its
            state is used up.

    Raises:
        ScenarioError: a pose or target cannot be reached; `path` names the key.
    """
    start = pose_of(scenario.start.flange)
    check_given_ways(scenario, plan_joints)  # the statics take longer: what does not depend on them first
    command = start_command(scenario.start, soft.body)
    drafts = _drafts(scenario, soft, start, command)
    joints = _joints_along(scenario, plan_joints, start, [draft.way for draft in drafts])
    plans = tuple(
        PhasePlan(
            draft.phase, path, draft.begin.unsealed(), draft.end.unsealed(), rule,
            draft.holding, _target_point(draft.phase.tip_target), draft.way.end, draft.path,
        )
        for draft, path, rule in zip(drafts, joints, gas_rules(scenario), strict=True)
    )  # fmt: skip
    return Plan(start, joints[0].first, command, scenario.gravity_m_s2, plans)


def check_given_ways(scenario: Scenario, plan_joints: JointPlanner) -> None:
    """Check the arm's start, and the phases before the first whose end depends on the soft body.

    Raises:
        ScenarioError: a pose cannot be reached; `path` names the key.
    """
    start = pose_of(scenario.start.flange)
    _joints_along(scenario, plan_joints, start, _given_ways(scenario, start))


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


@final
@dataclass(frozen=True)
class _Draft:
    """A phase whose flange motion is known, before the arm's joints are."""

    phase: PhaseTable
    way: AnyWay
    begin: SoftCommand
    end: SoftCommand
    holding: Holding
    path: PlannedTipPath | None = None


def _drafts(scenario: Scenario, soft: SoftSide, start: Pose, command: SoftCommand) -> list[_Draft]:
    """Return all phases; only those up to the last tip target need the statics of the soft body."""
    sides, gravity = scenario.soft_robot.sides_of, scenario.gravity_m_s2
    damping_per_s = scenario.solver.damping_per_s if scenario.mode == "dynamic" else None
    targets = [index for index, phase in enumerate(scenario.phases) if phase.tip_key is not None]
    solved = 1 + max(targets, default=-1)
    drafts: list[_Draft] = []
    if solved:
        here = start_equilibrium(soft, start, loads_of(command, gravity))
        gas = ChamberGas(scenario.gas)
        soft.settle(here)
        for phase, rule in zip(scenario.phases[:solved], gas_rules(scenario), strict=False):
            holding = _holding(soft.body, sides, phase)
            holding.apply(soft, here.world_from_flange)
            gas.begin(rule, soft)
            begin = gas.filled(command.unsealed())
            here = replace(here, loads=loads_of(begin, gravity))
            end = _end_command(begin, phase, soft.body, sides)
            loads = here.loads if end is begin else loads_of(end, gravity)
            motion = solved_phase(soft, here, phase, loads, damping_per_s)
            here = motion.end
            end = replace(end, cable_tension_N=here.loads.cable_tension_N)  # as a target asks for them
            drafts.append(_Draft(phase, motion.way, begin, end, holding, motion.path))
            here, command = _leaked(soft, here, gas, phase, end)
        start = here.world_from_flange
    for phase in scenario.phases[solved:]:
        way, end = given_way(start, phase), _end_command(command, phase, soft.body, sides)
        drafts.append(_Draft(phase, way, command, end, _holding(soft.body, sides, phase)))
        start, command = way.end, end
    return drafts


def _leaked(
    soft: SoftSide, here: Equilibrium, gas: ChamberGas, phase: PhaseTable, command: SoftCommand
) -> tuple[Equilibrium, SoftCommand]:
    """Return the equilibrium at the end of a phase, what flows in its time gone, and its command."""
    soft.settle(here)
    for _ in range(_LEAK_PIECES if gas.flows else 0):
        gas.advance(soft, (phase.duration_s + phase.settle_s) / _LEAK_PIECES)
        command = gas.filled(command.unsealed())
        try:
            here = soft.follow(here, here.world_from_flange, loads_of(command, here.loads.gravity))
        except SolverError as error:
            raise ScenarioError(f"phase.{phase.name}", f"the static plan fails: {error}") from error
        soft.settle(here)
    return here, command


def _holding(body: SoftBody, sides: SidesOf, phase: PhaseTable) -> Holding:
    hold = held_components(body, sides, phase.supports)
    hold[nodes_of(body, sides, phase.clamp, None)] = True
    return Holding(nodes_of(body, sides, phase.release, None), hold)


def _target_point(target: TipTargetTable | None) -> Array | None:
    if target is None:
        return None
    if target.position_m is not None:
        return np.array(target.position_m)
    return np.array([np.nan, np.nan, target.height_m])


def _end_command(command: SoftCommand, phase: PhaseTable, body: SoftBody, sides: SidesOf) -> SoftCommand:
    """Return what is asked for at the end of a phase; the same object where the phase changes nothing."""
    if phase.pressure_Pa is not None:
        names = _chamber_names(body)
        pressure = values_after(command.pressure_Pa, phase.pressure_Pa, names, "pressure_Pa")
        command = replace(command, pressure_Pa=pressure)
    if phase.cable_tension_N is not None:
        command = replace(command, cable_tension_N=tuple(phase.cable_tension_N))
    if phase.forces:
        command = replace(command, nodal_force=nodal_force(body, sides, phase.forces))
    return command
