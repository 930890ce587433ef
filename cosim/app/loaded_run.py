"""Loading what a run saw from its directory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

from cosim.app.run_files import ARRAYS, CHECKPOINT, FRAMES, SCENARIO, SUMMARY, parts
from cosim.errors import InputError
from cosim.results.array_files import check_rows, read_parts, read_stage
from cosim.results.html import as_html
from cosim.results.result import COLUMNS, FRAME_COLUMNS, RunResult
from cosim.telemetry.summary import Status, phase_row


def load_run(directory: str | Path) -> RunResult:
    """Return what a run saw: its arrays as they were in memory, its summary, and names of all parts.

    Args:
        directory: that `cosim run` or `cosim.run(..., out=directory)` wrote.

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
            f"{where}: holds no {ARRAYS} and {FRAMES}, which cosim {version} did not write yet; "
            f"{_again(where)}"
        )
    stage = read_stage(ticks[-1])
    arrays = read_parts(ticks, COLUMNS, "tick") | read_parts(frames, FRAME_COLUMNS, "frame_tick")
    check_rows(arrays, ticks, frames, summary["ticks"], _again(where))
    return RunResult(stage, summary, where, **arrays)


def _summary(where: Path) -> dict[str, Any]:
    path = where / SUMMARY
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        if (where / CHECKPOINT).is_file():
            raise InputError(
                f"{where}: the run has not ended; go on with it: cosim run --resume {where}"
            ) from None
        raise InputError(
            f"{where}: holds no run, for want of a {SUMMARY}; make one: cosim run SCENARIO --out {where}"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read: {error}; {_again(where)}") from error
    if not isinstance(found, dict) or "status" not in found:
        raise InputError(f"{path}: is no summary of a run; {_again(where)}")
    try:
        _check_figures(found)
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: is no whole summary of a run: {type(error).__name__}: {error}; {_again(where)}"
        ) from error
    return found


def _check_figures(summary: dict[str, Any]) -> None:
    """Raise what is raised where figures are missing or of another kind, by showing them."""
    as_html("", summary)
    status, ticks = summary["status"], summary["ticks"]
    if status not in get_args(Status) or type(ticks) is not int or not 0 <= ticks < 2**53:
        raise ValueError(f"status {status!r:.80}, ticks {ticks!r:.80}")
    for phase in summary["phases"]:
        phase_row(phase)


def _again(where: Path) -> str:
    return f"run it again: cosim run {where / SCENARIO}"
