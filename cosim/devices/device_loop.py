"""What moves cables and gas through a run besides the ramps of the phases: controllers, winches, pumps.

Makes devices and controllers from their tables.

Says which devices a scenario models.

Per tick, at the state before it: controllers that are due see the run and command; pumps work on the gas;
winches turn. A scenario without any of these passes through untouched.

The commands of a scenario: its phases, the gas in the chambers, and its devices and controllers.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.config.schema.devices import ControllerTable, WinchTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.devices import command_source, sensor
from cosim.devices.command_source import CommandsAhead, FlangeOffset, RobotState, StepToTake, measured_cables
from cosim.devices.controller import (
    AnyController,
    BangBang,
    Controller,
    FeedbackLaw,
    FeedbackLoop,
    Held,
    Measurement,
    ProportionalIntegral,
    TipFollower,
    ZeroOrderHold,
    over,
)
from cosim.devices.device_report import ActuationReport, ControlReport, DeviceNames, PumpReport
from cosim.devices.drives import (
    CableDrive,
    DelayLine,
    LiveOrders,
    Order,
    Pump,
    PumpDrive,
    PumpState,
    drums_of,
    orders_of,
)
from cosim.errors import InputError, ScenarioError
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.commands import CommandRamp, RobotCommand, SoftCommand
from cosim.plan.plan import PhasePlan, Plan
from cosim.plan.references import IncrementReferences, TickReferences
from cosim.soft.body.body import SoftBody


def build_holds(scenario: Scenario, given: Mapping[str, AnyController]) -> dict[str, ZeroOrderHold]:
    """Return every controller at its rate, by name.

    Args:
        scenario: checked.
        given: controllers of kind "python", by name.

    Raises:
        ScenarioError: one is missing.
        InputError: one is given that the scenario does not name, or that is no controller.
    """
    expected = [entry.name for entry in scenario.controllers if entry.kind == "python"]
    for name, controller in given.items():
        if name not in expected:
            raise InputError(
                f"controllers: the scenario has no [[controller]] '{name}' of kind 'python'; it has: "
                f"{', '.join(expected) or 'none'}"
            )
        if not isinstance(controller, Controller):
            raise InputError(
                f"controllers: '{name}' is a {type(controller).__name__}; derive it from cosim.Controller"
            )
    cables, pumps = scenario.soft_robot.cable_names(), tuple(pump.name for pump in scenario.pumps)
    holds = {}
    for entry in scenario.controllers:
        period = round(entry.period_s / scenario.clock.tick_s)
        holds[entry.name] = ZeroOrderHold(entry.name, _controller(entry, given), period, cables, pumps)
    return holds


def _controller(entry: ControllerTable, given: Mapping[str, AnyController]) -> AnyController:
    if entry.kind == "python":
        if entry.name not in given:
            raise ScenarioError(
                f"controller.{entry.name}.kind",
                f"'python' needs the controller itself: cosim.run(..., controllers={{'{entry.name}': ...}})",
            )
        return given[entry.name]
    if entry.measures == "tip_position_m":
        gains = entry.proportional_gain or 0.0, entry.integral_gain_per_s or 0.0
        return TipFollower(*gains, entry.period_s)
    assert entry.commands != "flange_twist", "checked with the scenario"
    return FeedbackLoop(entry.measures, _law(entry), entry.commands, entry.cables)


def _law(entry: ControllerTable) -> FeedbackLaw:
    highest = np.inf if entry.output_max is None else entry.output_max
    if entry.kind == "bang_bang":
        assert entry.increment is not None, "checked with the scenario"
        return BangBang(entry.increment, entry.band, entry.output_min, highest)
    gains = entry.proportional_gain or 0.0, entry.integral_gain_per_s or 0.0
    return ProportionalIntegral(*gains, entry.period_s, entry.output_min, highest)


def device_names(scenario: Scenario) -> DeviceNames | None:
    """Return what of devices there is to show; None where nothing is."""
    lengths = any(phase.commands_lengths for phase in scenario.phases) or any(
        entry.kind == "python" or entry.commands == "cable_shortening_m" for entry in scenario.controllers
    )
    lengths = lengths or bool(scenario.winches)
    if not (lengths or scenario.pumps or scenario.controllers):
        return None
    controllers = tuple(
        (entry.name, "" if entry.kind == "python" else entry.measures) for entry in scenario.controllers
    )
    pumps = tuple(entry.name for entry in scenario.pumps)
    return DeviceNames(pumps, controllers, lengths, bool(scenario.winches))


def device_report(scenario: Scenario) -> dict[str, str]:
    """Return in words what is modelled of devices and sensors, by heading; empty without any."""
    lines = {"Pumps": _pumps(scenario), "Cables": _cables(scenario), "Controllers": _controllers(scenario)}
    lines["Sensors"] = sensor.sensor_report(scenario)
    return {heading: text for heading, text in lines.items() if text}


def _pumps(scenario: Scenario) -> str:
    return "; ".join(
        f"{entry.name}, {1e6 * entry.flow_kg_s:g} mg/s, band {1e-3 * entry.band_Pa:g} kPa, sensor "
        f"{1e3 * entry.sensor_delay_s:g} ms late"
        for entry in scenario.pumps
    )


def _cables(scenario: Scenario) -> str:
    names = device_names(scenario)
    if names is None or not names.lengths:
        return ""
    if not scenario.winches:
        return "lengths commanded in places, without a winch: at once"
    return "; ".join(
        f"winch {winch.name} on {', '.join(winch.cables)}{_one_motor(winch)}, "
        f"{1e6 * winch.step_m:.3g} um a step, "
        f"at most {1e3 * winch.speed_m_s:.3g} mm/s, stalls at {winch.stall_force_N:.3g} N"
        for winch in scenario.winches
    )


def _one_motor(winch: WinchTable) -> str:
    return " by one motor" if winch.one_motor else ""


def _controllers(scenario: Scenario) -> str:
    texts = []
    for entry in scenario.controllers:
        rate = f"every {1e3 * entry.period_s:g} ms"
        if entry.kind == "python":
            texts.append(f"{entry.name}, in Python, {rate}")
        else:
            moves = f"{entry.commands} of {', '.join(entry.cables)}" if entry.cables else entry.commands
            texts.append(f"{entry.name}, {entry.kind}, {entry.measures} by {moves}, {rate}")
    return "; ".join(texts)


@final
@dataclass(frozen=True)
class ActuationState:
    """What the next tick depends on, besides drives, pumps and controllers.

    Args:
        started: names of the controllers that have been asked in the present phase.
        held: whether it drives cables that the scenario does not give it to drive.
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
        """What the next tick depends on, besides drives, pumps and controllers."""
        self._planned: PhasePlan | None = None
        self._orders: list[Order | None] = []
        self._setpoints: dict[str, float | None] = {}
        self._modelled = device_names(scenario) is not None
        self._looks_through = {entry.name: entry.sensors for entry in scenario.controllers}
        self.sensors: sensor.Sensors | None = None
        """What controllers look through; whoever plans the run makes it."""
        self.live: LiveOrders | None = None
        """What is commanded from outside, in place of phases and controllers; whoever does sets it again."""

    @property
    def active(self) -> bool:
        """Whether it drives anything: otherwise what is planned passes through untouched."""
        return self._modelled or self.state.held

    def parts(self) -> dict[str, Any]:
        """Return what the next tick depends on, by name, see `CommandSource.parts`."""
        controllers = list(self._holds.values())
        return {"cables": self.cables, "pumps": self.pumps, "controllers": controllers, "devices": self}

    def hold(self, tension_N: Sequence[float]) -> None:
        """Drive cables from now on that nothing drove before, at these tensions."""
        self.state = replace(self.state, held=True)
        for drive, tension in zip(self.cables, tension_N, strict=True):
            drive.state = drive.at_rest(tension)

    def begin_phase(self, planned: PhasePlan, soft: SoftSide) -> None:
        """Take over what a phase asks; nothing moves at this instant."""
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
        soft: SoftSide,
        see: Callable[[], RobotState],
        reached: tuple[int, float],
    ) -> tuple[float, ...] | None:
        """Let controllers, pumps and winches act for one tick, from the state before it.

        Returns:
            Twist of the flange that is commanded besides the plan, see `Command`; None for none.

        Args:
            planned: the phase.
            gas: in the chambers; pumps change it.
            soft: soft side.
            see: looks at the rest of what controllers see.
            reached: ticks of the phase at the end of the tick, and load factor of its ramp then.
        """
        if not self.active:
            return None
        self._take_over(planned)
        done, load_factor = reached
        twist: tuple[float, ...] | None = None
        commanded: list[Order | None] = [None] * len(self.cables)
        given = planned.phase.pump_pressure_Pa or {}
        pressures = [given.get(pump.name) for pump in self.pumps]
        wanted = planned.tip_wanted(done, self._tick_s) if self._setpoints else None
        for name in self._setpoints:
            held = self._ask(name, partial(self._measure, gas, soft, see, name, wanted))
            for k, (tension, length) in enumerate(zip(held.tension_N, held.length_m, strict=True)):
                order: Order | None = None if tension is None else ("tension", tension)
                commanded[k] = order or (commanded[k] if length is None else ("length", length))
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
        """Return a command with the cables as they are driven."""
        if not self.active:
            return planned
        tension = tuple(drive.given_tension_N for drive in self.cables)
        lengths = tuple(drive.step_length_m for drive in self.cables)
        stiffening = tuple(drive.spring[0] for drive in self.cables) if self._creep else ()
        return replace(planned, cable_tension_N=tension, cable_length_m=lengths, cable_stiffening=stiffening)

    def report(self, soft: SoftSide, flange: Pose) -> ActuationReport | None:
        """Return what the devices do at present; None where there are none."""
        if not self.active:
            return None
        x = soft.state.positions
        angle = command_source.bending_angle(soft.body.tip_direction(x), flange)
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
        """Read what a phase asks: a run that continues from a saved state may ask something else."""
        if planned is not self._planned:
            self._planned, self._orders = planned, orders_of(planned, self._names)
            self._setpoints = planned.phase.acting()

    def _ask(self, name: str, see: Callable[[], Measurement]) -> Held:
        hold = self._holds[name]
        if name not in self.state.started:
            hold.start(see())
            self.state = replace(self.state, started=(*self.state.started, name))
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
        self, gas: ChamberGas, soft: SoftSide, see: Callable[[], RobotState], name: str, wanted: Array | None
    ) -> Measurement:
        cables, setpoint = self.measured_cables(soft), self._setpoints[name]
        truth = replace(
            command_source.measured(soft, see(), gas, cables, setpoint=setpoint), tip_wanted=wanted
        )
        if not self.sensors:
            return truth
        through = self.sensors.through(truth, self._looks_through[name])
        return replace(through, sensors=self.sensors.readings)

    def measured_cables(
        self, soft: SoftSide, tension_N: Sequence[float] | None = None
    ) -> dict[str, dict[str, float]]:
        """Return those fields of a measurement that are by cable; `tension_N` where nothing drives them."""
        given = None if self.active else tension_N
        return measured_cables(self._names, self.cables, soft.state.positions, given)


def _pump_report(drive: PumpDrive) -> PumpReport:
    setpoint_Pa, pump = drive.state.setpoint_Pa, drive.state.pump or PumpState(DelayLine())
    return PumpReport(setpoint_Pa, pump.on, pump.venting, pump.starts, pump.on_s, pump.delivered_kg)


@final
class PlannedCommands(command_source.CommandSource):
    """Asks for what a scenario plans, and what its devices and controllers make of it.

    Args:
        scenario: checked.
        plan: made from it.
        soft: soft side, which devices act on and look at.
        actuation: devices.
    """

    gas: ChamberGas
    """What is in the chambers."""
    actuation: Actuation
    """Its devices."""

    def __init__(self, scenario: Scenario, plan: Plan, soft: SoftSide, actuation: Actuation) -> None:
        self._plan, self._soft, self.actuation = plan, soft, actuation
        self._tick_s = None if scenario.mode == "quasistatic" else scenario.clock.tick_s
        self.gas = ChamberGas(scenario.gas)
        self._offset = FlangeOffset(len(plan.joints))
        self.sensors = actuation.sensors = sensor.Sensors(scenario, len(plan.joints))
        self._references: TickReferences | IncrementReferences | None = None

    def begin_phase(self, phase: int) -> None:
        planned = self._plan.phases[phase]
        self.gas.begin(planned.gas, self._soft)
        self.actuation.begin_phase(planned, self._soft)

    def next(self, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        references = self._of(step.phase)
        planned, (joints, load_factor) = references.planned, references.at(step.done)
        self.gas.advance(self._soft, step.length_s)
        if self.actuation.active:
            twist = self.actuation.act(planned, self.gas, self._soft, see, (step.done, load_factor))
            joints = self._offset.moved(joints, twist, see, step.length_s)
        asked = self.gas.between(planned.begin, planned.end, load_factor)
        return RobotCommand(joints, self.actuation.driven(asked))

    def ahead(self, phase: int, done: int, most: int | None = None) -> CommandsAhead | None:
        references, by_tick = self._of(phase), self.actuation.active or self.sensors or self.gas.holds_gas
        if by_tick or isinstance(references, IncrementReferences):
            return None
        planned, (joints, shares) = references.planned, references.from_on(done, most)
        begin, end, between = planned.begin, planned.end, self.gas.between
        return CommandsAhead(joints, tuple([between(begin, end, share) for share in shares]))

    def cable_tension_N(self, phase: int, done: int) -> tuple[float, ...]:
        references = self._of(phase)
        ramp = CommandRamp(references.planned.begin, references.planned.end)
        return self.actuation.driven(ramp.at(references.at(done)[1])).cable_tension_N

    def report(self, flange: Pose) -> ActuationReport | None:
        return self.actuation.report(self._soft, flange)

    def parts(self) -> dict[str, Any]:
        return {"gas": self.gas, **self.actuation.parts(), "offset": self._offset, "sensors": self.sensors}

    def _of(self, phase: int) -> TickReferences | IncrementReferences:
        """Return what a phase asks for, step by step."""
        planned, found = self._plan.phases[phase], self._references
        if found is None or found.planned is not planned:
            tick_s = self._tick_s
            found = IncrementReferences(planned) if tick_s is None else TickReferences(planned, tick_s)
            self._references = found
        return found
