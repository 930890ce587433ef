"""Factors on differences of two meshes that bound the error of the coarser one. Two meshes may agree by
chance, so some figures have a lower bound by the differences of others. docs/run_error.md describes the
calibration.
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
"""Factor on the error of oscillations, whose frequencies differ from those at the end of a phase."""
_OF_SHAPE: Final = 0.5
"""Least error of sag, length and tensions over the differences of tip and volume; their own may vanish."""
_OF_TENSION: Final = 0.1
"""Least relative error of a tension."""


@final
@dataclass(frozen=True)
class Calibration:
    """Factors from the difference of two meshes to the error of the coarser one; see docs/run_error.md.

    Args:
        factors: one for each of `FIGURES`.
        of_volume: whether a difference of volumes bounds those of tip, sag and length.
    """

    factors: Mapping[str, float]
    of_volume: bool


GRADED: Final = Calibration(dict(zip(FIGURES, (2.5, 2.3, 2.4, 2.8, 1.5, 1.5), strict=True)), True)
DRAWN: Final = Calibration(dict(zip(FIGURES, (1.7, 1.7, 1.7, 1.5, 1.5, 1.9), strict=True)), False)
"""For square units on the drawn mesh with refined holes, as of fingers: it lacks volume, not reach."""


def calibration_of(scenario: Scenario) -> Calibration:
    """Return the calibration for the mesh of a scenario."""
    robot = scenario.soft_robot
    if not isinstance(robot, SoftRobotTable) or robot.stack is None or robot.attachments:
        return GRADED
    stack = robot.stack
    finger_mesh = stack.mesh == "drawn" and stack.refine_holes > 0 and not scenario.model.published
    return DRAWN if finger_mesh and stack.sides == FINGER_SIDES else GRADED


def bounded(
    difference: dict[str, float], figures: dict[str, Any], calibration: Calibration
) -> dict[str, float]:
    """Return differences of two meshes, not below their lower bounds.

    A coarse mesh has too little volume, which may move the tip in any direction. Tip, sag and length differ
    by at least half of max(|tip|, length |dV| / V), or of |tip|.

    Args:
        difference: of each figure.
        figures: on the run's mesh, with length [m] and volume [m^3].
        calibration: of the mesh.
    """
    of_volume = calibration.of_volume and figures["volume_m3"] > 0.0
    filled = figures["length_m"] * difference["volume_m3"] / figures["volume_m3"] if of_volume else 0.0
    least = _OF_SHAPE * max(difference["tip_m"], filled)
    return difference | {key: max(difference[key], least) for key in ("tip_m", "sag_m", "length_m")}


def bounded_tension(most_N: float, difference_N: float, of_tip_N: float) -> float:
    """Return the difference of the tensions for a target on two meshes, with lower bounds [N].

    Near the free height two meshes may agree by chance, though their tips do not. The difference and both
    bounds are added as independent errors: root of the sum of squares.

    Args:
        most_N: largest tension on the run's mesh.
        difference_N: of the tensions on both meshes.
        of_tip_N: tension that moves the tip by its difference under equal tensions: slope times difference.
    """
    return math.hypot(difference_N, _OF_SHAPE * of_tip_N, _OF_TENSION * most_N)


def tension_difference(one: Loads, other: Loads) -> float:
    """Return the largest difference of a cable's tension [N]."""
    return float(np.abs(np.subtract(one.cable_tension_N, other.cable_tension_N)).max())
