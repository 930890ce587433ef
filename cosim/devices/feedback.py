"""Controllers that cosim includes: bang-bang and proportional-integral laws from an error to an output, loops
that move cables with such a law, and a loop that moves the flange so that the tip follows its path.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, final

import numpy as np

from cosim.devices.controller import Command, Controller, Measurement
from cosim.errors import InputError

Quantity: TypeAlias = Literal["bending_angle_rad", "tip_height_m"]
Output: TypeAlias = Literal["cable_tension_N", "cable_shortening_m"]
MEASURE: Final[dict[str, Callable[[Measurement], float]]] = {
    "bending_angle_rad": lambda seen: seen.bending_angle_rad,
    "tip_height_m": lambda seen: float(seen.tip_position[2]),
}


@final
@dataclass(frozen=True)
class LawState:
    """State of a feedback law.

    Args:
        output: the last output.
        integral: integral part of the output.
    """

    output: float
    integral: float = 0.0


class FeedbackLaw(ABC):
    """Keeps a measured quantity at its setpoint."""

    @abstractmethod
    def begin(self, output: float) -> LawState:
        """Return the state of a law that starts from a given output."""

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
class LoopState:
    """State of a feedback loop.

    Args:
        law: state of its feedback law.
        unstretched_m: length of each cable at zero shortening; empty if tensions are commanded.
    """

    law: LawState
    unstretched_m: tuple[float, ...] = ()


@final
@dataclass(frozen=True)
class FeedbackLoop(Controller[LoopState]):
    """Moves cables so that a quantity stays at its setpoint; all of them get the same output.

    Args:
        quantity: the measured quantity; a higher output must raise it.
        law: from its error to the output.
        output: "cable_tension_N", or "cable_shortening_m": decrease of the length since the start.
        cables: names of the cables.
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
    """Translates the flange in addition to its plan, so that the tip is on the phase's path or target.

    velocity = K_i e + K_p (e - e') / h: the flange's offset is K_p e plus the integral of K_i e. e is the
    tip's target minus its measured position; e' (3,) [m], the state, is that of the previous sample.

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
        error = np.nan_to_num(seen.tip_wanted - seen.tip_position)  # free components have no error
        velocity = self.integral_gain_per_s * error + self.proportional_gain * (error - state) / self.period_s
        return tuple(error.tolist()), Command(flange_twist=(*velocity.tolist(), 0.0, 0.0, 0.0))
