"""What moves cables and gas through a run, besides the ramps of the phases: controllers, winches, pumps.

Per tick, at the state before it: controllers that are due see the run and command; pumps work on the gas;
winches turn. A scenario without any of these passes through untouched.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import final

import numpy as np

from cosim.base.frames import Pose
from cosim.config.rules.device_rules import acting
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.devices.cable_drive import CableDrive, CableDriveState, Order
from cosim.devices.cable_orders import LiveOrders, orders_of
from cosim.devices.command_source import RobotState
from cosim.devices.controller import AnyController, Measurement
from cosim.devices.device_build import build_holds, build_pump, build_winch
from cosim.devices.device_names import device_names
from cosim.devices.device_report import ActuationReport, ControlReport, PumpReport
from cosim.devices.measuring import bending_angle, measured, measured_cables
from cosim.devices.pump_drive import PumpDrive, PumpDriveState
from cosim.devices.zero_order_hold import Held, HoldState
from cosim.errors import InputError
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.plan import PhasePlan
from cosim.plan.robot_command import SoftCommand
from cosim.soft.body.body import SoftBody


@final
@dataclass(frozen=True)
class ActuationState:
    """What the next tick depends on.

    Args:
        cables: of each cable's drive.
        pumps: of each pump.
        holds: of each controller, in the order of the scenario.
        started: names of the controllers that have been asked in the present phase.
        held: whether it drives cables that the scenario does not give it to drive.
    """

    cables: tuple[CableDriveState, ...]
    pumps: tuple[PumpDriveState, ...]
    holds: tuple[HoldState, ...]
    started: tuple[str, ...]
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
        winches = {name: build_winch(entry) for entry in scenario.winches for name in entry.cables}
        tensions = scenario.start.cable_tension_N or (0.0,) * len(self._names)
        triples = zip(body.cables, self._names, tensions, strict=True)
        self.cables = [CableDrive(cable, winches.get(name), tension) for cable, name, tension in triples]
        chambers = scenario.soft_robot.chamber_names()
        places = [chambers.index(entry.chamber or chambers[0]) for entry in scenario.pumps]
        self.pumps = [
            PumpDrive(entry.name, build_pump(entry, self._tick_s), place)
            for entry, place in zip(scenario.pumps, places, strict=True)
        ]
        self._holds = build_holds(scenario, controllers or {})
        self._quantities = {
            entry.name: "" if entry.kind == "python" else entry.measures for entry in scenario.controllers
        }
        self._started: tuple[str, ...] = ()
        self._planned: PhasePlan | None = None
        self._orders: list[Order | None] = []
        self._setpoints: dict[str, float | None] = {}
        self._modelled, self._held = device_names(scenario) is not None, False
        self.live: LiveOrders | None = None
        """What is commanded from outside, in place of phases and controllers; whoever does sets it anew."""

    @property
    def active(self) -> bool:
        """Whether it drives anything: otherwise what is planned passes through untouched."""
        return self._modelled or self._held

    def hold(self, tension_N: Sequence[float]) -> None:
        """Drive cables from now on that nothing drove before, at these tensions."""
        self._held = True
        for drive, tension in zip(self.cables, tension_N, strict=True):
            drive.restore_state(CableDriveState(tension, tension))

    def begin_phase(self, planned: PhasePlan, soft: SoftSide) -> None:
        """Take over what a phase asks; nothing moves at this instant."""
        if not self.active:
            return
        self._take_over(planned)
        for drive, order in zip(self.cables, self._orders, strict=True):
            drive.begin(order, soft.state.positions)
        pressures = soft.pressures_Pa
        for pump in self.pumps:
            given = (planned.phase.pump_pressure_Pa or {}).get(pump.name, pump.setpoint_Pa)
            sealed = planned.gas[pump.chamber].sealed
            pump.begin(given if sealed else None, pressures[pump.chamber])
        self._started = tuple(name for name in self._started if name in self._setpoints)

    def act(
        self,
        planned: PhasePlan,
        gas: ChamberGas,
        soft: SoftSide,
        see: Callable[[], RobotState],
        load_factor: float,
    ) -> tuple[float, ...] | None:
        """Let controllers, pumps and winches act for one tick, from the state before it.

        Returns:
            Twist of the flange that is commanded besides the plan, see `Command`; None for none.

        Args:
            planned: the phase.
            gas: in the chambers; pumps change it.
            soft: soft side.
            see: looks at the rest of what controllers see.
            load_factor: of the phase's ramp at the end of the tick.
        """
        if not self.active:
            return None
        self._take_over(planned)
        twist: tuple[float, ...] | None = None
        commanded: list[Order | None] = [None] * len(self.cables)
        given = planned.phase.pump_pressure_Pa or {}
        pressures = [given.get(pump.name) for pump in self.pumps]
        for name, setpoint in self._setpoints.items():
            held = self._ask(name, partial(self._measure, gas, soft, see, setpoint))
            for k, (tension, length) in enumerate(zip(held.tension_N, held.length_m, strict=True)):
                order: Order | None = None if tension is None else ("tension", tension)
                commanded[k] = order or (commanded[k] if length is None else ("length", length))
            pairs = zip(held.pump_pressure_Pa, pressures, strict=True)
            pressures = [old if new is None else new for new, old in pairs]
            twist = twist if held.flange_twist is None else held.flange_twist
        if self.live is not None:
            commanded = [mine or order for mine, order in zip(self.live.cables, commanded, strict=True)]
            pairs = zip(self.live.pump_pressure_Pa, pressures, strict=True)
            pressures = [old if new is None else new for new, old in pairs]
        self._work_pumps(gas, soft, pressures)
        triples = zip(self.cables, self._orders, commanded, strict=True)
        for drive, order, command in triples:
            drive.move(order, load_factor, command, soft.state.positions, self._tick_s)
        return twist

    def driven(self, planned: SoftCommand) -> SoftCommand:
        """Return a command with the cables as they are driven."""
        if not self.active:
            return planned
        tension = tuple(drive.given_tension_N for drive in self.cables)
        lengths = tuple(drive.length_m for drive in self.cables)
        return replace(planned, cable_tension_N=tension, cable_length_m=lengths)

    def report(self, soft: SoftSide, flange: Pose) -> ActuationReport | None:
        """Return what the devices do at present; None where there are none."""
        if not self.active:
            return None
        x = soft.state.positions
        angle = bending_angle(soft.body.tip_direction(x), flange)
        height = float(soft.body.tip_position(x)[2])
        values = {"bending_angle_rad": angle, "tip_height_m": height}
        drives = self.cables
        return ActuationReport(
            cable_tension_N=np.array([drive.tension_N(x) for drive in drives]),
            cable_length_m=np.array([drive.cable.length(x) for drive in drives]),
            unstretched_m=np.array([np.nan if d.length_m is None else d.length_m for d in drives]),
            lost_steps=np.array([drive.lost_steps for drive in drives], dtype=np.int64),
            bending_angle_rad=angle,
            pumps=tuple(_pump_report(drive) for drive in self.pumps),
            controls=tuple(
                ControlReport(name, setpoint, values.get(self._quantities[name]))
                for name, setpoint in self._setpoints.items()
            ),
        )

    def save_state(self) -> ActuationState:
        """Return what the next tick depends on."""
        return ActuationState(
            tuple(drive.save_state() for drive in self.cables),
            tuple(pump.save_state() for pump in self.pumps),
            tuple(hold.save_state() for hold in self._holds.values()),
            self._started,
            self._held,
        )

    def restore_state(self, state: ActuationState) -> None:
        """Return to a state of `save_state`.

        Raises:
            InputError: it is of a run with other devices.
        """
        saved, here = (
            (len(cables), len(pumps), len(holds))
            for cables, pumps, holds in (
                (state.cables, state.pumps, state.holds), (self.cables, self.pumps, self._holds)
            )
        )  # fmt: skip
        if saved != here:
            raise InputError(
                f"the saved state has {saved[0]} cables, {saved[1]} pumps, {saved[2]} controllers; here are "
                f"{here[0]}, {here[1]} and {here[2]}"
            )
        for drive, cable in zip(self.cables, state.cables, strict=True):
            drive.restore_state(cable)
        for pump, own in zip(self.pumps, state.pumps, strict=True):
            pump.restore_state(own)
        for hold, held in zip(self._holds.values(), state.holds, strict=True):
            hold.restore_state(held)
        self._started, self._held = state.started, state.held

    def _take_over(self, planned: PhasePlan) -> None:
        """Read what a phase asks: a run that goes on from a saved state may ask something else."""
        if planned is not self._planned:
            self._planned, self._orders = planned, orders_of(planned, self._names)
            self._setpoints = acting(planned.phase)

    def _ask(self, name: str, see: Callable[[], Measurement]) -> Held:
        hold = self._holds[name]
        if name not in self._started:
            hold.start(see())
            self._started += (name,)
        return hold.tick(see)

    def _work_pumps(self, gas: ChamberGas, soft: SoftSide, setpoints: list[float | None]) -> None:
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
        self, gas: ChamberGas, soft: SoftSide, see: Callable[[], RobotState], setpoint: float | None
    ) -> Measurement:
        return measured(soft, see(), gas, self.measured_cables(soft), setpoint=setpoint)

    def measured_cables(
        self, soft: SoftSide, tension_N: Sequence[float] | None = None
    ) -> dict[str, dict[str, float]]:
        """Return those fields of a measurement that are by cable; `tension_N` where nothing drives them."""
        given = None if self.active else tension_N
        return measured_cables(self._names, self.cables, soft.state.positions, given)


def _pump_report(drive: PumpDrive) -> PumpReport:
    state = drive.state
    if state is None:
        return PumpReport(drive.setpoint_Pa, False, False, 0, 0.0, 0.0)
    return PumpReport(
        drive.setpoint_Pa, state.on, state.venting, state.starts, state.on_s, state.delivered_kg
    )
