"""Runs the designs of a study and writes their table; what is known is not run again."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

from cosim.app.output_directory import OutputDirectory
from cosim.base.files_read import changed_file
from cosim.base.identity import code_identity, content_name
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.studies.study_files import load_study
from cosim.config.studies.study_table import StudyTable
from cosim.config.writing import scenario_text
from cosim.errors import InputError
from cosim.sweeps.designs import designs_of, varied_keys
from cosim.sweeps.engines import PROCESSES, Engine
from cosim.sweeps.fan_out import Run, rows_of
from cosim.sweeps.journal import Journal
from cosim.sweeps.measures import Measure, check_travels, measure_identity, measure_named
from cosim.sweeps.table import TABLE, Design, write_table
from cosim.sweeps.task import Row, Task
from cosim.sweeps.warming import warm_up
from cosim.telemetry.summary import reason_of

JOURNAL: Final = "rows.jsonl"


@final
@dataclass(frozen=True)
class SweepProgress:
    """How far a sweep is.

    Args:
        count: of designs.
        done: designs with a row.
        computed: rows that were computed this time.
        statuses: how many rows have which status.
        elapsed_s: wall time since the first of these: before it, workers were started.
    """

    count: int
    done: int
    computed: int
    statuses: Mapping[str, int]
    elapsed_s: float

    @property
    def left_s(self) -> float | None:
        """Wall time to the end, at the rate so far; None before there is one."""
        return self.elapsed_s / (self.computed - 1) * (self.count - self.done) if self.computed > 1 else None


@final
@dataclass(frozen=True)
class SweepOutcome:
    """A sweep that has come to its end; `cosim.open_sweep(directory)` is its table.

    Args:
        directory: of its files.
        count: of designs.
        computed: designs that were run this time.
        reused: designs whose rows were known.
        statuses: how many designs have which status.
        reasons: how many designs are not completed for which reason, the most frequent one first.
    """

    directory: Path
    count: int
    computed: int
    reused: int
    statuses: Mapping[str, int]
    reasons: Mapping[str, int]


Tell = Callable[[SweepProgress], object]


def run_study(
    run: Run,
    study: str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    engine: Executor | str = PROCESSES,
    workers: int | None = None,
    measure: Measure | None = None,
    modules: Sequence[str] = (),
    tell: Tell | None = None,
) -> SweepOutcome:
    """Run every design of a study; see `cosim.sweep`.

    Args:
        run: what a worker does with a design.
        study: as there, like all that follow.
        out: directory of the results.
        engine: what runs the designs.
        workers: processes of this machine.
        measure: returns more columns of a run's result.
        modules: for every worker to import.
        tell: told of the progress.

    Raises:
        InputError: study, directory or engine is wrong.
        OutputError: the results cannot be written.
    """
    table = load_study(study)
    if measure is not None and table.measure is not None:
        raise InputError("measure: is given in the study as well; leave it out in one of them")
    if measure is not None and isinstance(engine, str):
        check_travels(measure)
    chosen = Engine(engine, workers)
    function = measure_named(table.measure) if table.measure is not None else measure
    where = Path(out) if out is not None else _default_directory(study, table)
    with OutputDirectory(where) as directory:
        directory.make()
        directory.claim(JOURNAL, TABLE)
        with Journal(where / JOURNAL) as journal:
            under_way = _Sweep(table, where, journal, function, tuple(modules), tell or _tell_nobody)
            under_way.fan_out(chosen, run)
        outcome = under_way.outcome()
        write_table(where / TABLE, varied_keys(table), under_way.designs(), table.figures)
    return outcome


@final
@dataclass
class _Sweep:
    """A sweep under way.

    Args:
        study: its table.
        where: directory of its files.
        journal: of rows.
        measure: of results.
        modules: for workers to import.
        tell: told of the progress.
    """

    study: StudyTable
    where: Path
    journal: Journal
    measure: Measure | None
    modules: tuple[str, ...]
    tell: Tell
    varied: list[dict[str, Any]] = field(default_factory=list)
    identities: list[str] = field(default_factory=list)
    refused: dict[int, Row] = field(default_factory=dict)
    computed: dict[str, Row] = field(default_factory=dict)
    waiting: Counter[str] = field(default_factory=Counter)
    statuses: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.varied = designs_of(self.study)
        self._code = content_name(code_identity(), self.measure and measure_identity(self.measure))
        self._seen: dict[str, str] = {}  # digests of files, each taken once
        self._first_s: float | None = None

    def fan_out(self, engine: Engine, run: Run) -> None:
        """Compute the rows that are not known."""
        for name, row in rows_of(engine, run, self._tasks()):
            self.journal.add(name, row)
            self.computed[name] = row
            self._note(row.status, self.waiting.pop(name))

    def designs(self) -> list[Design]:
        """Return all designs with their rows."""
        rows = self.journal.rows
        return [
            Design(varied, identity, self.refused[place] if place in self.refused else rows[identity])
            for place, (varied, identity) in enumerate(zip(self.varied, self.identities, strict=True))
        ]

    def outcome(self) -> SweepOutcome:
        """Return what came out, in numbers."""
        count, computed = len(self.varied), len(self.computed)
        reused = count - sum(identity in self.computed for identity in self.identities) - len(self.refused)
        reasons = Counter(design.row.reason for design in self.designs() if design.row.reason)
        return SweepOutcome(
            self.where, count, computed, reused, dict(self.statuses), dict(reasons.most_common())
        )

    def _tasks(self) -> Iterator[tuple[str, Task]]:
        """Yield what is to be computed; note what is known, and what is refused."""
        for place, varied in enumerate(self.varied):
            try:
                scenario = load_scenario(self.study.scenario, {**self.study.set, **varied})
                name = content_name(scenario_text(scenario), self._code)
            except InputError as error:
                self.identities.append("")
                self.refused[place] = Row("refused", reason_of(error))
                self._note("refused")
                continue
            self.identities.append(name)
            if self._is_known(name):
                self._note(self.journal.rows[name].status)
            elif self.waiting[name]:
                self.waiting[name] += 1  # the same contents, by other values
            else:
                self.waiting[name] = 1
                yield name, self._task(name, scenario)

    def _is_known(self, name: str) -> bool:
        """Return whether there is a row of a name, and what its run read is as it was."""
        row = self.journal.rows.get(name)
        return row is not None and changed_file(row.files, self._seen) is None

    def _task(self, name: str, scenario: Scenario) -> Task:
        warm_up(scenario)
        folder = str((self.where / name).resolve()) if self.study.keep_runs else None
        measure = self.measure if self.study.measure is None else self.study.measure
        return Task.of(scenario, modules=self.modules, measure=measure, directory=folder)

    def _note(self, status: str, count: int = 1) -> None:
        self.statuses[status] += count
        done, computed, now_s = self.statuses.total(), len(self.computed), time.perf_counter()
        if computed and self._first_s is None:
            self._first_s = now_s
        elapsed_s = 0.0 if self._first_s is None else now_s - self._first_s
        self.tell(SweepProgress(len(self.varied), done, computed, dict(self.statuses), elapsed_s))


def _default_directory(study: str | Path | Mapping[str, Any], table: StudyTable) -> Path:
    name = f"sweep_{Path(table.scenario).stem}" if isinstance(study, Mapping) else Path(study).stem
    return Path("runs", name)


def _tell_nobody(_progress: SweepProgress) -> None:
    """Do nothing."""
