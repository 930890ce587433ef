"""Resumes an interrupted run from its checkpoint."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.app.checkpoint import Checkpoint
from cosim.app.run_files import CHECKPOINT, SCENARIO, SUMMARY, scenario_digest
from cosim.app.shown_state import check_shown, naming, sizes_of
from cosim.base import resources, state_file
from cosim.base.files import changed_file
from cosim.base.identity import code_identity
from cosim.base.state_checks import check_state
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.telemetry.summary import SummaryBuilder

if TYPE_CHECKING:
    from cosim.stepping.stepped_run import SteppedRun


def check_resumable(directory: Path) -> None:
    """Check that a directory has an incomplete run with a checkpoint.

    Raises:
        InputError: there is no run, it is complete, or it has no checkpoint.
    """
    scenario, path, where = directory / SCENARIO, directory / CHECKPOINT, f"--resume {directory}:"
    if not resources.is_file(scenario):
        raise InputError(f"{where} has no run: {SCENARIO} is missing; start one: cosim run SCENARIO")
    if not resources.is_file(path):
        if _status(directory) == "completed":
            raise InputError(f"{where} this run is completed; nothing is left to do")
        raise InputError(f"{where} the run has no {CHECKPOINT}; start it again: cosim run {scenario}")


def tick_to_resume(directory: Path, scenario: Scenario) -> int:
    """Return the tick after which the run in a directory can continue.

    Args:
        directory: of the run.
        scenario: loaded from there.

    Raises:
        InputError: the checkpoint cannot be read, another program wrote it, or the scenario or one of its
            files was changed later.
    """
    file, path, where = directory / SCENARIO, directory / CHECKPOINT, f"--resume {directory}:"
    header = state_file.load_header(path)
    changed = changed_file(_table(header, "loaded"), {SCENARIO: scenario_digest(scenario)})
    if changed is not None:
        raise InputError(
            f"{where} {changed} was changed after the run began; start it again, or branch from Python: "
            f"cosim.Simulation({str(file)!r}, start={str(path)!r})"
        )
    before, now = _table(header, "written_by"), code_identity()
    other = [f"{key} {before.get(key)} (now {now[key]})" for key in now if now[key] != before.get(key)]
    if other:
        raise InputError(
            f"{where} the checkpoint was written with {', '.join(other)}; its results "
            f"would differ; start it again: cosim run {file}"
        )
    tick = header.get("tick")
    if not isinstance(tick, int):
        raise InputError(f"{where} {CHECKPOINT} has no tick; start it again: cosim run {file}")
    return tick


def read_checkpoint(directory: Path, simulation: SteppedRun) -> Checkpoint:
    """Restore a simulation from the checkpoint of a run, and return the checkpoint.

    Args:
        directory: of the run.
        simulation: to restore.

    Raises:
        InputError: the checkpoint cannot be read, or does not fit the simulation.
    """
    path, stage = directory / CHECKPOINT, simulation.stage
    checkpoint = state_file.load(path)
    if not isinstance(checkpoint, Checkpoint):
        raise InputError(f"{path}: holds a {type(checkpoint).__name__}, not a checkpoint")
    with naming(path):
        check_state(checkpoint, None, Checkpoint, place="checkpoint", sizes=sizes_of(stage), finite=False)
        for snapshot in (checkpoint.first, checkpoint.summary.seen):
            check_shown(snapshot, stage)
        SummaryBuilder(stage, 0.0, "").state = checkpoint.summary
        simulation.restore_state(checkpoint.run)
    return checkpoint


def _table(header: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return a table of a header, empty where the header has no such table."""
    table = header.get(key)
    return table if isinstance(table, dict) else {}


def _status(directory: Path) -> str | None:
    try:
        summary = json.loads((directory / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return str(summary.get("status")) if isinstance(summary, dict) else None
