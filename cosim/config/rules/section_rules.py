"""Rules on what a section model can show."""

from __future__ import annotations

from cosim.config.schema.given_body import AnySoftRobot, GivenBodyTable
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.stack import FIRST_RING
from cosim.config.toml.faults import Faults
from cosim.errors import ScenarioError


def check_section(scenario: Scenario, faults: Faults) -> None:
    """Check that nothing is asked of a section model that it leaves out.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        _check_robot(scenario.soft_robot, faults)
    with faults:
        if scenario.contact.self_contact:
            raise ScenarioError("contact.self_contact", "is not in a section model; use fidelity = 'lumped'")
    for phase in scenario.phases:
        with faults:
            _check_phase(phase, scenario.soft_robot, faults)


def _check_robot(robot: AnySoftRobot, faults: Faults) -> None:
    if isinstance(robot, GivenBodyTable):
        return  # is refused by itself
    with faults:
        if robot.copies:
            raise ScenarioError(
                "soft_robot.copies",
                "have no section model: fingers fold where they close, and a folded section has no "
                "equilibrium to condense (docs/section.md); use fidelity = 'lumped'",
            )
    with faults:
        if robot.attachments:
            raise ScenarioError(
                "soft_robot.attach",
                "has no section model: it is of one stack of units; use fidelity = 'lumped'",
            )
    if robot.base != (FIRST_RING,):
        raise ScenarioError(
            "soft_robot.base", f"is {list(robot.base)}; a section model needs ['{FIRST_RING}'] alone"
        )


def _check_phase(phase: PhaseTable, robot: AnySoftRobot, faults: Faults) -> None:
    path = f"phase.{phase.name}"
    with faults:
        if phase.supports:
            raise ScenarioError(f"{path}.support", "is not in a section model; use fidelity = 'lumped'")
    if isinstance(robot, GivenBodyTable) or robot.stack is None:
        return  # is refused by itself
    frames = robot.stack.frame_rings()
    for key in ("clamp", "release"):
        with faults:
            for ring in getattr(phase, key):
                if ring not in frames:
                    raise ScenarioError(
                        f"{path}.{key}", f"names '{ring}'; a section model holds outer rings and the tip only"
                    )
