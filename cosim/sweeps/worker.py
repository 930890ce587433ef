"""What a worker does with a design: compiles once, runs it, one at a time, and returns a row.

Kernels are compiled once, here, before any worker needs them: many processes at once would each do it.
"""

from __future__ import annotations

import logging
import os
import pickle
import platform
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from cosim.app.driver import Observer, Options, build_simulation, execute
from cosim.base.files_read import files_read
from cosim.base.kept_parts import KeptParts
from cosim.build.kernel_modules import kernel_modules
from cosim.config.loading import register_installed, register_module
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.results.result import ResultBuilder
from cosim.sweeps.task import Row, Task, figures_of, measure_named, measured
from cosim.telemetry.summary import reason_of


def warm_up(scenario: Scenario) -> None:
    """Compile the kernels of a scenario, unless those of another one like it have been.

    Args:
        scenario: checked.
    """
    _compile(tuple(module.__name__ for module in kernel_modules(scenario)))


@cache
def _compile(names: tuple[str, ...]) -> None:
    import cosim.build.simulation  # noqa: F401  # the engines: a run waits for them, too
    from cosim.soft.solve.compilation import compile_kernels  # here: it loads the kernels

    announce = logging.getLogger("cosim").warning
    compile_kernels(announce, tuple(sys.modules[name] for name in names))


Prepare = Callable[..., Scenario]
"""`cosim.app.first_run.prepared`, or what stands for it."""
_ONE_AT_A_TIME: Final = threading.Lock()
"""Executors may have several threads in a process; runs keep to one each, as kernels and engines expect."""


def run_task(prepare: Prepare, task: Task) -> Row:
    """Run a design; whatever is wrong with it is said in the row.

    Args:
        prepare: chooses the fidelity of a scenario, and builds what its run needs.
        task: the design.
    """
    with _ONE_AT_A_TIME:
        wall, cpu = time.perf_counter(), time.thread_time()
        with files_read() as files:
            try:
                scenario = _unpacked(task)
                wall, cpu = time.perf_counter(), time.thread_time()
                row = _run(prepare(scenario, _say_nothing, recording=False), task)
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
    warm_up(scenario)
    return scenario


def _run(scenario: Scenario, task: Task) -> Row:
    started = time.perf_counter()
    measure = measure_named(task.measure) if isinstance(task.measure, str) else task.measure
    arrays = ResultBuilder(scenario.recording.frames_per_s)
    watchers: Sequence[Observer] = () if measure is None else (arrays,)
    directory = None if task.directory is None else Path(task.directory)
    build = partial(build_simulation, kept=_kept_here())
    outcome = execute(scenario, build, Options(directory, None, watchers), started)
    error, summary = outcome.error, outcome.summary
    if isinstance(error, InputError):
        return Row("refused", reason_of(error))
    figures = figures_of(summary)
    if measure is not None and summary["status"] == "completed":
        figures |= measured(measure, arrays.result(summary, directory))
    return Row(summary["status"], summary["reason"], figures)


@cache
def _kept_here() -> KeptParts:
    """Return the parts that the designs of a process share; see `_ONE_AT_A_TIME`."""
    return KeptParts()


@cache
def _make_known(modules: tuple[str, ...]) -> None:
    register_installed()
    for name in modules:
        register_module(name)


def _say_nothing(_text: Any) -> None:
    """Do nothing: who started the sweep has been told."""
