"""Ends of a run's phases, and the film's motion between them, for studies of the finished run."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.solve.branching import WHOLE, Branching
from cosim.telemetry.tick_batch import TickBatch

_JUMP: Final = 0.05
"""Motion of the tip in a snap, over the length: with less, the figures of the phase have error bars."""
_LEAST_ROWS: Final = 256
BRANCHES: Final = "the soft robot branches in it, and figures jump there"
SNAPS: Final = "the soft robot snaps at its end, and figures jump there"
TOUCHES: Final = "the soft robot touches the scene, and contact with it is not modelled on the refined mesh"


@final
@dataclass(frozen=True)
class PhaseEnd:
    """The end of a phase.

    Args:
        phase: its index.
        tick: count of ticks there.
        state: of the soft side, see `SoftRobot.end_state`.
        why_not: why figures there have no error bars; empty if the run knows no reason.
    """

    phase: int
    tick: int
    state: Any
    why_not: str = ""


@final
@dataclass(frozen=True)
class PhaseEnds:
    """Ends of phases so far.

    Args:
        ends: of the phases that have ended, in order.
        moments: (rows, m, 3) [kg^1/2 m] of the film's shape, a row for the state at rest and for each tick,
            see `ShapeMoments`; (0, 0, 3) if its motion is unknown.
        branches: whether the soft robot has branched in the present phase.
        cpu_s: processor time of the run.
    """

    ends: tuple[PhaseEnd, ...] = ()
    moments: Annotated[Array, ("*", "*", 3)] = field(default_factory=lambda: np.zeros((0, 0, 3)))
    branches: bool = False
    cpu_s: float = 0.0


@final
class PhaseEndsBuilder:
    """Gathers ends of phases from ticks in order.

    Args:
        moves: whether the film's motion is gathered: in dynamic runs with a film that is not rigid.
    """

    def __init__(self, *, moves: bool) -> None:
        self._moves, self._began = moves, time.process_time()
        self._ends: list[PhaseEnd] = []
        self._moments, self._known = np.zeros((0, 0, 3)), 0
        self._branches, self._before_s = False, 0.0

    @property
    def state(self) -> PhaseEnds:
        """Ends so far, without a copy: later ticks are written behind the view."""
        cpu_s = self._before_s + time.process_time() - self._began
        return PhaseEnds(tuple(self._ends), self._moments[: self._known], self._branches, cpu_s)

    @state.setter
    def state(self, state: PhaseEnds) -> None:
        self._ends, self._known = list(state.ends), 0
        self._branches, self._before_s, self._began = state.branches, state.cpu_s, time.process_time()
        self._add(state.moments)

    def observe(self, batch: TickBatch) -> None:
        """Add ticks of one phase."""
        if self._moves:
            self._add(batch.film.moments())
        self._branches |= any(self._jumps(batch, row, passed) for row, passed in batch.branchings.items())
        for row, state in batch.ends.items():
            why_not = self._why_not(batch, row)
            self._ends.append(PhaseEnd(int(batch.phase[row]), int(batch.tick[row]), state, why_not))
            self._branches = False

    def _add(self, moments: Array) -> None:
        known, needed = self._known, self._known + len(moments)
        if len(self._moments) < needed or self._moments.shape[1:] != moments.shape[1:]:
            # by halves more: a run may be planned for far more ticks than are ever taken
            grown = np.empty((needed + max(_LEAST_ROWS, needed // 2), *moments.shape[1:]))
            if known:
                grown[:known] = self._moments[:known]
            self._moments = grown
        self._moments[known:needed] = moments
        self._known = needed

    def _why_not(self, batch: TickBatch, row: int) -> str:
        """Return why figures at the end of a phase have no error bars; empty if the run knows no reason."""
        stability = batch.stability.get(row)
        if batch.slides[row]:
            return SNAPS
        if batch.contacts[row]:
            return TOUCHES
        if stability is not None and (kind := stability.stability(())) != "stable":
            return f"the soft robot is {kind} at its end, where a small difference may move it far"
        return BRANCHES if self._branches else ""

    @staticmethod
    def _jumps(batch: TickBatch, row: int, passed: Sequence[Branching]) -> bool:
        length_m = float(batch.film.figures.center_line_m[row])
        return any(jumps(each, length_m) for each in passed)


def jumps(passed: Branching, length_m: float) -> bool:
    """Return whether more than a wrinkle moves: the body branches, or snaps farther than any error bar.

    Args:
        passed: branching in a tick.
        length_m: of the soft robot at its end.
    """
    before, after = passed.other_tip_m, passed.tip_m
    if passed.extent < WHOLE or not passed.snap or before is None or after is None:
        return passed.extent >= WHOLE
    return math.dist(before, after) >= _JUMP * length_m
