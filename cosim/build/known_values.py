"""What a run tells of how the values of its soft robot are known."""

from __future__ import annotations

from cosim.build.published_robot import TAKEN_AWAY
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.writing import to_table


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
