"""Decides which effects a run models (contact, inertia, losses, ...) and gives the reason and the key of each
decision.
"""

from typing import TYPE_CHECKING

import numpy as np

from cosim.config.gas_rules import gas_rules
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.phase import CELL_KEYS
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.plan.commands import SoftCommand
from cosim.plan.decision import CONTACT, CONTACT_ENABLED, ONLY_IN_REACH, Decision
from cosim.plan.film_reach import FlangeTravel, film_reach, flange_travel, within_reach
from cosim.plan.plan import Plan
from cosim.soft.beams.beam_rings import stiffener_report
from cosim.soft.body.body import SoftBody
from cosim.stepping.film_contact import film_pairs, film_report

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm
    from cosim.rigid.scene.scene import RigidScene

_TOUCHED_AT_REST = ("section", "lumped", "refined")  # models whose equilibria include contact
_SLOW = 0.01  # accelerations below this fraction of gravity are negligible


def contact_decision(
    scenario: Scenario, soft: SoftRobot, plan: Plan, arm: "Arm", scene: "RigidScene"
) -> Decision:
    """Decide whether the run models contact with the scene.

    Args:
        scenario: checked, with an arm.
        soft: soft side.
        plan: of the run.
        arm: of Pinocchio.
        scene: at its start.
    """
    what, switch = CONTACT, CONTACT_ENABLED
    if not scenario.contact.enabled:
        return Decision(what, False, "switched off", switch)
    if scenario.mode == "quasistatic" and scenario.fidelity not in _TOUCHED_AT_REST:
        reason = f"the {scenario.fidelity} model has none in the quasistatic mode"
        return Decision(what, False, reason, "fidelity")
    if not scenario.contact.only_in_reach:
        return Decision(what, True, "required, whatever is in reach", ONLY_IN_REACH)
    open_question = _unknown_reach(scenario) if scene.coupled is scene else "other arms can move"
    if open_question:
        return Decision(what, True, open_question, switch)
    reach = soft.reach_m or film_reach(soft.body, largest_pressure(plan))
    statics = scenario.mode == "quasistatic"
    bodies = within_reach(scene, flange_travel(arm, plan), reach, fixed_only=statics)
    if bodies:
        return Decision(what, True, f"the film reaches {reach:.2f} m, as far as {', '.join(bodies)}", switch)
    reason = f"nothing is within the film's reach of {reach:.2f} m around the flange's path"
    return Decision(what, False, reason, ONLY_IN_REACH)


def _unknown_reach(scenario: Scenario) -> str:
    """Return why the film's reach is unknown before the run; empty if it is known."""
    moving = [entry.name for entry in scenario.objects if entry.mass_kg is not None]
    moving += [wire.name for wire in scenario.wires]
    asked = (getattr(phase, key) for phase in scenario.phases for key in CELL_KEYS)
    moving += sorted({f"cell/{name}" for names in asked for name in names or {}})
    if moving and scenario.mode == "dynamic":
        return f"{', '.join(moving)} can move"
    if any(rule.sealed for rules in gas_rules(scenario) for rule in rules):
        return "the pressure of sealed gas is not known beforehand"
    if any(entry.kind == "python" for entry in scenario.controllers):
        return "a controller in Python can move the flange"
    if scenario.endless:
        return "without phases, commands are not known beforehand"
    if scenario.commands:
        return "the commands of [[command]] are not known beforehand"
    if any(phase.release for phase in scenario.phases):
        return "rings are released"
    return ""


def largest_pressure(plan: Plan) -> float:
    """Return the largest gauge pressure [Pa] of a chamber in a plan, at least 0."""
    return max(0.0, *(pressure for command in _commands(plan) for pressure in command.pressure_Pa))


def _commands(plan: Plan) -> list[SoftCommand]:
    """Return the commands of a plan's start, and at begin and end of each phase."""
    return [plan.command, *(end for phase in plan.phases for end in (phase.begin, phase.end))]


def decisions(
    scenario: Scenario, body: SoftBody, plan: Plan, contact: Decision, travel: FlangeTravel | None
) -> tuple[Decision, ...]:
    """Return all decisions of a run.

    Args:
        scenario: checked.
        body: of the soft robot.
        plan: of the run.
        contact: decision on contact with the scene.
        travel: of the flange; None if it is held.
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
    """Return that the first tick does not resolve a linear ramp of the loads; nothing without such a ramp."""
    lumped = scenario.fidelity in ("lumped", "refined")
    if scenario.mode != "dynamic" or not lumped or not scenario.phases:
        return ()
    first = scenario.phases[0]
    if first.ramp != "linear" or (first.pressure_Pa is None and first.cable_tension_N is None):
        return ()
    reason = f"phase '{first.name}' begins with a jump of the loads' rate"
    return (Decision("first tick of a linear ramp", False, reason, f"phase.{first.name}.ramp"),)


def finer_steps(scenario: Scenario, scene: "RigidScene") -> tuple[Decision, ...]:
    """Return the object that shortens the rigid steps; nothing with one rigid step per tick."""
    if scene.substeps == 1:
        return ()
    free = [entry for entry in scenario.objects if entry.mass_kg and not (entry.hinge or entry.slide)]
    lightest = min(free, key=lambda entry: entry.mass_kg or 0.0)
    step_ms = 1e3 * scenario.clock.tick_s / scene.substeps
    reason = (
        f"'{lightest.name}' ({lightest.mass_kg:g} kg) needs {scene.substeps} rigid steps per tick; all rigid "
        "bodies take them, at all times"
    )
    return (Decision(f"rigid steps of {step_ms:g} ms for '{lightest.name}'", True, reason, "clock.tick_s"),)


def _elasticity(scenario: Scenario) -> Decision:
    if scenario.fidelity == "rigid":
        return Decision("elasticity", False, "the shape of the start is kept", "fidelity")
    return Decision("elasticity", True, f"fidelity is {scenario.fidelity}", "fidelity")


def _losses(scenario: Scenario, body: SoftBody) -> tuple[Decision, ...]:
    """Return the decision on material losses; nothing if no film has a loss factor."""
    largest = max((each.film.loss_factor for each in body.membranes), default=0.0)
    if not largest:
        return ()
    what, switch = "losses of the film's material", _of_robot(scenario, "film.loss_factor")
    if scenario.mode == "quasistatic":
        return (Decision(what, False, "statics have no strain rates", "mode"),)
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
    included = scenario.touches_itself and bool(film_pairs(body))
    return Decision("contact with itself", included, film_report(scenario, body), "contact.self_contact")


def _cables(scenario: Scenario, body: SoftBody, plan: Plan) -> Decision:
    what, switch = "cables", "phase.*.cable_tension_N"
    if not body.cables:
        return Decision(what, False, "the soft robot has none", _of_robot(scenario, "cable"))
    if scenario.fidelity == "rigid":
        return Decision(what, False, "they do not move a rigid body", "fidelity")
    driven = scenario.winches or scenario.controllers or scenario.commands or scenario.endless
    if any(any(command.cable_tension_N) for command in _commands(plan)) or driven:
        one_way = [cable for cable in body.cables if not cable.directed]
        loses = any(cable.loss_factor < 1.0 or cable.friction_coefficient > 0.0 for cable in one_way)
        given_back = "; a release gives back what a pull has lost (losses of cables)" if loses else ""
        return Decision(what, True, f"they are pulled{given_back}", switch)
    return Decision(what, False, "they are slack throughout", switch)


def _sliding(scenario: Scenario, body: SoftBody) -> tuple[Decision, ...]:
    """Return that cable losses do not depend on the direction of sliding; nothing without such losses."""
    one_way = any(cable.lossy and not cable.directed for cable in body.cables)
    if not one_way:
        return ()
    reason = (
        "tension falls from the base whichever way the cable slides: if it slides back, eyelets generate "
        "energy (eyelets_made_J); losses = 'directed' opposes the sliding"
    )
    return (Decision("direction of cable losses", False, reason, _of_robot(scenario, "cable.*.losses")),)


def _hinges(scenario: Scenario, body: SoftBody) -> Decision:
    switch = _of_robot(scenario, "hinge.stiffness_factor")
    if scenario.fidelity == "rigid":
        return Decision("hinges", False, "the shape of the start is kept", "fidelity")
    if not body.hinges.stiffness.any():
        return Decision("hinges", False, "their stiffness is zero", switch)
    reason = "their fraction of the elastic energy is in the summary, by phase"
    return Decision("hinges", True, reason, switch)


def _of_robot(scenario: Scenario, key: str) -> str:
    """Return the path of a key in a soft robot's file; "body" for a body given from Python."""
    return "body" if isinstance(scenario.soft_robot, GivenBodyTable) else f"soft_robot.{key}"
