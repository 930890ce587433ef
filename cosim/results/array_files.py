"""The arrays of a run on disk: written part by part while it lasts, read back as one.

A part of a run that went on from a checkpoint begins there; what an earlier part holds of later ticks is
passed over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cosim._version import __version__
from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.results.array_texts import ArrayText, array_texts
from cosim.results.parquet import read_columns, read_header, write_columns
from cosim.results.result import COLUMNS, FRAME_COLUMNS, RunResult, frame_rows
from cosim.results.stored_stage import stage_of, stored_stage
from cosim.telemetry.snapshot import RunInfo

ARRAYS_SCHEMA: Final = 1


def write_arrays(
    ticks: Path, frames: Path, stage: RunInfo, frames_per_s: float, arrays: Mapping[str, Array]
) -> None:
    """Write a part of a run.

    Args:
        ticks: file of what has a row per tick.
        frames: file of what has a row per frame.
        stage: of the run.
        frames_per_s: how often node positions are kept, in simulated time.
        arrays: all of them, by name.

    Raises:
        OutputError: they cannot be written.
    """
    header = {
        "schema": ARRAYS_SCHEMA,
        "cosim_version": __version__,
        "frames_per_s": frames_per_s,
        "stage": stored_stage(stage),
    }
    for path, names in ((frames, FRAME_COLUMNS), (ticks, COLUMNS)):
        texts = {name: _said(array_texts(RunResult)[name], stage, arrays[name]) for name in names}
        write_columns(path, {name: arrays[name] for name in names}, texts, header)


def read_stage(path: Path) -> RunInfo:
    """Return the stage of the run that a file of arrays belongs to.

    Raises:
        InputError: it cannot be read, or is of another schema.
    """
    header = read_header(path)
    if header.get("schema") != ARRAYS_SCHEMA:
        raise InputError(
            f"{path}: has schema {header.get('schema')}, of cosim {header.get('cosim_version')}; this cosim, "
            f"{__version__}, reads {ARRAYS_SCHEMA}"
        )
    try:
        return stage_of(header["stage"])
    except (InputError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error


def read_parts(paths: Sequence[Path], names: Sequence[str], tick: str) -> dict[str, Any]:
    """Return the arrays of the parts of a run as one.

    Args:
        paths: of the parts, in order.
        names: of the arrays.
        tick: which of them counts the ticks.

    Raises:
        InputError: one cannot be read, or lacks an array.
    """
    found: list[dict[str, Array]] = []
    for path in paths:
        part = read_columns(path)
        if missing := [name for name in names if name not in part]:
            raise InputError(f"{path}: lacks {', '.join(missing)}")
        if len(part[tick]):
            found = [_before(earlier, tick, part[tick][0]) for earlier in found]
            found.append(part)
    if not found:
        return {name: np.zeros(0) for name in names}
    return {name: np.concatenate([part[name] for part in found]) for name in names}


def check_rows(
    arrays: Mapping[str, Array], ticks: Sequence[Path], frames: Sequence[Path], last: int, remedy: str
) -> None:
    """Check that there is a row for each tick of a run, and one for each of its frames.

    Args:
        arrays: of all parts.
        ticks: files of what has a row per tick.
        frames: files of what has a row per frame.
        last: tick of the run; a run that failed at its start has no rows.
        remedy: what to do where rows are missing.

    Raises:
        InputError: there are fewer, more, or others.
    """
    tick, frame_tick = arrays["tick"], arrays["frame_tick"]
    wanted = range(last + 1 if last or len(tick) else 0)  # a damaged summary may count any number
    _check_same(ticks, tick, wanted, f"the run's summary counts ticks 0 to {last}", remedy)
    frames_per_s = read_header(frames[-1]).get("frames_per_s")
    if frames_per_s is not None:  # in files since this was written
        kept = tick[frame_rows(arrays["time_s"], frames_per_s)]
        _check_same(frames, frame_tick, kept, f"{frames_per_s:g} frames/s were kept", remedy)


def _check_same(files: Sequence[Path], found: Any, wanted: Any, why: str, remedy: str) -> None:
    if len(found) != len(wanted):
        problem = f"{len(found)} rows; must have {len(wanted)}"
    elif not np.array_equal(found, wanted):
        problem = f"rows of other ticks than it must have, {len(wanted)} of them"
    else:
        return
    names = ", ".join([str(files[0]), *(file.name for file in files[1:])])
    raise InputError(f"{names}: {'have' if len(files) > 1 else 'has'} {problem}, since {why}; {remedy}")


def _before(part: dict[str, Array], tick: str, first: int) -> dict[str, Array]:
    rows = int(np.searchsorted(part[tick], first))
    return {name: array[:rows] for name, array in part.items()}


def _said(text: ArrayText, stage: RunInfo, array: Array) -> dict[str, Any]:
    said: dict[str, Any] = {"unit": text.unit, "meaning": text.meaning, "axes": text.axes}
    if "nodes" not in text.axes:
        said["components"] = text.components(stage, array.shape[1:]) if array.ndim > 1 else []
    return said
