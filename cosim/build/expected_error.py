"""Known errors of the lumped model of a soft robot, from a table of measurements (`measured_models.toml`),
and the origin of the robot's values.
"""

import tomllib
from functools import cache
from pathlib import Path
from typing import Any, Final

from cosim.build.paper_model import TAKEN_AWAY, published_robot
from cosim.config.loading import to_table
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable

FIGURES: Final = ("extension", "bending", "volume")
"""Figures with a known error."""
PRESSURE_Pa: Final = (2e3, 40e3)
"""Range of the measurements."""
_TABLE: Final = Path(__file__).with_name("measured_models.toml")


def known_report(scenario: Scenario) -> str:
    """Return the keys of a scenario's soft robot by the origin of their values, as text."""
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        return "given as arrays"
    return _origins(robot, scenario.model.published) or "not stated by its file"


def _origins(robot: SoftRobotTable, published: bool) -> str:
    texts = []
    for how, keys in to_table(robot.known).items():
        left = [key for key in keys if not (published and key.startswith(TAKEN_AWAY))]
        if left:
            texts.append(f"{how}: {', '.join(left)}")
    for part in robot.attachments:
        of_part = _origins(part.robot, published)
        if of_part:
            texts.append(f"{part.name}: {of_part}")
    return "; ".join(texts)


def modelled_robot(scenario: Scenario) -> SoftRobotTable | None:
    """Return a scenario's soft robot as modelled, but without "refined"; None for a body given as arrays."""
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        return None
    return published_robot(robot) if scenario.model.published else robot


def expected_error(scenario: Scenario) -> dict[str, dict[str, Any] | None]:
    """Return the known relative error of each figure: low, high, reference, source, pressures; None: unknown.

    Args:
        scenario: checked; attachments of its robot are ignored.
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
    """Return the range of pressure [Pa] in which the measurements apply to a film; None: they do not."""
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
    """Return the known errors as text."""
    found = expected_error(scenario)
    within = next((error["pressure_Pa"] for error in found.values() if error is not None), PRESSURE_Pa)
    low, high = (1e-3 * pressure for pressure in within)
    texts = [f"{figure} {_text(error)}" for figure, error in found.items()]
    return f"{'; '.join(texts)}; from {low:.3g} to {high:.3g} kPa"


def extension_report(scenario: Scenario) -> str:
    """Return the measured extension of specimens with other stiffeners; empty for a robot without beams."""
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
        and row.get("side_ratio", 1.0) == stiffener.side_ratio
    )


def _text(error: dict[str, Any] | None) -> str:
    if error is None:
        return "not measured"
    low, high = (f"{100.0 * error[end]:+.0f}" for end in ("low", "high"))
    return f"{low if low == high else f'{low} to {high}'} % (against {error['against']}; {error['source']})"


@cache
def _measured() -> dict[str, Any]:
    return tomllib.loads(_TABLE.read_text(encoding="utf-8"))
