"""Steps many runs of one scenario together, in processes; each is bit-identical to the same run alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypeVar, final

from cosim.app import preparation
from cosim.app.simulation import SavedState, Simulation
from cosim.app.workers import Workers
from cosim.base.kept_parts import KeptParts
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import checked_step, shown, whole
from cosim.devices.live.live_values import WHO
from cosim.errors import InputError

if TYPE_CHECKING:
    from cosim.devices.controller import Command, Measurement

Changes: TypeAlias = Mapping[str, Any] | None
_Entry = TypeVar("_Entry")


@final
class Batch:
    """Runs of one scenario, stepped together.

    A failed run stays in the state before the tick that could not be solved, and is skipped until it is
    reset. If a process ends, its runs fail too. `failed` lists both; the other runs continue. Processes are
    spawned: a script that makes a batch guards that by `if __name__ == "__main__":`.

    Args:
        scenario: as of a `Simulation`.
        n: number of runs.
        workers: number of processes that hold the runs.
        overrides: values by key path, for all runs.
        changes: further values by key path, for each run; None: no further values.
        start: what all runs continue from, see `Simulation`.

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
        # kernels and section models, which take long, are made once, before the processes start
        self.scenario, kept = load_scenario(scenario, overrides), KeptParts(on_disk=True)
        preparation.build_section_model(self.scenario, preparation.log, kept)
        preparation.warm_up()
        each = _for_each(changes, n, "changes")
        make = partial(_simulation, self.scenario, each, start, kept)
        self._workers: Workers[Simulation] = Workers(make, n, workers)
        self._failed: dict[int, Exception] = {}
        self.measure()

    @property
    def failed(self) -> Mapping[int, Exception]:
        """Errors of failed runs, by the run's number from 0 on."""
        return MappingProxyType(self._failed)

    @property
    def processes(self) -> tuple[int, ...]:
        """Process number of each worker; run k is in worker k modulo the number of workers."""
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
            InputError: the number of commands differs from the number of runs, or a command is invalid; no
                run has taken a step.
        """
        unchecked: Any = commands
        several = isinstance(unchecked, Sequence) and not isinstance(unchecked, str | bytes)
        listed = unchecked if several else (unchecked,) * len(self)
        each = _for_each(listed, len(self), "commands")
        checked = [checked_step(command, ticks, f"{WHO}, run {k}") for k, command in enumerate(each)]
        return self._call(_advanced, {k: checked[k] for k in self._running})

    def measure(self) -> tuple[Measurement | None, ...]:
        """Return the present measurements of all runs; None for failed runs."""
        return self._call(Simulation.measure, dict.fromkeys(self._running, ()))

    def save(self) -> tuple[SavedState | None, ...]:
        """Return the present states of all runs; None for failed runs."""
        return self._call(Simulation.save, dict.fromkeys(self._running, ()))

    def reset(
        self,
        runs: Iterable[int] | None = None,
        *,
        start: SavedState | str | Path | None = None,
        changes: Changes | Sequence[Changes] = None,
    ) -> tuple[Measurement | None, ...]:
        """Reset runs, failed ones included, and return their measurements.

        A process that has ended is replaced; its other runs restart when they are reset.

        Args:
            runs: their numbers; None for all.
            start: state that they continue from; None: from where they began.
            changes: values by key path that apply until the next reset: for all of these runs, or for each.

        Raises:
            InputError: the number of changes differs from the number of runs, or there is no such run.
        """
        chosen = list(range(len(self)) if runs is None else runs)
        if unknown := [k for k in chosen if whole(k) not in range(len(self))]:
            raise InputError(f"there is no run {shown(unknown[0])}; there are 0 to {len(self) - 1}")
        listed = changes if isinstance(changes, Sequence) else (changes,) * len(chosen)
        each = _for_each(listed, len(chosen), "changes")
        self._workers.replace(chosen)
        for k in chosen:
            self._failed.pop(k, None)
        return self._call(_restarted, {k: (start, change) for k, change in zip(chosen, each, strict=True)})

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
    def _running(self) -> list[int]:
        return [k for k in range(len(self)) if k not in self._failed]

    def _call(
        self, function: Callable[..., Any], arguments: Mapping[int, tuple[Any, ...]]
    ) -> tuple[Any, ...]:
        """Call a function of a simulation for some runs; return its results, None for all other runs."""
        results = self._workers.call(function, arguments)
        self._failed |= {k: result for k, result in results.items() if isinstance(result, Exception)}
        return tuple(None if k in self._failed else results.get(k) for k in range(len(self)))

    def __repr__(self) -> str:
        """Return one line: scenario, number of runs and processes."""
        failed = f", {len(self._failed)} failed" if self._failed else ""
        return f"Batch of {len(self)} runs of {self.scenario.name} in {len(self.processes)} processes{failed}"


def _simulation(
    scenario: Scenario,
    changes: Sequence[Changes],
    start: SavedState | str | Path | None,
    kept: KeptParts,
    k: int,
) -> Simulation:
    """Return run k; all runs of a process share the kept parts."""
    return Simulation(scenario, overrides=changes[k], start=start, kept=kept)


def _advanced(simulation: Simulation, command: Command | None, ticks: int) -> Measurement:
    """Advance a run, and return its measurement."""
    simulation.step(command, ticks=ticks)
    return simulation.measure()


def _restarted(
    simulation: Simulation, start: SavedState | str | Path | None, changes: Changes
) -> Measurement:
    """Reset a run, and return its measurement."""
    simulation.reset(start, changes)
    return simulation.measure()


def _for_each(entries: Sequence[_Entry] | None, count: int, what: str) -> tuple[_Entry | None, ...]:
    """Return one entry for each run.

    Raises:
        InputError: the number of entries differs from the number of runs.
    """
    if entries is None:
        return (None,) * count
    if len(entries) != count:
        raise InputError(f"{len(entries)} {what} were given for {count} runs; give one for each run")
    return tuple(entries)
