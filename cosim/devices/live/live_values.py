"""What `Simulation.step` has commanded so far of gas, cables and pumps, and how that goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Final, TypeAlias, final

from cosim.config.schema.scenario import Scenario
from cosim.devices.cable_drive import Order
from cosim.devices.cable_orders import LiveOrders
from cosim.devices.command_values import check_command, check_one_order_each, named_values
from cosim.devices.controller import Command

_Values: TypeAlias = tuple[float | None, ...]
WHO: Final = "step"
"""Commands, in messages."""


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
        """Return what a command names.

        Args:
            command: any.
            scenario: checked.
            who: commands, for messages.

        Raises:
            InputError: it names what there is not, or a value that is not allowed.
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
        """Return what is commanded once something new is; of a cable, length or tension."""
        pressure, gas, tension, length, pump = map(_first, new._columns, self._columns)
        tension, length = _unless(new.cable_length_m, tension), _unless(new.cable_tension_N, length)
        return LiveValues(pressure, gas, tension, length, pump)

    def beginning(self, end: LiveValues, present: LiveValues) -> LiveValues:
        """Return where these values go on from to those of `end`: what is there, if not commanded yet."""
        triples = zip(self._columns, end._columns, present._columns, strict=True)
        return LiveValues(*[
            tuple([
                None if to is None else there if now is None else now
                for now, to, there in zip(*columns, strict=True)
            ])
            for columns in triples
        ])  # fmt: skip

    def reaches(self, end: LiveValues) -> bool:
        """Return whether these values name all that others do, but for the setpoints of pumps."""
        pairs = zip(chain(*self._columns[:-1]), chain(*end._columns[:-1]), strict=True)
        return all(to is None or here is not None for here, to in pairs)

    def between(self, end: LiveValues, share: float) -> LiveValues:
        """Return the values at a share of the way, 0 to 1; setpoints of pumps are at the end at once."""
        if share >= 1.0:
            return end
        rest, found = 1.0 - share, list(end._columns)
        for k, (here, there) in enumerate(zip(self._columns[:-1], end._columns, strict=False)):
            pairs = zip(here, there, strict=True)
            found[k] = tuple([b if a is None or b is None else rest * a + share * b for a, b in pairs])
        return LiveValues(*found)

    @property
    def _columns(self) -> tuple[_Values, ...]:
        """All values, by what they are of; setpoints of pumps come last."""
        return (
            self.pressure_Pa, self.gas_kg, self.cable_tension_N, self.cable_length_m, self.pump_pressure_Pa,
        )  # fmt: skip

    def orders(self, wound: Sequence[bool], end: LiveValues) -> LiveOrders:
        """Return what devices are asked for; a winch gets the length of the end at once."""
        rows = zip(self.cable_tension_N, self.cable_length_m, wound, end.cable_length_m, strict=True)
        return LiveOrders(tuple(_order(*row) for row in rows), self.pump_pressure_Pa)


def _order(tension: float | None, length: float | None, wound: bool, wanted: float | None) -> Order | None:
    if tension is not None:
        return "tension", tension
    length = wanted if wound else length
    return None if length is None else ("length", length)


def _first(values: _Values, others: _Values) -> _Values:
    return tuple([other if value is None else value for value, other in zip(values, others, strict=True)])


def _unless(instead: _Values, values: _Values) -> _Values:
    return tuple([value if other is None else None for value, other in zip(values, instead, strict=True)])
