"""Runs all designs of a study and writes their table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from cosim.app.output_directory import OutputDirectory
from cosim.config import studies
from cosim.errors import InputError
from cosim.sweeps.engines import PROCESSES, Engine
from cosim.sweeps.figure_names import check_figures
from cosim.sweeps.journal import JOURNAL, Journal
from cosim.sweeps.measure import Measure, check_sendable, measure_named
from cosim.sweeps.study_run import StudyRun, SweepOutcome, SweepProgress, Tell
from cosim.sweeps.table import TABLE, write_table
from cosim.sweeps.worker import run_task, warm_up


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
    """Run every design of a study and write the table `sweep.parquet`; an interrupted sweep continues.

    The row of a design that cannot be built or solved has the reason. A row is computed again if the contents
    of its scenario or the code have changed.

    Args:
        study: path of a study's .toml file, or the table itself.
        out: directory of the results; None: `runs/` and the study's name.
        engine: "processes", the address of a Dask scheduler, such as "tcp://127.0.0.1:8786", or any executor.
        workers: processes of this machine; None: one for each processor.
        measure: returns further columns of a run's result; workers import it by its name.
        modules: with custom kinds; imported by every worker.
        tell: called with the progress after every design.

    Raises:
        InputError: study, directory or engine is wrong; nothing was run.
        OutputError: the results cannot be written.
    """
    table = studies.load_study(study)
    if measure is not None and table.measure is not None:
        raise InputError("measure: the study has one as well; leave one of them out")
    if measure is not None and isinstance(engine, str):
        check_sendable(measure)
    if measure is None:
        check_figures(table)
    chosen = Engine(engine, workers)
    function = measure_named(table.measure) if table.measure is not None else measure
    name = f"sweep_{Path(table.scenario).stem}" if isinstance(study, Mapping) else Path(study).stem
    where = Path(out) if out is not None else Path("runs", name)
    with OutputDirectory(where) as directory:
        directory.make()
        directory.claim(JOURNAL, TABLE)
        with Journal(where / JOURNAL).open() as journal:
            run = StudyRun(table, where, journal, function, tuple(modules), tell or _ignore)
            run.compute(chosen, run_task, warm_up)
        outcome = run.outcome()
        write_table(where / TABLE, studies.varied_keys(table), run.designs(), table.figures)
    return outcome


def _ignore(_progress: SweepProgress) -> None:
    """Do nothing."""
