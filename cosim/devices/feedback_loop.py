"""A controller that closes one loop: a measured quantity, a feedback law, and the cables that it moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, final

from cosim.devices.controller import Command, Controller, Measurement
from cosim.devices.feedback_law import FeedbackLaw, LawState
from cosim.errors import InputError

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

    Raises:
        InputError: there are no cables.
    """

    quantity: Quantity
    law: FeedbackLaw
    output: Output
    cables: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.cables:
            raise InputError("a feedback loop needs at least one cable to move")

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
