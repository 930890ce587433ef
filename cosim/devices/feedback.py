"""Feedback: laws from an error to an output, and controllers that close one loop with them.

A controller that closes one loop: a measured quantity, a feedback law, and the cables that it moves.

A controller that leads the tip along a path by the flange's motion, from what it measures of the tip.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Controller, Measurement
from cosim.errors import InputError


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


@final
@dataclass(frozen=True)
class SensorState:
    """Errors on their way from a sensor.

    Args:
        samples: measured so far.
        waiting: the last errors, one for each sample of the delay, the oldest first.
    """

    samples: int = 0
    waiting: tuple[tuple[float, ...], ...] = ()


@final
@dataclass(frozen=True)
class SensorNoise:
    """How a sensor reads an error: setpoint minus measured value, both at the instant of the measurement.

    Args:
        noise: standard deviation of white normal noise, in the measured unit, component by component.
        delay: samples after which a measurement is read; before the first one the error is zero.
        seed: of the noise; a sample's noise depends on its number alone.
    """

    noise: float = 0.0
    delay: int = 0
    seed: int = 0

    def read(self, state: SensorState, error: Array) -> tuple[SensorState, Array]:
        """Return the state after a sample, and the error (k,) that is read.

        Args:
            state: after the last sample.
            error: (k,), true.
        """
        if self.noise > 0.0:
            drawn = np.random.default_rng((self.seed, state.samples)).normal(size=error.size)
            error = error - self.noise * drawn
        line = (*state.waiting, tuple(error.tolist()))
        late = len(line) > self.delay
        read = np.array(line[0]) if late else np.zeros(error.size)
        return SensorState(state.samples + 1, line[1:] if late else line), read


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
        sensor: of its sensor.
    """

    law: LawState
    unstretched_m: tuple[float, ...] = ()
    sensor: SensorState = SensorState()


@final
@dataclass(frozen=True)
class FeedbackLoop(Controller[LoopState]):
    """Moves cables so that a quantity keeps to its setpoint; all of them get the same output.

    Args:
        quantity: that is measured; a higher output is expected to raise it.
        law: from its error to the output.
        output: a tension, or how much shorter a cable is than it was at the start.
        cables: names.
        sensor: how the quantity is measured.
    """

    quantity: Quantity
    law: FeedbackLaw
    output: Output
    cables: tuple[str, ...]
    sensor: SensorNoise = SensorNoise()

    def start(self, seen: Measurement) -> LoopState:
        if self.output == "cable_tension_N":
            return LoopState(self.law.begin(seen.cable_tension_N[self.cables[0]]))
        return LoopState(self.law.begin(0.0), tuple(seen.cable_unstretched_m[name] for name in self.cables))

    def act(self, state: LoopState, seen: Measurement) -> tuple[LoopState, Command]:
        if seen.setpoint is None:
            raise InputError(f"a feedback loop needs a setpoint for {self.quantity}; none is given")
        sensor, (error,) = self.sensor.read(
            state.sensor, np.array([seen.setpoint - MEASURE[self.quantity](seen)])
        )
        law = self.law.next(state.law, float(error))
        after = LoopState(law, state.unstretched_m, sensor)
        if self.output == "cable_tension_N":
            return after, Command(cable_tension_N=dict.fromkeys(self.cables, law.output))
        pairs = zip(self.cables, state.unstretched_m, strict=True)
        return after, Command(cable_length_m={name: length - law.output for name, length in pairs})


@final
@dataclass(frozen=True)
class FollowerState:
    """What a tip follower remembers.

    Args:
        sensor: of its sensor.
        error: (3,) [m], the last one read.
    """

    sensor: SensorState = SensorState()
    error: tuple[float, ...] = (0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class TipFollower(Controller[FollowerState]):
    """Moves the flange besides its plan, without turning it, so that the tip is where a phase has it.

    velocity = K_i e + K_p (e - e') / h: the flange is off its plan by K_p e plus the integral of K_i e.
    e is where the phase has the tip less where it was measured, both at the instant of the measurement; e' is
    that of the sample before.

    Args:
        proportional_gain: K_p.
        integral_gain_per_s: K_i.
        period_s: h, between samples.
        sensor: how the tip's position is measured.
    """

    proportional_gain: float
    integral_gain_per_s: float
    period_s: float
    sensor: SensorNoise = SensorNoise()

    def start(self, seen: Measurement) -> FollowerState:
        return FollowerState()

    def act(self, state: FollowerState, seen: Measurement) -> tuple[FollowerState, Command]:
        if seen.tip_wanted is None:
            raise InputError("a tip follower needs a tip_path or tip_target in its phase; there is none")
        true = np.nan_to_num(seen.tip_wanted - seen.tip_position)  # free components are none of its business
        sensor, error = self.sensor.read(state.sensor, true)
        rate = self.proportional_gain * (error - state.error) / self.period_s
        velocity = self.integral_gain_per_s * error + rate
        twist = (*velocity.tolist(), 0.0, 0.0, 0.0)
        return FollowerState(sensor, tuple(error.tolist())), Command(flange_twist=twist)
