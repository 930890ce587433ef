"""The tension of a cable that swings: a source of commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, final

from cosim.config.schema.phase import CommandTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.quantities import Positive
from cosim.devices.command_source import ChangedCommands, CommandSource, StepToTake
from cosim.devices.controller import RobotState
from cosim.errors import InputError
from cosim.plan.commands import RobotCommand


@final
class SineTension(ChangedCommands):
    """Adds a (1 - cos(2 pi f t)) / 2 to the tension that is asked of a cable.

    Args:
        given: asks for the rest.
        cable: its place among the cables.
        amplitude_N: a.
        frequency_Hz: f.
    """

    def __init__(self, given: CommandSource, cable: int, amplitude_N: float, frequency_Hz: float) -> None:
        super().__init__(given)
        self._cable, self._amplitude_N, self._frequency_Hz = cable, amplitude_N, frequency_Hz

    def changed(self, command: RobotCommand, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        end_s = step.begin_s + step.length_s
        tensions = list(command.soft.cable_tension_N)
        tensions[self._cable] += self._amplitude_N * math.sin(math.pi * self._frequency_Hz * end_s) ** 2
        return replace(command, soft=replace(command.soft, cable_tension_N=tuple(tensions)))


@final
@dataclass(frozen=True, kw_only=True)
class SineTable(CommandTable):
    """A cable whose tension swings upwards from the phases' value.

    Args:
        cable: its name.
        amplitude_N: from the lowest to the highest tension.
        frequency_Hz: of the swing.
    """

    kind: Literal["sine"] = "sine"
    cable: str
    amplitude_N: Positive
    frequency_Hz: Positive

    def source(self, given: CommandSource, scenario: Scenario) -> SineTension:
        names = scenario.soft_robot.cable_names()
        if self.cable not in names:
            raise InputError(f"a sine pulls cable '{self.cable}'; there are: {', '.join(names) or 'none'}")
        return SineTension(given, names.index(self.cable), self.amplitude_N, self.frequency_Hz)
