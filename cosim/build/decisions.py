"""What a run models, what it leaves out, and why; each with the key that decides otherwise."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from cosim.config.rules.cell_rules import CELL_KEYS
from cosim.config.rules.gas_rules import gas_rules
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.plan.decision import Decision
from cosim.plan.plan import Plan
from cosim.plan.reach import FlangeTravel, film_reach, flange_travel, within_reach
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.self_contact_faces import FilmFaces
from cosim.stepping.parts import film_report
from cosim.telemetry.choices import CONTACT, CONTACT_ENABLED, ONLY_IN_REACH

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm
    from cosim.rigid.scene.scene import RigidScene

_TOUCHED_AT_REST = ("section", "lumped", "refined")  # models whose equilibria take in contact
_SLOW = 0.01  # share of gravity below which accelerations are negligible


def contact_decision(
    scenario: Scenario, soft: SoftSide, plan: Plan, arm: Arm, scene: RigidScene, ready: Callable[[], None]
) -> Decision:
    """Decide whether contact with the scene is searched for.

    Args:
        scenario: checked, with an arm.
        soft: soft side.
        plan: of the run.
        arm: kinematics.
        scene: at its start.
        ready: called before distances to the scene are computed.
    """
    what, switch = CONTACT, CONTACT_ENABLED
    if not scenario.contact.enabled:
        return Decision(what, False, "switched off", switch)
    if scenario.mode == "quasistatic" and scenario.fidelity not in _TOUCHED_AT_REST:
        reason = f"in the quasistatic mode the {scenario.fidelity} model knows none"
        return Decision(what, False, reason, "fidelity")
    if not scenario.contact.only_in_reach:
        return Decision(what, True, "asked for, whatever is in reach", ONLY_IN_REACH)
    open_question = _unknown_reach(scenario)
    if open_question:
        return Decision(what, True, open_question, switch)
    reach = soft.reach_m or film_reach(soft.body, largest_pressure(plan))
    statics = scenario.mode == "quasistatic"
    bodies = within_reach(scene, flange_travel(arm, plan), reach, fixed_only=statics, ready=ready)
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
    return (
        _elasticity(scenario),
        _inertia(scenario, travel),
        contact,
        _self_contact(scenario, body),
        _cables(scenario, body, plan),
        _hinges(scenario, body),
    )


def _elasticity(scenario: Scenario) -> Decision:
    if scenario.fidelity == "rigid":
        return Decision("elasticity", False, "the shape of the start is kept", "fidelity")
    return Decision("elasticity", True, f"fidelity is {scenario.fidelity}", "fidelity")


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
    included = scenario.contact.self_contact and scenario.fidelity != "rigid" and FilmFaces.of(body).can_meet
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
        return Decision(what, True, "they are pulled", switch)
    return Decision(what, False, "they are slack throughout", switch)


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
