"""What `Simulation.step` has commanded so far of gas, cables and pumps, and how that goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, TypeAlias, final

from cosim.config.schema.scenario import Scenario
from cosim.devices.cable_drive import Order
from cosim.devices.cable_orders import LiveOrders
from cosim.devices.command_values import check_one_order_each, named_values
from cosim.devices.controller import Command

_Values: TypeAlias = tuple[float | None, ...]


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
        check_one_order_each(command, who)
        return cls(
            named_values(command.pressure_Pa, chambers, who, "pressure_Pa", -scenario.gas.ambient_Pa),
            named_values(command.gas_kg, chambers, who, "gas_kg", 0.0),
            named_values(command.cable_tension_N, cables, who, "cable_tension_N", 0.0),
            named_values(command.cable_length_m, cables, who, "cable_length_m", 0.0),
            named_values(command.pump_pressure_Pa, pumps, who, "pump_pressure_Pa"),
        )

    @property
    def drives_cables(self) -> bool:
        """Whether a length is commanded."""
        return any(value is not None for value in self.cable_length_m)

    def followed_by(self, new: LiveValues) -> LiveValues:
        """Return what is commanded once something new is; of a cable, length or tension."""
        found = {
            entry.name: _first(getattr(new, entry.name), getattr(self, entry.name)) for entry in fields(self)
        }
        for key, other in (("cable_tension_N", "cable_length_m"), ("cable_length_m", "cable_tension_N")):
            found[key] = tuple(
                None if instead is not None else value
                for value, instead in zip(found[key], getattr(new, other), strict=True)
            )
        return LiveValues(**found)

    def beginning(self, end: LiveValues, present: LiveValues) -> LiveValues:
        """Return where these values go on from to those of `end`: what is there, if not commanded yet."""
        return LiveValues(**{
            entry.name: tuple(
                None if to is None else there if now is None else now
                for now, to, there in zip(*_columns(entry.name, self, end, present), strict=True)
            )
            for entry in fields(self)
        })  # fmt: skip

    def reaches(self, end: LiveValues) -> bool:
        """Return whether these values name all that others do, but for the setpoints of pumps."""
        keys = (entry.name for entry in fields(self) if entry.name != "pump_pressure_Pa")
        pairs = (zip(*_columns(key, self, end), strict=True) for key in keys)
        return all(to is None or here is not None for pair in pairs for here, to in pair)

    def between(self, end: LiveValues, share: float) -> LiveValues:
        """Return the values at a share of the way, 0 to 1; setpoints of pumps are at the end at once."""
        if share >= 1.0:
            return end
        found = {
            entry.name: tuple(
                b if a is None or b is None else (1.0 - share) * a + share * b
                for a, b in zip(getattr(self, entry.name), getattr(end, entry.name), strict=True)
            )
            for entry in fields(self)
        }
        return LiveValues(**found | {"pump_pressure_Pa": end.pump_pressure_Pa})

    def orders(self, wound: Sequence[bool], end: LiveValues) -> LiveOrders:
        """Return what devices are asked for; a winch gets the length of the end at once."""
        rows = zip(self.cable_tension_N, self.cable_length_m, wound, end.cable_length_m, strict=True)
        return LiveOrders(tuple(_order(*row) for row in rows), self.pump_pressure_Pa)


def _columns(key: str, *values: LiveValues) -> list[_Values]:
    return [getattr(one, key) for one in values]


def _order(tension: float | None, length: float | None, wound: bool, wanted: float | None) -> Order | None:
    if tension is not None:
        return "tension", tension
    length = wanted if wound else length
    return None if length is None else ("length", length)


def _first(values: _Values, others: _Values) -> _Values:
    return tuple(other if value is None else value for value, other in zip(values, others, strict=True))
