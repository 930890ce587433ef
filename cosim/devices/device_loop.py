"""The loop of devices in a run. In each tick, from the state at its start, due controllers measure and
command, pumps act on the gas, and winches turn. A scenario without devices is unchanged by it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.devices import measurement, sensor
from cosim.devices.build_controllers import build_holds
from cosim.devices.cable_drive import CableDrive
from cosim.devices.command_checks import over
from cosim.devices.controller import AnyController, Measurement, RobotState
from cosim.devices.device_report import ActuationReport, ControlReport, PumpReport
from cosim.devices.drum import drums_of
from cosim.devices.measurement import CableFigures, measured_cables
from cosim.devices.modelled_devices import device_names
from cosim.devices.orders import LiveOrders, Order, orders_of
from cosim.devices.pump import DelayLine, Pump, PumpDrive, PumpState
from cosim.devices.zero_order_hold import Held
from cosim.errors import InputError
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.commands import SoftCommand
from cosim.plan.plan import PhasePlan
from cosim.soft.body.body import SoftBody


@final
@dataclass(frozen=True)
class ActuationState:
    """State of `Actuation` without drives, pumps and controllers.

    Args:
        started: names of the controllers that have been started in the present phase.
        held: whether it drives cables because of a live command only.
    """

    started: tuple[str, ...] = ()
    held: bool = False


@final
class Actuation:
    """Drives cables and pumps of a run.

    Args:
        scenario: checked.
        body: the soft body.
        controllers: of kind "python", by name.

    Raises:
        InputError: a controller is missing, or too many.
    """

    def __init__(
        self, scenario: Scenario, body: SoftBody, controllers: Mapping[str, AnyController] | None = None
    ) -> None:
        self._names, self._tick_s = scenario.soft_robot.cable_names(), scenario.clock.tick_s
        winches = {name: entry for entry in scenario.winches for name in entry.cables}
        tensions = scenario.start.cable_tension_N or (0.0,) * len(self._names)
        triples = zip(body.cables, self._names, tensions, strict=True)
        step_s = self._tick_s if scenario.mode == "dynamic" else np.inf
        self.cables = [
            CableDrive(cable, winches.get(name), tension, step_s) for cable, name, tension in triples
        ]
        self._creep = any(cable.damping_Ns_m for cable in body.cables)
        self._drums = drums_of(scenario.winches, dict(zip(self._names, self.cables, strict=True)))
        chambers = scenario.soft_robot.chamber_names()
        places = [chambers.index(entry.chamber or chambers[0]) for entry in scenario.pumps]
        self.pumps = [
            PumpDrive(Pump(entry, round(entry.sensor_delay_s / self._tick_s)), place)
            for entry, place in zip(scenario.pumps, places, strict=True)
        ]
        self._holds = build_holds(scenario, controllers or {})
        self._quantities = {
            entry.name: "" if entry.kind == "python" else entry.measures for entry in scenario.controllers
        }
        self.state = ActuationState()
        """State without drives, pumps and controllers."""
        self._planned: PhasePlan | None = None
        self._orders: list[Order | None] = []
        self._setpoints: dict[str, float | None] = {}
        self._modelled = device_names(scenario) is not None
        self._looks_through = {entry.name: entry.sensors for entry in scenario.controllers}
        self.sensors: sensor.Sensors | None = None
        """Sensors, whose readings controllers get; set by `PlannedCommands`."""
        self.live: LiveOrders | None = None
        """Live commands, in place of those of phases and controllers; set in every tick."""

    @property
    def active(self) -> bool:
        """Whether there are devices; if not, planned commands are unchanged."""
        return self._modelled or self.state.held

    def parts(self) -> dict[str, Any]:
        """Return the objects with a state, by name, see `CommandSource.parts`."""
        controllers = list(self._holds.values())
        return {"cables": self.cables, "pumps": self.pumps, "controllers": controllers, "devices": self}

    def hold(self, tension_N: Sequence[float]) -> None:
        """Start driving cables for a live command, at these tensions.

        Args:
            tension_N: present tension of each cable.
        """
        self.state = replace(self.state, held=True)
        for drive, tension in zip(self.cables, tension_N, strict=True):
            drive.state = drive.at_rest(tension)

    def begin_phase(self, planned: PhasePlan, soft: SoftRobot) -> None:
        """Begin a phase; commands do not change at this instant.

        Args:
            planned: the phase.
            soft: soft side in its present state.
        """
        if not self.active:
            return
        self._take_over(planned)
        for drive, order in zip(self.cables, self._orders, strict=True):
            drive.begin(order, soft.state.positions)
        pressures = soft.pressures_Pa
        for pump in self.pumps:
            given = (planned.phase.pump_pressure_Pa or {}).get(pump.name, pump.state.setpoint_Pa)
            sealed = planned.gas[pump.chamber].sealed
            pump.begin(given if sealed else None, pressures[pump.chamber])
        started = tuple(name for name in self.state.started if name in self._setpoints)
        self.state = replace(self.state, started=started)

    def act(
        self,
        planned: PhasePlan,
        gas: ChamberGas,
        soft: SoftRobot,
        see: Callable[[], RobotState],
        done: int,
        load_factor: float,
    ) -> tuple[float, ...] | None:
        """Update controllers, pumps and winches for one tick, from the state at its start.

        Returns:
            Twist of the flange that controllers command, see `Command`; None for none.

        Args:
            planned: the phase.
            gas: in the chambers; pumps change it.
            soft: soft side.
            see: returns the state of the rest of the robot.
            done: ticks of the phase at the end of the tick.
            load_factor: of the phase's ramp, 0 to 1, at the end of the tick.
        """
        if not self.active:
            return None
        self._take_over(planned)
        twist: tuple[float, ...] | None = None
        commanded: list[Order | None] = [None] * len(self.cables)
        given = planned.phase.pump_pressure_Pa or {}
        pressures = [given.get(pump.name) for pump in self.pumps]
        wanted = planned.tip_wanted(done, self._tick_s) if self._setpoints else None
        for name in self._setpoints:
            held = self._ask(name, partial(self._measure, gas, soft, see, name, wanted))
            for k, (tension, length) in enumerate(zip(held.tension_N, held.length_m, strict=True)):
                if tension is not None:
                    commanded[k] = Order("tension", tension)
                elif length is not None:
                    commanded[k] = Order("length", length)
            pressures = over(held.pump_pressure_Pa, pressures)
            twist = twist if held.flange_twist is None else held.flange_twist
        if self.live is not None:
            commanded = over(self.live.cables, commanded)
            pressures = over(self.live.pump_pressure_Pa, pressures)
        self._work_pumps(gas, soft, pressures)
        triples = zip(self.cables, self._orders, commanded, strict=True)
        for drive, order, command in triples:
            drive.move(order, load_factor, command, soft.state.positions)
        for drum in self._drums:
            drum.turn(soft.state.positions, self._tick_s)
        return twist

    def driven(self, planned: SoftCommand) -> SoftCommand:
        """Return a command with the tensions and lengths of the drives."""
        if not self.active:
            return planned
        tension = tuple(drive.given_tension_N for drive in self.cables)
        lengths = tuple(drive.step_length_m for drive in self.cables)
        stiffening = tuple(drive.spring[0] for drive in self.cables) if self._creep else ()
        return replace(planned, cable_tension_N=tension, cable_length_m=lengths, cable_stiffening=stiffening)

    def report(self, soft: SoftRobot, flange: Pose) -> ActuationReport | None:
        """Return the present values of devices; None without any.

        Args:
            soft: soft side in its present state.
            flange: world_from_flange.
        """
        if not self.active:
            return None
        x = soft.state.positions
        angle = measurement.bending_angle(soft.body.tip_direction(x), flange)
        height = float(soft.body.tip_position(x)[2])
        values = {"bending_angle_rad": angle, "tip_height_m": height}
        drives = self.cables
        return ActuationReport(
            cable_tension_N=np.array([drive.tension_N(x) for drive in drives]),
            cable_length_m=np.array([drive.cable.length(x) for drive in drives]),
            unstretched_m=np.array([d.state.length_m for d in drives], dtype=float),
            off_drum_m=np.array([drive.off_drum_m(x) for drive in drives]),
            lost_steps=np.array([drive.lost_steps for drive in drives], dtype=np.int64),
            bending_angle_rad=angle,
            pumps=tuple(_pump_report(drive) for drive in self.pumps),
            controls=tuple(
                ControlReport(name, setpoint, values.get(self._quantities[name]))
                for name, setpoint in self._setpoints.items()
            ),
        )

    def _take_over(self, planned: PhasePlan) -> None:
        """Read the commands of a phase, if it is not the last one that was read."""
        if planned is not self._planned:
            self._planned = planned
            self._orders = orders_of(planned.phase, planned.end.cable_tension_N, self._names)
            self._setpoints = planned.phase.acting()

    def _ask(self, name: str, see: Callable[[], Measurement]) -> Held:
        hold = self._holds[name]
        if name not in self.state.started:
            hold.start(see())
            self.state = replace(self.state, started=(*self.state.started, name))
        return hold.tick(see)

    def _work_pumps(self, gas: ChamberGas, soft: SoftRobot, setpoints: list[float | None]) -> None:
        volumes = soft.volumes_m3 if self.pumps else ()
        for pump, setpoint in zip(self.pumps, setpoints, strict=True):
            content = gas.content(pump.chamber)
            if content is None and setpoint is not None:
                raise InputError(
                    f"{setpoint:g} Pa are commanded of pump '{pump.name}', whose chamber is at a "
                    "given pressure; give gas = 'sealed' in that phase"
                )
            if content is not None:
                gas.set_gas(pump.chamber, pump.work(content, volumes[pump.chamber], self._tick_s, setpoint))

    def _measure(
        self, gas: ChamberGas, soft: SoftRobot, see: Callable[[], RobotState], name: str, wanted: Array | None
    ) -> Measurement:
        cables, setpoint = self.measured_cables(soft), self._setpoints[name]
        truth = replace(measurement.measured(soft, see(), gas, cables, setpoint=setpoint), tip_wanted=wanted)
        if not self.sensors:
            return truth
        through = self.sensors.through(truth, self._looks_through[name])
        return replace(through, sensors=self.sensors.readings)

    def measured_cables(self, soft: SoftRobot, tension_N: Sequence[float] | None = None) -> CableFigures:
        """Return the fields of a measurement with values by cable.

        Args:
            soft: soft side in its present state.
            tension_N: of each cable, for cables without active drives.
        """
        given = None if self.active else tension_N
        return measured_cables(self._names, self.cables, soft.state.positions, given)


def _pump_report(drive: PumpDrive) -> PumpReport:
    setpoint_Pa, pump = drive.state.setpoint_Pa, drive.state.pump or PumpState(DelayLine())
    return PumpReport(setpoint_Pa, pump.on, pump.venting, pump.starts, pump.on_s, pump.delivered_kg)
