"""Joins the parts of a checked scenario into a simulation. No other module knows all the parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, final

from cosim.base.kept_parts import KeptParts, name_of
from cosim.build import options
from cosim.build.decisions import contact_decision, decisions, finer_steps, largest_pressure
from cosim.build.first_kernels import compile_first
from cosim.build.run_info import stage_of
from cosim.build.soft_model import SoftModel
from cosim.config import plugins, several_arms
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.devices import command_source, controller
from cosim.devices.device_loop import Actuation
from cosim.devices.live import live_commands
from cosim.devices.live.live_bounds import LiveBounds
from cosim.devices.planned_commands import PlannedCommands
from cosim.errors import ScenarioError, SolverError
from cosim.plan import arm_limits, film_reach, path_clearance, section_plan
from cosim.plan.decision import CONTACT, ONLY_IN_REACH, OTHER_FILMS, Choices, Decision
from cosim.plan.plan import Plan
from cosim.plan.planning import JointPlanner, make_plan
from cosim.plan.start_checks import check_base, checked_start, drawn_payload
from cosim.plan.static_plan import SolvedPhases, solved_phases
from cosim.soft.body.body import SoftBody
from cosim.stepping.carrier import Carrier
from cosim.stepping.dynamic import DynamicSimulation
from cosim.stepping.held_base import HeldBase
from cosim.stepping.parts import Parts
from cosim.stepping.quasistatic import QuasistaticSimulation
from cosim.stepping.several_arms import ArmsRun
from cosim.stepping.start import brought_to_rest
from cosim.telemetry.run_info import RunInfo

if TYPE_CHECKING:
    from cosim.build.arm_parts import ArmParts
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.host_scene import HostScene
    from cosim.stepping.arm_carrier import ArmCarrier
    from cosim.stepping.host_carrier import HostCarrier


@final
@dataclass(frozen=True)
class _Arranged:
    """A planned run, with the carrier of its flange.

    Args:
        plan: of the run.
        carrier: of the flange.
        modelled: decisions on the effects that the run models.
        planned_arm: planned motion of the arm; None without an arm.
        arm: of Pinocchio; None without an arm.
    """

    plan: Plan
    carrier: Carrier
    modelled: tuple[Decision, ...]
    planned_arm: arm_limits.PlannedArm | None = None
    arm: Arm | None = None


def build(
    scenario: Scenario,
    controllers: Mapping[str, controller.AnyController] | None = None,
    before: Choices | None = None,
    body: SoftBody | None = None,
    tell: Callable[[str], None] = lambda _text: None,
    kept: KeptParts | None = None,
) -> DynamicSimulation | QuasistaticSimulation:
    """Return the simulation of a scenario, planned and ready to step.

    Args:
        scenario: checked by `load_scenario`.
        controllers: of kind "python", by name.
        before: decisions of the run whose state it continues from; None for a run from its start.
        body: the soft body, if the scenario's is given as arrays.
        tell: gets progress messages: kernels that are compiled, long searches for an equilibrium or target.
        kept: cache of parts; gets those that are built here.

    Raises:
        InputError: a pose or target cannot be reached, a mesh is degenerate, a controller is missing.
    """
    kept = KeptParts() if kept is None else kept
    plugins.note_kinds(scenario)
    model = SoftModel(scenario, kept, body, tell)
    if model.section is None:
        compile_first(scenario, model.body)
    soft = model.side()
    actuation = Actuation(scenario, soft.body, controllers)
    arranged = (
        _held_base(scenario, model, soft) if scenario.robot == NO_ARM else _arm(scenario, model, soft, before)
    )
    parts, stage = _joined(scenario, model, soft, actuation, arranged)
    return (QuasistaticSimulation if scenario.mode == "quasistatic" else DynamicSimulation)(parts, stage)


def build_arms(
    scenarios: Mapping[str, Scenario], tell: Callable[[str], None], kept: KeptParts | None = None
) -> ArmsRun:
    """Return the run of several arms in one scene, planned and ready to step.

    Args:
        scenarios: of each arm, by its name; checked, with equal shared keys.
        tell: see `build`.
        kept: cache of parts; gets those that are built here.

    Raises:
        InputError: as of `build`, or arms come too near to one another.
    """
    from cosim.build.arm_parts import ArmParts, check_starts, scene_of_arms  # see below
    from cosim.stepping.arm_carrier import SharedArm

    kept = KeptParts() if kept is None else kept
    described, shared = scene_of_arms(scenarios, kept)
    all_planned = {}
    for (name, scenario), scene in zip(scenarios.items(), shared.arms, strict=True):
        plugins.note_kinds(scenario)
        with several_arms.of_arm(name):
            model = SoftModel(scenario, kept, None, tell)
            parts = ArmParts(scenario, kept, described[name], scene)
            all_planned[name] = _planned(scenario, model, model.side(), parts)
    check_starts(shared, {name: one.plan.joints for name, one in all_planned.items()})
    runs = {}
    for name, one in all_planned.items():
        rest = [each for each in all_planned.values() if each is not one]
        with several_arms.of_arm(name):
            arranged = _carried(one, None, SharedArm, rest)
            arranged = replace(arranged, modelled=(*arranged.modelled, OTHER_FILMS))
        actuation = Actuation(one.scenario, one.soft.body, None)
        runs[name] = DynamicSimulation(*_joined(one.scenario, one.model, one.soft, actuation, arranged))
    for run in runs.values():  # the scene that all share shows every arm at its start
        run.carrier.set_configuration(run.plan.joints)
    return ArmsRun(runs, shared.step)


def _joined(
    scenario: Scenario, model: SoftModel, soft: SoftRobot, actuation: Actuation, arranged: _Arranged
) -> tuple[Parts, RunInfo]:
    """Return the parts of a run, and its constant data."""
    commands = _steered(scenario, arranged.plan, soft, actuation, _bounds(model, arranged))
    rest = partial(brought_to_rest, model.kept, model.name, soft)
    parts = Parts(scenario, arranged.plan, arranged.carrier, soft, commands, rest)
    return parts, stage_of(parts, arranged.modelled, arranged.planned_arm, model.section)


def build_hosted(scenario: Scenario, model: SoftModel, scene: HostScene) -> tuple[HostCarrier, Parts]:
    """Return the carrier and the parts of a soft robot that is attached to a user's MuJoCo scene.

    Args:
        scenario: checked, without an arm and without phases.
        model: of its soft robot.
        scene: the user's.

    Raises:
        InputError: a mesh is degenerate, a device is wrong.
    """
    from cosim.stepping.host_carrier import HostCarrier  # see below

    soft = model.side()
    plan = _plan(scenario, HeldBase.plan, model)
    carrier = HostCarrier(scene, soft, options.contact_law(scenario) if scenario.contact.enabled else None)
    actuation = Actuation(scenario, soft.body, None)
    commands = _steered(scenario, plan, soft, actuation, LiveBounds(section_Pa=model.largest_pressure_Pa))
    rest = partial(brought_to_rest, model.kept, model.name, soft)
    return carrier, Parts(scenario, plan, carrier, soft, commands, rest)


def _steered(
    scenario: Scenario, plan: Plan, soft: SoftRobot, actuation: Actuation, bounds: LiveBounds
) -> live_commands.LiveCommands:
    """Return the commands of a plan, changed by the scenario's command sources and by live commands."""
    planned = PlannedCommands(scenario, plan, soft, actuation)
    commands: command_source.CommandSource = planned
    for entry in scenario.commands:
        commands = entry.source(commands, scenario)
    return live_commands.LiveCommands(commands, planned, scenario, soft, bounds)


def _held_base(scenario: Scenario, model: SoftModel, soft: SoftRobot) -> _Arranged:
    plan = _plan(scenario, HeldBase.plan, model)
    contact = Decision(CONTACT, False, "there is nothing to touch", "robot")
    modelled = decisions(scenario, soft.body, plan, contact, None)
    modelled += _range(scenario, plan, model, None, "", touched=False)
    return _Arranged(plan, HeldBase(soft, plan.start, scenario.clock.tick_s), modelled)


def _arm(scenario: Scenario, model: SoftModel, soft: SoftRobot, before: Choices | None) -> _Arranged:
    # imported here so that a scenario without an arm loads neither MuJoCo nor Pinocchio
    from cosim.build.arm_parts import ArmParts
    from cosim.stepping.arm_carrier import ArmCarrier

    planned = _planned(scenario, model, soft, ArmParts(scenario, model.kept))
    return _carried(planned, before, ArmCarrier)


@final
@dataclass(frozen=True)
class _Planned:
    """An arm with its soft robot, and its plan.

    Args:
        scenario: checked.
        model: of the soft robot.
        soft: its soft side.
        parts: the arm, and the scene around it.
        plan: of the run.
        payload: the soft robot in its drawn shape, and other mounted mass.
    """

    scenario: Scenario
    model: SoftModel
    soft: SoftRobot
    parts: ArmParts
    plan: Plan
    payload: Payload

    @property
    def on_its_way(self) -> path_clearance.PlannedArmMotion:
        """Its motion, for the clearances of other arms in the scene."""
        return path_clearance.PlannedArmMotion(self.parts.scene, self.plan, self.model.body)


def _planned(scenario: Scenario, model: SoftModel, soft: SoftRobot, parts: ArmParts) -> _Planned:
    payload = drawn_payload(soft.body, parts.mounted)
    plan = _plan(scenario, checked_start(parts.plan_joints, parts.arm, parts.scene, payload), model)
    return _Planned(scenario, model, soft, parts, plan, payload)


def _carried(
    planned: _Planned, before: Choices | None, carried_by: type[ArmCarrier], others: Sequence[_Planned] = ()
) -> _Arranged:
    """Return a planned arm with the carrier of its flange, and the decisions on modelled effects."""
    scenario, model, soft, parts, plan = (
        planned.scenario, planned.model, planned.soft, planned.parts, planned.plan
    )  # fmt: skip
    arm, scene, mounted = parts.arm, parts.scene, parts.mounted
    contact = contact_decision(scenario, soft, plan, arm, scene)
    if before is not None:
        contact = before.keep(contact)
    law = options.contact_law(scenario) if contact.included else None
    if law is not None:
        check_base(scene, soft.body, arm.forward(plan.joints), law.smoothing_m)
    carrier = carried_by(
        arm, scene, soft, scenario.payload_compensation, law, mounted, scenario.coupling, parts.driven
    )
    travel = film_reach.flange_travel(arm, plan, film_reach.film_reach(soft.body, 0.0))
    clear = parts.clearances(
        plan, model.body, model.body_name, film_touches=contact.included, lasting=model.lasting
    )
    clear = path_clearance.clearances_to_others(
        clear, planned.on_its_way, [each.on_its_way for each in others], scenario.plan,
        film_touches=contact.included,
    )  # fmt: skip
    path_clearance.check_clearances(clear, plan, scenario.plan)
    asked = parts.asked(plan, planned.payload, clear)
    modelled = decisions(scenario, soft.body, plan, contact, travel) + finer_steps(scenario, scene)
    way = parts.motion_name(plan)
    modelled += _range(scenario, plan, model, arm, way, touched=contact.included)
    return _Arranged(plan, carrier, modelled, asked, arm)


def _bounds(model: SoftModel, arranged: _Arranged) -> LiveBounds:
    contact = next(decision for decision in arranged.modelled if decision.what == CONTACT)
    unreached = not contact.included and contact.switch == ONLY_IN_REACH
    return LiveBounds(
        arranged.arm,
        None if arranged.arm is None else arm_limits.ArmLimits.of(arranged.arm),
        model.largest_pressure_Pa,
        largest_pressure(arranged.plan) if unreached else None,
    )


def _range(
    scenario: Scenario, plan: Plan, model: SoftModel, arm: Arm | None, way: str, *, touched: bool
) -> tuple[Decision, ...]:
    if model.section is None:
        return ()
    name = name_of(_asked_name(scenario, model), way, scenario.commands, touched)

    def walked() -> Decision:
        return section_plan.section_range(scenario, plan, model.chain(), arm, touched)

    return (model.kept.made("range", name, walked),)


def _asked_name(scenario: Scenario, model: SoftModel) -> str:
    """Return a cache name of a plan's statics."""
    return name_of(
        model.statics_name, scenario.start, scenario.phases, scenario.gas, scenario.gravity_m_s2,
        scenario.mode, scenario.solver.air_drag_per_s,
    )  # fmt: skip


def _plan(scenario: Scenario, plan_joints: JointPlanner, model: SoftModel) -> Plan:
    def solved() -> SolvedPhases:
        return solved_phases(scenario, model.flexible())

    def solve() -> SolvedPhases:
        name = _asked_name(scenario, model)
        if not model.lasting:
            return model.kept.made("solved phases", name, solved)
        # tip paths are solved again
        return model.kept.lasting("solved phases", name, SolvedPhases, solved)

    try:
        return make_plan(scenario, plan_joints, model.body, solve)
    except SolverError as error:
        raise ScenarioError("start", f"no equilibrium to start from: {error}") from error
