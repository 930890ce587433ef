"""How far the model of a soft robot is expected to be off, from a table of what has been measured."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any, Final

from cosim.build.published_robot import published_robot
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable

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
        found[figure] = (
            None if row is None else {**{key: row[key] for key in keys}, "pressure_Pa": list(PRESSURE_Pa)}
        )
    return found


def expected_error_report(scenario: Scenario) -> str:
    """Return the same for people."""
    low, high = (1e-3 * pressure for pressure in PRESSURE_Pa)
    texts = [f"{figure} {_text(error)}" for figure, error in expected_error(scenario).items()]
    return f"{'; '.join(texts)}; from {low:g} to {high:g} kPa"


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
