"""Rules on what a scenario's fidelity can show."""

from __future__ import annotations

from typing import Final

from cosim.config.rules.given_body_rules import check_not_a_stack
from cosim.config.rules.section_rules import check_section
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.faults import Faults
from cosim.errors import ScenarioError

_REFINE_MAX: Final = 4


def check_fidelity(scenario: Scenario, faults: Faults) -> None:
    """Check that nothing is asked of a fidelity that it leaves out.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        _check_auto(scenario)
    with faults:
        robot = scenario.soft_robot
        refined = scenario.fidelity == "refined"
        if isinstance(robot, SoftRobotTable) and not robot.all_stacks:
            check_not_a_stack(robot.name, "not drawn as a stack of units alone", scenario)
        elif (
            refined
            and isinstance(robot, SoftRobotTable)
            and robot.stack
            and robot.stack.refine >= _REFINE_MAX
        ):
            raise ScenarioError(
                "fidelity",
                "'refined' is one refinement more than soft_robot.stack.refine, which is at its bound of "
                f"{_REFINE_MAX} already",
            )
    if scenario.fidelity == "section":
        check_section(scenario, faults)
    if scenario.fidelity == "rigid":
        _check_rigid(scenario, faults)


def _refined(robot: SoftRobotTable) -> int:
    return 0 if robot.stack is None else robot.stack.refine


def _check_rigid(scenario: Scenario, faults: Faults) -> None:
    with faults:
        if not scenario.model.closed:
            raise ScenarioError(
                "fidelity",
                "'rigid' needs model.closed = true: it leaves out how an open chamber's gas pushes",
            )
    for phase in scenario.phases:
        for key, field in (("release", "release"), ("support", "supports")):
            with faults:
                if getattr(phase, field):
                    raise ScenarioError(
                        f"phase.{phase.name}.{key}",
                        "cannot stand beside fidelity = 'rigid': every node is held",
                    )


def _check_auto(scenario: Scenario) -> None:
    requirement = scenario.auto
    if scenario.fidelity != "auto":
        if requirement is not None and requirement.chosen is None:
            raise ScenarioError("auto", f"goes with fidelity = 'auto'; the fidelity is '{scenario.fidelity}'")
        return
    if scenario.mode != "dynamic":
        raise ScenarioError("fidelity", f"'auto' chooses among dynamic runs; the mode is '{scenario.mode}'")
    if requirement is None or (
        requirement.budget,
        requirement.tolerance_m,
        requirement.force_tolerance_N,
    ) == (None, None, None):
        raise ScenarioError(
            "auto", "is missing a requirement; fidelity = 'auto' needs auto.budget (least real-time factor), "
            "auto.tolerance_m (of the tip) or auto.force_tolerance_N",
        )  # fmt: skip
