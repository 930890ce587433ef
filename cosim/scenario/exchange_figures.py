"""What the ledger says about the exchange over a whole run; `docs/summary.md` documents the keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from cosim.coupling.ledger import LedgerEntry


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

    def after(self, ledgers: Sequence[LedgerEntry]) -> ExchangeFigures:
        """Return the figures with some ticks more."""
        trials = [entry.trials for entry in ledgers if entry.scheme == "iterated" and entry.trials > 0]
        return ExchangeFigures(
            self.iterated_ticks + len(trials),
            self.trials + sum(trials),
            max([self.most_trials, *trials]),
            max([self.residual, *[entry.interface_residual for entry in ledgers]]),
            max([self.power_error, *[entry.power_error for entry in ledgers]]),
            max([self.momentum_error, *[entry.momentum_error for entry in ledgers]]),
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
