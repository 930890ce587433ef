"""Many runs of a scenario at once, in processes: each is bit for bit what it would be alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypeVar, final

from cosim.app.driver import log, prepared
from cosim.app.simulation import SavedState, Simulation
from cosim.app.workers import Workers
from cosim.base.files import cache_directory
from cosim.base.kept_parts import KeptParts
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.controller import checked_step, shown, whole
from cosim.devices.live.live_values import WHO
from cosim.errors import InputError

if TYPE_CHECKING:
    from cosim.devices.controller import Command, Measurement

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
        self.scenario = prepared(loaded, log, recording=False, contact=True)
        given = _for_each(changes, n, "changes")
        run = partial(BatchRun.of, self.scenario, given, start, KeptParts(cache_directory()))
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
        kept: KeptParts,
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
