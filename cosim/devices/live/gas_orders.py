"""Checks live commands to chambers and pumps: a chamber takes a pressure, or an amount of gas while it is
sealed; with an active pump, its setpoint. A phase that seals or opens a chamber ends the commands to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import final

from cosim.config.gas_rules import gas_rules
from cosim.config.schema.scenario import Scenario
from cosim.devices.live.live_values import WHO, LiveValues
from cosim.devices.pump import PumpDrive
from cosim.errors import InputError
from cosim.plan.chamber_gas import ChamberGas


@final
@dataclass(frozen=True)
class GasOrders:
    """Chambers of a scenario with the phases that seal or open them, for the checks of live commands.

    Args:
        before: ticks of the run before each phase, and before its end.
        phases: names.
        sealed: whether a phase seals a chamber, by phase and chamber.
        chambers: names.
        pumped: index of the chamber of each pump.
        pumps: names.
    """

    before: tuple[int, ...]
    phases: tuple[str, ...]
    sealed: tuple[tuple[bool, ...], ...]
    chambers: tuple[str, ...]
    pumped: tuple[int, ...]
    pumps: tuple[str, ...]

    @classmethod
    def of(cls, scenario: Scenario) -> GasOrders:
        """Return the chambers and phases of a checked scenario."""
        chambers, phases = scenario.soft_robot.chamber_names(), scenario.phases
        counts = [scenario.ticks(phase) for phase in phases]
        return cls(
            (0, *accumulate(counts)),
            tuple(phase.name for phase in phases),
            tuple(tuple(rule.sealed for rule in rules) for rules in gas_rules(scenario)),
            chambers,
            tuple(chambers.index(pump.chamber or chambers[0]) for pump in scenario.pumps),
            tuple(pump.name for pump in scenario.pumps),
        )

    def check(self, new: LiveValues, gas: ChamberGas, pumps: Sequence[PumpDrive]) -> None:
        """Check that commands to chambers fit their present gas.

        Args:
            new: commanded values.
            gas: in the chambers.
            pumps: in order.

        Raises:
            InputError: a pressure of a sealed chamber is commanded, or the gas of an open or pumped one.
        """
        for k, name in enumerate(self.chambers):
            content, wanted_kg = gas.content(k), new.gas_kg[k]
            if content is not None and new.pressure_Pa[k] is not None:
                raise InputError(f"{WHO}: pressure_Pa of '{name}', in which gas is sealed; command gas_kg")
            if content is None and wanted_kg is not None:
                raise InputError(f"{WHO}: gas_kg of '{name}', whose pressure is given; command pressure_Pa")
            if content is not None and math.isinf(content.pressure_Pa * (wanted_kg or 0.0) / content.mass_kg):
                raise InputError(
                    f"{WHO}: gas_kg of '{name}' is {wanted_kg:g}: its pressure is beyond all numbers; the "
                    f"chamber holds {content.mass_kg:.3g} kg now"
                )
        for pump, setpoint in zip(pumps, new.pump_pressure_Pa, strict=True):
            works = pump.state.setpoint_Pa is not None or setpoint is not None
            if works and new.gas_kg[pump.chamber] is not None:
                raise InputError(
                    f"{WHO}: gas_kg of '{self.chambers[pump.chamber]}', which pump '{pump.name}' fills; "
                    "command pump_pressure_Pa"
                )

    def check_reached(self, new: LiveValues, phase: int, first: int, ticks: int) -> None:
        """Check that no phase ends a command before its values are reached.

        Args:
            new: commanded values.
            phase: index of the phase of the first tick.
            first: ticks of the run before it.
            ticks: within which the values are reached.

        Raises:
            InputError: one does.
        """
        for later in range(phase + 1, len(self.phases)):
            after = self.before[later] - first
            if after >= ticks:
                return
            _, ended = self.left(new, later)
            if ended:
                raise InputError(
                    f"{WHO}: {ended[0]}; it begins after {after} of these {ticks} ticks: end the step there"
                )

    def left(self, values: LiveValues, phase: int) -> tuple[LiveValues, tuple[str, ...]]:
        """Return the values that remain commanded when a phase begins, and text on those that it ends.

        Args:
            values: commanded values.
            phase: index of the phase.
        """
        words: list[str] = []
        sealed, name = self.sealed[phase], self.phases[phase]
        pressure, gas, setpoint = map(list, (values.pressure_Pa, values.gas_kg, values.pump_pressure_Pa))
        for k, chamber in enumerate(self.chambers):
            if sealed[k] and pressure[k] is not None:
                words.append(f"pressure_Pa of '{chamber}': phase '{name}' seals its gas; command gas_kg")
                pressure[k] = None
            if not sealed[k] and gas[k] is not None:
                words.append(f"gas_kg of '{chamber}': phase '{name}' gives its pressure; command pressure_Pa")
                gas[k] = None
        for k, (pump, chamber_index) in enumerate(zip(self.pumps, self.pumped, strict=True)):
            if not sealed[chamber_index] and setpoint[k] is not None:
                chamber = self.chambers[chamber_index]
                words.append(
                    f"pump_pressure_Pa of '{pump}': phase '{name}' gives the pressure of '{chamber}'; "
                    "command pressure_Pa"
                )
                setpoint[k] = None
        if not words:
            return values, ()
        given = {"pressure_Pa": pressure, "gas_kg": gas, "pump_pressure_Pa": setpoint}
        return replace(values, **{key: tuple(column) for key, column in given.items()}), tuple(words)

    def pumped_by(self, new: LiveValues, values: LiveValues) -> LiveValues:
        """Return values without the amounts of gas of chambers whose pumps are commanded now."""
        taken = {
            k for k, setpoint in zip(self.pumped, new.pump_pressure_Pa, strict=True) if setpoint is not None
        }
        if not taken:
            return values
        kept = [None if k in taken else amount for k, amount in enumerate(values.gas_kg)]
        return replace(values, gas_kg=tuple(kept))
