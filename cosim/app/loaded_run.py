"""Loading what a run saw from its directory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cosim.app.run_files import ARRAYS, CHECKPOINT, FRAMES, SCENARIO, SUMMARY, parts
from cosim.errors import InputError
from cosim.results.array_files import read_parts, read_stage
from cosim.results.result import COLUMNS, FRAME_COLUMNS, RunResult


def load_run(directory: str | Path) -> RunResult:
    """Return what a run saw: its arrays as they were in memory, its summary, and names of all parts.

    Args:
        directory: that `cosim run` or `cosim.run(..., out=directory)` wrote.

    Raises:
        InputError: there is no run, it has not ended, or its files cannot be read or are of another version.
    """
    where = Path(directory)
    summary = _summary(where)
    ticks, frames = parts(where, ARRAYS), parts(where, FRAMES)
    if not ticks or not frames:
        version = summary.get("cosim_version")
        raise InputError(
            f"{where}: holds no {ARRAYS} and {FRAMES}, which cosim {version} did not write yet; "
            f"run it again: cosim run {where / SCENARIO}"
        )
    stage = read_stage(ticks[-1])
    arrays = read_parts(ticks, COLUMNS, "tick") | read_parts(frames, FRAME_COLUMNS, "frame_tick")
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
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    if not isinstance(found, dict) or "status" not in found:
        raise InputError(f"{path}: is no summary of a run")
    return found
