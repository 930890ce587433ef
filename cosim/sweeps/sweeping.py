"""Runs the designs of a study and writes their table; what is known is not run again.

The designs of a study: what each of them sets, by key path.

The rows of a sweep, one line of JSON each, written as they come: what a killed sweep goes on from.

`cosim.sweep`.
"""

from __future__ import annotations

import json
import math
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from hashlib import sha256
from itertools import product
from pathlib import Path
from types import TracebackType
from typing import Any, Final, TextIO, final

import numpy as np

from cosim.app.first_run import prepared
from cosim.app.run_files import OutputDirectory
from cosim.base.files_read import changed_file
from cosim.base.frames import Array
from cosim.base.identity import code_identity, content_name
from cosim.base.kept_parts import KeptParts
from cosim.base.resources import is_file
from cosim.base.state_check import check_state
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.studies import RangeTable, SamplesTable, StudyTable, load_study
from cosim.config.writing import scenario_text
from cosim.errors import MOST_LINES, InputError, OutputError, ScenarioError
from cosim.sweeps.engines import PROCESSES, Engine, Run, rows_of
from cosim.sweeps.table import TABLE, Design, write_table
from cosim.sweeps.task import LOST, Measure, Row, Task, check_travels, measure_identity, measure_named
from cosim.sweeps.worker import run_task, warm_up
from cosim.telemetry.summary import reason_of

MOST_DESIGNS: Final = 1_000_000


def varied_keys(study: StudyTable) -> list[str]:
    """Return the key paths that differ between designs, in the order of the study."""
    sampled = study.samples.range if study.samples is not None else {}
    return list(dict.fromkeys([*(key for design in study.design for key in design), *study.grid, *sampled]))


def designs_of(study: StudyTable) -> list[dict[str, Any]]:
    """Return what each design sets beside `set`; samples vary fastest, entries of `design` slowest.

    Raises:
        InputError: there are too many.
    """
    listed = list(study.design) or [{}]
    count = len(listed) * math.prod(map(len, study.grid.values()))
    count *= study.samples.count if study.samples is not None else 1
    if count > MOST_DESIGNS:
        raise InputError(f"the study has {count} designs; at most {MOST_DESIGNS} are run, vary less")
    samples = _samples(study.samples)
    grid = [dict(zip(study.grid, values, strict=True)) for values in product(*study.grid.values())]
    return [{**design, **point, **sample} for design, point, sample in product(listed, grid, samples)]


def check_designs(study: StudyTable) -> None:
    """Check that each design of a study can be loaded and built; nothing is run.

    Args:
        study: checked by `load_study`.

    Raises:
        ScenarioError: what is wrong, by design and key; what several designs share stands there once.
    """
    from cosim.build.file_checks import check_built  # here: it loads the engines

    designs, kept, found = designs_of(study), KeptParts(), dict[str, list[int]]()
    for number, varied in enumerate(designs, 1):
        try:
            check_built(load_scenario(study.scenario, {**study.set, **varied}), kept)
        except InputError as error:
            for place, problem in getattr(error, "faults", (("", str(error)),)):
                found.setdefault(f"{place}: {problem}" if place else problem, []).append(number)
    if not found:
        return
    faults = [(_named(numbers, designs), problem) for problem, numbers in found.items()]
    if len(faults) > MOST_LINES:
        faults[MOST_LINES:] = [("", f"... and {len(faults) - MOST_LINES} more")]
    raise ScenarioError(*faults[0], further=tuple(faults[1:]))


def _named(numbers: list[int], designs: list[dict[str, Any]]) -> str:
    """Return the designs of some numbers, for a message: the first one with what it sets."""
    if len(numbers) == len(designs):
        return f"all {len(designs)} designs"
    values = ", ".join(f"{key} = {value!r}" for key, value in designs[numbers[0] - 1].items())
    others = f", and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"design {numbers[0]} of {len(designs)} ({values}){others}"


def _samples(table: SamplesTable | None) -> list[dict[str, Any]]:
    if table is None:
        return [{}]
    from scipy.stats import qmc  # here: it takes long to load

    engines = {"latin_hypercube": qmc.LatinHypercube, "sobol": qmc.Sobol, "halton": qmc.Halton}
    engine = engines[table.method](len(table.range), rng=table.seed)
    with warnings.catch_warnings():  # counts that are no power of 2 are as balanced as they can be
        warnings.simplefilter("ignore", UserWarning)
        points: Array = engine.random(table.count)
    columns = [list(_scaled(points[:, k], entry)) for k, entry in enumerate(table.range.values())]
    return [dict(zip(table.range, row, strict=True)) for row in zip(*columns, strict=True)]


def _scaled(points: Array, entry: RangeTable) -> Iterator[float | int]:
    """Yield points of 0 to 1 as values of a range."""
    low, high = entry.low, entry.high + (1.0 if entry.integer else 0.0)
    values = low * (high / low) ** points if entry.scale == "log" else low + (high - low) * points
    if entry.integer:
        whole: list[int] = np.floor(values).astype(np.int64).tolist()
        yield from (min(value, int(entry.high)) for value in whole)
    else:
        yield from np.clip(values, entry.low, entry.high).tolist()


@final
class Journal:
    """Rows by the names of their designs' contents.

    Args:
        path: of the file; it is made, or gone on with.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows = {name: row for name, row in _read(path) if row.status != LOST}
        self._file: TextIO | None = None

    def __enter__(self) -> Journal:
        try:
            self._file = self._path.open("a", encoding="utf-8")
            if self._file.tell():
                self._file.write("\n")  # whoever was killed may have left half a line
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def add(self, name: str, row: Row) -> None:
        """Take in a row; it is on disk when this returns.

        Raises:
            OutputError: it cannot be written.
        """
        assert self._file is not None, "a journal is entered first"
        self.rows[name] = row
        try:
            table = {"design": name, **asdict(row)}
            self._file.write(json.dumps({**table, "digest": _digest(table)}) + "\n")
            self._file.flush()
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error


def _digest(table: dict[str, Any]) -> str:
    """Return what tells a row from a damaged one."""
    return sha256(json.dumps(table).encode()).hexdigest()[:16]


def _read(path: Path) -> list[tuple[str, Row]]:
    """Return the rows of a file; what is no whole row, as in half a line, is computed again.

    Raises:
        InputError: it cannot be read.
    """
    if not is_file(path):
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
    """Run every design of a study and write the table `sweep.parquet`; run again, go on where it was ended.

    A design that cannot be built or solved is a row with the reason. Rows are known by the contents of
    scenario and code: whatever of these changes is computed anew.

    Args:
        study: path of a study's .toml file, or the table itself.
        out: directory of the results; None: `runs/` and the study's name.
        engine: "processes", the address of a Dask scheduler, such as "tcp://127.0.0.1:8786", or any executor.
        workers: processes of this machine; None: one for each processor.
        measure: returns more columns of a run's result; workers import it by its name.
        modules: with kinds of one's own, for every worker to import.
        tell: told of the progress after every design.

    Raises:
        InputError: study, directory or engine is wrong; nothing was run.
        OutputError: the results cannot be written.
    """
    return run_study(
        partial(run_task, prepared), study, out=out, engine=engine, workers=workers, measure=measure,
        modules=modules, tell=tell,
    )  # fmt: skip
