"""Calls a controller at its rate, checks its commands, and holds them between two samples."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, final

from cosim.devices.command_checks import check_command, check_one_order_each, named_values, numbers
from cosim.devices.controller import AnyController, Command, Measurement
from cosim.errors import InputError

_OF_STEPS: Final = ("pressure_Pa", "gas_kg", "flange", "joint_position", "joint_velocity")


@final
@dataclass(frozen=True)
class Held:
    """A command in the order of cables and pumps; None: as planned.

    Args:
        tension_N: of each cable.
        length_m: unstretched, of each cable.
        pump_pressure_Pa: setpoint of each pump.
        flange_twist: (6,) [m/s, rad/s], see `Command`.
    """

    tension_N: tuple[float | None, ...]
    length_m: tuple[float | None, ...]
    pump_pressure_Pa: tuple[float | None, ...]
    flange_twist: tuple[float, ...] | None = None


@final
@dataclass(frozen=True)
class HoldState:
    """State of a `ZeroOrderHold`.

    Args:
        controller: state of the controller; None before its first phase.
        held: its last command, or None.
        wait_ticks: ticks until it is called again.
    """

    controller: Any = None
    held: Held | None = None
    wait_ticks: int = 0


@final
class ZeroOrderHold:
    """One controller at its rate.

    Args:
        name: of the controller, for messages.
        controller: that is called.
        period_ticks: between two calls, at least 1.
        cables: names of all cables, in order.
        pumps: names of all pumps, in order.
    """

    def __init__(
        self,
        name: str,
        controller: AnyController,
        period_ticks: int,
        cables: tuple[str, ...],
        pumps: tuple[str, ...] = (),
    ) -> None:
        self.name, self.controller, self.period_ticks = name, controller, period_ticks
        self._cables, self._pumps = cables, pumps
        self.state = HoldState()
        """State, on which the next tick depends."""

    def start(self, seen: Measurement) -> None:
        """Restart the controller; the next tick calls it."""
        self.state = HoldState(self.controller.start(seen))

    def tick(self, see: Callable[[], Measurement]) -> Held:
        """Return the command of the next tick.

        Args:
            see: returns the measurement; called only if the controller is called.

        Raises:
            InputError: the command names a device that does not exist, or a value that is not allowed.
            InstabilityError: the command has a number that is not finite.
        """
        state = self.state
        if state.wait_ticks > 0 and state.held is not None:
            self.state = HoldState(state.controller, state.held, state.wait_ticks - 1)
            return state.held
        after, command = self.controller.act(state.controller, see())
        held = self._ordered(command)
        self.state = HoldState(after, held, self.period_ticks - 1)
        return held

    def _ordered(self, command: Command) -> Held:
        who = f"controller '{self.name}'"
        check_command(command, who)
        for key in _OF_STEPS:
            given = getattr(command, key)
            if given is not None and not (isinstance(given, Mapping) and not given):
                raise InputError(f"{who} commands {key}, which only `Simulation.step` takes")
        held = Held(
            named_values(command.cable_tension_N, self._cables, who, "cable_tension_N", lowest=0.0),
            named_values(command.cable_length_m, self._cables, who, "cable_length_m", above=0.0),
            named_values(command.pump_pressure_Pa, self._pumps, who, "pump_pressure_Pa"),
            numbers(command.flange_twist, 6, who, "flange_twist"),
        )
        check_one_order_each(held.tension_N, held.length_m, self._cables, who)
        return held
