"""A planned run that is stepped, saved between two steps, and continued from what was saved."""

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

from cosim.base.frames import Pose
from cosim.base.state import restore_states, states_of
from cosim.base.state_checks import KnownStates, check_state, check_states
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.devices.controller import Command, Measurement
from cosim.errors import InputError, SolverError
from cosim.plan.decision import CONTACT, Choices
from cosim.plan.plan import Plan
from cosim.stepping.carrier import Carrier
from cosim.stepping.parts import Parts
from cosim.telemetry import cameras, tick_batch
from cosim.telemetry.camera_image import CameraImage
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot

_LOOKS: Final = 8
"""Looks in a phase, at most, at whether films overlap; the last one at its end."""
_LOOK_TICKS: Final = 16
"""At least between two of them."""


@final
@dataclass(frozen=True)
class Cursor:
    """Where in its plan a run is.

    Args:
        tick: steps taken in all.
        phase: index of the phase.
        done: steps taken in that phase.
    """

    tick: int = 0
    phase: int = 0
    done: int = 0

    def following(self, counts: Sequence[int]) -> "Cursor | None":
        """Return where the next step ends, with so many steps in each phase; None at the end of the plan."""
        if self.done < counts[self.phase]:
            return Cursor(self.tick + 1, self.phase, self.done + 1)
        if self.phase + 1 < len(counts):
            return Cursor(self.tick + 1, self.phase + 1, 1)
        return None

    def later(self, steps: int) -> "Cursor":
        """Return where so many steps later end, in the same phase."""
        return Cursor(self.tick + steps, self.phase, self.done + steps)


TOGETHER: Final = 512
"""Steps that may be taken in one call, where a model takes many at once: more cost no less each."""
_SHOWN: Final = 128
"""Steps that are shown together, where few are taken at once: fine meshes are large."""
_SHOWN_S: Final = 0.2
"""Wall time of steps after which they are shown, though they are fewer."""


@final
@dataclass(frozen=True)
class RunState:
    """Everything that the steps to come depend on, besides the scenario.

    Args:
        cursor: where in the plan.
        soft: state of the soft side.
        parts: states of all else, by name.
        choices: what the kind of this state follows from.
    """

    cursor: Cursor
    soft: Any
    parts: dict[str, Any]
    choices: Choices


class SteppedRun(ABC):
    """Steps a planned run.

    Args:
        parts: of the run.
        stage: its unchanging description.
        counts: steps of each phase, at least one.
    """

    def __init__(self, parts: Parts, stage: RunInfo, counts: Sequence[int]) -> None:
        self._parts, self.stage, self._counts = parts, stage, tuple(counts)
        contact = next(decision for decision in stage.modelled if decision.what == CONTACT)
        self.choices = Choices.of(parts.scenario, contact)
        self._cursor: Cursor | None = None
        self._fitting = TOGETHER  # steps that take no longer than is to pass until they are shown
        self._failed = False  # in a step after the last one shown
        self._known = KnownStates()
        self._cameras = cameras.Cameras(parts.scenario.cameras, stage)

    @property
    def plan(self) -> Plan:
        """What is commanded, phase by phase."""
        return self._parts.plan

    @property
    def soft(self) -> SoftRobot:
        """The soft side that is stepped."""
        return self._parts.soft

    @property
    def carrier(self) -> Carrier:
        """What carries the flange."""
        return self._parts.carrier

    @property
    def tick(self) -> int | None:
        """Steps taken so far; None before the state at rest is known."""
        return None if self._cursor is None else self._cursor.tick

    def _looked_at(self, to: Cursor, done: int) -> list[int]:
        """Return the rows of some ticks after which overlap of films is looked for."""
        count = self._counts[to.phase]
        looks = max(1, min(_LOOKS, count // _LOOK_TICKS))
        rows = {-(-count * k // looks) - to.done for k in range(1, looks + 1)}
        return sorted(row for row in rows if 0 <= row < done)

    def steps(self, most: int | None = None) -> Iterator[Snapshot]:
        """Yield the state at rest, unless the run has begun, then that after every step to come.

        In between the run may be saved, where it `saves_now`, or restored: the next step is the one after
        that state's.

        Args:
            most: states to yield, and steps to take for them; None for all.

        Raises:
            SolverError: the physics could not be solved; the snapshots so far stand.
        """
        for taken in self.batches(1, most):
            yield from taken

    def batches(self, together: int = TOGETHER, most: int | None = None) -> Iterator[tick_batch.TickBatch]:
        """Yield the same many steps at a time, all of one phase: this costs less.

        Args:
            together: steps that may be taken before the first of them is shown, at least one.
            most: as in `steps`.

        Raises:
            SolverError: the physics could not be solved; the steps before it have been yielded.
        """
        gathered: list[tick_batch.TickBatch] = []
        count, spent_s, wanted = 0, 0.0, sys.maxsize if most is None else most
        try:
            while wanted:
                room = max(1, min(_SHOWN, together) - count) if gathered else together
                taken = self._some(min(room, wanted))
                if taken is None:
                    break
                gathered.append(taken)
                count, wanted = count + len(taken), wanted - len(taken)
                spent_s += float(taken.tick_wall_s.sum())
                if count >= min(_SHOWN, together) or spent_s >= _SHOWN_S or self.at_edge:
                    shown, gathered, count, spent_s = gathered, [], 0, 0.0
                    yield tick_batch.TickBatch.joined(shown)
        except (Exception, KeyboardInterrupt):
            if gathered:
                self._failed = True
                yield tick_batch.TickBatch.joined(gathered)
            raise
        if gathered:
            yield tick_batch.TickBatch.joined(gathered)

    def advance(self, steps: int) -> Snapshot:
        """Take some steps, at least one, and return what is there then; the first finds the state at rest.

        Raises:
            SolverError: the physics could not be solved.
        """
        for taken in self.batches(most=steps):
            last = taken
        return last.snapshot(-1)

    def command(self, command: Command, ticks: int) -> None:
        """Take up a command for the ticks to come; see `LiveCommands.command`."""
        self._parts.commands.command(command, ticks)
        self._forget_ahead()

    def measured(self, last: Snapshot, sensors: Sequence[str] = ()) -> Measurement:
        """Return what is measured of the run after its last step, which a snapshot shows.

        Args:
            last: that snapshot.
            sensors: names of those whose readings take the place of the truth.

        Raises:
            InputError: there is no such sensor.
        """
        return self._parts.measured(last.time_s, last.cable_tension_N, sensors)

    def seeded(self, last: Snapshot, seed: int) -> Snapshot:
        """Let the sensors begin with a seed after the last step, and return its snapshot with them."""
        return self._parts.seeded(last, seed)

    def _some(self, most: int) -> tick_batch.TickBatch | None:
        """Find the state at rest, or take up to so many steps, at least one; None at the end of the plan."""
        if self._cursor is None:
            began = time.perf_counter()
            try:
                first = self._start(began)
            except SolverError as error:
                raise error.at("at the start") from error.__cause__
            self._cursor, self._fitting = Cursor(), 1  # until it is known how long steps take
            return self._cameras.filmed(first)
        to = self._cursor.following(self._counts)
        if to is None:
            return None
        taken = self._located(to, min(most, self._fitting, self._counts[to.phase] - to.done + 1))
        self._cursor = to.later(len(taken) - 1)
        if self.at_edge and (end := self._parts.soft.end_state) is not None:
            taken = replace(taken, ends={len(taken) - 1: end})
        self._fitting = max(1, int(_SHOWN_S / max(float(taken.tick_wall_s.max()), _SHOWN_S / TOGETHER)))
        return self._cameras.filmed(taken) if self.stage.cameras else taken

    def image(self, camera: str, last: Snapshot) -> CameraImage:
        """Return what a camera sees, by its name, in a snapshot.

        Raises:
            InputError: there is no such camera.
            OutputError: nothing can draw here.
        """
        return self._cameras.image(camera, last)

    @property
    def at_edge(self) -> bool:
        """Whether no further step of the phase of the last one is to come."""
        cursor = self._cursor
        return cursor is None or cursor.done in (0, self._counts[cursor.phase])

    def _located(self, to: Cursor, most: int) -> tick_batch.TickBatch:
        """Take steps as `_take` does; an error says in which of them it was raised."""
        parts, planned = self._parts, self._parts.plan.phases[to.phase]
        try:
            with parts.soft.searching(f"phase.{planned.phase.name}, {self._step_of(to)}"):
                return self._take(to, most)
        except SolverError as error:
            tensions = parts.commands.cable_tension_N(to.phase, to.done)
            pressures, names = parts.soft.pressures_Pa, parts.scenario.soft_robot.cable_names()
            where = whereabouts(planned.phase.name, self._step_of(to), pressures, tensions, names)
            raise error.at(where) from error.__cause__

    @property
    def saves_now(self) -> bool:
        """Whether no step has been taken, or begun, beyond the one shown last."""
        return not self._failed

    @property
    @abstractmethod
    def state(self) -> Any:
        """What the steps to come depend on besides soft side, carrier and commands; None before the first."""

    @state.setter
    @abstractmethod
    def state(self, state: Any) -> None:
        """Set it, after all the rest.

        Raises:
            InputError: the state does not fit.
        """

    def save_state(self) -> RunState:
        """Return the present state; costs little, as arrays are shared.

        Raises:
            InputError: the run has not begun, or is in the middle of a step.
        """
        if self._cursor is None:
            raise InputError("a run can be saved once its state at rest is known: take the first of steps()")
        if not self.saves_now:
            raise InputError(f"a later tick than {self._cursor.tick} has been begun: save before or after it")
        soft, parts = self._parts.soft.full_state, states_of(self.parts())
        saved = RunState(self._cursor, soft, parts, self.choices)
        self._known.add(saved)
        return saved

    def parts(self) -> dict[str, Any]:
        """Return what the steps to come depend on besides the soft side, by name, see `restore_states`."""
        return {"run": self, **self._parts.carrier.parts(), **self._parts.commands.parts()}

    def restore_state(self, state: RunState) -> None:
        """Return to a state of `save_state`, of this run or of one whose parts have the same sizes.

        Raises:
            InputError: the state does not fit.
        """
        known = state in self._known
        if not known:
            state.choices.check(self.choices)
            self._check_place(state.cursor)
            check_state(state, None, RunState)
        states = self._parts.carrier.completed(state.parts)
        if not known:
            sizes = dict[str, int]()
            check_state(state.soft, self._parts.soft.full_state, place="state.soft", sizes=sizes)
            check_states(self.parts(), states, "state", sizes)
        self._failed = False
        self._parts.soft.full_state = state.soft
        restore_states(self.parts(), states)
        self._cursor = state.cursor
        self._known.add(state)

    def _check_place(self, cursor: Cursor) -> None:
        check_state(cursor, None, Cursor, place="state.cursor")
        counts = self._counts
        if not (0 <= cursor.phase < len(counts) and 0 <= cursor.done <= counts[cursor.phase]):
            raise InputError(
                f"the saved state is at step {cursor.done} of phase {cursor.phase + 1}; here the phases have "
                f"{', '.join(map(str, counts))} steps"
            )
        if cursor.tick != sum(counts[: cursor.phase]) + cursor.done:
            raise InputError(f"the saved state is at step {cursor.tick}, which is not {cursor}")

    def _begin_phase(self, phase: int, flange: Pose) -> None:
        """Change what is held and what is asked for, with the flange where it is."""
        self._parts.plan.phases[phase].holding.apply(self._parts.soft, flange)
        self._parts.commands.begin_phase(phase)

    def _forget_ahead(self) -> None:  # noqa: B027  # not every mode works anything out
        """Forget what has been worked out of the steps to come."""

    @abstractmethod
    def _start(self, began: float) -> tick_batch.TickBatch:
        """Bring everything to rest where the plan starts; `began` is when the work on it did."""

    @abstractmethod
    def _take(self, to: Cursor, most: int) -> tick_batch.TickBatch:
        """Take steps of a phase, the first of which ends at `to`: at least that, and up to so many."""

    @abstractmethod
    def _step_of(self, to: Cursor) -> str:
        """Return what the step that ends at `to` is called."""


def whereabouts(
    phase: str, step: str, pressures_Pa: Sequence[float], tensions_N: Sequence[float], cables: Sequence[str]
) -> str:
    """Return phase, step, pressures and the largest cable tension of a step that has failed.

    Args:
        phase: its name.
        step: which tick or increment.
        pressures_Pa: of the chambers, gauge, before the step.
        tensions_N: planned at its end, or as devices drive them.
        cables: their names.
    """
    low, high = 1e-3 * min(pressures_Pa), 1e-3 * max(pressures_Pa)
    parts = [f"phase '{phase}'", step, f"{low:.4g} kPa" if low == high else f"{low:.4g} to {high:.4g} kPa"]
    largest = max(tensions_N, default=0.0)
    if largest > 0.0:
        parts.append(f"cable {cables[tensions_N.index(largest)]} at {largest:.4g} N")
    elif tensions_N:
        parts.append("cables slack")
    return ", ".join(parts)
