"""Solves the phases on the statics, before joint paths are known: the flange's motion, and the equilibrium at
the end of each phase. Targets of the tip are solved here; an unreachable one is an input error.
"""

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Pose
from cosim.config.gas_rules import gas_rules
from cosim.config.schema.named_values import values_after
from cosim.config.schema.phase import PhaseTable, StartTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.errors import ScenarioError, SolverError, UnreachableError
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.commands import SoftCommand, loads_of
from cosim.plan.flange_motion import FlangeMotion, Shake, pose_of
from cosim.plan.node_groups import SidesOf, held_components, nodal_force, nodes_of
from cosim.plan.plan import Holding
from cosim.plan.tip_errors import PlannedTipPath
from cosim.plan.tip_paths import AnyFlangeMotion, PhaseMotion, follow_path
from cosim.plan.tip_targets import reach, walk
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium

_LEAK_PIECES = 8


def solved_phase(
    soft: SoftRobot, here: Equilibrium, phase: PhaseTable, loads: Loads, air_drag_per_s: float | None
) -> PhaseMotion:
    """Return the flange's motion through a phase and the equilibrium at its end.

    Args:
        soft: soft side whose equilibria are solved.
        here: equilibrium at the phase's start.
        phase: of the scenario.
        loads: at its end.
        air_drag_per_s: of a moving soft body; None in statics.

    Raises:
        ScenarioError: there is no equilibrium, or the target cannot be reached.
    """
    try:
        if phase.tip_path is not None:
            return follow_path(soft, here, loads, phase.tip_path, air_drag_per_s)
        if phase.tip_target is None:
            way = given_motion(here.world_from_flange, phase)
            return PhaseMotion(way, walk(soft, here, way, loads))
        way, end = reach(soft, here, loads, phase.tip_target)
        return PhaseMotion(replace(way, even=phase.ramp == "linear"), end)
    except (UnreachableError, SolverError) as error:
        raise ScenarioError(flange_key(phase), f"the static plan fails: {error}") from error


def given_motion(here: Pose, phase: PhaseTable) -> FlangeMotion:
    """Return the flange's motion through a phase whose table gives it.

    Args:
        here: pose at its start, world from flange.
        phase: of the scenario, without a tip target or path.
    """
    if phase.flange is not None:
        way = FlangeMotion.to(here, pose_of(phase.flange))
    else:
        shift = None if phase.flange_shift_m is None else np.array(phase.flange_shift_m)
        way = FlangeMotion.relative(here, phase.flange_turn, shift, Shake.of(phase))
    return replace(way, even=phase.ramp == "linear")


def flange_key(phase: PhaseTable) -> str:
    """Return the key that moves the flange in a phase."""
    for key in ("flange", "flange_turn", "flange_shift_m", "flange_shake", "tip_target", "tip_path"):
        if getattr(phase, key) is not None:
            return f"phase.{phase.name}.{key}"
    return f"phase.{phase.name}"


@final
@dataclass(frozen=True)
class PhaseDraft:
    """A phase whose flange motion is known, before joint paths are.

    Args:
        way: motion of the flange.
        begin: command to the soft robot at its start.
        end: command at its end.
        holding: changes of held nodes at its start.
        path: that the tip follows; None without one.
    """

    way: AnyFlangeMotion
    begin: SoftCommand
    end: SoftCommand
    holding: Holding
    path: PlannedTipPath | None = None


def start_command(start: StartTable, body: SoftBody) -> SoftCommand:
    """Return the command to the soft robot at the start; omitted values are zero."""
    names = _chamber_names(body)
    nothing, slack = (0.0,) * len(names), (0.0,) * len(body.cables)
    return SoftCommand(
        pressure_Pa=values_after(nothing, start.pressure_Pa, names, "pressure_Pa"),
        gas=(None,) * len(names),
        cable_tension_N=tuple(start.cable_tension_N or slack),
        cable_length_m=(None,) * len(body.cables),
    )


def start_equilibrium(
    soft: SoftRobot, flange: Pose, loads: Loads, hung: Equilibrium | None = None
) -> Equilibrium:
    """Return the equilibrium before the first phase: first without pressure, then loaded; see `SoftRobot`.

    Raises:
        ConvergenceError: no equilibrium was found near the drawn shape.
    """
    with soft.searching("start"):
        return soft.start(flange, loads, hung)


@final
@dataclass(frozen=True)
class SolvedPhases:
    """The phases up to the last whose end depends on the soft body.

    Args:
        drafts: of these phases.
        command: to the soft robot after them, with leaks and flows of gas.
        flange: pose after them, world from flange.
    """

    drafts: tuple[PhaseDraft, ...]
    command: SoftCommand
    flange: Pose


def solved_count(scenario: Scenario) -> int:
    """Return the number of phases up to the last one whose end depends on the soft body."""
    return 1 + max((k for k, phase in enumerate(scenario.phases) if phase.tip_key is not None), default=-1)


def solved_phases(scenario: Scenario, soft: SoftRobot) -> SolvedPhases:
    """Return the phases whose ends depend on the soft body, and those between them.

    Args:
        scenario: checked.
        soft: soft side whose statics are solved; its state is changed.

    Raises:
        ScenarioError: a target cannot be reached; `path` names the key.
        SolverError: there is no equilibrium to start from.
    """
    sides, gravity = scenario.soft_robot.sides_of, scenario.gravity_m_s2
    air_drag_per_s = scenario.solver.air_drag_per_s if scenario.mode == "dynamic" else None
    command, start = start_command(scenario.start, soft.body), pose_of(scenario.start.flange)
    here, drafts = start_equilibrium(soft, start, loads_of(command, gravity)), list[PhaseDraft]()
    gas = ChamberGas(scenario.gas)
    soft.commit(here)
    for phase, rule in zip(scenario.phases[: solved_count(scenario)], gas_rules(scenario), strict=False):
        holding = _holding(soft.body, sides, phase)
        holding.apply(soft, here.world_from_flange)
        gas.begin(rule, soft)
        begin = gas.filled(command.unsealed())
        # films that touch stay in contact: without it the equilibrium may not be stable
        here = replace(here, loads=replace(loads_of(begin, gravity), self_contact=here.loads.self_contact))
        end = _end_command(begin, phase, soft.body, sides)
        loads = here.loads if end is begin else loads_of(end, gravity)
        with soft.searching(flange_key(phase)):
            motion = solved_phase(soft, here, phase, loads, air_drag_per_s)
        here = motion.end
        end = replace(end, cable_tension_N=here.loads.cable_tension_N)  # a target may have changed them
        drafts.append(PhaseDraft(motion.way, begin, end, holding, motion.path))
        here, command = _leaked(soft, here, gas, phase, end)
    return SolvedPhases(tuple(drafts), command, here.world_from_flange)


def all_drafts(scenario: Scenario, solved: SolvedPhases | None, body: SoftBody) -> tuple[PhaseDraft, ...]:
    """Return all phases of a scenario: the solved ones, and those after them, which need no statics.

    Args:
        scenario: checked.
        solved: None if no phase's end depends on the soft body.
        body: of the soft robot.
    """
    sides = scenario.soft_robot.sides_of
    if solved is None:
        solved = SolvedPhases((), start_command(scenario.start, body), pose_of(scenario.start.flange))
    drafts, command, start = list(solved.drafts), solved.command, solved.flange
    for phase in scenario.phases[len(drafts) :]:
        way, end = given_motion(start, phase), _end_command(command, phase, body, sides)
        drafts.append(PhaseDraft(way, command, end, _holding(body, sides, phase)))
        start, command = way.end, end
    return tuple(drafts)


def _leaked(
    soft: SoftRobot, here: Equilibrium, gas: ChamberGas, phase: PhaseTable, command: SoftCommand
) -> tuple[Equilibrium, SoftCommand]:
    """Return equilibrium and command at the end of a phase, after the leaks and flows of gas in its time."""
    soft.commit(here)
    for _ in range(_LEAK_PIECES if gas.flows else 0):
        gas.advance(soft, (phase.duration_s + phase.settle_s) / _LEAK_PIECES)
        command = gas.filled(command.unsealed())
        try:
            here = soft.follow(here, here.world_from_flange, loads_of(command, here.loads.gravity))
        except SolverError as error:
            raise ScenarioError(f"phase.{phase.name}", f"the static plan fails: {error}") from error
        soft.commit(here)
    return here, command


def _holding(body: SoftBody, sides: SidesOf, phase: PhaseTable) -> Holding:
    hold = held_components(body, sides, phase.supports)
    hold[nodes_of(body, sides, phase.clamp, None)] = True
    return Holding(nodes_of(body, sides, phase.release, None), hold)


def _end_command(command: SoftCommand, phase: PhaseTable, body: SoftBody, sides: SidesOf) -> SoftCommand:
    """Return the command at the end of a phase; the same object if the phase changes nothing."""
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
