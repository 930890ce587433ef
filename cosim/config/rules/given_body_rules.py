"""Rules on what may be asked of a soft body that is given from Python."""

from __future__ import annotations

from typing import Final

from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.faults import Faults
from cosim.errors import ScenarioError

_NEEDS: Final = {
    "section": "a stack of units",
    "refined": "a geometry that can be drawn finer",
    "auto": "to choose among models of a soft robot's file",
}


def check_given_body(body: GivenBodyTable, scenario: Scenario, faults: Faults) -> None:
    """Check that a scenario asks nothing of a given body that only a soft robot's file can tell.

    Args:
        body: in place of the scenario's soft robot.
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        check_not_a_stack(body.name, "given as arrays", scenario)
    if scenario.model.closed != body.closed:
        raise ScenarioError(
            "model.closed",
            f"is {str(scenario.model.closed).lower()}; the soft body '{body.name}' is given with "
            f"closed = {body.closed}",
        )


def check_not_a_stack(name: str, drawn: str, scenario: Scenario) -> None:
    """Check that a scenario asks nothing of a soft body that only a stack of units has.

    Args:
        name: of the body.
        drawn: how it is, for messages.
        scenario: may hold UNKNOWN.

    Raises:
        ScenarioError: it does.
    """
    if scenario.fidelity in _NEEDS:
        raise ScenarioError(
            "fidelity",
            f"'{scenario.fidelity}' needs {_NEEDS[scenario.fidelity]}; the soft body '{name}' is {drawn}: "
            "take 'lumped' or 'rigid'",
        )
    if scenario.model.published:
        raise ScenarioError(
            "model.published", f"is true; the paper's model is one of stacks of units, '{name}' is {drawn}"
        )
    if not scenario.model.all_hinges:
        raise ScenarioError(
            "model.all_hinges", f"is false; the published hinges are those of stacks, '{name}' is {drawn}"
        )


def file_of(scenario: Scenario, what: str) -> SoftRobotTable:
    """Return the soft robot of a scenario as its file has it.

    Args:
        scenario: checked.
        what: needs it, for the message.

    Raises:
        ScenarioError: its soft body is given as arrays.
    """
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        raise ScenarioError(
            "soft_robot", f"'{robot.name}' is given as arrays; {what} needs a soft robot's file"
        )
    return robot


def check_in_file(soft_robot: object) -> None:
    """Refuse a soft robot's table that a run with a body given from Python has written.

    Args:
        soft_robot: as in a scenario's file.

    Raises:
        ScenarioError: it is one.
    """
    if isinstance(soft_robot, dict) and "arrays" in soft_robot:
        raise ScenarioError(
            "soft_robot",
            f"'{soft_robot.get('name')}' was given as arrays, which are in no file: run this from Python, "
            "cosim.run(..., body=...), or go on with cosim.Simulation(..., body=..., start=...)",
        )
