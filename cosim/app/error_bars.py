"""`cosim.error_bars`: the error bars of a finished run, from what it has kept of the ends of its phases."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cosim.app import driver
from cosim.app.checkpoint import naming
from cosim.app.ended_run import load_run
from cosim.app.preparation import log
from cosim.app.run_files import PHASE_ENDS, SCENARIO
from cosim.base import state_file
from cosim.base.kept_parts import KeptParts
from cosim.base.resources import is_file
from cosim.base.state_checks import check_indices, check_state
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.results.result import RunResult
from cosim.telemetry.phase_ends import PhaseEnds
from cosim.telemetry.run_errors import RunErrors
from cosim.telemetry.run_info import RunInfo


def error_bars(run: RunResult | str | Path) -> RunErrors:
    """Return how far the figures of a finished run may be off, at the ends of all its phases.

    The run is not repeated: states at rest near the ends of its phases are solved on its mesh and on a finer
    one. See docs/run_error.md.

    Args:
        run: the result of `cosim.run` or `cosim.load_run`, or the directory of a run.

    Raises:
        InputError: there is no such run, it has kept no ends of phases, or they cannot be read.
    """
    from cosim.bars.study import find_bars  # here, because it loads the film's kernels

    result = run if isinstance(run, RunResult) else load_run(run)
    ends, scenario = result.ends, result.scenario
    if ends is None or scenario is None:
        if result.directory is None:
            raise InputError("the run has kept no ends of phases: it was no single arm's, made by cosim.run")
        ends, scenario = _read(result.directory, result.stage)
    return find_bars(scenario, ends, log, everywhere=True, parts=KeptParts(on_disk=True))


def bars_finder(error: bool | None, tell: Callable[[str], None], kept: KeptParts) -> driver.FindsBars | None:
    """Return what works out the error bars at the end of a run; None where `error` is false.

    Args:
        error: whether they are asked for; None: where they cost little of the run.
        tell: told in a sentence if it takes more than a second.
        kept: parts that may be used again.
    """
    if error is False:
        return None

    def find(scenario: Scenario, ends: PhaseEnds) -> RunErrors:
        from cosim.bars.study import find_bars  # here, because it loads the film's kernels

        return find_bars(scenario, ends, tell, everywhere=error is True, parts=kept)

    return find


def _read(directory: Path, stage: RunInfo) -> tuple[PhaseEnds, Scenario]:
    """Return the phase ends in a run's directory, and its scenario.

    Raises:
        InputError: there are none, or they cannot be read.
    """
    from cosim.coupling.robots import beam_robot, film_robot  # noqa: F401  # of which states are

    path, scenario = directory / PHASE_ENDS, directory / SCENARIO
    if not is_file(path):
        raise InputError(
            f"{directory}: holds no {PHASE_ENDS}: the run is of another cosim, or one of several arms; run "
            f"it again: cosim run {scenario}"
        )
    found = state_file.load(path)
    if not isinstance(found, PhaseEnds):
        raise InputError(f"{path}: holds no ends of phases but a {type(found).__name__}")
    with naming(path):
        check_state(found, None, PhaseEnds, place="phase ends")
        for end in found.ends:
            check_indices(np.array([end.phase]), len(stage.phase_names), "phases")
    return found, load_scenario(scenario)
