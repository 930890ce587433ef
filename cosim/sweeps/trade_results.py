"""The results of a trade: cost and errors of each candidate."""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.sweeps.candidates import Candidate

FORCE_WINDOW_S: Final = 0.04
"""Time over which the flange force is averaged: two of the longest ticks."""


@final
@dataclass(frozen=True)
class Measured:
    """A candidate's cost and errors; errors are NaN without a reference.

    Args:
        candidate: the candidate.
        real_time_factor: simulated time over CPU time of the whole command, without error bars.
        loop_factor: the same of its loop alone.
        iterations: Newton iterations a tick.
        tip_error_m: largest distance from the reference's tip over the run.
        tip_rms_m: its root mean square.
        end_error_m: largest distance at the ends of phases.
        object_error_m: largest distance of a movable object from its position in the reference.
        force_error_N: largest difference over the run of the flange force's mean over 40 ms.
        contact_error_N: root mean square difference of the sum of normal contact forces over the run.
        failure: reason why the run did not finish; empty if it did.
        reference: whether the other candidates were compared with it.
    """

    candidate: Candidate
    real_time_factor: float = np.nan
    loop_factor: float = np.nan
    iterations: float = np.nan
    tip_error_m: float = np.nan
    tip_rms_m: float = np.nan
    end_error_m: float = np.nan
    object_error_m: float = np.nan
    force_error_N: float = np.nan
    contact_error_N: float = np.nan
    failure: str = ""
    reference: bool = False

    @property
    def position_error_m(self) -> float:
        """Largest error of the tip and of movable objects."""
        return float(np.fmax(self.tip_error_m, self.object_error_m))

    @property
    def comparable(self) -> bool:
        """Whether it has finished and was compared with a reference."""
        return not self.failure and not self.reference and bool(np.isfinite(self.tip_error_m))
