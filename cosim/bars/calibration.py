"""By what differences of two meshes are multiplied to bound the error of the coarser one.

Two meshes may agree by chance: so some figures have a lower bound that follows from the differences of
others. How the factors were found: docs/run_error.md.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.soft.body.loads import Loads

FINGER_SIDES: Final = 4
FIGURES: Final = ("tip_m", "sag_m", "length_m", "volume_m3", "cable_tension_N", "peak_strain")
TICK_FACTOR: Final = 2.2
"""By which the error of the swings is multiplied: the frequencies have not always been those of the end."""
_OF_SHAPE: Final = 0.5
"""Share of the differences of tip and volume that sag, length and tensions are off by: theirs may vanish."""
_OF_TENSION: Final = 0.1
"""Of a tension that was found: it is off by at least that much."""


@final
@dataclass(frozen=True)
class Calibration:
    """How the difference of two meshes bounds the error of the coarser one; docs/run_error.md.

    Args:
        factors: by which differences are multiplied, one for each of `FIGURES`.
        of_volume: whether a difference of volumes bounds those of tip, sag and length.
    """

    factors: Mapping[str, float]
    of_volume: bool


GRADED: Final = Calibration(dict(zip(FIGURES, (2.5, 2.3, 2.4, 2.8, 1.5, 1.5), strict=True)), True)
DRAWN: Final = Calibration(dict(zip(FIGURES, (1.7, 1.7, 1.7, 1.5, 1.5, 1.9), strict=True)), False)
"""Of square units on the drawn mesh with refined holes, as fingers have: it lacks volume, not reach."""


def calibration_of(scenario: Scenario) -> Calibration:
    """Return the calibration that holds for the mesh of a scenario."""
    robot = scenario.soft_robot
    if not isinstance(robot, SoftRobotTable) or robot.stack is None or robot.attachments:
        return GRADED
    stack = robot.stack
    finger_mesh = stack.mesh == "drawn" and stack.refine_holes > 0 and not scenario.model.published
    return DRAWN if finger_mesh and stack.sides == FINGER_SIDES else GRADED


def apart(away: dict[str, float], here: dict[str, Any], calibration: Calibration) -> dict[str, float]:
    """Return how far figures are taken to be apart on two meshes.

    A coarse mesh holds too little gas, whichever way that moves the tip. Tip, sag and length are off by at
    least half of max(|tip|, length |dV| / V), or of |tip|.

    Args:
        away: how far they were found apart.
        here: on the run's mesh, its length [m] and volume [m^3].
        calibration: says which.
    """
    counts = calibration.of_volume and here["volume_m3"] > 0.0
    filled = here["length_m"] * away["volume_m3"] / here["volume_m3"] if counts else 0.0
    least = _OF_SHAPE * max(away["tip_m"], filled)
    return away | {key: max(away[key], least) for key in ("tip_m", "sag_m", "length_m")}


def tension_apart(most_N: float, away_N: float, of_tip_N: float) -> float:
    """Return how far the tensions for a target are taken to be apart on two meshes [N].

    Near the free height two meshes may agree by chance, though their tips do not. What each of three asks
    for is added as independent errors are: root of the sum of squares.

    Args:
        most_N: the largest, on the run's mesh.
        away_N: difference of what was found on both.
        of_tip_N: what makes good for the difference of the tips under equal tensions, slope times difference.
    """
    return math.hypot(away_N, _OF_SHAPE * of_tip_N, _OF_TENSION * most_N)


def tension_difference(one: Loads, other: Loads) -> float:
    """Return the largest difference of a cable's tension [N]."""
    return float(np.abs(np.subtract(one.cable_tension_N, other.cable_tension_N)).max())
