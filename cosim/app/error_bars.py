"""Error bars of a finished run, from the saved ends of its phases."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cosim.app.ended_run import load_run
from cosim.app.preparation import log
from cosim.app.run_files import PHASE_ENDS, SCENARIO
from cosim.app.run_follower import FindsBars
from cosim.app.shown_state import naming
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
    """Return the error bars of a finished run at the ends of all its phases.

    The run is not repeated: states at rest near the ends of its phases are solved on its mesh and on a finer
    mesh. See docs/run_error.md.

    Args:
        run: the result of `cosim.run` or `cosim.load_run`, or the directory of a run.

    Raises:
        InputError: there is no such run, it has no saved ends of phases, or they cannot be read.
    """
    from cosim.bars.study import find_bars  # here: it loads the film's kernels

    result = run if isinstance(run, RunResult) else load_run(run)
    ends, scenario = result.ends, result.scenario
    if ends is None or scenario is None:
        if result.directory is None:
            raise InputError("the run has no saved ends of phases, as only runs of one arm by cosim.run have")
        ends, scenario = _read(result.directory, result.stage)
    return find_bars(scenario, ends, log, everywhere=True, parts=KeptParts(on_disk=True))


def bars_finder(error: bool | None, tell: Callable[[str], None], kept: KeptParts) -> FindsBars | None:
    """Return a function that computes the error bars at the end of a run; None if `error` is False.

    Args:
        error: whether error bars are wanted; None: if they cost little compared with the run.
        tell: called with a sentence before something takes long.
        kept: parts that may be used again.
    """
    if error is False:
        return None

    def find(scenario: Scenario, ends: PhaseEnds) -> RunErrors:
        from cosim.bars.study import find_bars  # here: it loads the film's kernels

        return find_bars(scenario, ends, tell, everywhere=error is True, parts=kept)

    return find


def _read(directory: Path, stage: RunInfo) -> tuple[PhaseEnds, Scenario]:
    """Return the phase ends in a run's directory, and its scenario.

    Raises:
        InputError: there are none, or they cannot be read.
    """
    from cosim.coupling.robots import beam_robot, film_robot  # noqa: F401  # they define the states

    path, scenario = directory / PHASE_ENDS, directory / SCENARIO
    if not is_file(path):
        raise InputError(
            f"{directory}: has no {PHASE_ENDS}: the run is of another version of cosim, or of several arms; "
            f"run it again: cosim run {scenario}"
        )
    ends = state_file.load(path)
    if not isinstance(ends, PhaseEnds):
        raise InputError(f"{path}: holds a {type(ends).__name__}, not ends of phases")
    with naming(path):
        check_state(ends, None, PhaseEnds, place="phase ends")
        for end in ends.ends:
            check_indices(np.array([end.phase]), len(stage.phase_names), "phases")
    return ends, load_scenario(scenario)
