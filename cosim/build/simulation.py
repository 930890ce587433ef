"""Joins the parts of a checked scenario into a simulation; the only place that knows all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from cosim.base.frames import Array
from cosim.build.decisions import contact_decision, decisions, largest_pressure
from cosim.build.expected_error import expected_error, expected_error_report, extension_report
from cosim.build.fidelity import fidelity_report, soft_sides
from cosim.build.kernel_modules import compile_contact
from cosim.build.known_values import known_report
from cosim.build.section_cache import section_figures, section_model
from cosim.config.rules.gas_rules import gas_report
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.devices.command_source import CommandSource
from cosim.devices.controller import AnyController
from cosim.devices.device_loop import Actuation
from cosim.devices.device_names import device_names, device_report
from cosim.devices.live.live_bounds import LiveBounds
from cosim.devices.live.live_commands import LiveCommands
from cosim.devices.planned_commands import PlannedCommands
from cosim.errors import ScenarioError, SolverError
from cosim.plan.arm_limits import ArmLimits, PlannedArm
from cosim.plan.arm_plan import check_base, checked_start, drawn_payload, planned_arm
from cosim.plan.decision import Decision
from cosim.plan.path_clearances import check_clearances, path_clearances
from cosim.plan.plan import JointPlanner, Plan, make_plan
from cosim.plan.reach import film_reach, flange_travel
from cosim.plan.section_plan import section_range
from cosim.soft.beams.strength import stiffener_report, stiffener_strain
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.solve.energy_share import hinge_energy_share
from cosim.stepping.carrier import Carrier, HeldBase
from cosim.stepping.dynamic import DynamicSimulation
from cosim.stepping.parts import Parts
from cosim.stepping.quasistatic import QuasistaticSimulation
from cosim.stepping.self_contact_law import film_report
from cosim.telemetry.choices import CONTACT, ONLY_IN_REACH, Choices
from cosim.telemetry.snapshot import RunInfo

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm

_Arranged: TypeAlias = tuple[Plan, Carrier, tuple[Decision, ...], PlannedArm | None, "Arm | None"]


def build(
    scenario: Scenario,
    controllers: Mapping[str, AnyController] | None = None,
    before: Choices | None = None,
    body: SoftBody | None = None,
    tell: Callable[[str], None] = lambda _text: None,
) -> DynamicSimulation | QuasistaticSimulation:
    """Return the simulation of a scenario, planned and ready to step.

    Args:
        scenario: checked by `load_scenario`.
        controllers: of kind "python", by name.
        before: of the run whose state it goes on from; None for a run from its start.
        body: the soft body, where the scenario's is given as arrays.
        tell: told when the plan leads to something to touch, whose kernels are then compiled.

    Raises:
        InputError: a pose or target cannot be reached, a mesh is degenerate, a controller is missing.
    """
    trial, soft = soft_sides(scenario, body)
    actuation = Actuation(scenario, soft.body, controllers)
    plan, carrier, modelled, planned, arm = (
        _held_base(scenario, trial, soft)
        if scenario.robot == NO_ARM
        else _arm(scenario, trial, soft, before, partial(compile_contact, tell))
    )
    own = PlannedCommands(scenario, plan, soft, actuation)
    commands: CommandSource = own
    for entry in scenario.commands:
        commands = entry.source(commands, scenario)
    live = LiveCommands(commands, own, scenario, soft, _bounds(scenario, plan, modelled, arm))
    parts = Parts(scenario, plan, carrier, soft, live)
    if scenario.mode == "quasistatic":
        ticks = sum(phase.increments for phase in scenario.phases)
        duration = sum(phase.duration_s + phase.settle_s for phase in scenario.phases)
        return QuasistaticSimulation(parts, _stage(parts, modelled, planned, ticks, duration / ticks))
    ticks = sum(parts.ticks(phase) for phase in scenario.phases)
    return DynamicSimulation(parts, _stage(parts, modelled, planned, ticks, scenario.clock.tick_s))


def _held_base(scenario: Scenario, trial: SoftSide, soft: SoftSide) -> _Arranged:
    plan = _plan(scenario, HeldBase.plan, trial)
    contact = Decision(CONTACT, False, "there is nothing to touch", "robot")
    modelled = decisions(scenario, soft.body, plan, contact, None)
    modelled += _range(scenario, plan, None, touched=False)
    return plan, HeldBase(soft, plan.start, scenario.clock.tick_s), modelled, None, None


def _arm(
    scenario: Scenario,
    trial: SoftSide,
    soft: SoftSide,
    before: Choices | None,
    ready_for_contact: Callable[[], None],
) -> _Arranged:
    # imported here: a scene without an arm waits for neither engine
    from cosim.build.arm_in_scene import arm_in_scene
    from cosim.plan.joint_planner import plan_joints
    from cosim.stepping.arm_carrier import ArmCarrier

    built = arm_in_scene(scenario)
    arm, scene, driven, mounted = built.arm, built.scene, built.driven, built.mounted
    payload = drawn_payload(soft.body, mounted)
    plan = _plan(scenario, checked_start(partial(plan_joints, arm), arm, scene, payload), trial)
    contact = contact_decision(scenario, soft, plan, arm, scene, ready_for_contact)
    if before is not None:
        contact = before.keep(contact)
    if contact.included:
        ready_for_contact()
    law = _contact_law(scenario) if contact.included else None
    if law is not None:
        check_base(scene, soft.body, arm.forward(plan.joints), law.smoothing_m)
    carrier = ArmCarrier(
        arm, scene, soft, scenario.payload_compensation, law, mounted, scenario.coupling, driven
    )
    travel = flange_travel(arm, plan, film_reach(soft.body, 0.0))
    clear = path_clearances(scene, plan, soft.body, scenario.plan, driven, film_touches=contact.included)
    check_clearances(clear, plan, scenario.plan)
    dynamic = scenario.mode == "dynamic"
    planned = planned_arm(arm, scene, plan, payload, clear, dynamic=dynamic)
    modelled = decisions(scenario, soft.body, plan, contact, travel)
    modelled += _range(scenario, plan, arm, touched=contact.included)
    return plan, carrier, modelled, planned, arm


def _bounds(scenario: Scenario, plan: Plan, modelled: tuple[Decision, ...], arm: Arm | None) -> LiveBounds:
    contact = next(decision for decision in modelled if decision.what == CONTACT)
    unreached = not contact.included and contact.switch == ONLY_IN_REACH
    return LiveBounds(
        arm,
        None if arm is None else ArmLimits.of(arm),
        section_model(scenario).spline.largest_Pa if scenario.fidelity == "section" else None,
        largest_pressure(plan) if unreached else None,
    )


def _range(scenario: Scenario, plan: Plan, arm: Arm | None, *, touched: bool) -> tuple[Decision, ...]:
    if scenario.fidelity != "section":
        return ()
    return (section_range(scenario, plan, soft_sides(scenario)[0], arm, touched),)


def _contact_law(scenario: Scenario) -> ContactLaw:
    given = scenario.contact
    return ContactLaw(given.stiffness_N_m3, given.smoothing_m, given.stick_m)


def _plan(scenario: Scenario, plan_joints: JointPlanner, trial: SoftSide) -> Plan:
    try:
        return make_plan(scenario, plan_joints, trial)
    except SolverError as error:
        raise ScenarioError("start", f"no equilibrium to start from: {error}") from error


def _stage(
    parts: Parts, modelled: tuple[Decision, ...], planned: PlannedArm | None, ticks: int, tick_s: float
) -> RunInfo:
    scenario, carrier, body = parts.scenario, parts.carrier, parts.soft.body
    return RunInfo(
        scenario=scenario.name,
        title=scenario.title,
        mode=scenario.mode,
        tick_s=tick_s,
        duration_s=ticks * tick_s,
        ticks=ticks,
        phase_names=tuple(phase.name for phase in scenario.phases),
        joint_names=carrier.joint_names,
        body_names=carrier.body_names,
        shapes=carrier.shapes,
        soft_triangles=body.triangles,
        cables=tuple(cable.nodes for cable in body.cables),
        chamber_names=tuple(chamber.name for chamber in body.gas_chambers),
        soft_weight_N=body.mass_kg * float(np.linalg.norm(scenario.gravity_m_s2)),
        gravity=np.array(scenario.gravity_m_s2),
        membrane_stress=partial(_largest_stress, body),
        cable_names=scenario.soft_robot.cable_names(),
        devices=device_names(scenario),
        report=_report(parts, modelled),
        modelled=modelled,
        hinge_energy_share=partial(hinge_energy_share, body),
        stiffener_strain=partial(stiffener_strain, body),
        section_model=section_figures(scenario),
        expected_error=expected_error(scenario),
        arm=planned,
        tip_paths=parts.tip_paths,
    )


def _largest_stress(body: SoftBody, positions: Array) -> Array:
    return body.principal_stress(positions)[:, 0]


def _report(parts: Parts, modelled: tuple[Decision, ...]) -> str:
    scenario, body = parts.scenario, parts.soft.body
    integrator = scenario.solver.integrator.replace("_", " ")
    lines = {
        **parts.carrier.report,
        "Soft robot": f"{scenario.soft_robot.name}, {1e3 * body.mass_kg:.0f} g, {body.nodes} nodes, "
        f"{len(body.triangles)} triangles, {len(body.hinges.nodes)} hinges, "
        f"{len(body.cables)} cables",
        "Stiffeners": "; ".join(filter(None, (stiffener_report(body), extension_report(scenario)))),
        "Known": known_report(scenario),
        "Fidelity": fidelity_report(scenario),
        "Chamber": "closed by caps" if body.closed else "open ends (no cap force)",
        "Gas": gas_report(scenario),
        **device_report(scenario),
        "Motion": "quasistatic" if scenario.mode == "quasistatic" else f"dynamic, {integrator}",
        "Self contact": film_report(scenario, body),
        "Contact": _contact_report(scenario, modelled),
        "Expected error": expected_error_report(scenario),
        "Modelled": "; ".join(entry.line for entry in modelled if entry.included),
        "Left out": "; ".join(entry.line for entry in modelled if not entry.included) or "nothing",
    }
    return "\n".join(f"- **{name}**: {text}" for name, text in lines.items())


def _contact_report(scenario: Scenario, modelled: tuple[Decision, ...]) -> str:
    decision = next(entry for entry in modelled if entry.what == CONTACT)
    if not decision.included:
        return f"none: {decision.reason}"
    law = _contact_law(scenario)
    names = [entry.name for entry in scenario.objects] + [wire.name for wire in scenario.wires]
    friction = f"friction sticks within {1e3 * law.stick_m:g} mm"
    if scenario.mode == "quasistatic":
        names = [entry.name for entry in scenario.objects if entry.mass_kg is None]
        friction = "no friction; what can move is not touched"
    cell = [] if scenario.scene is None else ["cell"]
    things = ", ".join(["floor", *cell, *names])
    return f"with {things}; {law.stiffness_N_m3:.0e} N/m^3, {friction}"
