"""The gas in the chamber through a run: at a given pressure, or a sealed amount that may leak."""

from __future__ import annotations

from dataclasses import replace
from typing import final

from cosim.coupling.soft_side import SoftSide
from cosim.scenario.gas_rules import GasRule
from cosim.scenario.solver_schema import Gas
from cosim.soft.body import Loads
from cosim.soft.gas import SealedGas, leak


@final
class ChamberGas:
    """Knows what is in the chamber at present, and puts it into the planned loads.

    Args:
        settings: of the gas where it is sealed.
    """

    def __init__(self, settings: Gas) -> None:
        self._settings = settings
        self._leak_kg_s_Pa = 0.0
        self._sealed: SealedGas | None = None
        self._pressure_Pa = 0.0

    def begin(self, rule: GasRule, soft: SoftSide) -> None:
        """Begin a phase: seal what is in the chamber, or open it; nothing changes at this instant.

        Raises:
            InputError: there is nothing to seal, as the chamber has no volume.
        """
        self._pressure_Pa, self._leak_kg_s_Pa = soft.pressure_Pa, rule.leak_kg_s_Pa
        if not rule.sealed:
            self._sealed = None
        elif self._sealed is None:
            settings = self._settings
            self._sealed = SealedGas(
                settings.ambient_Pa + self._pressure_Pa, soft.volume_m3, settings.exponent,
                settings.ambient_Pa, settings.temperature_K,
            )  # fmt: skip

    def filled(self, loads: Loads) -> Loads:
        """Return loads with what is in the chamber in place of the pressure."""
        return replace(loads, pressure_Pa=self._pressure_Pa, gas=self._sealed)

    def between(self, begin: Loads, end: Loads, share: float) -> Loads:
        """Return the loads at a share of a phase: only a given pressure changes as planned.

        Args:
            begin: planned, at the start of the phase.
            end: planned, at its end.
            share: 0 to 1.
        """
        if self._sealed is None:
            return self.filled(begin).interpolated(end, share)
        return self.filled(begin.interpolated(end, share))

    def pass_time(self, soft: SoftSide, step_s: float) -> None:
        """Let a sealed gas leak for a while, at the present volume."""
        if self._sealed is None:
            return
        self._pressure_Pa = soft.pressure_Pa
        if self._leak_kg_s_Pa:
            self._sealed = leak(self._sealed, soft.volume_m3, self._leak_kg_s_Pa, step_s)
