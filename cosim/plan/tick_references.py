"""What a phase asks for at each of its ticks, worked out for many ticks at once, or increments."""

from __future__ import annotations

from typing import final

from cosim.config.schema.phase import PhaseTable
from cosim.plan.joint_path import JointReference
from cosim.plan.plan import PhasePlan
from cosim.plan.ramp import Progress, progress

_TICKS = 256  # worked out at once


def ticks_of(phase: PhaseTable, tick_s: float) -> int:
    """Return how many ticks of a length [s] a phase lasts, at least one."""
    return max(1, round((phase.duration_s + phase.settle_s) / tick_s))


@final
class TickReferences:
    """References of the arm and progress of the loads, tick by tick.

    Args:
        planned: the phase.
        tick_s: length of a tick [s].
    """

    def __init__(self, planned: PhasePlan, tick_s: float) -> None:
        self.planned, self._tick_s = planned, tick_s
        self._first = 0
        self._joints: JointReference | None = None
        self._shares: list[float] = []

    @property
    def _ramp_s(self) -> float:
        """Length of the ramp [s]; a linear one ends with a tick, so that the last one is no shorter step."""
        phase, tick_s = self.planned.phase, self._tick_s
        whole = max(1, round(phase.duration_s / tick_s)) * tick_s
        return whole if phase.ramp == "linear" else phase.duration_s

    def at(self, done: int) -> tuple[JointReference, float]:
        """Return what the servos follow in a tick, and the share of the ramp at its end.

        The servos act on the error at the start of a tick, so they get the reference of that instant.

        Args:
            done: ticks of the phase at its end, at least one.
        """
        joints, place = self._worked_out(done)
        return joints.row(place), self._shares[place]

    def from_on(self, done: int, most: int | None = None) -> tuple[JointReference, list[float]]:
        """Return what `at` does for a tick and those after it that have been worked out, `most` of them."""
        joints, place = self._worked_out(done)
        end = None if most is None else place + most
        return joints.some(place, end), self._shares[place:end]

    def _worked_out(self, done: int) -> tuple[JointReference, int]:
        """Return references of many ticks, and the place of one among them."""
        place = done - 1 - self._first
        if self._joints is None or not 0 <= place < len(self._shares):
            return self._work_out((done - 1) // _TICKS * _TICKS), (done - 1) % _TICKS
        return self._joints, place

    def _work_out(self, first: int) -> JointReference:
        phase, duration_s = self.planned.phase, self._ramp_s
        instants = [
            progress(phase.ramp, tick * self._tick_s, duration_s) for tick in range(first, first + _TICKS + 1)
        ]
        self._first, self._joints = first, self.planned.joints.through(instants[:-1])
        self._shares = [instant.value for instant in instants[1:]]
        return self._joints


@final
class IncrementReferences:
    """References of the arm and progress of the loads, increment by increment.

    Args:
        planned: the phase.
    """

    def __init__(self, planned: PhasePlan) -> None:
        self.planned = planned

    def at(self, done: int) -> tuple[JointReference, float]:
        """Return where the joints are to be after so many increments, and the share of the ramp there."""
        share = done / self.planned.phase.increments
        return self.planned.joints.at(Progress(share, 0.0, 0.0)), share
