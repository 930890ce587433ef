"""What a run says of itself before it starts: names, counts, what is modelled, how, and how well.

How far the model of a soft robot is expected to be off, from a table of what has been measured.
"""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from cosim.base.frames import Array
from cosim.build.options import contact_law, described_body, dynamic_options, fidelity_report, section_figures
from cosim.build.soft_body import TAKEN_AWAY, published_robot
from cosim.config.gas_rules import gas_report, gas_rules
from cosim.config.loading import to_table
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.phase import CELL_KEYS
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.devices import device_loop, sensor
from cosim.plan.arm_limits import PlannedArm
from cosim.plan.clearance import FlangeTravel, film_reach, flange_travel, within_reach
from cosim.plan.decision import CONTACT, CONTACT_ENABLED, ONLY_IN_REACH, Decision
from cosim.plan.plan import Plan
from cosim.reduced.section_model import SectionModel
from cosim.soft.beams.beam_rings import stiffener_report, stiffener_strain
from cosim.soft.body.body import SoftBody, hinge_energy_share
from cosim.soft.body.places import parents
from cosim.soft.elements.frame_stops import FrameStops
from cosim.soft.film.film_energies import FilmEnergies
from cosim.soft.solve import state
from cosim.stepping.parts import Parts, film_report, meetings
from cosim.telemetry.energy import EnergyParts
from cosim.telemetry.snapshot import CameraInfo, Decay, DrawnFilm, ObjectInfo, RunInfo

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm
    from cosim.rigid.scene.scene import RigidScene


def known_report(scenario: Scenario) -> str:
    """Return the keys of a scenario's soft robot by how its file says that their values are known."""
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        return "given as arrays"
    return _told(robot, scenario.model.published) or "not stated by its file"


def _told(robot: SoftRobotTable, published: bool) -> str:
    texts = []
    for how, keys in to_table(robot.known).items():
        left = [key for key in keys if not (published and key.startswith(TAKEN_AWAY))]
        if left:
            texts.append(f"{how}: {', '.join(left)}")
    for part in robot.attachments:
        carried = _told(part.robot, published)
        if carried:
            texts.append(f"{part.name}: {carried}")
    return "; ".join(texts)


FIGURES: Final = ("extension", "bending", "volume")
"""What errors are expected of."""
PRESSURE_Pa: Final = (2e3, 40e3)
"""Between which the table holds."""
_TABLE: Final = Path(__file__).with_name("measured_models.toml")


def modelled_robot(scenario: Scenario) -> SoftRobotTable | None:
    """Return a scenario's soft robot as it is modelled, but for a finer mesh; None for a given body."""
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        return None
    return published_robot(robot) if scenario.model.published else robot


def expected_error(scenario: Scenario) -> dict[str, dict[str, Any] | None]:
    """Return what is expected of each figure: low, high, against what, source, pressures; None: not measured.

    Args:
        scenario: checked. What its robot carries is not looked at.
    """
    robot = modelled_robot(scenario)
    if robot is None or robot.stack is None or scenario.fidelity == "rigid":
        return dict.fromkeys(FIGURES)
    refine = robot.stack.refine + (scenario.fidelity == "refined")
    keys = ("low", "high", "against", "source")
    found: dict[str, dict[str, Any] | None] = {}
    for figure in FIGURES:
        rows = (row for row in _measured()["error"] if row["of"] == figure and _fits(row, robot, refine))
        row = next(rows, None)
        pressure_Pa = None if row is None else _pressures(robot)
        found[figure] = (
            None
            if row is None or pressure_Pa is None
            else {**{key: row[key] for key in keys}, "pressure_Pa": pressure_Pa}
        )
    return found


def _pressures(robot: SoftRobotTable) -> list[float] | None:
    """Return between which pressures [Pa] rows hold for a film; None where they do not, at any."""
    stack, film = robot.stack, robot.film
    assert stack is not None
    size_m = stack.corner_radius_m
    within = next((each for each in _measured()["range"] if stack.sides in each["sides"]), None)
    if within is None or film.young_modulus_Pa is None:
        return None
    ratios = {"thickness": film.thickness_m / size_m, "hole": stack.hole_radius_m / size_m}
    if not all(within[key][0] <= ratio <= within[key][1] for key, ratio in ratios.items()):
        return None
    most, least = (film.young_modulus_Pa * film.thickness_m / (end * size_m) for end in within["tension"])
    low, high = max(PRESSURE_Pa[0], least), min(PRESSURE_Pa[1], most)
    return [low, high] if low < high else None


def expected_error_report(scenario: Scenario) -> str:
    """Return the same for people."""
    found = expected_error(scenario)
    within = next((error["pressure_Pa"] for error in found.values() if error is not None), PRESSURE_Pa)
    low, high = (1e-3 * pressure for pressure in within)
    texts = [f"{figure} {_text(error)}" for figure, error in found.items()]
    return f"{'; '.join(texts)}; from {low:.3g} to {high:.3g} kPa"


def extension_report(scenario: Scenario) -> str:
    """Return how far specimens extend with other stiffeners; empty where the robot has no beams."""
    robot = modelled_robot(scenario)
    if robot is None or robot.stack is None or robot.stiffener.kind != "beam":
        return ""
    texts = []
    for row in _measured()["extension"]:
        if row["sides"] == robot.stack.sides:
            widths, lengths = (
                ", ".join(f"{1e3 * x:g}" for x in row[key]) for key in ("width_m", "extension_m")
            )
            texts.append(
                f"{row['specimen']} with {widths} mm square extend by {lengths} mm at "
                f"{1e-3 * row['pressure_Pa']:g} kPa"
            )
    return "; ".join(texts)


def _fits(row: dict[str, Any], robot: SoftRobotTable, refine: int) -> bool:
    stack, stiffener = robot.stack, robot.stiffener
    assert stack is not None
    return (
        row["law"] == robot.film.law
        and row["stiffener"] == stiffener.kind
        and stack.sides in row["sides"]
        and row["refine"] == refine
        and row.get("mesh", "drawn") == stack.mesh
        and row.get("refine_holes", stack.refine_holes) == stack.refine_holes
        and row.get("neck", stack.neck is not None) == (stack.neck is not None)
        and row.get("least_width_m", 0.0) <= (stiffener.width_m or 0.0)
    )


def _text(error: dict[str, Any] | None) -> str:
    if error is None:
        return "not measured"
    low, high = (f"{100.0 * error[end]:+.0f}" for end in ("low", "high"))
    return f"{low if low == high else f'{low} to {high}'} % (against {error['against']}; {error['source']})"


@cache
def _measured() -> dict[str, Any]:
    return tomllib.loads(_TABLE.read_text(encoding="utf-8"))


_TOUCHED_AT_REST = ("section", "lumped", "refined")  # models whose equilibria take in contact
_SLOW = 0.01  # share of gravity below which accelerations are negligible


def contact_decision(
    scenario: Scenario, soft: SoftSide, plan: Plan, arm: "Arm", scene: "RigidScene"
) -> Decision:
    """Decide whether contact with the scene is searched for.

    Args:
        scenario: checked, with an arm.
        soft: soft side.
        plan: of the run.
        arm: kinematics.
        scene: at its start.
    """
    what, switch = CONTACT, CONTACT_ENABLED
    if not scenario.contact.enabled:
        return Decision(what, False, "switched off", switch)
    if scenario.mode == "quasistatic" and scenario.fidelity not in _TOUCHED_AT_REST:
        reason = f"in the quasistatic mode the {scenario.fidelity} model knows none"
        return Decision(what, False, reason, "fidelity")
    if not scenario.contact.only_in_reach:
        return Decision(what, True, "asked for, whatever is in reach", ONLY_IN_REACH)
    open_question = _unknown_reach(scenario) if scene.coupled is scene else "other arms can move"
    if open_question:
        return Decision(what, True, open_question, switch)
    reach = soft.reach_m or film_reach(soft.body, largest_pressure(plan))
    statics = scenario.mode == "quasistatic"
    bodies = within_reach(scene, flange_travel(arm, plan), reach, fixed_only=statics)
    if bodies:
        return Decision(what, True, f"the film reaches {reach:.2f} m, as far as {', '.join(bodies)}", switch)
    reason = f"nothing is within the film's reach of {reach:.2f} m around the flange's way"
    return Decision(what, False, reason, ONLY_IN_REACH)


def _unknown_reach(scenario: Scenario) -> str:
    """Return why what the film can get to is not known beforehand; empty if it is."""
    moving = [entry.name for entry in scenario.objects if entry.mass_kg is not None]
    moving += [wire.name for wire in scenario.wires]
    asked = (getattr(phase, key) for phase in scenario.phases for key in CELL_KEYS)
    moving += sorted({f"cell/{name}" for names in asked for name in names or {}})
    if moving and scenario.mode == "dynamic":
        return f"{', '.join(moving)} can move"
    if any(rule.sealed for rules in gas_rules(scenario) for rule in rules):
        return "sealed gas has no pressure known beforehand"
    if any(entry.kind == "python" for entry in scenario.controllers):
        return "a controller in Python can move the flange"
    if scenario.endless:
        return "without phases, commands are not known beforehand"
    if scenario.commands:
        return "what [[command]] asks for is not known beforehand"
    if any(phase.release for phase in scenario.phases):
        return "rings are let go"
    return ""


def largest_pressure(plan: Plan) -> float:
    """Return the largest gauge pressure [Pa] that a plan gives to a chamber, at least 0."""
    commands = [plan.command, *(asked for phase in plan.phases for asked in (phase.begin, phase.end))]
    return max(0.0, *(pressure for command in commands for pressure in command.pressure_Pa))


def decisions(
    scenario: Scenario, body: SoftBody, plan: Plan, contact: Decision, travel: FlangeTravel | None
) -> tuple[Decision, ...]:
    """Return all decisions of a run.

    Args:
        scenario: checked.
        body: of the soft robot.
        plan: of the run.
        contact: with the scene.
        travel: of the flange; None where it is held.
    """
    cables = _cables(scenario, body, plan)
    return (
        _elasticity(scenario),
        _inertia(scenario, travel),
        contact,
        _self_contact(scenario, body),
        cables,
        *(_sliding(scenario, body) if cables.included else ()),
        _hinges(scenario, body),
        *_losses(scenario, body),
        *_first_tick(scenario),
    )


def _first_tick(scenario: Scenario) -> tuple[Decision, ...]:
    """Return that the first tick does not resolve a linear ramp; nothing if the run begins with none."""
    lumped = scenario.fidelity in ("lumped", "refined")
    if scenario.mode != "dynamic" or not lumped or not scenario.phases:
        return ()
    first = scenario.phases[0]
    if first.ramp != "linear" or (first.pressure_Pa is None and first.cable_tension_N is None):
        return ()
    reason = f"phase '{first.name}' begins with a jump of the loads' rate"
    return (Decision("first tick of a linear ramp", False, reason, f"phase.{first.name}.ramp"),)


def finer_steps(scenario: Scenario, scene: "RigidScene") -> tuple[Decision, ...]:
    """Return that a free object shortens the steps of rigid bodies, and which one; nothing if none does."""
    if scene.substeps == 1:
        return ()
    free = [entry for entry in scenario.objects if entry.mass_kg and not (entry.hinge or entry.slide)]
    lightest = min(free, key=lambda entry: entry.mass_kg or 0.0)
    step_ms = 1e3 * scenario.clock.tick_s / scene.substeps
    reason = (
        f"'{lightest.name}' ({lightest.mass_kg:g} kg) has rigid bodies take {scene.substeps} steps in a "
        "tick, the arm as well, wherever it is"
    )
    return (Decision(f"rigid steps of {step_ms:g} ms for '{lightest.name}'", True, reason, "clock.tick_s"),)


def _elasticity(scenario: Scenario) -> Decision:
    if scenario.fidelity == "rigid":
        return Decision("elasticity", False, "the shape of the start is kept", "fidelity")
    return Decision("elasticity", True, f"fidelity is {scenario.fidelity}", "fidelity")


def _losses(scenario: Scenario, body: SoftBody) -> tuple[Decision, ...]:
    """Return what becomes of the losses of materials; nothing is said where none has a loss factor."""
    largest = max((each.film.loss_factor for each in body.membranes), default=0.0)
    if not largest:
        return ()
    what, switch = "losses of the film's material", _of_robot(scenario, "film.loss_factor")
    if scenario.mode == "quasistatic":
        return (Decision(what, False, "statics know no rates of strain", "mode"),)
    if scenario.fidelity in ("rigid", "section"):
        return (Decision(what, False, f"fidelity '{scenario.fidelity}' has none", "fidelity"),)
    frames = "" if stiffener_report(body) == "none" else "; frames have none"
    return (Decision(what, True, f"its loss factor is {largest:g}{frames}", switch),)


def _inertia(scenario: Scenario, travel: FlangeTravel | None) -> Decision:
    what = "inertia"
    if scenario.mode == "quasistatic":
        return Decision(what, False, "a chain of equilibria", "mode")
    gravity = float(np.linalg.norm(scenario.gravity_m_s2))
    if travel is None or gravity == 0.0:
        return Decision(what, True, "the mode is dynamic", "mode")
    fraction = travel.acceleration_m_s2 / gravity
    hint = "; mode = 'quasistatic' would leave out little" if fraction < _SLOW else ""
    reason = f"the plan asks the end of a straight arm for up to {100.0 * fraction:.2g} % of gravity{hint}"
    return Decision(what, True, reason, "mode")


def _self_contact(scenario: Scenario, body: SoftBody) -> Decision:
    included = scenario.touches_itself and bool(meetings(body))
    return Decision("contact with itself", included, film_report(scenario, body), "contact.self_contact")


def _cables(scenario: Scenario, body: SoftBody, plan: Plan) -> Decision:
    what, switch = "cables", "phase.*.cable_tension_N"
    if not body.cables:
        return Decision(what, False, "there are none", _of_robot(scenario, "cable"))
    if scenario.fidelity == "rigid":
        return Decision(what, False, "they do not move a rigid body", "fidelity")
    commands = [plan.command, *(asked for phase in plan.phases for asked in (phase.begin, phase.end))]
    driven = scenario.winches or scenario.controllers or scenario.commands or scenario.endless
    if any(any(command.cable_tension_N) for command in commands) or driven:
        one_way = [cable for cable in body.cables if not cable.directed]
        loses = any(cable.loss_factor < 1.0 or cable.friction_coefficient > 0.0 for cable in one_way)
        given_back = "; a release gives back what a pull has lost (losses of cables)" if loses else ""
        return Decision(what, True, f"they are pulled{given_back}", switch)
    return Decision(what, False, "they are slack throughout", switch)


def _sliding(scenario: Scenario, body: SoftBody) -> tuple[Decision, ...]:
    """Return that losses do not follow the way in which cables slide; nothing where none has such losses."""
    one_way = any(cable.lossy and not cable.directed for cable in body.cables)
    if not one_way:
        return ()
    reason = (
        "tension falls from the base whichever way the cable slides: where it slides back, eyelets make "
        "energy (eyelets_made_J); losses = 'directed' opposes the way it slides"
    )
    return (Decision("direction of cable losses", False, reason, _of_robot(scenario, "cable.*.losses")),)


def _hinges(scenario: Scenario, body: SoftBody) -> Decision:
    switch = _of_robot(scenario, "hinge.stiffness_factor")
    if scenario.fidelity == "rigid":
        return Decision("hinges", False, "the shape of the start is kept", "fidelity")
    if not body.hinges.stiffness.any():
        return Decision("hinges", False, "their stiffness is zero", switch)
    return Decision("hinges", True, "their share of the elastic energy is in the summary, by phase", switch)


def _of_robot(scenario: Scenario, key: str) -> str:
    """Return the switch that a soft robot's file has; of a body given from Python, its arrays are that."""
    return "body" if isinstance(scenario.soft_robot, GivenBodyTable) else f"soft_robot.{key}"


def stage_of(
    parts: Parts, modelled: tuple[Decision, ...], arm: PlannedArm | None, section: SectionModel | None
) -> RunInfo:
    """Return everything about a run that does not change while it lasts.

    Args:
        parts: of the run.
        modelled: what it models, and what it leaves out.
        arm: what the plan asks of it; None without one.
        section: model of the soft robot; None where another represents it.
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
        devices=device_loop.device_names(scenario),
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
    )


def _objects(parts: Parts) -> tuple[ObjectInfo, ...]:
    names = parts.carrier.body_names
    moves = parts.scenario.mode == "dynamic"
    objects = parts.carrier.objects if moves else ()
    return tuple(ObjectInfo(names[body], body, figures, free) for body, free, figures in objects)


def _films(body: SoftBody) -> int:
    """Return of how many films a body consists that share no node."""
    first, second = body.triangles[:, (0, 1)].T, body.triangles[:, (1, 2)].T
    edges = np.hstack([first, second])
    count, nodes = len(body.node_mass), np.unique(edges)
    graph = csr_array((np.ones(edges.shape[1], dtype=bool), tuple(edges)), shape=(count, count))
    return len(np.unique(connected_components(graph, directed=False)[1][nodes]))


def _frames_length(body: SoftBody) -> Callable[[Array], float] | None:
    """Return what measures the frames of one stack, if they rest on one another."""
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
    return partial(state.mode_decay, options.integrator, scenario.clock.tick_s, options.losses_per_s)


def _steps(parts: Parts) -> tuple[int, float]:
    """Return how many steps a run has, and how long one is [s], in the mean where it has no clock."""
    scenario = parts.scenario
    if scenario.mode == "dynamic":
        return sum(scenario.ticks(phase) for phase in scenario.phases), scenario.clock.tick_s
    count = sum(phase.increments for phase in scenario.phases)
    return count, sum(phase.duration_s + phase.settle_s for phase in scenario.phases) / count


def _drawn(scenario: Scenario, body: SoftBody) -> DrawnFilm | None:
    """Return the film on the mesh before refining: a section model's film knows no finer shape."""
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
    return body.principal_stress(np.array(positions))[:, 0]  # kernels take no array that is read-only


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
        **device_loop.device_report(scenario),
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
