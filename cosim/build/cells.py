"""The cell of a scenario, as the rigid side wants it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cosim.build.blame import blamed_on
from cosim.config.rules.cell_rules import CELL_KEYS
from cosim.config.schema.objects import SceneTable
from cosim.config.schema.scenario import Scenario
from cosim.plan.cell_motion import CellMotion, cell_motion

if TYPE_CHECKING:  # a scene without an arm waits for neither engine
    from cosim.rigid.build.cell import Cell


def cell_of(scene: SceneTable) -> Cell:
    """Return the cell of a scene.

    Raises:
        ScenarioError: its file is not usable.
    """
    from cosim.rigid.build.cell_reading import read_cell

    with blamed_on("scene.mjcf"):
        return read_cell(Path(scene.mjcf))


def motion_of(scenario: Scenario, cell: Cell | None) -> CellMotion | None:
    """Return how the phases drive a scenario's cell; None where it has no joints.

    Raises:
        ScenarioError: there is no such joint, or it cannot go there.
    """
    joints, tick_s = () if cell is None else cell.joints, scenario.clock.tick_s
    asked = any(getattr(phase, key) is not None for phase in scenario.phases for key in CELL_KEYS)
    if not joints and not asked:
        return None
    lengths = [tick_s * max(1, round((p.duration_s + p.settle_s) / tick_s)) for p in scenario.phases]
    return cell_motion(scenario.phases, joints, lengths)
