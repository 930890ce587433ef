"""When a search for a tip target may stop, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.soft.solve.state import Equilibrium


@final
@dataclass(frozen=True)
class TargetOptions:
    """Bounds of the search.

    Args:
        position_tolerance_m: accepted distance of the tip.
        angle_tolerance_rad: accepted angle of the tip.
        iterations_max: sensitivities before giving up.
        lever_m: length that weighs a flange rotation against a translation (the smaller motion is chosen).
        tension_max_N: largest cable tension allowed.
    """

    position_tolerance_m: float = 1e-5
    angle_tolerance_rad: float = 1e-4
    iterations_max: int = 20
    lever_m: float = 0.5
    tension_max_N: float = 100.0

    def met(self, found: TargetSolution) -> bool:
        """Return whether a tip is on its target."""
        return (
            found.position_error_m <= self.position_tolerance_m
            and found.angle_error_rad <= self.angle_tolerance_rad
        )


@final
@dataclass(frozen=True)
class TargetSolution:
    """A flange pose and loads whose equilibrium has the tip on target.

    Args:
        equilibrium: with its flange pose and loads.
        position_error_m: distance of the tip from the target.
        angle_error_rad: angle of the tip from the target.
        iterations: sensitivities computed.
    """

    equilibrium: Equilibrium
    position_error_m: float
    angle_error_rad: float
    iterations: int

    def off(self) -> str:
        """Return how far off the tip is, for a message."""
        angle = f" and {np.degrees(self.angle_error_rad):.2f} degrees" if self.angle_error_rad else ""
        return f"{1e3 * self.position_error_m:.2f} mm{angle}"
