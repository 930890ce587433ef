"""Collects the constant data of a run, for recordings, results and the summary: names, counts, what is
modelled and how.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from cosim.base.components import components
from cosim.base.frames import Array
from cosim.build.expected_error import (
    expected_error,
    expected_error_report,
    extension_report,
    known_report,
    modelled_robot,
)
from cosim.build.fidelity import fidelity_report, section_figures
from cosim.build.options import contact_law, described_body, dynamic_options
from cosim.config.gas_rules import gas_report
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.devices import modelled_devices, sensor
from cosim.plan.arm_limits import PLANNED, PlannedArm
from cosim.plan.decision import CONTACT, Decision
from cosim.plan.whole_ticks import lengths_s, rounding_warnings
from cosim.reduced.section_model import SectionModel
from cosim.soft.beams.beam_rings import stiffener_report, stiffener_strain
from cosim.soft.body.body import SoftBody, hinge_energy_share
from cosim.soft.body.places import parents
from cosim.soft.elements.frame_stops import FrameStops
from cosim.soft.film.film_energies import FilmEnergies
from cosim.soft.solve import step_scheme
from cosim.stepping.film_contact import film_report
from cosim.stepping.parts import Parts
from cosim.telemetry.camera_image import CameraInfo
from cosim.telemetry.energy import EnergyParts
from cosim.telemetry.run_info import Decay, DrawnFilm, ObjectInfo, RunInfo


def stage_of(
    parts: Parts, modelled: tuple[Decision, ...], arm: PlannedArm | None, section: SectionModel | None
) -> RunInfo:
    """Return the constant data of a run.

    Args:
        parts: of the run.
        modelled: decisions on the effects that it models.
        arm: its planned motion; None without an arm.
        section: section model of the soft robot; None with another fidelity.
    """
    scenario, carrier, body = parts.scenario, parts.carrier, parts.soft.body
    (ticks, tick_s), robot = _steps(parts), modelled_robot(scenario)
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
        devices=modelled_devices.device_names(scenario),
        report=_report(parts, modelled, section),
        modelled=modelled,
        hinge_energy_share=partial(hinge_energy_share, body),
        stiffener_strain=partial(stiffener_strain, body),
        section_model=section_figures(section),
        expected_error=expected_error(scenario),
        arm=arm,
        tip_paths=parts.tip_paths,
        decay=_decay(scenario),
        energy=_energy(scenario, body),
        soft_mass_kg=body.mass_kg,
        drawn=_drawn(scenario, body),
        mounted=carrier.mounted,
        objects=_objects(parts),
        grasps=scenario.soft_robot.palm is not None or _films(body) > 1,
        sliding=carrier.sliding,
        tip_measured_by=body.tip_measured_by,
        tip_directions={
            k: phase.tip_target.direction
            for k, phase in enumerate(scenario.phases)
            if phase.tip_target is not None and phase.tip_target.direction is not None
        },
        stored_m=None if robot is None else robot.stored_m,
        frames_length=_frames_length(body),
        sensors=sensor.sensor_names(scenario, carrier.joint_names),
        cameras=tuple(CameraInfo(one.name, one.size, one.fov_rad, one.rate_Hz) for one in scenario.cameras),
        lengths_s=lengths_s(scenario),
        rounded=tuple(f"{PLANNED}{text}" for text in rounding_warnings(scenario)),
    )


def _objects(parts: Parts) -> tuple[ObjectInfo, ...]:
    names = parts.carrier.body_names
    moves = parts.scenario.mode == "dynamic"
    objects = parts.carrier.objects if moves else ()
    return tuple(ObjectInfo(names[one.body], one.body, one.figures, one.free) for one in objects)


def _films(body: SoftBody) -> int:
    """Return the number of connected films of a body."""
    edges = np.concatenate([body.triangles[:, (0, 1)], body.triangles[:, (1, 2)]])
    return len(np.unique(components(len(body.node_mass), edges)[np.unique(edges)]))


def _frames_length(body: SoftBody) -> Callable[[Array], float] | None:
    """Return the function that measures the stacked length of a body's frames; None if they cannot touch."""
    stops = body.of_kind(FrameStops)
    return stops[0].length if len(stops) == 1 else None


def _energy(scenario: Scenario, body: SoftBody) -> EnergyParts | None:
    options, lumped = dynamic_options(scenario), scenario.fidelity in ("lumped", "refined")
    if scenario.mode != "dynamic" or not lumped:
        return None
    gravity = np.array(scenario.gravity_m_s2)
    tick_s = scenario.clock.tick_s
    film = FilmEnergies(body, tick_s)
    resisted = film.resisted if any(each.film.loss_factor for each in body.membranes) else None
    return EnergyParts.of(body, film.elastic, resisted, options, tick_s, gravity)


def _decay(scenario: Scenario) -> Decay | None:
    if scenario.mode != "dynamic":
        return None
    options = dynamic_options(scenario)
    return partial(step_scheme.mode_decay, options.integrator, scenario.clock.tick_s, options.losses_per_s)


def _steps(parts: Parts) -> tuple[int, float]:
    """Return the number of steps of a run, and their duration [s], which is a mean in statics."""
    scenario = parts.scenario
    if scenario.mode == "dynamic":
        return sum(scenario.ticks(phase) for phase in scenario.phases), scenario.clock.tick_s
    count = sum(phase.increments for phase in scenario.phases)
    return count, sum(phase.duration_s + phase.settle_s for phase in scenario.phases) / count


def _drawn(scenario: Scenario, body: SoftBody) -> DrawnFilm | None:
    """Return the unrefined film for drawing: a section model has no finer shape. None without refinement."""
    robot = scenario.soft_robot
    if scenario.fidelity != "section" or isinstance(robot, GivenBodyTable) or robot.copies or robot.palm:
        return None
    nodes, fine = np.arange(body.nodes), body
    for level in reversed(range(robot.stack.refine if robot.stack else 0)):
        assert robot.stack is not None, "it has levels"
        coarse = described_body(replace(robot, stack=replace(robot.stack, refine=level)), scenario.model)
        first, second = parents(coarse, fine).T
        kept = np.flatnonzero(first == second)
        nodes, fine = nodes[kept[np.argsort(first[kept])]], coarse
    if fine is body:
        return None
    return DrawnFilm(
        nodes, fine.triangles, tuple(cable.nodes for cable in fine.cables), partial(_largest_stress, fine)
    )


def _largest_stress(body: SoftBody, positions: Array) -> Array:
    return body.principal_stress(np.array(positions))[:, 0]  # kernels need a writable array


def _report(parts: Parts, modelled: tuple[Decision, ...], section: SectionModel | None) -> str:
    scenario, body = parts.scenario, parts.soft.body
    integrator = scenario.solver.integrator.replace("_", " ")
    lines = {
        **parts.carrier.report,
        "Soft robot": f"{scenario.soft_robot.name}, {1e3 * body.mass_kg:.0f} g, {body.nodes} nodes, "
        f"{len(body.triangles)} triangles, {len(body.hinges.nodes)} hinges, "
        f"{len(body.cables)} cables",
        "Stiffeners": "; ".join(filter(None, (stiffener_report(body), extension_report(scenario)))),
        "Known": known_report(scenario),
        "Fidelity": fidelity_report(scenario, section),
        "Chamber": "closed by caps" if body.closed else "open ends (no cap force)",
        "Gas": gas_report(scenario),
        **modelled_devices.device_report(scenario),
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
        friction = "no friction; only fixed bodies are touched"
    cell = [] if scenario.scene is None else ["cell"]
    things = ", ".join(["floor", *cell, *names])
    return f"with {things}; {law.stiffness_N_m3:.0e} N/m^3, {friction}"
