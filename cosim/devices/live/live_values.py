"""Values of gas, cables and pumps that live commands set, and their transitions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Final, TypeAlias, final

from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import check_command, check_one_order_each, named_values, over
from cosim.devices.controller import Command
from cosim.devices.orders import LiveOrders, Order

_Values: TypeAlias = tuple[float | None, ...]
WHO: Final = "step"
"""Source of live commands, in messages."""


@final
@dataclass(frozen=True)
class LiveValues:
    """Values of everything that can be commanded by name; None: as planned.

    Args:
        pressure_Pa: gauge, of each chamber.
        gas_kg: of each chamber.
        cable_tension_N: of each cable.
        cable_length_m: unstretched, of each cable.
        pump_pressure_Pa: setpoint of each pump.
    """

    pressure_Pa: Annotated[_Values, ("chambers",)]
    gas_kg: Annotated[_Values, ("chambers",)]
    cable_tension_N: Annotated[_Values, ("cables",)]
    cable_length_m: Annotated[_Values, ("cables",)]
    pump_pressure_Pa: Annotated[_Values, ("pumps",)]

    @classmethod
    def of(cls, command: Command, scenario: Scenario, who: str) -> LiveValues:
        """Return the values of a command.

        Args:
            command: the command.
            scenario: checked.
            who: source of the command, for messages.

        Raises:
            InputError: it names a device that does not exist, or a value that is not allowed.
            InstabilityError: a value is not finite.
        """
        robot, pumps = scenario.soft_robot, tuple(pump.name for pump in scenario.pumps)
        chambers, cables = robot.chamber_names(), robot.cable_names()
        check_command(command, who)
        values = cls(
            named_values(command.pressure_Pa, chambers, who, "pressure_Pa", lowest=-scenario.gas.ambient_Pa),
            named_values(command.gas_kg, chambers, who, "gas_kg", lowest=0.0),
            named_values(command.cable_tension_N, cables, who, "cable_tension_N", lowest=0.0),
            named_values(command.cable_length_m, cables, who, "cable_length_m", above=0.0),
            named_values(command.pump_pressure_Pa, pumps, who, "pump_pressure_Pa"),
        )
        check_one_order_each(values.cable_tension_N, values.cable_length_m, cables, who)
        return values

    @property
    def drives_cables(self) -> bool:
        """Whether a length is commanded."""
        return any(value is not None for value in self.cable_length_m)

    def followed_by(self, new: LiveValues) -> LiveValues:
        """Return the values after a new command, which overrides them; a cable has a length or a tension."""
        pressure, gas, tension, length, pump = map(tuple, map(over, new._columns, self._columns))
        tension, length = _unless(new.cable_length_m, tension), _unless(new.cable_tension_N, length)
        return LiveValues(pressure, gas, tension, length, pump)

    def beginning(self, end: LiveValues, present: LiveValues) -> LiveValues:
        """Return the start values of a motion to `end`: these values, or present ones if not commanded."""
        triples = zip(self._columns, end._columns, present._columns, strict=True)
        return LiveValues(*[
            tuple([
                None if to is None else there if now is None else now
                for now, to, there in zip(*columns, strict=True)
            ])
            for columns in triples
        ])  # fmt: skip

    def reaches(self, end: LiveValues) -> bool:
        """Return whether these values include all that `end` has, setpoints of pumps excepted."""
        pairs = zip(chain(*self._columns[:-1]), chain(*end._columns[:-1]), strict=True)
        return all(to is None or here is not None for here, to in pairs)

    def between(self, end: LiveValues, fraction: float) -> LiveValues:
        """Return the values at a fraction, 0 to 1, of the way to `end`; pumps get its setpoints at once."""
        if fraction >= 1.0:
            return end
        rest, columns = 1.0 - fraction, list(end._columns)
        for k, (begin, to) in enumerate(zip(self._columns[:-1], end._columns, strict=False)):
            pairs = zip(begin, to, strict=True)
            columns[k] = tuple([b if a is None or b is None else rest * a + fraction * b for a, b in pairs])
        return LiveValues(*columns)

    @property
    def _columns(self) -> tuple[_Values, ...]:
        """All values, column by column; setpoints of pumps come last."""
        return (
            self.pressure_Pa, self.gas_kg, self.cable_tension_N, self.cable_length_m, self.pump_pressure_Pa,
        )  # fmt: skip

    def orders(self, wound: Sequence[bool], end: LiveValues) -> LiveOrders:
        """Return the commands to devices; a winch gets the final length at once."""
        rows = zip(self.cable_tension_N, self.cable_length_m, wound, end.cable_length_m, strict=True)
        return LiveOrders(tuple(_order(*row) for row in rows), self.pump_pressure_Pa)


def _order(tension: float | None, length: float | None, wound: bool, wanted: float | None) -> Order | None:
    if tension is not None:
        return Order("tension", tension)
    length = wanted if wound else length
    return None if length is None else Order("length", length)


def _unless(instead: _Values, values: _Values) -> _Values:
    return tuple([value if other is None else None for value, other in zip(values, instead, strict=True)])
