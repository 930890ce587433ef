"""What a run says of itself before it starts: names, counts, and in words what is modelled and how."""

from __future__ import annotations

from functools import partial

import numpy as np

from cosim.base.frames import Array
from cosim.build.expected_error import expected_error, expected_error_report, extension_report
from cosim.build.fidelity import contact_law, fidelity_report
from cosim.build.known_values import known_report
from cosim.build.parts.soft_model import SoftModel
from cosim.build.section_cache import section_figures
from cosim.config.rules.gas_rules import gas_report
from cosim.config.schema.scenario import Scenario
from cosim.devices.device_names import device_names, device_report
from cosim.plan.arm_limits import PlannedArm
from cosim.plan.decision import Decision
from cosim.soft.beams.strength import stiffener_report, stiffener_strain
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.energy_share import hinge_energy_share
from cosim.stepping.parts import Parts, film_report
from cosim.telemetry.choices import CONTACT
from cosim.telemetry.snapshot import RunInfo


def stage_of(
    parts: Parts, modelled: tuple[Decision, ...], arm: PlannedArm | None, model: SoftModel
) -> RunInfo:
    """Return everything about a run that does not change while it lasts.

    Args:
        parts: of the run.
        modelled: what it models, and what it leaves out.
        arm: what the plan asks of it; None without one.
        model: of the soft robot.
    """
    ticks, tick_s = _steps(parts)
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
        report=_report(parts, modelled, model),
        modelled=modelled,
        hinge_energy_share=partial(hinge_energy_share, body),
        stiffener_strain=partial(stiffener_strain, body),
        section_model=section_figures(model.section),
        expected_error=expected_error(scenario),
        arm=arm,
        tip_paths=parts.tip_paths,
    )


def _steps(parts: Parts) -> tuple[int, float]:
    """Return how many steps a run has, and how long one is [s], in the mean where it has no clock."""
    scenario = parts.scenario
    if scenario.mode == "dynamic":
        return sum(parts.ticks(phase) for phase in scenario.phases), scenario.clock.tick_s
    count = sum(phase.increments for phase in scenario.phases)
    return count, sum(phase.duration_s + phase.settle_s for phase in scenario.phases) / count


def _largest_stress(body: SoftBody, positions: Array) -> Array:
    return body.principal_stress(np.array(positions))[:, 0]  # kernels take no array that is read-only


def _report(parts: Parts, modelled: tuple[Decision, ...], model: SoftModel) -> str:
    scenario, body = parts.scenario, parts.soft.body
    integrator = scenario.solver.integrator.replace("_", " ")
    lines = {
        **parts.carrier.report,
        "Soft robot": f"{scenario.soft_robot.name}, {1e3 * body.mass_kg:.0f} g, {body.nodes} nodes, "
        f"{len(body.triangles)} triangles, {len(body.hinges.nodes)} hinges, "
        f"{len(body.cables)} cables",
        "Stiffeners": "; ".join(filter(None, (stiffener_report(body), extension_report(scenario)))),
        "Known": known_report(scenario),
        "Fidelity": fidelity_report(scenario, model.section),
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
    law = contact_law(scenario)
    names = [entry.name for entry in scenario.objects] + [wire.name for wire in scenario.wires]
    friction = f"friction sticks within {1e3 * law.stick_m:g} mm"
    if scenario.mode == "quasistatic":
        names = [entry.name for entry in scenario.objects if entry.mass_kg is None]
        friction = "no friction; what can move is not touched"
    cell = [] if scenario.scene is None else ["cell"]
    things = ", ".join(["floor", *cell, *names])
    return f"with {things}; {law.stiffness_N_m3:.0e} N/m^3, {friction}"
