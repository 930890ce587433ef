"""The record of a change from one model of the soft robot to another, and when the section model holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, final

from cosim.base.frames import Array

Model: TypeAlias = Literal["section", "film"]

FADE_S: Final = 0.2
"""In which the forces that bridge both models fade; about half a swing of an arm."""
FADE_INCREMENTS: Final = 10
"""The same in statics."""
INSIDE: Final = 0.9
"""Share of the section model's range that the film must be within for the section model to take back."""
HOLDING: Final = 0.6
"""Share of the range of bending at which copies that touch something are left to the film.

The pads of a chain do not dent, so heavy objects slide off them long before a finger has left its range."""
HOLDING_LOOK_S: Final = 0.1
"""Simulated time between two looks at that."""
MOST_TIP_M, MOST_WRENCH = 5e-4, 0.05
"""Jump and gap beyond which the section model does not take back."""
MOST_BRIDGED: Final = 0.25
"""Gap of the wrench up to which it is bridged; beyond, the wrench jumps by it."""
LOOK_S: Final = 0.02
"""Simulated time between two looks at where in that range the film is; in statics every increment."""
_LOOKS, _LOOKS_MAX = 5, 80
_SOON_S, _SOON_INCREMENTS = 1.0, 20


@final
@dataclass(frozen=True)
class Handover:
    """One change of the model that represents the soft robot.

    Both models take the last tick before it from the same state, with the forces that bridge them; jumps and
    gaps are what they differ by at its end. Gaps up to `MOST_BRIDGED` are bridged as well: the flange feels
    them later.

    Args:
        tick: the first that the new model takes; 0: the run begins with it.
        to: the new model.
        why: why.
        tip_jump_m: of the tip.
        force_gap_N: of the force on the flange.
        wrench_gap: of the wrench on the flange over its size, at least the soft robot's weight; not a number
            where the tick could not be taken by both.
        kinetic_jump_J: of the kinetic energy.
        pressure_jump_Pa: of the gas in the first chamber, where it is sealed.
        touched_gap_N: of the force on the object that copies hold, at rest; 0 where they hold none.
    """

    tick: int
    to: Model
    why: str
    tip_jump_m: float = 0.0
    force_gap_N: float = 0.0
    wrench_gap: float = 0.0
    kinetic_jump_J: float = 0.0
    pressure_jump_Pa: float = 0.0
    touched_gap_N: float = 0.0


@final
class TakenOver(Exception):  # noqa: N818  # nothing has failed
    """The film has taken over within a tick, of which what it touches is to be found again.

    Args:
        off: (n, 3) [m], how far the film's nodes lie off those that the chain has touched with.
    """

    def __init__(self, off: Array) -> None:
        super().__init__("the film has taken over")
        self.off = off


@final
@dataclass(frozen=True)
class BridgeEnd:
    """Where the forces that bridged a change have faded.

    Args:
        tick: the last in which they acted.
        work_J: that they have done on the soft robot.
    """

    tick: int
    work_J: float


@final
@dataclass(frozen=True)
class Inside:
    """How long the film has been well within the range of the section model.

    Args:
        looks: in a row that found it there.
        wanted: after which the section model takes back; more where it has left again soon.
        since: ticks since the last change.
    """

    looks: int = 0
    wanted: int = _LOOKS
    since: int = 0

    def left(self, step_s: float) -> Inside:
        """Return it after the section model has left its range, in steps of some length [s]; 0: statics."""
        soon = _SOON_INCREMENTS if step_s == 0.0 else math.ceil(_SOON_S / step_s)
        wanted = min(_LOOKS_MAX, 2 * self.wanted) if self.since < soon else _LOOKS
        return Inside(wanted=wanted)

    def taken_back(self) -> Inside:
        """Return it where the section model has just taken over."""
        return Inside(wanted=self.wanted)

    def refused(self) -> Inside:
        """Return it where the section model could not take over."""
        return replace(self, looks=0, wanted=min(_LOOKS_MAX, 2 * self.wanted))

    def looked(self, inside: bool) -> Inside:
        """Return it after a look."""
        return replace(self, looks=self.looks + 1 if inside else 0)

    @property
    def due(self) -> bool:
        """Whether the section model is to take back."""
        return self.looks >= self.wanted


def look_every(step_s: float, look_s: float = LOOK_S) -> int:
    """Return after how many steps of some length [s] it is looked where the film is; 0 s: statics."""
    return 1 if step_s == 0.0 else max(1, round(look_s / step_s))


def fade_steps(step_s: float) -> int:
    """Return in how many steps of some length [s] bridging forces fade; 0 s: statics."""
    return FADE_INCREMENTS if step_s == 0.0 else max(1, math.ceil(FADE_S / step_s))
