"""What a controller sees, commands and is; its commands are checked and held between its samples.

A controller is a frozen description; what it remembers is a state that goes in and comes out, so that a run
can be saved and continued. It is asked at a fixed rate; its last command holds in between.

Controllers that come with cosim close one loop with a law from an error to an output: on cables, from a
measured quantity, or on the flange's motion, which leads the tip along a path.
"""

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, Final, Generic, Literal, TypeAlias, TypeVar, final

import numpy as np

from cosim.base.frames import Array, Pose, Shown, Wrench
from cosim.errors import InputError, InstabilityError

State = TypeVar("State")
Value = TypeVar("Value")


@final
@dataclass(frozen=True)
class Measurement(Shown):
    """What is measured of a run between two ticks, without noise: by controllers, by `Simulation.measure`.

    Args:
        time_s: simulated time.
        setpoint: of the phase for the controller that looks, in the unit of the controlled value; None:
            nothing, or nobody does.
        tip_wanted: (3,) [m], world, where the phase's tip path or tip target has the tip now; free components
            are not numbers; None: nowhere, or no controller looks.
        tip_position: (3,) [m], world.
        tip_direction: (3,), unit normal of the tip ring, world.
        tip_twist: (6,) [m/s, rad/s], linear then angular, of the tip ring's centre, world axes; how fast the
            ring turns about its own normal is part of it.
        bending_angle_rad: between the tip's direction and the flange's z axis.
        pressure_Pa: gauge pressure of each chamber.
        volume_m3: of each chamber.
        gas_kg: sealed in each chamber; None where its pressure is given.
        cable_tension_N: at the base end of each cable, by its name.
        cable_length_m: of each cable's route, by its name.
        cable_unstretched_m: commanded length of each cable, by its name; while its tension is commanded, the
            length by which it would be the same.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s].
        joint_torque: (joints,) [N m], that the servos gave in the last tick; at rest, their holding torque.
        flange: world_from_flange.
        flange_twist: (6,) [m/s, rad/s], linear then angular, of the flange's origin, world axes.
        flange_wrench: that soft robot and palm exert on the flange, about the flange's origin, world axes.
        contact_force_N: (3,) [N] of the soft robot on each rigid body in the last tick, world axes, by the
            body's name; the floor is part of "world".
        body_pose: world from each rigid body, by its name.
        limits: what does not go as commanded, in words: joints and speeds that a command asked for beyond
            their bounds, torques that servos cannot exceed, gas whose command a phase has ended; empty where
            all follow.
        sensors: readings (n,) of the scenario's sensors, by name; see `Simulation.measure`.
    """

    time_s: float
    setpoint: float | None
    tip_position: Array
    tip_direction: Array
    tip_twist: Array
    bending_angle_rad: float
    pressure_Pa: tuple[float, ...]
    volume_m3: tuple[float, ...]
    gas_kg: tuple[float | None, ...]
    cable_tension_N: Mapping[str, float]
    cable_length_m: Mapping[str, float]
    cable_unstretched_m: Mapping[str, float]
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    flange: Pose
    flange_twist: Array
    flange_wrench: Wrench
    contact_force_N: Mapping[str, Array]
    body_pose: Mapping[str, Pose]
    limits: tuple[str, ...] = ()
    sensors: Mapping[str, Array] = field(default_factory=dict)
    tip_wanted: Array | None = None


@final
@dataclass(frozen=True)
class Command:
    """What a controller or `Simulation.step` asks for; a run makes a complete `RobotCommand` of it.

    What it leaves out, a controller leaves to the plan. `Simulation.step` leaves it as it was commanded last,
    and to the plan where it never was; of `flange`, `flange_twist` and `joint_position` it takes one at most,
    and a flange whose twist is commanded no more stands. The last five keys are of `Simulation.step` alone.

    Args:
        cable_tension_N: by cable name.
        cable_length_m: unstretched length, by cable name; not for a cable whose tension is commanded.
        pump_pressure_Pa: setpoint, by pump name.
        flange_twist: (6,) [m/s, rad/s], linear then angular, world axes: how the flange's reference moves
            besides the plan, about its origin; None: it moves as planned, from where it has been moved to.
        pressure_Pa: gauge, by chamber name; not where gas is sealed, nor beyond the tick in which it will be.
        gas_kg: amount of gas, by name of a chamber in which it is sealed and no pump works; what comes in
            has its temperature.
        flange: world_from_flange; the joints go there evenly, on the branch they are on.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s] of the joints as they arrive at `joint_position`, along a cubic from
            their present speed, where no bound is in the way; None: they go there evenly.
    """

    cable_tension_N: Mapping[str, float] = field(default_factory=dict)
    cable_length_m: Mapping[str, float] = field(default_factory=dict)
    pump_pressure_Pa: Mapping[str, float] = field(default_factory=dict)
    flange_twist: Sequence[float] | Array | None = None
    pressure_Pa: Mapping[str, float] = field(default_factory=dict)
    gas_kg: Mapping[str, float] = field(default_factory=dict)
    flange: Pose | None = None
    joint_position: Sequence[float] | Array | None = None
    joint_velocity: Sequence[float] | Array | None = None


class Controller(ABC, Generic[State]):
    """Decides what devices do. Subclasses are frozen; their state is a frozen dataclass, number or tuple."""

    @abstractmethod
    def start(self, seen: Measurement) -> State:
        """Return the state in which a phase begins that uses this controller after one that did not.

        Args:
            seen: the measurement then.
        """

    @abstractmethod
    def act(self, state: State, seen: Measurement) -> tuple[State, Command]:
        """Return the state afterwards and the command that holds for the next period.

        Args:
            state: of the call before, or `start`.
            seen: the measurement now.
        """


AnyController = Controller[Any]


_LONGEST: Final = 60
_ROTATION: Final = 1e-3
"""Largest entry by which R^T R may differ from 1: whoever types a pose gives few digits."""


def named_values(
    given: Mapping[str, float],
    names: tuple[str, ...],
    who: str,
    key: str,
    *,
    lowest: float = -math.inf,
    above: float = -math.inf,
) -> tuple[float | None, ...]:
    """Return what is commanded of each name in order; None where it is left out.

    Args:
        given: values by name.
        names: that there are.
        who: commands, for messages.
        key: of the command.
        lowest: value that is allowed.
        above: what values have to be.

    Raises:
        InputError: there is no such name, or a value is no number or too low.
        InstabilityError: a value is not finite.
    """
    if type(given) is not dict and not isinstance(given, Mapping):  # the first costs least
        raise InputError(f"{who}: {key} is {shown(given)}; give numbers by name, such as {{'name': 1.0}}")
    values = {}
    for name, value in given.items():
        if name not in names:
            raise InputError(f"{who}: {key} of {shown(name)}; there are: {', '.join(names) or 'none'}")
        number = value if type(value) is float else _number(value, f"{who}: {key} of '{name}'")
        values[name] = number
        if not math.isfinite(number):
            raise InstabilityError(f"{who}: {key} of '{name}' is {number}")
        if number < lowest:
            raise InputError(f"{who}: {key} of '{name}' is {number:g}; must be at least {lowest:g}")
        if number <= above:
            raise InputError(f"{who}: {key} of '{name}' is {number:g}; must be above {above:g}")
    return tuple(values.get(name) for name in names)


def numbers(
    given: Sequence[float] | Array | None, count: int, who: str, key: str
) -> tuple[float, ...] | None:
    """Return a list of a command; None where it is left out.

    Args:
        given: numbers.
        count: that there have to be.
        who: commands, for messages.
        key: of the command.

    Raises:
        InputError: there are not as many, or they are no numbers.
        InstabilityError: one is not finite.
    """
    if given is None:
        return None
    values = row_of_numbers(given, count, f"{who}: {key}")
    if not all(map(math.isfinite, values)):
        raise InstabilityError(f"{who}: {key} is {values}")
    return values


def row_of_numbers(given: Any, count: int, place: str) -> tuple[float, ...]:
    """Return a list or array (count,) as numbers, which may be infinite or not a number.

    Args:
        given: whatever is given as one.
        count: that there have to be.
        place: what it is, for messages.

    Raises:
        InputError: there are not as many, or they are no numbers.
    """
    if isinstance(given, np.ndarray) and given.ndim == 1:
        given = given.tolist()
    if type(given) is not list and (not isinstance(given, Sequence) or isinstance(given, str | bytes)):
        raise InputError(f"{place} is {shown(given)}; must be {count} numbers in a row, shape ({count},)")
    values = tuple([
        value if type(value) is float else _number(value, f"{place}[{k}]") for k, value in enumerate(given)
    ])  # fmt: skip
    if len(values) != count:
        raise InputError(f"{place} has {len(values)} numbers; must be {count}")
    return values


def check_command(command: Command, who: str) -> None:
    """Check that a command is one, and that its flange is a pose.

    Raises:
        InputError: it is not.
        InstabilityError: a number of the pose is not finite.
    """
    if not isinstance(command, Command):
        raise InputError(f"{who}: command is {shown(command)}; give a cosim.Command")
    if (pose := command.flange) is not None:
        if not isinstance(pose, Pose):
            raise InputError(f"{who}: flange is {shown(pose)}; give a cosim.Pose")
        if not (np.isfinite(pose.rotation).all() and np.isfinite(pose.translation).all()):
            raise InstabilityError(f"{who}: flange holds a number that is not finite")
        off = float(np.abs(pose.rotation.T @ pose.rotation - np.eye(3)).max())
        if not (off <= _ROTATION and np.linalg.det(pose.rotation) > 0.0):
            raise InputError(f"{who}: flange.rotation is no rotation; its rows must be a right-handed triad")


def check_one_order_each(
    tension_N: Sequence[float | None], length_m: Sequence[float | None], cables: Sequence[str], who: str
) -> None:
    """Check that no cable is commanded twice.

    Raises:
        InputError: one is.
    """
    for name, pull, long in zip(cables, tension_N, length_m, strict=True):
        if pull is not None and long is not None:
            raise InputError(f"{who} commands both tension and length of cable '{name}'")


def checked_step(command: Any, ticks: Any, who: str) -> tuple[Command | None, int]:
    """Return the command and the ticks of a step, of which `step(5)` gives the ticks alone.

    Args:
        command: a `Command`, a number of ticks, or None.
        ticks: of the clock.
        who: is asked, for messages.

    Raises:
        InputError: they are something else, or both are numbers.
    """
    if command is not None and not isinstance(command, Command):
        if whole(ticks) != 1 or (number := whole(command)) is None:
            raise InputError(
                f"{who}: command is {shown(command)}; give a cosim.Command, or a number of ticks alone"
            )
        return None, number
    if (number := whole(ticks)) is None:
        raise InputError(f"{who}: ticks is {shown(ticks)}; must be a whole number")
    return command, number


def whole(value: Any) -> int | None:
    """Return a value as a whole number; None where it is none: neither True nor 1.0 is."""
    if isinstance(value, bool | np.bool_):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def over(values: Iterable[Value | None], others: Iterable[Value]) -> list[Value]:
    """Return values with others in place of those that are None."""
    return [other if value is None else value for value, other in zip(values, others, strict=True)]


def shown(value: Any) -> str:
    """Return a value as a message shows it: in one line, not too long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}... ({type(value).__name__})"


def _number(value: Any, place: str) -> float:
    if isinstance(value, np.ndarray) and not value.ndim:
        value = value.item()
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise InputError(f"{place} is {shown(value)}; must be a number")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{place} is beyond the largest number, 1.8e308") from None


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
    """Where a held controller is.

    Args:
        controller: the controller's own state; None before its first phase.
        held: its last command, or None.
        wait_ticks: until it is asked again.
    """

    controller: Any = None
    held: Held | None = None
    wait_ticks: int = 0


@final
class ZeroOrderHold:
    """One controller at its rate.

    Args:
        name: of the controller, for messages.
        controller: what is asked.
        period_ticks: between two questions, at least 1.
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
        """What the next tick depends on."""

    def start(self, seen: Measurement) -> None:
        """Begin again: the next tick asks the controller."""
        self.state = HoldState(self.controller.start(seen))

    def tick(self, see: Callable[[], Measurement]) -> Held:
        """Return what is commanded in the next tick.

        Args:
            see: measures; called only when the controller is asked.

        Raises:
            InputError: it commands what does not exist or what no device can do.
            InstabilityError: it commands a number that is not finite.
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


@final
@dataclass(frozen=True)
class LawState:
    """What a feedback law remembers.

    Args:
        output: the last one.
        integral: share of the output that has been integrated.
    """

    output: float
    integral: float = 0.0


class FeedbackLaw(ABC):
    """Keeps a measured quantity at its setpoint."""

    @abstractmethod
    def begin(self, output: float) -> LawState:
        """Return the state of a law that takes over at a given output."""

    @abstractmethod
    def next(self, state: LawState, error: float) -> LawState:
        """Return the state after one more sample; its `output` holds until the next.

        Args:
            state: after the last sample.
            error: setpoint minus measured value.
        """


@final
@dataclass(frozen=True)
class BangBang(FeedbackLaw):
    """Raises the output by a fixed increment while the measured value is low, lowers it while it is high.

    Source: the law of the example Hexagon_Arm_Control of the paper "cable pneumatic soft robots".

    Args:
        increment: per sample.
        band: width about the setpoint within which the output stays.
        output_min: lowest output.
        output_max: highest output.
    """

    increment: float
    band: float = 0.0
    output_min: float = 0.0
    output_max: float = math.inf

    def begin(self, output: float) -> LawState:
        return LawState(_limited(output, self.output_min, self.output_max))

    def next(self, state: LawState, error: float) -> LawState:
        if abs(error) < 0.5 * self.band or error == 0.0:
            return state
        wanted = state.output + math.copysign(self.increment, error)
        return replace(state, output=_limited(wanted, self.output_min, self.output_max))


@final
@dataclass(frozen=True)
class ProportionalIntegral(FeedbackLaw):
    """output = K_p e + I, I += K_i e h, within limits.

    Anti-windup: a sample whose output is beyond a limit does not integrate an error that pushes further out.
    Source: Astrom and Hagglund, Advanced PID Control (2006), section 3.5 (conditional integration).

    Args:
        proportional_gain: K_p, output per error.
        integral_gain_per_s: K_i, output per error and second.
        period_s: h, between samples.
        output_min: lowest output.
        output_max: highest output.
    """

    proportional_gain: float
    integral_gain_per_s: float
    period_s: float
    output_min: float = 0.0
    output_max: float = math.inf

    def begin(self, output: float) -> LawState:
        limited = _limited(output, self.output_min, self.output_max)
        return LawState(limited, limited)

    def next(self, state: LawState, error: float) -> LawState:
        integral = state.integral + self.integral_gain_per_s * self.period_s * error
        wanted = self.proportional_gain * error + integral
        output = _limited(wanted, self.output_min, self.output_max)
        windup = (wanted - output) * error > 0.0
        return LawState(output, state.integral if windup else integral)


def _limited(value: float, lowest: float, highest: float) -> float:
    return min(max(value, lowest), highest)


Quantity: TypeAlias = Literal["bending_angle_rad", "tip_height_m"]
Output: TypeAlias = Literal["cable_tension_N", "cable_shortening_m"]
MEASURE: Final[dict[str, Callable[[Measurement], float]]] = {
    "bending_angle_rad": lambda seen: seen.bending_angle_rad,
    "tip_height_m": lambda seen: float(seen.tip_position[2]),
}


@final
@dataclass(frozen=True)
class LoopState:
    """What a feedback loop remembers.

    Args:
        law: of its feedback law.
        unstretched_m: length of each cable at zero shortening; empty where tensions are commanded.
    """

    law: LawState
    unstretched_m: tuple[float, ...] = ()


@final
@dataclass(frozen=True)
class FeedbackLoop(Controller[LoopState]):
    """Moves cables so that a quantity keeps to its setpoint; all of them get the same output.

    Args:
        quantity: that is measured; a higher output is expected to raise it.
        law: from its error to the output.
        output: a tension, or how much shorter a cable is than it was at the start.
        cables: names.
    """

    quantity: Quantity
    law: FeedbackLaw
    output: Output
    cables: tuple[str, ...]

    def start(self, seen: Measurement) -> LoopState:
        if self.output == "cable_tension_N":
            return LoopState(self.law.begin(seen.cable_tension_N[self.cables[0]]))
        return LoopState(self.law.begin(0.0), tuple(seen.cable_unstretched_m[name] for name in self.cables))

    def act(self, state: LoopState, seen: Measurement) -> tuple[LoopState, Command]:
        if seen.setpoint is None:
            raise InputError(f"a feedback loop needs a setpoint for {self.quantity}; none is given")
        law = self.law.next(state.law, seen.setpoint - MEASURE[self.quantity](seen))
        after = LoopState(law, state.unstretched_m)
        if self.output == "cable_tension_N":
            return after, Command(cable_tension_N=dict.fromkeys(self.cables, law.output))
        pairs = zip(self.cables, state.unstretched_m, strict=True)
        return after, Command(cable_length_m={name: length - law.output for name, length in pairs})


@final
@dataclass(frozen=True)
class TipFollower(Controller[tuple[float, ...]]):
    """Moves the flange besides its plan, without turning it, so that the tip is where a phase has it.

    velocity = K_i e + K_p (e - e') / h: the flange is off its plan by K_p e plus the integral of K_i e.
    e is where the phase has the tip less where it was measured; e' (3,) [m], the state, that of the sample
    before.

    Args:
        proportional_gain: K_p.
        integral_gain_per_s: K_i.
        period_s: h, between samples.
    """

    proportional_gain: float
    integral_gain_per_s: float
    period_s: float

    def start(self, seen: Measurement) -> tuple[float, ...]:
        return (0.0, 0.0, 0.0)

    def act(self, state: tuple[float, ...], seen: Measurement) -> tuple[tuple[float, ...], Command]:
        if seen.tip_wanted is None:
            raise InputError("a tip follower needs a tip_path or tip_target in its phase; give it one")
        error = np.nan_to_num(seen.tip_wanted - seen.tip_position)  # free components are left alone
        velocity = self.integral_gain_per_s * error + self.proportional_gain * (error - state) / self.period_s
        return tuple(error.tolist()), Command(flange_twist=(*velocity.tolist(), 0.0, 0.0, 0.0))
