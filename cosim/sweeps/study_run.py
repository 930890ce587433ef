"""A sweep in progress: computes the missing rows of a study, and counts them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, final

from cosim.base.files import changed_file
from cosim.base.identity import code_identity, content_name
from cosim.config import loading, studies
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.sweeps.designs import Design, DesignFollower, Row, Task
from cosim.sweeps.engines import Engine, IdentifiedTask, Run, rows_of
from cosim.sweeps.journal import Journal
from cosim.sweeps.measure import Measure, measure_identity
from cosim.telemetry.summary import reason_of


@final
@dataclass(frozen=True)
class SweepProgress:
    """Progress of a sweep.

    Args:
        count: number of designs.
        done: designs with a row.
        computed: rows that were computed this time.
        statuses: number of rows with each status.
        elapsed_s: wall time since the first computed row, before which workers were started.
    """

    count: int
    done: int
    computed: int
    statuses: Mapping[str, int]
    elapsed_s: float

    @property
    def left_s(self) -> float | None:
        """Wall time to the end at the present rate; None before two rows."""
        return self.elapsed_s / (self.computed - 1) * (self.count - self.done) if self.computed > 1 else None


@final
@dataclass(frozen=True)
class SweepOutcome:
    """Result of a sweep; `cosim.open_sweep(directory)` returns its table.

    Args:
        directory: of its files.
        count: number of designs.
        computed: designs that were run this time.
        reused: designs with known rows.
        statuses: number of designs with each status.
        reasons: number of designs that are not completed, by reason, the most frequent first.
    """

    directory: Path
    count: int
    computed: int
    reused: int
    statuses: Mapping[str, int]
    reasons: Mapping[str, int]


Tell: TypeAlias = Callable[[SweepProgress], object]


@final
@dataclass
class StudyRun:
    """A sweep in progress.

    Args:
        study: its table.
        where: directory of its files.
        journal: of rows.
        measure: function of results; None for none.
        modules: imported by workers.
        tell: called with the progress.
        followers: of the designs, in their order; empty for none.
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
        self._code = content_name(code_identity(), self.measure and measure_identity(self.measure))
        self._digests: dict[str, str] = {}  # of files, each computed once
        self._first_s: float | None = None

    def compute(self, engine: Engine, run: Run, warm_up: Callable[[], None]) -> None:
        """Compute the missing rows.

        Args:
            engine: makes the workers.
            run: called by the workers.
            warm_up: called before each task is sent.
        """
        for identity, row in rows_of(engine, run, self._tasks(warm_up)):
            self.journal.add(identity, row)
            self.computed[identity] = row
            self._note(row.status, self.waiting.pop(identity))

    def designs(self) -> list[Design]:
        """Return all designs with their rows."""
        rows = self.journal.rows
        return [
            Design(varied, identity, self.refused[k] if k in self.refused else rows[identity])
            for k, (varied, identity) in enumerate(zip(self.varied, self.identities, strict=True))
        ]

    def outcome(self) -> SweepOutcome:
        """Return the result of the sweep."""
        count, computed = len(self.varied), len(self.computed)
        reused = count - sum(identity in self.computed for identity in self.identities) - len(self.refused)
        reasons = Counter(design.row.reason for design in self.designs() if design.row.reason)
        return SweepOutcome(
            self.where, count, computed, reused, dict(self.statuses), dict(reasons.most_common())
        )

    def _tasks(self, warm_up: Callable[[], None]) -> Iterator[IdentifiedTask]:
        """Yield the tasks of missing rows; count known and refused designs."""
        for k, varied in enumerate(self.varied):
            follower = self.followers[k] if self.followers else None
            try:
                scenario = loading.load_scenario(self.study.scenario, {**self.study.set, **varied})
                identity = content_name(loading.scenario_text(scenario), self._code, follower)
            except InputError as error:
                self.identities.append("")
                self.refused[k] = Row("refused", reason_of(error))
                self._note("refused")
                continue
            self.identities.append(identity)
            if self._is_known(identity):
                self._note(self.journal.rows[identity].status)
            elif self.waiting[identity]:
                self.waiting[identity] += 1  # the same contents by other values
            else:
                self.waiting[identity] = 1
                warm_up()
                yield IdentifiedTask(identity, self._task(identity, scenario, follower))

    def _is_known(self, identity: str) -> bool:
        """Return whether there is a row whose files have not changed."""
        row = self.journal.rows.get(identity)
        return row is not None and changed_file(row.files, self._digests) is None

    def _task(self, identity: str, scenario: Scenario, follower: DesignFollower | None) -> Task:
        folder = str((self.where / identity).resolve()) if self.study.keep_runs else None
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
