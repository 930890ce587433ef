"""A pump at work on a chamber's gas through a run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

from cosim.devices.pump import Pump, PumpState
from cosim.soft.elements.gas import SealedGas


@final
@dataclass(frozen=True)
class PumpDriveState:
    """Where a pump is in a run.

    Args:
        setpoint_Pa: of the present phase; None: it does not work.
        pump: of the pump; None before it first works.
    """

    setpoint_Pa: float | None = None
    pump: PumpState | None = None


@final
class PumpDrive:
    """One pump.

    Args:
        name: of the pump.
        pump: what it can do.
        chamber: index of the chamber.
    """

    def __init__(self, name: str, pump: Pump, chamber: int) -> None:
        self.name, self.pump, self.chamber = name, pump, chamber
        self._state = PumpDriveState()

    @property
    def setpoint_Pa(self) -> float | None:
        """Setpoint; None while it does not work."""
        return self._state.setpoint_Pa

    @property
    def state(self) -> PumpState | None:
        """State of the pump itself; None before it first works."""
        return self._state.pump

    def begin(self, setpoint_Pa: float | None, pressure_Pa: float) -> None:
        """Begin a phase.

        Args:
            setpoint_Pa: None: it does not work.
            pressure_Pa: gauge, in the chamber at present.
        """
        pump = self._state.pump
        if pump is None:
            pump = self.pump.standing(pressure_Pa)
        elif self._state.setpoint_Pa is None:
            # the sensor has looked on all the time
            pump = replace(pump, sensor=self.pump.standing(pressure_Pa).sensor)
        if setpoint_Pa is None:
            pump = replace(pump, on=False, venting=False)
        self._state = PumpDriveState(setpoint_Pa, pump)

    def work(self, gas: SealedGas, volume_m3: float, step_s: float, commanded_Pa: float | None) -> SealedGas:
        """Return the gas after the pump has worked for a tick.

        Args:
            gas: before.
            volume_m3: of the chamber.
            step_s: length of the tick.
            commanded_Pa: setpoint by a controller, in place of the phase's.
        """
        setpoint, pump = self._state.setpoint_Pa, self._state.pump
        if commanded_Pa is not None:
            setpoint = commanded_Pa
        if setpoint is None or pump is None:
            return gas
        pump = self.pump.switched(pump, gas.gauge_pressure(volume_m3), setpoint)
        pump, gas = self.pump.worked(pump, gas, volume_m3, step_s)
        self._state = PumpDriveState(setpoint, pump)
        return gas

    def save_state(self) -> PumpDriveState:
        """Return what the next tick depends on."""
        return self._state

    def restore_state(self, state: PumpDriveState) -> None:
        """Return to a state of `save_state`."""
        self._state = state
