"""The command source of a scenario: its phases, the gas in the chambers, devices and controllers."""

from collections.abc import Callable
from typing import Any, final

from cosim.base.frames import Pose
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.devices import command_source, sensor
from cosim.devices.command_source import CommandsAhead, StepToTake
from cosim.devices.controller import RobotState
from cosim.devices.device_loop import Actuation
from cosim.devices.device_report import ActuationReport
from cosim.devices.flange_offset import FlangeOffset
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.commands import CommandRamp, RobotCommand
from cosim.plan.plan import Plan
from cosim.plan.references import IncrementReferences, TickReferences


@final
class PlannedCommands(command_source.CommandSource):
    """Commands of a scenario's plan, with its devices and controllers.

    Args:
        scenario: checked.
        plan: of the scenario.
        soft: soft side, whose state devices measure.
        actuation: devices.
    """

    gas: ChamberGas
    """The gas in the chambers."""
    actuation: Actuation
    """Devices of the scenario."""

    def __init__(self, scenario: Scenario, plan: Plan, soft: SoftRobot, actuation: Actuation) -> None:
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
            twist = self.actuation.act(planned, self.gas, self._soft, see, step.done, load_factor)
            joints = self._offset.moved(joints, twist, see, step.length_s)
        asked = self.gas.between(planned.begin, planned.end, load_factor)
        return RobotCommand(joints, self.actuation.driven(asked))

    def ahead(self, phase: int, done: int, most: int | None = None) -> CommandsAhead | None:
        references, by_tick = self._of(phase), self.actuation.active or self.sensors or self.gas.holds_gas
        if by_tick or isinstance(references, IncrementReferences):
            return None
        planned, (joints, factors) = references.planned, references.from_on(done, most)
        begin, end, between = planned.begin, planned.end, self.gas.between
        return CommandsAhead(joints, tuple([between(begin, end, factor) for factor in factors]))

    def cable_tension_N(self, phase: int, done: int) -> tuple[float, ...]:
        references = self._of(phase)
        ramp = CommandRamp(references.planned.begin, references.planned.end)
        return self.actuation.driven(ramp.at(references.at(done)[1])).cable_tension_N

    def report(self, flange: Pose) -> ActuationReport | None:
        return self.actuation.report(self._soft, flange)

    def parts(self) -> dict[str, Any]:
        return {"gas": self.gas, **self.actuation.parts(), "offset": self._offset, "sensors": self.sensors}

    def _of(self, phase: int) -> TickReferences | IncrementReferences:
        """Return the references of a phase, step by step."""
        planned, found = self._plan.phases[phase], self._references
        if found is None or found.planned is not planned:
            tick_s = self._tick_s
            found = IncrementReferences(planned) if tick_s is None else TickReferences(planned, tick_s)
            self._references = found
        return found
