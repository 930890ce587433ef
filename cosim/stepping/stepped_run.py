"""Base class of runs: steps a plan in batches, and saves and restores its state."""

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

TOGETHER: Final = 512
"""Most steps in one call; more would not be faster."""
_SHOWN: Final = 128
"""Steps in a batch, if fewer are taken in one call: fine meshes are large."""
_SHOWN_S: Final = 0.2
"""Wall time of steps after which a smaller batch is yielded."""
_OVERLAP_CHECKS: Final = 8
"""Most checks of overlap in a phase; the last one is at its end."""
_OVERLAP_CHECK_TICKS: Final = 16
"""Least ticks between two checks of overlap."""


@final
@dataclass(frozen=True)
class Cursor:
    """Position of a run in its plan.

    Args:
        tick: number of steps taken.
        phase: index of the phase.
        done: number of steps taken in that phase.
    """

    tick: int = 0
    phase: int = 0
    done: int = 0

    def following(self, counts: Sequence[int]) -> "Cursor | None":
        """Return the end of the next step, by the numbers of steps in each phase; None at the end."""
        if self.done < counts[self.phase]:
            return Cursor(self.tick + 1, self.phase, self.done + 1)
        if self.phase + 1 < len(counts):
            return Cursor(self.tick + 1, self.phase + 1, 1)
        return None

    def later(self, steps: int) -> "Cursor":
        """Return the position some steps later in the same phase."""
        return Cursor(self.tick + steps, self.phase, self.done + steps)


@final
@dataclass(frozen=True)
class RunState:
    """State of a run, from which it continues with the same scenario.

    Args:
        cursor: position in the plan.
        soft: state of the soft side.
        parts: states of all other parts, by name.
        choices: of the model, which determine the types of states.
    """

    cursor: Cursor
    soft: Any
    parts: dict[str, Any]
    choices: Choices


class SteppedRun(ABC):
    """Steps a planned run; subclasses are its modes.

    Args:
        parts: of the run.
        stage: description of the run.
        counts: number of steps of each phase, at least one.
    """

    def __init__(self, parts: Parts, stage: RunInfo, counts: Sequence[int]) -> None:
        self._parts, self.stage, self._counts = parts, stage, tuple(counts)
        contact = next(decision for decision in stage.modelled if decision.what == CONTACT)
        self.choices = Choices.of(parts.scenario, contact)
        self._cursor: Cursor | None = None
        self._fitting = TOGETHER  # steps that take at most `_SHOWN_S`
        self._failed = False  # in a step after the last batch
        self._known = KnownStates()
        self._cameras = cameras.Cameras(parts.scenario.cameras, stage)

    @property
    def plan(self) -> Plan:
        """Plan of all phases."""
        return self._parts.plan

    @property
    def soft(self) -> SoftRobot:
        """The soft side."""
        return self._parts.soft

    @property
    def carrier(self) -> Carrier:
        """Carrier of the flange."""
        return self._parts.carrier

    @property
    def tick(self) -> int | None:
        """Steps taken so far; None before the state at rest is known."""
        return None if self._cursor is None else self._cursor.tick

    def _overlap_rows(self, to: Cursor, done: int) -> list[int]:
        """Return the rows of some ticks after which overlap of films is checked."""
        count = self._counts[to.phase]
        checks = max(1, min(_OVERLAP_CHECKS, count // _OVERLAP_CHECK_TICKS))
        rows = {-(-count * k // checks) - to.done for k in range(1, checks + 1)}
        return sorted(row for row in rows if 0 <= row < done)

    def steps(self, most: int | None = None) -> Iterator[Snapshot]:
        """Yield the state at rest, unless the run has begun, then the state after every further step.

        Between two steps the run may be saved, if it `saves_now`, or restored; the next step then follows the
        restored state.

        Args:
            most: number of states to yield; None for all.

        Raises:
            SolverError: the physics could not be solved; the snapshots so far are valid.
        """
        for batch in self.batches(1, most):
            yield from batch

    def batches(self, together: int = TOGETHER, most: int | None = None) -> Iterator[tick_batch.TickBatch]:
        """Yield the same in batches of steps of one phase, which is faster.

        Args:
            together: most steps in a batch, at least one.
            most: as in `steps`.

        Raises:
            SolverError: the physics could not be solved; the steps before it have been yielded.
        """
        gathered: list[tick_batch.TickBatch] = []
        count, spent_s, wanted = 0, 0.0, sys.maxsize if most is None else most
        try:
            while wanted:
                room = max(1, min(_SHOWN, together) - count) if gathered else together
                batch = self._some(min(room, wanted))
                if batch is None:
                    break
                gathered.append(batch)
                count, wanted = count + len(batch), wanted - len(batch)
                spent_s += float(batch.tick_wall_s.sum())
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
        """Take some steps, at least one, and return the last; the first one of a run is its state at rest.

        Raises:
            SolverError: the physics could not be solved.
        """
        for batch in self.batches(most=steps):
            last = batch
        return last.snapshot(-1)

    def command(self, command: Command, ticks: int) -> None:
        """Set a command for the next ticks; see `LiveCommands.command`."""
        self._parts.commands.command(command, ticks)
        self._forget_ahead()

    def measured(self, last: Snapshot, sensors: Sequence[str] = ()) -> Measurement:
        """Return the measurement after the last step.

        Args:
            last: snapshot of that step.
            sensors: names of sensors whose readings replace exact values.

        Raises:
            InputError: there is no such sensor.
        """
        return self._parts.measured(last.time_s, last.cable_tension_N, sensors)

    def seeded(self, last: Snapshot, seed: int) -> Snapshot:
        """Restart the sensors with a seed, and return the last snapshot with their readings."""
        return self._parts.seeded(last, seed)

    def _some(self, most: int) -> tick_batch.TickBatch | None:
        """Return the state at rest, or one or several steps; None at the end of the plan."""
        if self._cursor is None:
            began = time.perf_counter()
            try:
                first = self._start(began)
            except SolverError as error:
                raise error.at("at the start") from error.__cause__
            self._cursor, self._fitting = Cursor(), 1  # the duration of steps is unknown
            return self._cameras.filmed(first)
        to = self._cursor.following(self._counts)
        if to is None:
            return None
        batch = self._located(to, min(most, self._fitting, self._counts[to.phase] - to.done + 1))
        self._cursor = to.later(len(batch) - 1)
        if self.at_edge and (end := self._parts.soft.end_state) is not None:
            batch = replace(batch, ends={len(batch) - 1: end})
        self._fitting = max(1, int(_SHOWN_S / max(float(batch.tick_wall_s.max()), _SHOWN_S / TOGETHER)))
        return self._cameras.filmed(batch)

    def image(self, camera: str, last: Snapshot) -> CameraImage:
        """Return the image of a camera, by its name, at a snapshot.

        Raises:
            InputError: there is no such camera.
            OutputError: no driver for drawing was found.
        """
        return self._cameras.image(camera, last)

    @property
    def at_edge(self) -> bool:
        """Whether the last step is the end of its phase."""
        cursor = self._cursor
        return cursor is None or cursor.done in (0, self._counts[cursor.phase])

    def _located(self, to: Cursor, most: int) -> tick_batch.TickBatch:
        """Take steps as `_take` does; an error names its step."""
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
        """Whether no step has been taken, or begun, after the last batch."""
        return not self._failed

    @property
    @abstractmethod
    def state(self) -> Any:
        """State of the mode, in addition to soft side, carrier and commands; None before the first step."""

    @state.setter
    @abstractmethod
    def state(self, state: Any) -> None:
        """Set the state, after those of all other parts.

        Raises:
            InputError: the state does not fit.
        """

    def save_state(self) -> RunState:
        """Return the present state, which shares arrays with the run.

        Raises:
            InputError: the run has not begun, or is in the middle of a step.
        """
        if self._cursor is None:
            raise InputError("the state at rest is not known yet: take the first of steps() before saving")
        if not self.saves_now:
            raise InputError(f"a later tick than {self._cursor.tick} has begun: save before or after it")
        soft, parts = self._parts.soft.full_state, states_of(self.parts())
        saved = RunState(self._cursor, soft, parts, self.choices)
        self._known.add(saved)
        return saved

    def parts(self) -> dict[str, Any]:
        """Return the parts with a state, without the soft side, by name, see `restore_states`."""
        return {"run": self, **self._parts.carrier.parts(), **self._parts.commands.parts()}

    def restore_state(self, state: RunState) -> None:
        """Restore a state of this run, or of a run whose parts have the same sizes.

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
        """Begin a phase: its clamps, at the present pose of the flange, and its commands."""
        self._parts.plan.phases[phase].holding.apply(self._parts.soft, flange)
        self._parts.commands.begin_phase(phase)

    def _forget_ahead(self) -> None:  # noqa: B027  # not every mode computes commands ahead
        """Drop the commands of later steps."""

    @abstractmethod
    def _start(self, began: float) -> tick_batch.TickBatch:
        """Return the state at rest at the plan's start; the work on it began at `began`."""

    @abstractmethod
    def _take(self, to: Cursor, most: int) -> tick_batch.TickBatch:
        """Take up to `most` steps of a phase, at least the one that ends at `to`."""

    @abstractmethod
    def _step_of(self, to: Cursor) -> str:
        """Return the name of the step that ends at `to`."""


def whereabouts(
    phase: str, step: str, pressures_Pa: Sequence[float], tensions_N: Sequence[float], cables: Sequence[str]
) -> str:
    """Return a text with phase, step, pressures and the largest cable tension of a failed step.

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
