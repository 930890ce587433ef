"""Rules on what a section model can show."""

from __future__ import annotations

from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError


def check_section(scenario: Scenario) -> None:
    """Check that nothing is asked of a section model that it leaves out.

    Raises:
        ScenarioError: the first rule that is broken.
    """
    robot = scenario.soft_robot
    if robot.copies:
        raise ScenarioError(
            "soft_robot.copies",
            "have no section model: fingers fold where they close, and a folded section has no equilibrium "
            "to condense (docs/section.md); use fidelity = 'lumped'",
        )
    if robot.attachments:
        raise ScenarioError(
            "soft_robot.attach", "has no section model: it is of one stack of units; use fidelity = 'lumped'"
        )
    if robot.base != ("unit_1.hole",):
        raise ScenarioError(
            "soft_robot.base", f"is {list(robot.base)}; a section model needs ['unit_1.hole'] alone"
        )
    if scenario.contact.self_contact:
        raise ScenarioError("contact.self_contact", "is not in a section model; use fidelity = 'lumped'")
    for phase in scenario.phases:
        _check_phase(phase)


def _check_phase(phase: PhaseTable) -> None:
    path = f"phase.{phase.name}"
    if phase.supports:
        raise ScenarioError(f"{path}.support", "is not in a section model; use fidelity = 'lumped'")
    for key, rings in (("clamp", phase.clamp), ("release", phase.release)):
        for ring in rings:
            if not (ring.endswith(".outer") or ring == "tip"):
                raise ScenarioError(
                    f"{path}.{key}", f"names '{ring}'; a section model holds outer rings and the tip only"
                )
