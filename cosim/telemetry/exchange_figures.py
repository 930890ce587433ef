"""What the ledger says about the exchange over a whole run; `docs/summary.md` documents the keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from cosim.base.frames import Array
from cosim.telemetry.tick_batch import TickBatch


@final
@dataclass(frozen=True)
class ExchangeFigures:
    """Figures of the ticks so far.

    Args:
        iterated_ticks: ticks that were repeated until the loads agreed.
        trials: how often these were taken, together.
        most_trials: the same, of one tick.
        residual: largest relative difference of the loads in them.
        power_error: largest relative one, of any tick.
        momentum_error: the same.
    """

    iterated_ticks: int = 0
    trials: int = 0
    most_trials: int = 0
    residual: float = 0.0
    power_error: float = 0.0
    momentum_error: float = 0.0

    def after(self, batch: TickBatch) -> ExchangeFigures:
        """Return the figures with some ticks more."""
        trials = batch.iterated_trials
        return ExchangeFigures(
            self.iterated_ticks + int(np.count_nonzero(trials)),
            self.trials + int(trials.sum()),
            max(self.most_trials, int(trials.max())),
            largest(self.residual, batch.interface_residual),
            largest(self.power_error, batch.power_error),
            largest(self.momentum_error, batch.momentum_error),
        )

    def summary(self) -> dict[str, Any]:
        """Return them by their keys in the summary."""
        return {
            "iterated_ticks": self.iterated_ticks,
            "interface_trials": self.trials,
            "max_interface_trials": self.most_trials,
            "max_interface_residual": self.residual,
            "max_interface_power_error": self.power_error,
            "max_momentum_error": self.momentum_error,
        }


def largest(before: float, values: Array) -> float:
    """Return the largest of a number and values (k,); what is not a number does not count."""
    return float(np.fmax.reduce(values, initial=before))
