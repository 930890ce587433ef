"""Names of the devices and sensors of a run, and their values at the end of a tick."""

from dataclasses import dataclass
from typing import Annotated, final

from cosim.base.frames import Array, IntArray, Shown


@final
@dataclass(frozen=True)
class DeviceNames:
    """Names of a scenario's devices, for plots and results.

    Args:
        pumps: names.
        controllers: name and measured quantity; "" for a controller in Python.
        lengths: whether cable lengths are commanded in any phase.
        winches: whether there are winches.
    """

    pumps: tuple[str, ...]
    controllers: tuple[tuple[str, str], ...]
    lengths: bool
    winches: bool


@final
@dataclass(frozen=True)
class SensorNames:
    """A sensor, for plots and results.

    Args:
        name: of the sensor.
        unit: of its readings; "1" without one.
        values: names of its values; one empty name for a single number.
    """

    name: str
    unit: str
    values: tuple[str, ...]


@final
@dataclass(frozen=True)
class PumpReport:
    """A pump at the end of a tick.

    Args:
        setpoint_Pa: None while the pump is inactive.
        on: whether it runs.
        venting: whether its valve is open.
        starts: so far.
        on_s: time for which it ran so far.
        delivered_kg: so far.
    """

    setpoint_Pa: float | None
    on: bool
    venting: bool
    starts: int
    on_s: float
    delivered_kg: float


@final
@dataclass(frozen=True)
class ControlReport:
    """An active controller.

    Args:
        name: of the controller.
        setpoint: of the phase; None: no setpoint.
        measured: value of the controlled quantity; None for a controller in Python.
    """

    name: str
    setpoint: float | None
    measured: float | None


@final
@dataclass(frozen=True)
class ActuationReport(Shown):
    """Devices at the end of a tick.

    Args:
        cable_tension_N: (cables,) at the base end.
        cable_length_m: (cables,) of the routes.
        unstretched_m: (cables,) of the cable off the drum; not a number while the tension is commanded.
        off_drum_m: (cables,) the same; while the tension is commanded, the length that gives this tension.
        lost_steps: (cables,) of the winches.
        bending_angle_rad: between the tip's direction and the flange's z axis.
        pumps: in the order of the scenario.
        controls: the active controllers.
    """

    cable_tension_N: Annotated[Array, ("cables",)]
    cable_length_m: Annotated[Array, ("cables",)]
    unstretched_m: Annotated[Array, ("cables",)]
    off_drum_m: Annotated[Array, ("cables",)]
    lost_steps: Annotated[IntArray, ("cables",)]
    bending_angle_rad: float
    pumps: tuple[PumpReport, ...] = ()
    controls: tuple[ControlReport, ...] = ()
