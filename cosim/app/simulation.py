"""A scenario stepped by hand: saved, restored and branched between two ticks; many at once.

A `Batch` has its runs in processes: each is bit for bit what it would be alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypeVar, final, overload

from cosim.app import checkpoint, preparation
from cosim.app.workers import Workers
from cosim.base import kept_parts, state_file
from cosim.base.state_checks import check_state
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import checked_step, shown, whole
from cosim.devices.live.live_values import WHO
from cosim.errors import InputError
from cosim.plan.decision import Choices
from cosim.results.result import result_of
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
        """Return one line: where the simulation is."""
        return f"SavedState after tick {self.snapshot.tick}, at {self.snapshot.time_s:g} s"


@final
class Simulation:
    """A scenario that is stepped by hand; a pickled one continues bit-identically.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        overrides: values by key path, such as {"phase.lift.cable_tension_N": [...]}.
        start: what to continue from instead of the state at rest: a saved state, a file of one, or the
            checkpoint.npz of a run. The scenario may differ from the one that was saved, as long as bodies,
            joints and nodes are as many; what differs acts from the next tick on.
        controllers: the scenario's controllers of kind "python", by name.
        body: a soft body in place of the scenario's soft robot.
        kept: parts of other simulations of this process: those that fit are taken, others made and added, by
            its resets and branches too. The results are bit-identical, and it starts faster the more fits.

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
        self._made = self.scenario, self._run, self.save()

    def _begin(
        self,
        scenario: str | Path | Scenario,
        overrides: Mapping[str, Any] | None,
        start: SavedState | str | Path | None,
    ) -> None:
        """Build a scenario and go to where it starts."""
        loaded = load_scenario(scenario, overrides, self._body and self._body.table())
        self.scenario = preparation.prepared(loaded, preparation.log, kept=self._kept)
        before = start._run.choices if isinstance(start, SavedState) else None
        self._run = self._built(before)
        if start is None:
            self._snapshot = self._run.advance(1)
            return
        saved = _read(start)
        # what is in a file can be read once something like it has been built
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
        """The present state, as it shows itself."""
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
            command: to the robot from here on: values are reached evenly within these ticks and
                held then, values that it leaves out stay as commanded last; see `Command`.
            ticks: of the clock.

        Raises:
            InputError: the scenario ends before, or the command asks for what there is not; no trace is left.
            SolverError: the physics could not be solved; the simulation is where it was before that tick, as
                it is after whatever else is raised, such as by a controller. `result` of the error holds the
                arrays of the ticks of this call that were solved.
            KeyboardInterrupt: of the user; the simulation is where it was before all these ticks.
        """
        command, ticks = checked_step(command, ticks, WHO)
        if not (command is not None) <= ticks <= self.ticks_left:
            raise InputError(f"{ticks} ticks were asked for; the scenario has {self.ticks_left} left")
        if not ticks:
            return self._snapshot
        before = self._run.save_state()
        self._command(command, ticks)
        try:
            self._snapshot = self._run.advance(ticks)
        except Exception as error:
            # the ticks that were solved are solved again: cheaper than to keep a state before every one
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
            sensors: names of those whose readings take the place of the truth.

        Raises:
            InputError: there is no such sensor.
        """
        return self._run.measured(self._snapshot, sensors)

    def _command(self, command: Command | None, ticks: int) -> None:
        if command is not None:
            self._run.command(command, ticks)

    def _again(self, ticks: int) -> Iterator[TickBatch]:
        """Yield the present state and some ticks that are known to be solved."""
        yield self._snapshot.table
        for batch in self._run.batches(most=ticks):
            self._snapshot = batch.snapshot(-1)
            yield batch

    def save(self) -> SavedState:
        """Return the present state; it costs little, and saving has no effect on the ticks to come."""
        return SavedState(self._run.save_state(), self._snapshot.kept())

    def restore(self, saved: SavedState | str | Path) -> None:
        """Go to a saved state, that of a file, or a run's checkpoint.npz.

        Args:
            saved: what `save` has returned, or a file's path.

        Raises:
            InputError: the file cannot be read, or the state does not fit this scenario.
        """
        found = _read(saved)
        if isinstance(saved, SavedState):
            self._run.restore_state(found._run)
        else:
            with checkpoint.naming(Path(saved)):
                checkpoint.check_shown(found.snapshot, self.stage)
                self._run.restore_state(found._run)
        self._snapshot = found.snapshot

    def image(self, camera: str) -> CameraImage:
        """Return the present image of a camera.

        Args:
            camera: its name in the scenario.

        Raises:
            InputError: there is no such camera.
            OutputError: nothing can draw here.
        """
        return self._run.image(camera, self._snapshot)

    def seed_sensors(self, seed: int) -> Snapshot:
        """Restart the sensors with other noise, and return the present snapshot with their readings.

        Args:
            seed: from 0 to 2^31 - 1, which joins those of the scenario's sensors; 0 is that of a new run.

        Raises:
            InputError: it is none.
        """
        if (number := whole(seed)) is None or not 0 <= number < 2**31:
            raise InputError(f"seed is {seed!r}; must be a whole number from 0 to {2**31 - 1}")
        self._snapshot = self._run.seeded(self._snapshot, number)
        return self._snapshot

    def reset(
        self, start: SavedState | str | Path | None = None, changes: Mapping[str, Any] | None = None
    ) -> Snapshot:
        """Begin again, with the scenario that the simulation was made with, and return the new state.

        The ticks to come are bit-identical to those of a new simulation of that scenario and start. Only the
        noise of sensors is random, see `seed_sensors`; for random scenarios, draw `changes`.

        Args:
            start: what to continue from; None: from where this simulation began.
            changes: values by key path that differ until the next reset, such as {"clock.tick_s": 1e-3}; a
                simulation that began at rest then begins at the changed scenario's state at rest.

        Raises:
            InputError: a change is wrong or asks for what cannot be reached, or `start` does not fit; the
                simulation is where it was.
            SolverError: there is no state at rest to start from; the same.
        """
        scenario, run, began = self._made
        here = self.scenario, self._run
        try:
            if changes is None or (isinstance(changes, Mapping) and not changes):
                self.scenario, self._run = scenario, run
                self.restore(began if start is None else start)
            else:
                self._begin(scenario, changes, self._given if start is None else start)
        except BaseException:
            self.scenario, self._run = here
            raise
        return self._snapshot

    def branch(self, overrides: Mapping[str, Any] | None = None) -> Simulation:
        """Return a second simulation at the same point, with a scenario that may differ; see `start`.

        Args:
            overrides: values by key path.

        Raises:
            InputError: the changed scenario is wrong, or the present state does not fit it.
        """
        given: dict[str, Any] = {"controllers": self._controllers, "body": self._body, "kept": self._kept}
        return Simulation(self.scenario, overrides=overrides, start=self.save(), **given)

    def __repr__(self) -> str:
        """Return one line: what is simulated, and where it is."""
        stage, last = self.stage, self._snapshot
        of = "" if self.scenario.endless else f" of {stage.ticks}"
        when = f"tick {last.tick}{of}, {last.time_s:g} s"
        return f"Simulation of {stage.scenario}, {stage.mode}: {when}"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to make it again, from where it began, and its present state."""
        scenario, _, began = self._made
        changed = None if self.scenario is scenario else self.scenario
        given: dict[str, Any] = {"controllers": self._controllers, "body": self._body}
        anew = partial(Simulation, scenario, start=began, **given)
        return anew, (), (self._given, changed, self.save())

    def __setstate__(self, state: tuple[Any, Scenario | None, SavedState]) -> None:
        """Go to the state that was pickled."""
        self._given, changed, here = state
        if changed is None:
            self.restore(here)
        else:
            self._begin(changed, None, here)


def stepped_run(simulation: Simulation) -> SteppedRun:
    """Return what a simulation steps, for parts of cosim that look into it."""
    return simulation._run


def _read(saved: SavedState | str | Path) -> SavedState:
    """Return a saved state, that of a file, or of a run's checkpoint.

    Raises:
        InputError: the file cannot be read, or holds something else.
    """
    found = state_file.load(Path(saved)) if isinstance(saved, str | Path) else saved
    if isinstance(found, checkpoint.Checkpoint):
        found = SavedState(found.run, found.summary.seen)
    if not isinstance(found, SavedState) or not isinstance(found._run, RunState):
        raise InputError(f"{saved}: holds no simulation but a {type(found).__name__}")
    if found is not saved:
        check_state(found._run.choices, None, Choices, place=f"{saved}: choices")
    return found


Changes: TypeAlias = Mapping[str, Any] | None
_Entry = TypeVar("_Entry")


@final
class Batch:
    """Runs of one scenario, stepped together.

    A run that fails stays where it was before the tick that could not be solved, and takes no more part until
    it is reset; a process that ends takes its own runs with it. `failed` names both, and the others continue.
    Processes are spawned: a script that makes a batch guards that by `if __name__ == "__main__":`.

    Args:
        scenario: as that of a `Simulation`.
        n: runs.
        workers: processes that hold them.
        overrides: values by key path, of all runs.
        changes: values by key path, of each run besides; None: none.
        start: what all continue from, see `Simulation`.

    Raises:
        InputError: the scenario is wrong, or there are not as many changes as runs.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        n: int,
        *,
        workers: int = 1,
        overrides: Changes = None,
        changes: Sequence[Changes] | None = None,
        start: SavedState | str | Path | None = None,
    ) -> None:
        # what takes long for the first time, kernels and section models, is made once, before there are many
        loaded = load_scenario(scenario, overrides)
        self.scenario = preparation.prepared(loaded, preparation.log)
        preparation.warm_up()
        given = _for_each(changes, n, "changes")
        run = partial(BatchRun.of, self.scenario, given, start, kept_parts.KeptParts(on_disk=True))
        self._workers = Workers(run, n, workers)
        self._failed: dict[int, Exception] = {}
        self.measure()

    @property
    def failed(self) -> Mapping[int, Exception]:
        """What runs have failed with, by their numbers from 0 on."""
        return MappingProxyType(self._failed)

    @property
    def processes(self) -> tuple[int, ...]:
        """Number of the process of each worker; run k is in worker k modulo their number."""
        return self._workers.processes

    def __len__(self) -> int:
        return self._workers.count

    def step(
        self, commands: Command | Sequence[Command | None] | None = None, *, ticks: int = 1
    ) -> tuple[Measurement | None, ...]:
        """Advance all runs by some ticks, and return their measurements; None for runs that have failed.

        Args:
            commands: one for all runs, or one for each; see `Simulation.step`.
            ticks: of the clock.

        Raises:
            InputError: there are not as many commands as runs, or one is none; no run has taken a step.
        """
        whatever: Any = commands
        several = isinstance(whatever, Sequence) and not isinstance(whatever, str | bytes)
        listed = whatever if several else (whatever,) * len(self)
        given = _for_each(listed, len(self), "commands")
        asked = [checked_step(command, ticks, f"{WHO}, run {k}") for k, command in enumerate(given)]
        return self._called("step", {k: asked[k] for k in self._well})

    def measure(self) -> tuple[Measurement | None, ...]:
        """Return measurements of all runs at present; None for those that have failed."""
        return self._called("measure", dict.fromkeys(self._well, ()))

    def save(self) -> tuple[SavedState | None, ...]:
        """Return the present state of all runs; None of those that have failed."""
        return self._called("save", dict.fromkeys(self._well, ()))

    def reset(
        self,
        runs: Iterable[int] | None = None,
        *,
        start: SavedState | str | Path | None = None,
        changes: Changes | Sequence[Changes] = None,
    ) -> tuple[Measurement | None, ...]:
        """Let runs begin again, those that have failed too, and return their measurements.

        A process that has ended is replaced; other runs of it begin again when they are reset.

        Args:
            runs: their numbers; None for all.
            start: state that they continue from; None: from where they began.
            changes: values by key path that differ until the next reset: for all of them, or for each.

        Raises:
            InputError: there are not as many changes as runs, or there is no such run.
        """
        chosen = list(range(len(self)) if runs is None else runs)
        if unknown := [k for k in chosen if whole(k) not in range(len(self))]:
            raise InputError(f"there is no run {shown(unknown[0])}; there are 0 to {len(self) - 1}")
        listed = changes if isinstance(changes, Sequence) else (changes,) * len(chosen)
        given = _for_each(listed, len(chosen), "changes")
        self._workers.replace(chosen)
        for k in chosen:
            self._failed.pop(k, None)
        return self._called("reset", {k: (start, change) for k, change in zip(chosen, given, strict=True)})

    def close(self) -> None:
        """End the processes."""
        self._workers.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _well(self) -> list[int]:
        return [k for k in range(len(self)) if k not in self._failed]

    def _called(self, method: str, arguments: Mapping[int, tuple[Any, ...]]) -> tuple[Any, ...]:
        found = self._workers.call(method, arguments)
        self._failed |= {k: answer for k, answer in found.items() if isinstance(answer, Exception)}
        return tuple(None if k in self._failed else found.get(k) for k in range(len(self)))

    def __repr__(self) -> str:
        """Return one line: what is run, how often, and where."""
        failed = f", {len(self._failed)} failed" if self._failed else ""
        return f"Batch of {len(self)} runs of {self.scenario.name} in {len(self.processes)} processes{failed}"


@final
class BatchRun:
    """One run, in the process that holds it.

    Args:
        simulation: of it.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        changes: Sequence[Changes],
        start: SavedState | str | Path | None,
        kept: kept_parts.KeptParts,
        k: int,
    ) -> BatchRun:
        """Return run k; those of one process share the parts that are kept there."""
        return cls(Simulation(scenario, overrides=changes[k], start=start, kept=kept))

    def step(self, command: Command | None, ticks: int) -> Measurement:
        """Advance, and return what is measured."""
        self._simulation.step(command, ticks=ticks)
        return self._simulation.measure()

    def measure(self) -> Measurement:
        """Return what is measured."""
        return self._simulation.measure()

    def save(self) -> SavedState:
        """Return the present state."""
        return self._simulation.save()

    def reset(self, start: SavedState | str | Path | None, changes: Changes) -> Measurement:
        """Begin again, and return what is measured."""
        self._simulation.reset(start, changes)
        return self._simulation.measure()


def _for_each(given: Sequence[_Entry] | None, count: int, what: str) -> tuple[_Entry | None, ...]:
    """Return one entry for each run.

    Raises:
        InputError: there are more, or fewer.
    """
    if given is None:
        return (None,) * count
    if len(given) != count:
        raise InputError(f"{len(given)} {what} were given for {count} runs")
    return tuple(given)
