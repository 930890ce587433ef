"""Runs designs in a worker, one at a time, and returns their rows."""

import os
import pickle
import platform
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from cosim.app import driver, preparation
from cosim.app.run_follower import Observer, Options
from cosim.base.files import files_read
from cosim.base.kept_parts import KeptParts
from cosim.config import plugins
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.results.result_builder import ResultBuilder
from cosim.sweeps.designs import Row, Task
from cosim.sweeps.measure import measure_named, measured
from cosim.sweeps.run_figures import figures_of
from cosim.telemetry.summary import reason_of

_ONE_AT_A_TIME: Final = threading.Lock()
"""Executors may have several threads in a process; kernels and engines need one run at a time."""


def run_task(task: Task) -> Row:
    """Run a design; the row has the reason if it cannot be built or solved."""
    with _ONE_AT_A_TIME:
        wall, cpu = time.perf_counter(), time.thread_time()
        with files_read() as files:
            try:
                scenario = _unpacked(task)
                wall, cpu = time.perf_counter(), time.thread_time()
                row = _run(scenario, task)
            except InputError as error:
                row = Row("refused", reason_of(error))
            except Exception as error:  # no error of a design may end the sweep
                row = Row("failed", reason_of(error))
        wall_s, cpu_s = time.perf_counter() - wall, time.thread_time() - cpu
        name = f"{platform.node()}:{os.getpid()}"
        return replace(row, wall_s=wall_s, cpu_s=cpu_s, worker=name, files=files)


def _unpacked(task: Task) -> Scenario:
    """Return the scenario of a task; the first task of a process also imports modules and loads kernels."""
    _import_modules(task.modules)
    _start_cpu_s()
    scenario: Scenario = pickle.loads(task.scenario)
    warm_up()
    return scenario


def _run(scenario: Scenario, task: Task) -> Row:
    started, before_s = time.perf_counter(), time.process_time() - _start_cpu_s()
    measure = measure_named(task.measure) if isinstance(task.measure, str) else task.measure
    arrays = ResultBuilder(scenario.recording.frames_per_s)
    watchers: Sequence[Observer] = () if measure is None else (arrays,)
    directory = None if task.directory is None else Path(task.directory)
    build = partial(preparation.build_simulation, kept=_kept_parts())
    options, follower = Options(directory, None, watchers), task.follower
    if follower is not None:
        options = replace(options, watchers=(*watchers, follower), stop=follower.stop)
    outcome = driver.execute(scenario, build, options, started)
    error, summary = outcome.error, outcome.summary
    if isinstance(error, InputError):
        return Row("refused", reason_of(error))
    figures: dict[str, Any] = dict(figures_of(summary))
    if measure is not None and summary["status"] == "completed":
        figures |= measured(measure, arrays.result(summary, directory))
    if follower is not None and summary["status"] == "completed":
        figures |= follower.figures(time.process_time() - before_s)
    return Row(summary["status"], summary["reason"], figures)


@cache
def _start_cpu_s() -> float:
    """Return the CPU time that this process took to start, before its first design: a command takes the same.

    Kernels are loaded later, as a run loads few of them.
    """
    return time.process_time()


@cache
def warm_up() -> None:
    """Load all kernels, once in a process; many workers at once would each compile those that are new."""
    preparation.warm_up()


@cache
def _kept_parts() -> KeptParts:
    """Return the parts that the designs of a process share; see `_ONE_AT_A_TIME`."""
    return KeptParts()


@cache
def _import_modules(modules: tuple[str, ...]) -> None:
    plugins.register_installed()
    for name in modules:
        plugins.register_module(name)
