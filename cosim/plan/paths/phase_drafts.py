"""Phases tried on the statics, before the arm's joints are known: where each begins and ends.

Targets of the tip are solved here: an unreachable one is an input error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

from cosim.base.frames import Pose
from cosim.config.rules.gas_rules import gas_rules
from cosim.config.schema.per_chamber import values_after
from cosim.config.schema.phase import PhaseTable, StartTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import ScenarioError, SolverError
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.flange_path import pose_of
from cosim.plan.node_groups import SidesOf, held_components, nodal_force, nodes_of
from cosim.plan.paths.phase_motion import AnyWay, flange_key, given_way, solved_phase
from cosim.plan.paths.tip_path import PlannedTipPath
from cosim.plan.plan import Holding
from cosim.plan.robot_command import SoftCommand, loads_of
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium

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
        ConvergenceError: there is none near the drawn shape.
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
    damping_per_s = scenario.solver.damping_per_s if scenario.mode == "dynamic" else None
    command, start = start_command(scenario.start, soft.body), pose_of(scenario.start.flange)
    here, drafts = start_equilibrium(soft, start, loads_of(command, gravity)), list[PhaseDraft]()
    gas = ChamberGas(scenario.gas)
    soft.settle(here)
    for phase, rule in zip(scenario.phases[: solved_count(scenario)], gas_rules(scenario), strict=False):
        holding = _holding(soft.body, sides, phase)
        holding.apply(soft, here.world_from_flange)
        gas.begin(rule, soft)
        begin = gas.filled(command.unsealed())
        here = replace(here, loads=loads_of(begin, gravity))
        end = _end_command(begin, phase, soft.body, sides)
        loads = here.loads if end is begin else loads_of(end, gravity)
        with soft.searching(flange_key(phase)):
            motion = solved_phase(soft, here, phase, loads, damping_per_s)
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
        names = _chamber_names(body)
        pressure = values_after(command.pressure_Pa, phase.pressure_Pa, names, "pressure_Pa")
        command = replace(command, pressure_Pa=pressure)
    if phase.cable_tension_N is not None:
        command = replace(command, cable_tension_N=tuple(phase.cable_tension_N))
    if phase.forces:
        command = replace(command, nodal_force=nodal_force(body, sides, phase.forces))
    return command


def _chamber_names(body: SoftBody) -> list[str]:
    return [chamber.name for chamber in body.gas_chambers]
