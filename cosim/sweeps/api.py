"""`cosim.sweep`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

from cosim.app.first_run import prepared
from cosim.sweeps.engines import PROCESSES
from cosim.sweeps.measures import Measure
from cosim.sweeps.sweeping import SweepOutcome, Tell, run_study
from cosim.sweeps.worker import run_task


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
