"""Steps a scenario by hand; it can be saved, restored and branched between two ticks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, final, overload

from cosim.app import preparation
from cosim.app.checkpoint import Checkpoint
from cosim.app.shown_state import check_shown, naming
from cosim.base import kept_parts, state_file
from cosim.base.state_checks import check_state
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import checked_step, whole
from cosim.devices.live.live_values import WHO
from cosim.errors import InputError
from cosim.plan.decision import Choices
from cosim.results.result_builder import result_of
from cosim.stepping.stepped_run import RunState
from cosim.telemetry.camera_image import CameraImage
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

if TYPE_CHECKING:
    from cosim.build.given_body import AnyBody
    from cosim.devices.controller import AnyController, Command, Measurement
    from cosim.stepping.stepped_run import SteppedRun


@final
@dataclass(frozen=True, repr=False)
class SavedState(state_file.WrittenState):
    """A simulation between two ticks; made by `Simulation.save`.

    Args:
        _run: the state that the ticks to come depend on, with arrays that the simulation shares.
        snapshot: of that state.
    """

    _run: Any
    snapshot: Snapshot

    @property
    def _ticks(self) -> int:
        return self.snapshot.tick

    def __repr__(self) -> str:
        """Return one line: its time."""
        return f"SavedState after tick {self.snapshot.tick}, at {self.snapshot.time_s:g} s"


@final
@dataclass(frozen=True)
class _Beginning:
    """Where a simulation began.

    Args:
        scenario: that it was made with.
        run: built from that.
        saved: state before the first tick.
    """

    scenario: Scenario
    run: SteppedRun
    saved: SavedState


@final
@dataclass(frozen=True)
class _Pickled:
    """What a pickled simulation has in addition to where it began.

    Args:
        given: start that its user passed.
        changed: scenario since the last reset; None: the one it was made with.
        present: state.
    """

    given: SavedState | str | Path | None
    changed: Scenario | None
    present: SavedState


@final
class Simulation:
    """A scenario that is stepped by hand; a pickled simulation continues bit-identically.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        overrides: values by key path, such as {"phase.lift.cable_tension_N": [...]}.
        start: what to continue from instead of the state at rest: a saved state, a file of one, or the
            checkpoint.npz of a run. The scenario may differ from the one that was saved, as long as bodies,
            joints and nodes are as many; what differs acts from the next tick on.
        controllers: the scenario's controllers of kind "python", by name.
        body: a soft body in place of the scenario's soft robot.
        kept: parts of other simulations of this process. Those that fit are used again, others are made and
            added, in resets and branches as well. Results are bit-identical; the more fits, the faster the
            start.

    Raises:
        InputError: the scenario is wrong, asks for what cannot be reached, or `start` does not fit.
        SolverError: there is no state at rest to start from.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        overrides: Mapping[str, Any] | None = None,
        start: SavedState | str | Path | None = None,
        controllers: Mapping[str, AnyController] | None = None,
        body: AnyBody | None = None,
        kept: kept_parts.KeptParts | None = None,
    ) -> None:
        self._controllers, self._body = controllers and dict(controllers), preparation.named_body(body)
        self._kept = kept_parts.KeptParts(on_disk=True) if kept is None else kept
        self._given = start
        self._begin(scenario, overrides, start)
        self._began = _Beginning(self.scenario, self._run, self.save())

    def _begin(
        self,
        scenario: str | Path | Scenario,
        overrides: Mapping[str, Any] | None,
        start: SavedState | str | Path | None,
    ) -> None:
        """Build a scenario and restore its start."""
        self.scenario = load_scenario(scenario, overrides, self._body and self._body.table())
        before = start._run.choices if isinstance(start, SavedState) else None
        self._run = self._built(before)
        if start is None:
            self._snapshot = self._run.advance(1)
            return
        saved = _read(start)
        # a file's content is readable once something like it has been built
        if saved._run.choices.contact not in self.stage.modelled:
            self._run = self._built(saved._run.choices)
        self.restore(start)

    def _built(self, before: Choices | None) -> SteppedRun:
        body = self._body and self._body.body
        given = self._controllers, before, body, preparation.log, self._kept
        return preparation.build_simulation(self.scenario, *given)

    @property
    def stage(self) -> RunInfo:
        """Everything that does not change during the run."""
        return self._run.stage

    @property
    def snapshot(self) -> Snapshot:
        """The present state."""
        return self._snapshot

    @property
    def ticks_left(self) -> int:
        """Ticks to the end of the scenario."""
        return self.stage.ticks - self._snapshot.tick

    @overload
    def step(self, ticks: int = 1, /) -> Snapshot: ...
    @overload
    def step(self, command: Command | None = None, /, *, ticks: int = 1) -> Snapshot: ...
    def step(self, command: Command | int | None = None, /, *, ticks: int = 1) -> Snapshot:
        """Advance by some ticks and return the new state; `step(5)` is `step(ticks=5)`.

        Args:
            command: for the robot: its values are reached evenly within these ticks and then held; omitted
                values stay as last commanded; see `Command`.
            ticks: of the clock.

        Raises:
            InputError: the scenario ends earlier, or the command names something that does not exist; the
                state is unchanged.
            SolverError: the physics could not be solved; the simulation is in the state before that tick, as
                after any other error, such as one of a controller. `result` of the error holds the arrays of
                the solved ticks of this call.
            KeyboardInterrupt: of the user; the simulation is in the state before all these ticks.
        """
        command, ticks = checked_step(command, ticks, WHO)
        least = int(command is not None)
        if not least <= ticks <= self.ticks_left:
            raise InputError(
                f"{ticks} ticks were asked for; the scenario has {self.ticks_left} left"
                + (f"; give {least} at least" if ticks < least else "")
            )
        if not ticks:
            return self._snapshot
        before = self._run.save_state()
        self._command(command, ticks)
        try:
            self._snapshot = self._run.advance(ticks)
        except Exception as error:
            # solving the solved ticks again is cheaper than saving the state before each of them
            solved = (self._run.tick or 0) - self._snapshot.tick
            self._run.restore_state(before)
            self._command(command if solved else None, ticks)
            frames_per_s = self.scenario.recording.frames_per_s
            vars(error)["result"] = result_of(self.stage, frames_per_s, self._again(solved), error)
            raise
        except KeyboardInterrupt:  # in the middle of anything
            self._run.restore_state(before)
            raise
        return self._snapshot

    def measure(self, sensors: Sequence[str] = ()) -> Measurement:
        """Return a measurement of the present state, without noise but for the readings of sensors.

        Args:
            sensors: names of sensors whose readings replace exact values.

        Raises:
            InputError: there is no such sensor.
        """
        return self._run.measured(self._snapshot, sensors)

    def _command(self, command: Command | None, ticks: int) -> None:
        if command is not None:
            self._run.command(command, ticks)

    def _again(self, ticks: int) -> Iterator[TickBatch]:
        """Yield the present state, then ticks that were solved before."""
        yield self._snapshot.table
        for batch in self._run.batches(most=ticks):
            self._snapshot = batch.snapshot(-1)
            yield batch

    def save(self) -> SavedState:
        """Return the present state; it costs little, and saving has no effect on the ticks to come."""
        return SavedState(self._run.save_state(), self._snapshot.kept())

    def restore(self, saved: SavedState | str | Path) -> None:
        """Restore a saved state, that of a file, or a run's checkpoint.npz.

        Args:
            saved: what `save` has returned, or a file's path.

        Raises:
            InputError: the file cannot be read, or the state does not fit this scenario.
        """
        state = _read(saved)
        if isinstance(saved, SavedState):
            self._run.restore_state(state._run)
        else:
            with naming(Path(saved)):
                check_shown(state.snapshot, self.stage)
                self._run.restore_state(state._run)
        self._snapshot = state.snapshot

    def image(self, camera: str) -> CameraImage:
        """Return the present image of a camera.

        Args:
            camera: its name in the scenario.

        Raises:
            InputError: there is no such camera.
            OutputError: no driver for drawing was found.
        """
        return self._run.image(camera, self._snapshot)

    def seed_sensors(self, seed: int) -> Snapshot:
        """Restart the sensors with other noise, and return the present snapshot with their readings.

        Args:
            seed: from 0 to 2^31 - 1, in addition to the seeds of the scenario's sensors; a new run has 0.

        Raises:
            InputError: the seed is out of these bounds.
        """
        if (number := whole(seed)) is None or not 0 <= number < 2**31:
            raise InputError(f"seed is {seed!r}; must be a whole number from 0 to {2**31 - 1}")
        self._snapshot = self._run.seeded(self._snapshot, number)
        return self._snapshot

    def reset(
        self, start: SavedState | str | Path | None = None, changes: Mapping[str, Any] | None = None
    ) -> Snapshot:
        """Restart with the scenario that the simulation was made with, and return the new state.

        The next ticks are bit-identical to those of a new simulation of that scenario and start. Only the
        noise of sensors is random, see `seed_sensors`; for random scenarios, draw `changes`.

        Args:
            start: what to continue from; None: the start of this simulation.
            changes: values by key path that apply until the next reset, such as {"clock.tick_s": 1e-3}; a
                simulation that began at rest then begins at the changed scenario's state at rest.

        Raises:
            InputError: a change is wrong or asks for what cannot be reached, or `start` does not fit; the
                state is unchanged.
            SolverError: there is no state at rest to start from; the same.
        """
        began, present = self._began, (self.scenario, self._run)
        try:
            if changes is None or (isinstance(changes, Mapping) and not changes):
                self.scenario, self._run = began.scenario, began.run
                self.restore(began.saved if start is None else start)
            else:
                self._begin(began.scenario, changes, self._given if start is None else start)
        except BaseException:
            self.scenario, self._run = present
            raise
        return self._snapshot

    def branch(self, overrides: Mapping[str, Any] | None = None) -> Simulation:
        """Return a second simulation in the same state, with a scenario that may differ; see `start`.

        Args:
            overrides: values by key path.

        Raises:
            InputError: the changed scenario is wrong, or the present state does not fit it.
        """
        given: dict[str, Any] = {"controllers": self._controllers, "body": self._body, "kept": self._kept}
        return Simulation(self.scenario, overrides=overrides, start=self.save(), **given)

    def __repr__(self) -> str:
        """Return one line: scenario, mode and time."""
        stage, last = self.stage, self._snapshot
        of = "" if self.scenario.endless else f" of {stage.ticks}"
        when = f"tick {last.tick}{of}, {last.time_s:g} s"
        return f"Simulation of {stage.scenario}, {stage.mode}: {when}"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make the simulation again, from where it began, and its present state."""
        began = self._began
        changed = None if self.scenario is began.scenario else self.scenario
        given: dict[str, Any] = {"controllers": self._controllers, "body": self._body}
        make = partial(Simulation, began.scenario, start=began.saved, **given)
        return make, (), _Pickled(self._given, changed, self.save())

    def __setstate__(self, state: _Pickled) -> None:
        """Restore the pickled state."""
        self._given = state.given
        if state.changed is None:
            self.restore(state.present)
        else:
            self._begin(state.changed, None, state.present)


def stepped_run(simulation: Simulation) -> SteppedRun:
    """Return the run that a simulation steps, for other modules of cosim."""
    return simulation._run


def _read(saved: SavedState | str | Path) -> SavedState:
    """Return a saved state, that of a file, or of a run's checkpoint.

    Raises:
        InputError: the file cannot be read, or holds something else.
    """
    state = state_file.load(Path(saved)) if isinstance(saved, str | Path) else saved
    if isinstance(state, Checkpoint):
        state = SavedState(state.run, state.summary.seen)
    if not isinstance(state, SavedState) or not isinstance(state._run, RunState):
        raise InputError(f"{saved}: holds a {type(state).__name__}, not the state of a simulation")
    if state is not saved:
        check_state(state._run.choices, None, Choices, place=f"{saved}: choices")
    return state
