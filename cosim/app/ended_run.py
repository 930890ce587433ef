"""Loads an ended run from its directory."""

import json
import os
from pathlib import Path
from typing import Any, get_args

from cosim.app import run_files
from cosim.app.run_files import ARRAYS, CHECKPOINT, FRAMES, RECORDING, SCENARIO, SUMMARY, parts, recordings
from cosim.base.resources import is_file
from cosim.config.several_arms import has_arms
from cosim.errors import InputError
from cosim.results.array_files import check_rows, read_images, read_parts, read_stage
from cosim.results.result import RunResult
from cosim.results.run_columns import COLUMNS, FRAME_COLUMNS
from cosim.results.run_html import as_html
from cosim.telemetry.summary import Status
from cosim.telemetry.texts.summary_tables import phase_cells


def load_run(directory: str | Path) -> RunResult:
    """Return the result of a run: its arrays, its summary, and its description.

    Args:
        directory: of `cosim run` or `cosim.run(..., out=directory)`.

    Raises:
        InputError: there is no run, it has not ended, or its files cannot be read, are of another version or
            do not fit together.
    """
    where = Path(directory)
    summary = _summary(where)
    ticks, frames = parts(where, ARRAYS), parts(where, FRAMES)
    if not ticks or not frames:
        version = summary.get("cosim_version")
        raise InputError(
            f"{where}: has no {ARRAYS} and {FRAMES}, which cosim {version} did not write yet; {_again(where)}"
        )
    stage = read_stage(ticks[-1])
    arrays = read_parts(ticks, COLUMNS, "tick") | read_parts(frames, FRAME_COLUMNS, "frame_tick")
    check_rows(arrays, ticks, frames, summary["ticks"], _again(where))
    images = {
        one.name: read_images(parts(where, run_files.images_file(one.name)), one.name)
        for one in stage.cameras
    }
    taken = {name: each for name, each in images.items() if each is not None}
    return RunResult(stage, summary, where, arrays, taken)


def _summary(where: Path) -> dict[str, Any]:
    path = where / SUMMARY
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        if (where / CHECKPOINT).is_file():
            raise InputError(
                f"{where}: the run has not ended; resume it: cosim run --resume {where}"
            ) from None
        if _is_of_several(where):
            arms = [folder.parent.name for folder in sorted(where.glob(f"*/{SUMMARY}"))]
            raise InputError(
                f"{where}: has the runs of several arms, {', '.join(arms)}; give the directory of one, "
                f"such as {where / arms[0] if arms else where / 'ARM'}"
            ) from None
        raise InputError(
            f"{where}: has no run: {SUMMARY} is missing; make one: cosim run SCENARIO --out {where}"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read: {error}; {_again(where)}") from error
    if not isinstance(summary, dict) or "status" not in summary:
        raise InputError(f"{path}: is no summary of a run; {_again(where)}")
    try:
        _check_figures(summary)
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: is no complete summary of a run: {type(error).__name__}: {error}; {_again(where)}"
        ) from error
    return summary


def _is_of_several(where: Path) -> bool:
    """Return whether a directory is that of a run of several arms."""
    return is_file(where / SCENARIO) and has_arms(where / SCENARIO)


def _check_figures(summary: dict[str, Any]) -> None:
    """Check figures by formatting them, which raises an error if one is missing or of another type."""
    as_html("", summary)
    status, ticks = summary["status"], summary["ticks"]
    if status not in get_args(Status) or type(ticks) is not int or not 0 <= ticks < 2**53:
        raise ValueError(f"status {status!r:.80}, ticks {ticks!r:.80}")
    for phase in summary["phases"]:
        phase_cells(phase)


def _again(where: Path) -> str:
    return f"run it again: cosim run {where / SCENARIO}"


def found_recordings(run: str | Path | RunResult) -> list[Path]:
    """Return the recordings of a run, in order; for one of several arms, those of all arms.

    Args:
        run: directory of the run, a .rrd file, or a run that wrote a recording.

    Raises:
        InputError: no run was found there.
    """
    if isinstance(run, RunResult):
        if run.directory is None:
            raise InputError("the run wrote no files; record it: cosim.run(..., recording=True)")
        run = run.directory
    path = Path(run)
    is_folder = os.path.isdir(path)  # also False if the name is too long
    files = recordings(path) if is_folder else [path]
    if not files and _is_of_several(path.absolute().parent):
        files = recordings(path.absolute().parent)
    if not files or not is_file(files[0]):
        missing = path / RECORDING if is_folder else path
        raise InputError(f"no recording at {missing}; make one: cosim run SCENARIO --out {path}")
    return files
