"""Makes the plan of a run: refuses what the arm cannot reach, solves what depends on the soft body.

Node groups that a scenario names by rings and corners, and what holds or loads them.

The flange's motion through one phase, and the equilibrium that it ends in.

Phases tried on the statics, before the arm's joints are known: where each begins and ends.

Targets of the tip are solved here: an unreachable one is an input error.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.config.gas_rules import gas_rules
from cosim.config.schema.named_values import values_after
from cosim.config.schema.phase import ForceTable, PhaseTable, StartTable, SupportTable, TipTargetTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.keys import matching
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import ScenarioError, SolverError, UnreachableError
from cosim.plan.motion import FlangeWay, JointPath, PlannedTipPath, Shake, pose_of
from cosim.plan.plan import ChamberGas, Holding, PhasePlan, Plan, SoftCommand, loads_of
from cosim.plan.tip_paths import PoseTrack, follow_path, reach, walk
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium

_AXES = "xyz"

SidesOf: TypeAlias = Callable[[str], int]
"""Name of a ring -> how many corners it has."""


def nodes_of(
    body: SoftBody, sides_of: SidesOf, rings: Sequence[str], corners: Sequence[int] | None
) -> IntArray:
    """Return the nodes (m,) of rings, ascending, or only those at some corners.

    Args:
        body: whose nodes.
        sides_of: name of a ring -> its corners.
        rings: names, or patterns of names.
        corners: 0 to sides - 1; None for all nodes of the rings.
    """
    found = []
    for name in (name for pattern in rings for name in matching(pattern, body.rings)):
        ring = body.rings[name]
        found.append(
            ring if corners is None else ring[np.array(corners, np.int64) * len(ring) // sides_of(name)]
        )
    return np.unique(np.concatenate([np.zeros(0, np.int64), *found]))


def held_components(body: SoftBody, sides_of: SidesOf, supports: Sequence[SupportTable]) -> Mask:
    """Return (n, 3) bool, the world components that supports hold."""
    held = np.zeros((body.nodes, 3), dtype=bool)
    for support in supports:
        nodes = nodes_of(body, sides_of, support.rings, support.corners)
        for axis in support.axes:
            held[nodes, _AXES.index(axis)] = True
    return held


def nodal_force(body: SoftBody, sides_of: SidesOf, forces: Sequence[ForceTable]) -> Array:
    """Return (n, 3) [N], each force shared evenly by its nodes."""
    total = np.zeros((body.nodes, 3))
    for force in forces:
        nodes = nodes_of(body, sides_of, force.rings, force.corners)
        total[nodes] += np.array(force.total_N) / len(nodes)
    return total


AnyWay: TypeAlias = FlangeWay | PoseTrack


@final
@dataclass(frozen=True)
class PhaseMotion:
    """A motion of the flange, tried on the statics.

    Args:
        way: of the flange.
        end: equilibrium at its end.
        path: of the tip, where one is followed.
    """

    way: AnyWay
    end: Equilibrium
    path: PlannedTipPath | None = None


def solved_phase(
    soft: SoftSide, here: Equilibrium, phase: PhaseTable, loads: Loads, air_drag_per_s: float | None
) -> PhaseMotion:
    """Return the flange's way through a phase and the equilibrium at its end.

    Args:
        soft: follows equilibria.
        here: equilibrium at the phase's begin.
        phase: of the scenario.
        loads: at its end.
        air_drag_per_s: of a soft body that moves; None in statics.

    Raises:
        ScenarioError: it cannot be passed.
    """
    try:
        if phase.tip_path is not None:
            found = follow_path(soft, here, loads, phase.tip_path, air_drag_per_s)
            return PhaseMotion(found.way, found.end, found.planned)
        if phase.tip_target is None:
            way = given_way(here.world_from_flange, phase)
            return PhaseMotion(way, walk(soft, here, way, loads))
        way, end = reach(soft, here, loads, phase.tip_target)
        return PhaseMotion(replace(way, even=phase.ramp == "linear"), end)
    except (UnreachableError, SolverError) as error:
        raise ScenarioError(flange_key(phase), f"the static plan fails: {error}") from error


def given_way(here: Pose, phase: PhaseTable) -> FlangeWay:
    """Return the flange's way through a phase that says where it goes."""
    if phase.flange is not None:
        way = FlangeWay.to(here, pose_of(phase.flange))
    else:
        shift = None if phase.flange_shift_m is None else np.array(phase.flange_shift_m)
        way = FlangeWay.relative(here, phase.flange_turn, shift, Shake.of(phase))
    return replace(way, even=phase.ramp == "linear")


def flange_key(phase: PhaseTable) -> str:
    """Return the key that moves the flange in a phase."""
    for key in ("flange", "flange_turn", "flange_shift_m", "flange_shake", "tip_target", "tip_path"):
        if getattr(phase, key) is not None:
            return f"phase.{phase.name}.{key}"
    return f"phase.{phase.name}"


_LEAK_PIECES = 8


@final
@dataclass(frozen=True)
class PhaseDraft:
    """A phase whose flange motion is known, before the arm's joints are.

    Args:
        way: of the flange.
        begin: asked of the soft robot at its start.
        end: at its end.
        holding: what is held otherwise from its start on.
        path: that the tip follows; None without one.
    """

    way: AnyWay
    begin: SoftCommand
    end: SoftCommand
    holding: Holding
    path: PlannedTipPath | None = None


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


def start_equilibrium(
    soft: SoftSide, flange: Pose, loads: Loads, hung: Equilibrium | None = None
) -> Equilibrium:
    """Return the equilibrium before the first phase: hung up without pressure, then loaded; see `SoftSide`.

    Raises:
        ConvergenceError: none was found near the drawn shape.
    """
    with soft.searching("start"):
        return soft.start(flange, loads, hung)


@final
@dataclass(frozen=True)
class SolvedPhases:
    """The phases up to the last whose end depends on the soft body.

    Args:
        drafts: of them.
        command: to the soft robot after them, what has flowed meanwhile gone.
        flange: where it is then.
    """

    drafts: tuple[PhaseDraft, ...]
    command: SoftCommand
    flange: Pose


def solved_count(scenario: Scenario) -> int:
    """Return how many phases there are up to the last whose end depends on the soft body."""
    return 1 + max((k for k, phase in enumerate(scenario.phases) if phase.tip_key is not None), default=-1)


def solved_phases(scenario: Scenario, soft: SoftSide) -> SolvedPhases:
    """Return the phases whose ends depend on the soft body, and those between them.

    Args:
        scenario: checked.
        soft: a soft side to try the phases on, statically; its state is used up.

    Raises:
        ScenarioError: a target cannot be reached; `path` names the key.
        SolverError: there is no equilibrium to start from.
    """
    sides, gravity = scenario.soft_robot.sides_of, scenario.gravity_m_s2
    air_drag_per_s = scenario.solver.air_drag_per_s if scenario.mode == "dynamic" else None
    command, start = start_command(scenario.start, soft.body), pose_of(scenario.start.flange)
    here, drafts = start_equilibrium(soft, start, loads_of(command, gravity)), list[PhaseDraft]()
    gas = ChamberGas(scenario.gas)
    soft.settle(here)
    for phase, rule in zip(scenario.phases[: solved_count(scenario)], gas_rules(scenario), strict=False):
        holding = _holding(soft.body, sides, phase)
        holding.apply(soft, here.world_from_flange)
        gas.begin(rule, soft)
        begin = gas.filled(command.unsealed())
        # films that press at its equilibrium go on doing so: without them it may not be stable
        here = replace(here, loads=replace(loads_of(begin, gravity), self_contact=here.loads.self_contact))
        end = _end_command(begin, phase, soft.body, sides)
        loads = here.loads if end is begin else loads_of(end, gravity)
        with soft.searching(flange_key(phase)):
            motion = solved_phase(soft, here, phase, loads, air_drag_per_s)
        here = motion.end
        end = replace(end, cable_tension_N=here.loads.cable_tension_N)  # as a target asks for them
        drafts.append(PhaseDraft(motion.way, begin, end, holding, motion.path))
        here, command = _leaked(soft, here, gas, phase, end)
    return SolvedPhases(tuple(drafts), command, here.world_from_flange)


def all_drafts(scenario: Scenario, solved: SolvedPhases | None, body: SoftBody) -> tuple[PhaseDraft, ...]:
    """Return all phases of a scenario: those that are solved, and those after them, which need no statics.

    Args:
        scenario: checked.
        solved: None where no phase's end depends on the soft body.
        body: of the soft robot.
    """
    sides = scenario.soft_robot.sides_of
    if solved is None:
        solved = SolvedPhases((), start_command(scenario.start, body), pose_of(scenario.start.flange))
    drafts, command, start = list(solved.drafts), solved.command, solved.flange
    for phase in scenario.phases[len(drafts) :]:
        way, end = given_way(start, phase), _end_command(command, phase, body, sides)
        drafts.append(PhaseDraft(way, command, end, _holding(body, sides, phase)))
        start, command = way.end, end
    return tuple(drafts)


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


def _end_command(command: SoftCommand, phase: PhaseTable, body: SoftBody, sides: SidesOf) -> SoftCommand:
    """Return what is asked for at the end of a phase; the same object where the phase changes nothing."""
    if phase.pressure_Pa is not None:
        before, names = command.pressure_Pa, _chamber_names(body)
        command = replace(command, pressure_Pa=values_after(before, phase.pressure_Pa, names, "pressure_Pa"))
    if phase.cable_tension_N is not None:
        command = replace(command, cable_tension_N=tuple(phase.cable_tension_N))
    if phase.forces:
        command = replace(command, nodal_force=nodal_force(body, sides, phase.forces))
    return command


def _chamber_names(body: SoftBody) -> list[str]:
    return [chamber.name for chamber in body.gas_chambers]


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


def check_given_ways(scenario: Scenario, plan_joints: JointPlanner) -> Array:
    """Check the arm's start, and the phases before the first whose end depends on the soft body, if any.

    Returns the joint angles (joints,) at the start [rad].

    Raises:
        ScenarioError: a pose cannot be reached; `path` names the key.
    """
    start = pose_of(scenario.start.flange)
    ways = _given_ways(scenario, start) or [given_way(start, scenario.phases[0])]
    return _joints_along(scenario, plan_joints, start, ways)[0].first


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
