"""Rules on what phases ask of a cell."""

from __future__ import annotations

from typing import Final

from cosim.config.schema.scenario import Scenario
from cosim.config.toml.faults import Faults
from cosim.errors import ScenarioError

CELL_KEYS: Final = ("cell_shift_m", "cell_angle_rad", "cell_speed_m_s", "cell_speed_rad_s")
"""Keys of a phase that drive joints of the cell."""


def check_cell(scenario: Scenario, faults: Faults) -> None:
    """Check that what is driven is there, in a run that has time.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    for phase in scenario.phases:
        for key in CELL_KEYS:
            with faults:
                if getattr(phase, key) is None:
                    continue
                path = f"phase.{phase.name}.{key}"
                if scenario.scene is None:
                    raise ScenarioError(path, "needs a cell with a joint of that name: [scene] mjcf")
                if scenario.mode == "quasistatic":
                    raise ScenarioError(path, "needs mode = 'dynamic': in statics a cell stands still")
