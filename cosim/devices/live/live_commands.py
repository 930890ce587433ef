"""Live commands of `Simulation.step`, which change the planned ones. A commanded value is reached linearly
within the ticks of its step, if devices are fast enough, and then held. Values that no command has named
follow the plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.devices import command_source, device_report, planned_commands
from cosim.devices.command_checks import over
from cosim.devices.command_source import CommandsAhead, CommandSource, StepToTake
from cosim.devices.controller import Command, Measurement, RobotState
from cosim.devices.live import gas_orders, live_bounds, live_values
from cosim.devices.live.joint_motion import Departure, JointMotion
from cosim.devices.measurement import measured
from cosim.plan import commands

_AT_BOUND: Final = 1.0 - 1e-6
_NONE: Final = np.zeros(0)
_HELD_TICKS: Final = 256
"""Number of ticks computed at once if the commands are constant."""


@final
@dataclass(frozen=True)
class LiveState:
    """Present live commands.

    Args:
        begin_tick: ticks of the run before the last command.
        ticks: over which its values are reached.
        begin: values at its start.
        end: values at its end.
        joints: commanded motion of the joints; None: planned motion.
        ended: text on commands that a phase has ended.
    """

    begin_tick: int
    ticks: int
    begin: live_values.LiveValues
    end: live_values.LiveValues
    joints: JointMotion | None
    ended: tuple[str, ...] = ()

    def values(self, tick: int) -> live_values.LiveValues:
        """Return the values at the end of a tick, counted from the run's first, 1."""
        return self.begin.between(self.end, (tick - self.begin_tick) / self.ticks)


@final
@dataclass(frozen=True)
class LiveCommandsState:
    """State of `LiveCommands` without that of the changed source.

    Args:
        live: present live commands; None: none.
    """

    live: LiveState | None


@final
class LiveCommands(command_source.SteeredCommands):
    """Changes planned commands by live commands.

    Args:
        given: source of the planned commands.
        planned: the part of that source with gas and devices.
        scenario: checked.
        soft: soft side.
        bounds: of live commands.
    """

    def __init__(
        self,
        given: CommandSource,
        planned: planned_commands.PlannedCommands,
        scenario: Scenario,
        soft: SoftRobot,
        bounds: live_bounds.LiveBounds,
    ) -> None:
        self._given, self._scenario, self._soft, self._bounds = given, scenario, soft, bounds
        self._gas, self._actuation, self._sensors = planned.gas, planned.actuation, planned.sensors
        self._tick_s = scenario.clock.tick_s
        self._gas_orders = gas_orders.GasOrders.of(scenario)
        self._before = self._gas_orders.before
        wound = {name for winch in scenario.winches for name in winch.cables}
        self._wound = [name in wound for name in scenario.soft_robot.cable_names()]
        self._state: LiveState | None = None
        self._none = live_values.LiveValues.of(Command(), scenario, live_values.WHO)
        # parts of a command that wait for its first tick
        self._new: tuple[live_values.LiveValues, int] | None = None
        self._motion: tuple[Command, int] | None = None

    def command(self, command: Command, ticks: int) -> None:
        values = live_values.LiveValues.of(command, self._scenario, live_values.WHO)
        moves = self._bounds.check(command, values, self._scenario)
        self._new = (values, ticks)
        self._motion = (command, ticks) if moves else None

    def begin_phase(self, phase: int) -> None:
        self._given.begin_phase(phase)
        state = self._state
        if state is not None:
            end, words = self._gas_orders.left(state.end, phase)
            begin = state.begin.beginning(end, self._none)
            self._state = replace(state, begin=begin, end=end, ended=words or state.ended)

    def next(self, step: StepToTake, see: Callable[[], RobotState]) -> commands.RobotCommand:
        tick = self._before[step.phase] + step.done
        self._begin_values(step.phase, step.done)
        if self._state is None:
            return self._given.next(step, see)
        values = self._state.values(tick)
        self._set_gas(values)
        self._actuation.live = values.orders(self._wound, self._state.end) if self._actuation.active else None
        planned = self._given.next(step, see)
        joints = self._joints(tick, planned.joints.position)
        reference = planned.joints if joints is None else joints.through(tick - 1, 1, self._tick_s).row(0)
        return commands.RobotCommand(reference, self._changed(planned.soft, values))

    def ahead(self, phase: int, done: int, most: int | None = None) -> CommandsAhead | None:
        self._begin_values(phase, done)
        state, tick = self._state, self._before[phase] + done
        if state is None:
            return self._given.ahead(phase, done, most)
        changing = state.begin_tick + state.ticks - tick + 1
        planned = self._given.ahead(phase, done, changing if changing > 0 else most or _HELD_TICKS)
        if planned is None:
            return None
        joints, asked = self._joints(tick, planned.joints.position[0]), planned.soft
        reference = planned.joints
        if joints is not None:
            reference = joints.through(tick - 1, len(asked), self._tick_s)
        return CommandsAhead(reference, self._changed_all(asked, tick))

    def cable_tension_N(self, phase: int, done: int) -> tuple[float, ...]:
        planned = self._given.cable_tension_N(phase, done)
        if self._state is None:
            return planned
        live = self._state.values(self._before[phase] + done).cable_tension_N
        return tuple(over(live, planned))

    def report(self, flange: Pose) -> device_report.ActuationReport | None:
        return self._given.report(flange)

    def measured(self, robot: RobotState, tension_N: Array, sensors: Sequence[str] = ()) -> Measurement:
        cables = self._actuation.measured_cables(self._soft, tension_N.tolist())
        truth = measured(self._soft, robot, self._gas, cables, limits=self._limits(robot.joint_torque))
        if not self._sensors and not sensors:
            return truth
        return replace(self._sensors.through(truth, sensors), sensors=self._sensors.readings)

    def sensed(
        self, see: Callable[[], RobotState], tension_N: Array, seed: int | None = None
    ) -> tuple[Array, Array]:
        if not self._sensors:
            return _NONE, _NONE
        truth = self.measured(see(), tension_N)
        return self._sensors.tick(truth) if seed is None else self._sensors.begin(truth, seed)

    @property
    def state(self) -> LiveCommandsState:
        """State without that of the changed source."""
        return LiveCommandsState(self._state)

    @state.setter
    def state(self, state: LiveCommandsState) -> None:
        self._state, self._new, self._motion = state.live, None, None
        self._actuation.live = None

    def parts(self) -> dict[str, Any]:
        return {**self._given.parts(), "live": self}

    def _begin_values(self, phase: int, done: int) -> None:
        """Apply the values of a new command, in its first tick."""
        if self._new is None:
            return
        (new, ticks), self._new = self._new, None
        before, tick = self._state, self._before[phase] + done - 1
        self._gas_orders.check(new, self._gas, self._actuation.pumps)
        self._gas_orders.check_reached(new, phase, tick, ticks)
        none = self._none
        now, end = (none, none) if before is None else (before.values(tick), before.end)
        if new.drives_cables and not self._actuation.active:
            given = self._given.cable_tension_N(phase, done)
            held = over(now.cable_tension_N, given)
            self._actuation.hold(held)
            end = replace(end, cable_tension_N=tuple(held))
        end = self._gas_orders.pumped_by(new, end).followed_by(new)
        begin = now.beginning(end, none)
        if not begin.reaches(end):  # values without a command start from the present ones
            begin = now.beginning(end, self._present(self._given.cable_tension_N(phase, done)))
        self._state = LiveState(tick, ticks, begin, end, None if before is None else before.joints)

    def _present(self, tension_N: tuple[float, ...]) -> live_values.LiveValues:
        """Return the present values of everything that can be commanded."""
        soft = self._soft
        contents = [self._gas.content(k) for k in range(len(soft.pressures_Pa))]
        cables = self._actuation.measured_cables(soft, tension_N)
        return live_values.LiveValues(
            tuple(soft.pressures_Pa),
            tuple(None if content is None else content.mass_kg for content in contents),
            tuple(cables["cable_tension_N"].values()),
            tuple(cables["cable_unstretched_m"].values()),
            (None,) * len(self._scenario.pumps),
        )

    def _joints(self, tick: int, here: Array) -> JointMotion | None:
        """Return the commanded motion of the joints; a new command starts from `here` (joints,) [rad]."""
        state = self._state
        if state is None or self._motion is None:
            return None if state is None else state.joints
        (command, ticks), arm, limits = self._motion, self._bounds.arm, self._bounds.limits
        assert arm is not None, "checked with the command"
        assert limits is not None, "an arm has them"
        speed = np.zeros(here.shape)
        if state.joints is not None:
            here = state.joints.through(tick - 1, 1, self._tick_s).position[0]
            speed = state.joints.speed_at(tick - 1, self._tick_s)
        departure = Departure(here, tick - 1, ticks, limits, self._tick_s)
        if command.flange is not None:
            found = departure.to_pose(arm, command.flange)
        elif command.joint_position is not None:
            speeds = None
            if command.joint_velocity is not None:
                speeds = np.stack([speed, np.array(command.joint_velocity, dtype=float)])
            found = departure.towards(np.array(command.joint_position, dtype=float), speeds)
        else:
            found = departure.along(arm, np.array(command.flange_twist, dtype=float))
        self._state, self._motion = replace(state, joints=found), None
        return found

    def _set_gas(self, values: live_values.LiveValues) -> None:
        for k, wanted in enumerate(values.gas_kg):
            content = self._gas.content(k)
            if wanted is not None and content is not None and wanted != content.mass_kg:
                self._gas.set_gas(k, content.with_mass(wanted))

    def _changed_all(
        self, planned: tuple[commands.SoftCommand, ...], tick: int
    ) -> tuple[commands.SoftCommand, ...]:
        """Return the changed commands of successive ticks; the same object if nothing changes."""
        assert self._state is not None
        found: list[commands.SoftCommand] = []
        last: tuple[commands.SoftCommand, live_values.LiveValues] | None = None
        for k, asked in enumerate(planned):
            values = self._state.values(tick + k)
            same = last is not None and last[0] is asked and last[1] is values
            found.append(found[-1] if same else self._changed(asked, values))
            last = asked, values
        return tuple(found)

    def _changed(self, planned: commands.SoftCommand, values: live_values.LiveValues) -> commands.SoftCommand:
        pressure, tension = tuple(over(values.pressure_Pa, planned.pressure_Pa)), planned.cable_tension_N
        if not self._actuation.active:
            tension = tuple(over(values.cable_tension_N, tension))
        return commands.SoftCommand(
            pressure, planned.gas, tension, planned.cable_length_m, planned.nodal_force
        )

    def _limits(self, torque: Array) -> tuple[str, ...]:
        """Return text on limits that the arm has reached, at servo torques (joints,) [N m]."""
        state, limits = self._state, self._bounds.limits
        words = () if state is None else state.ended
        if limits is None:
            return words
        if state is not None and state.joints is not None:
            words += state.joints.limits
        full = np.flatnonzero(np.abs(torque) >= _AT_BOUND * limits.torque)
        return words + tuple(
            f"torque of {limits.joint_names[k]}: its servo is at its limit, {limits.torque[k]:.4g} "
            f"{'N' if limits.prismatic[k] else 'N m'}"
            for k in full
        )
