"""Joint references and load factors of a phase, tick by tick (computed for many ticks at once) or increment
by increment.
"""

from typing import final

from cosim.plan.joint_path import JointReference
from cosim.plan.plan import PhasePlan
from cosim.plan.ramp import Progress, progress

_TICKS = 256  # computed at once


@final
class TickReferences:
    """Joint references and load factors of a phase, tick by tick.

    Args:
        planned: the phase.
        tick_s: length of a tick [s].
    """

    def __init__(self, planned: PhasePlan, tick_s: float) -> None:
        self.planned, self._tick_s = planned, tick_s
        self._first = 0
        self._joints: JointReference | None = None
        self._factors: list[float] = []

    @property
    def _ramp_s(self) -> float:
        """Duration of the ramp [s]; a linear one ends with a tick, so that all its steps are equal."""
        phase, tick_s = self.planned.phase, self._tick_s
        whole = max(1, round(phase.duration_s / tick_s)) * tick_s
        return whole if phase.ramp == "linear" else phase.duration_s

    def at(self, done: int) -> tuple[JointReference, float]:
        """Return the joint reference at the start of a tick, and the load factor at its end.

        The servos act on the error at the start of a tick, so they get the reference of that instant.

        Args:
            done: ticks of the phase at the end of this one, at least one.
        """
        joints, row = self._computed(done)
        return joints.row(row), self._factors[row]

    def from_on(self, done: int, most: int | None = None) -> tuple[JointReference, list[float]]:
        """Return the values of `at` for a tick and the following ones that are computed, at most `most`."""
        joints, row = self._computed(done)
        end = None if most is None else row + most
        return joints.some(row, end), self._factors[row:end]

    def _computed(self, done: int) -> tuple[JointReference, int]:
        """Return references of many ticks, and the row of one tick."""
        row = done - 1 - self._first
        if self._joints is None or not 0 <= row < len(self._factors):
            return self._compute((done - 1) // _TICKS * _TICKS), (done - 1) % _TICKS
        return self._joints, row

    def _compute(self, first: int) -> JointReference:
        phase, duration_s = self.planned.phase, self._ramp_s
        instants = [
            progress(phase.ramp, tick * self._tick_s, duration_s) for tick in range(first, first + _TICKS + 1)
        ]
        self._first, self._joints = first, self.planned.joints.through(instants[:-1])
        self._factors = [instant.value for instant in instants[1:]]
        return self._joints


@final
class IncrementReferences:
    """Joint references and load factors of a phase, increment by increment.

    Args:
        planned: the phase.
    """

    def __init__(self, planned: PhasePlan) -> None:
        self.planned = planned

    def at(self, done: int) -> tuple[JointReference, float]:
        """Return the joint reference and the load factor after `done` increments."""
        load_factor = done / self.planned.phase.increments
        return self.planned.joints.at(Progress(load_factor, 0.0, 0.0)), load_factor
