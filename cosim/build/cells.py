"""The cell of a scenario, as the rigid side wants it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cosim.build.blame import blamed_on
from cosim.config.schema.objects import SceneTable

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
