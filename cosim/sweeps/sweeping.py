"""Runs the designs of a study and writes their table; what is known is not run again.

What a worker does with a design: compiles once, runs it, one at a time, and returns a row. Kernels are
compiled once, here, before any worker needs them: many processes at once would each do it.

The rows of a sweep, one line of JSON each, written as they come: what a killed sweep continues from.

`cosim.sweep`.
"""

from __future__ import annotations

import json
import os
import pickle
import platform
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, TextIO, final

from cosim.app import driver, preparation
from cosim.app.output_directory import OutputDirectory
from cosim.base import resources, writing
from cosim.base.files import changed_file, files_read
from cosim.base.identity import code_identity, content_name
from cosim.base.kept_parts import KeptParts
from cosim.base.state_checks import check_state
from cosim.config import loading, plugins, studies
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.results.result import ResultBuilder
from cosim.sweeps import table as tables
from cosim.sweeps.engines import PROCESSES, Engine, rows_of
from cosim.sweeps.figure_names import check_figures
from cosim.sweeps.table import LOST, TABLE, Design, DesignFollower, Measure, Row, Task
from cosim.telemetry.summary import reason_of

_ONE_AT_A_TIME: Final = threading.Lock()
"""Executors may have several threads in a process; runs keep to one each, as kernels and engines expect."""


def run_task(task: Task) -> Row:
    """Run a design; whatever is wrong with it is said in the row."""
    with _ONE_AT_A_TIME:
        wall, cpu = time.perf_counter(), time.thread_time()
        with files_read() as files:
            try:
                scenario = _unpacked(task)
                wall, cpu = time.perf_counter(), time.thread_time()
                row = _run(preparation.prepared(scenario, _tell_nobody), task)
            except InputError as error:
                row = Row("refused", reason_of(error))
            except Exception as error:  # a design must not end the sweep, whatever it raises
                row = Row("failed", reason_of(error))
        wall_s, cpu_s = time.perf_counter() - wall, time.thread_time() - cpu
        name = f"{platform.node()}:{os.getpid()}"
        return replace(row, wall_s=wall_s, cpu_s=cpu_s, worker=name, files=files)


def _unpacked(task: Task) -> Scenario:
    """Return the scenario of a task; what the first one of a process waits for is no part of its run."""
    _make_known(task.modules)
    scenario: Scenario = pickle.loads(task.scenario)
    _warm_up()
    return scenario


def _run(scenario: Scenario, task: Task) -> Row:
    started = time.perf_counter()
    measure = tables.measure_named(task.measure) if isinstance(task.measure, str) else task.measure
    arrays = ResultBuilder(scenario.recording.frames_per_s)
    watchers: Sequence[driver.Observer] = () if measure is None else (arrays,)
    directory = None if task.directory is None else Path(task.directory)
    build = partial(preparation.build_simulation, kept=_kept_here())
    options, follower = driver.Options(directory, None, watchers), task.follower
    if follower is not None:
        options = replace(options, watchers=(*watchers, follower), stop=follower.stop)
    outcome = driver.execute(scenario, build, options, started)
    error, summary = outcome.error, outcome.summary
    if isinstance(error, InputError):
        return Row("refused", reason_of(error))
    figures: dict[str, Any] = dict(tables.figures_of(summary))
    if measure is not None and summary["status"] == "completed":
        figures |= tables.measured(measure, arrays.result(summary, directory))
    if follower is not None and summary["status"] == "completed":
        figures |= follower.figures()
    return Row(summary["status"], summary["reason"], figures)


@cache
def _warm_up() -> None:
    preparation.warm_up()


@cache
def _kept_here() -> KeptParts:
    """Return the parts that the designs of a process share; see `_ONE_AT_A_TIME`."""
    return KeptParts()


@cache
def _make_known(modules: tuple[str, ...]) -> None:
    plugins.register_installed()
    for name in modules:
        plugins.register_module(name)


@final
class Journal:
    """Rows by the names of their designs' contents.

    Args:
        path: of the file; it is made, or continued with.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows = {name: row for name, row in _read(path) if row.status != LOST}
        self._file: TextIO | None = None

    @contextmanager
    def open(self) -> Iterator[Journal]:
        """Open its file for further rows.

        Raises:
            InputError: it cannot be written.
        """
        try:
            self._file = self._path.open("a", encoding="utf-8")
            if self._file.tell():
                self._file.write("\n")  # whoever was killed may have left half a line
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror}") from error
        try:
            yield self
        finally:
            with suppress(OSError):
                self._file.close()

    def add(self, name: str, row: Row) -> None:
        """Take in a row; it is on disk when this returns.

        Raises:
            OutputError: it cannot be written.
        """
        assert self._file is not None, "a journal is opened first"
        self.rows[name] = row
        with writing.writing(self._path):
            table = {"design": name, **asdict(row)}
            self._file.write(json.dumps({**table, "digest": _digest(table)}) + "\n")
            self._file.flush()


def _digest(table: dict[str, Any]) -> str:
    """Return what tells a row from a damaged one."""
    return sha256(json.dumps(table).encode()).hexdigest()[:16]


def _read(path: Path) -> list[tuple[str, Row]]:
    """Return the rows of a file; what is no whole row, as in half a line, is computed again.

    Raises:
        InputError: it cannot be read.
    """
    if not resources.is_file(path):
        return []
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    found = []
    for line in lines:
        with suppress(ValueError, TypeError, AttributeError, KeyError, RecursionError, InputError):
            table = json.loads(line)
            if table.pop("digest") != _digest(table):
                continue
            name, row = table.pop("design"), Row(**table)
            check_state((name, row), None, tuple[str, Row], finite=False)
            found.append((name, row))
    return found


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


@final
@dataclass
class StudyRun:
    """A sweep under way.

    Args:
        study: its table.
        where: directory of its files.
        journal: of rows.
        measure: of results.
        modules: for workers to import.
        tell: told of the progress.
        followers: of the designs, by their places; empty for none.
    """

    study: studies.StudyTable
    where: Path
    journal: Journal
    measure: Measure | None
    modules: tuple[str, ...]
    tell: Tell
    followers: Sequence[DesignFollower] = ()
    varied: list[dict[str, Any]] = field(default_factory=list)
    identities: list[str] = field(default_factory=list)
    refused: dict[int, Row] = field(default_factory=dict)
    computed: dict[str, Row] = field(default_factory=dict)
    waiting: Counter[str] = field(default_factory=Counter)
    statuses: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.varied = studies.designs_of(self.study)
        self._code = content_name(code_identity(), self.measure and tables.measure_identity(self.measure))
        self._seen: dict[str, str] = {}  # digests of files, each taken once
        self._first_s: float | None = None

    def fan_out(self, engine: Engine) -> None:
        """Compute the rows that are not known."""
        for name, row in rows_of(engine, run_task, self._tasks()):
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
            follower = self.followers[place] if self.followers else None
            try:
                scenario = loading.load_scenario(self.study.scenario, {**self.study.set, **varied})
                name = content_name(loading.scenario_text(scenario), self._code, follower)
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
                yield name, self._task(name, scenario, follower)

    def _is_known(self, name: str) -> bool:
        """Return whether there is a row of a name, and what its run read is as it was."""
        row = self.journal.rows.get(name)
        return row is not None and changed_file(row.files, self._seen) is None

    def _task(self, name: str, scenario: Scenario, follower: DesignFollower | None) -> Task:
        _warm_up()
        folder = str((self.where / name).resolve()) if self.study.keep_runs else None
        measure = self.measure if self.study.measure is None else self.study.measure
        how = {"modules": self.modules, "measure": measure, "directory": folder, "follower": follower}
        return Task.of(scenario, **how)

    def _note(self, status: str, count: int = 1) -> None:
        self.statuses[status] += count
        done, computed, now_s = self.statuses.total(), len(self.computed), time.perf_counter()
        if computed and self._first_s is None:
            self._first_s = now_s
        elapsed_s = 0.0 if self._first_s is None else now_s - self._first_s
        self.tell(SweepProgress(len(self.varied), done, computed, dict(self.statuses), elapsed_s))


def _tell_nobody(_what: Any) -> None:
    """Do nothing; of what a worker would tell, who started the sweep has been told."""


def sweep(
    study: str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    engine: Executor | str = PROCESSES,
    workers: int | None = None,
    measure: Measure | None = None,
    modules: Sequence[str] = (),
    tell: Tell | None = None,
) -> SweepOutcome:
    """Run every design of a study and write the table `sweep.parquet`; run again, continue where it ended.

    A design that cannot be built or solved is a row with the reason. Rows are known by the contents of
    scenario and code: whatever of these changes is computed again.

    Args:
        study: path of a study's .toml file, or the table itself.
        out: directory of the results; None: `runs/` and the study's name.
        engine: "processes", the address of a Dask scheduler, such as "tcp://127.0.0.1:8786", or any executor.
        workers: processes of this machine; None: one for each processor.
        measure: returns more columns of a run's result; workers import it by its name.
        modules: with custom kinds, for every worker to import.
        tell: told of the progress after every design.

    Raises:
        InputError: study, directory or engine is wrong; nothing was run.
        OutputError: the results cannot be written.
    """
    table = studies.load_study(study)
    if measure is not None and table.measure is not None:
        raise InputError("measure: is given in the study as well; leave it out in one of them")
    if measure is not None and isinstance(engine, str):
        tables.check_travels(measure)
    if measure is None:
        check_figures(table)
    chosen = Engine(engine, workers)
    function = tables.measure_named(table.measure) if table.measure is not None else measure
    name = f"sweep_{Path(table.scenario).stem}" if isinstance(study, Mapping) else Path(study).stem
    where = Path(out) if out is not None else Path("runs", name)
    with OutputDirectory(where) as directory:
        directory.make()
        directory.claim(JOURNAL, TABLE)
        with Journal(where / JOURNAL).open() as journal:
            under_way = StudyRun(table, where, journal, function, tuple(modules), tell or _tell_nobody)
            under_way.fan_out(chosen)
        outcome = under_way.outcome()
        tables.write_table(where / TABLE, studies.varied_keys(table), under_way.designs(), table.figures)
    return outcome
