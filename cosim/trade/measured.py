"""What one way to run a scenario costs, and how far it is from the reference."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final, final

import numpy as np

from cosim.trade.candidate import Candidate

FORCE_WINDOW_S: Final = 0.04
"""Time over which the flange force is averaged: two of the longest ticks."""

FORCE_MEAN: Final = f"{1e3 * FORCE_WINDOW_S:g} ms mean"
"""What of the flange force is compared, in words."""


@final
@dataclass(frozen=True)
class Measured:
    """A candidate's cost and errors; errors are NaN where there is nothing to measure against.

    Args:
        candidate: which.
        real_time_factor: simulated time over CPU time of the loop.
        tip_error_m: largest distance from the reference's tip over the run.
        tip_rms_m: root mean square of it.
        end_error_m: largest at the ends of phases.
        force_error_N: largest difference over the run of the flange force's mean over 40 ms.
        contact_error_N: root mean square difference of the sum of normal contact forces over the run.
        iterations: Newton iterations a tick.
        object_error_m: largest distance of an object that can move from where it is in the reference.
        base_error_m: largest distance from the tip of the model as it is, over the run (statics: at the
            ends of phases); NaN where that is the reference.
        failure: why it did not finish; empty if it did.
        reference: whether the others of its group were measured against it.
    """

    candidate: Candidate
    real_time_factor: float = np.nan
    tip_error_m: float = np.nan
    tip_rms_m: float = np.nan
    end_error_m: float = np.nan
    force_error_N: float = np.nan
    contact_error_N: float = np.nan
    iterations: float = np.nan
    object_error_m: float = np.nan
    base_error_m: float = np.nan
    failure: str = ""
    reference: bool = False

    @classmethod
    def numbers(cls) -> tuple[str, ...]:
        """Return the names of its figures."""
        return tuple(entry.name for entry in fields(cls) if entry.type == "float")

    @property
    def position_error_m(self) -> float:
        """Largest error of the tip, and of what can move."""
        return float(np.fmax(self.tip_error_m, self.object_error_m))

    @property
    def comparable(self) -> bool:
        """Whether it has finished and was measured against another one."""
        return not self.failure and not self.reference and bool(np.isfinite(self.tip_error_m))
