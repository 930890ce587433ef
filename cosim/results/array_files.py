"""The arrays of a run on disk: written in parts while the run lasts, read back as one."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cosim._version import __version__
from cosim.base.column import Column
from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.results.arrow_files import read_columns, read_header, write_columns
from cosim.results.result import CameraImages
from cosim.results.result_builder import frame_rows
from cosim.results.run_columns import COLUMNS, FRAME_COLUMNS, IMAGE_COLUMNS
from cosim.results.stored_stage import stage_of, stored_stage
from cosim.telemetry.run_info import RunInfo

ARRAYS_SCHEMA: Final = 1


def write_arrays(
    ticks: Path, frames: Path, stage: RunInfo, frames_per_s: float, arrays: Mapping[str, Array]
) -> None:
    """Write a part of a run.

    Args:
        ticks: file of the arrays with a row per tick.
        frames: file of the arrays with a row per frame.
        stage: of the run.
        frames_per_s: frames with node positions, per second of simulated time.
        arrays: all arrays by name.

    Raises:
        OutputError: a file cannot be written.
    """
    header = {
        "schema": ARRAYS_SCHEMA,
        "cosim_version": __version__,
        "frames_per_s": frames_per_s,
        "stage": stored_stage(stage),
    }
    for path, columns in ((frames, FRAME_COLUMNS), (ticks, COLUMNS)):
        texts = {name: _described(column, stage, arrays[name]) for name, column in columns.items()}
        write_columns(path, {name: arrays[name] for name in columns}, texts, header)


def write_images(path: Path, camera: str, images: CameraImages) -> None:
    """Write the images of a camera.

    Args:
        path: of the file.
        camera: its name.
        images: at least one.

    Raises:
        OutputError: the file cannot be written.
    """
    texts = {
        name: {"unit": column.unit, "meaning": column.meaning, "axes": column.axes}
        for name, column in IMAGE_COLUMNS.items()
    }
    write_columns(path, images.arrays, texts, {"schema": ARRAYS_SCHEMA, "camera": camera})


def read_images(paths: Sequence[Path], camera: str) -> CameraImages | None:
    """Return the images of a camera in some files; None without any.

    Raises:
        InputError: a file cannot be read, or lacks an array.
    """
    files = [path for path in paths if read_header(path).get("camera") == camera]
    return CameraImages(read_parts(files, IMAGE_COLUMNS, "tick")) if files else None


def read_stage(path: Path) -> RunInfo:
    """Return the description of the run that a file of arrays belongs to.

    Raises:
        InputError: the file cannot be read, or has another schema.
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


def read_parts(paths: Sequence[Path], names: Iterable[str], tick: str) -> dict[str, Any]:
    """Return the arrays of the parts of a run as one.

    A part begins at its checkpoint; later ticks of an earlier part are skipped.

    Args:
        paths: of the parts, in order.
        names: of the arrays.
        tick: name of the array of ticks.

    Raises:
        InputError: a file cannot be read, or lacks an array.
    """
    parts: list[dict[str, Array]] = []
    for path in paths:
        part = read_columns(path)
        if missing := [name for name in names if name not in part]:
            raise InputError(f"{path}: lacks {', '.join(missing)}; run its scenario again")
        if len(part[tick]):
            parts = [_before(earlier, tick, part[tick][0]) for earlier in parts]
            parts.append(part)
    if not parts:
        return {name: np.zeros(0) for name in names}
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


def check_rows(
    arrays: Mapping[str, Array], ticks: Sequence[Path], frames: Sequence[Path], last: int, remedy: str
) -> None:
    """Check that there is a row for each tick of a run, and one for each of its frames.

    Args:
        arrays: of all parts.
        ticks: files of the arrays with a row per tick.
        frames: files of the arrays with a row per frame.
        last: last tick of the run; a run that failed at its start has no rows.
        remedy: text on what to do if rows are missing.

    Raises:
        InputError: rows are missing, or belong to other ticks.
    """
    tick, frame_tick = arrays["tick"], arrays["frame_tick"]
    expected = range(last + 1 if last or len(tick) else 0)  # a damaged summary may have any number
    _check_same(ticks, tick, expected, f"the run's summary counts ticks 0 to {last}", remedy)
    frames_per_s = read_header(frames[-1]).get("frames_per_s")
    if frames_per_s is not None:  # older files lack it
        framed = tick[frame_rows(arrays["time_s"], frames_per_s)]
        _check_same(frames, frame_tick, framed, f"there are {frames_per_s:g} frames/s", remedy)


def _check_same(files: Sequence[Path], ticks: Any, expected: Any, why: str, remedy: str) -> None:
    if len(ticks) != len(expected):
        problem = f"{len(ticks)} rows; must have {len(expected)}"
    elif not np.array_equal(ticks, expected):
        problem = f"rows of other ticks than the {len(expected)} that it must have"
    else:
        return
    names = ", ".join([str(files[0]), *(file.name for file in files[1:])])
    raise InputError(f"{names}: {'have' if len(files) > 1 else 'has'} {problem}, since {why}; {remedy}")


def _before(part: dict[str, Array], tick: str, first: int) -> dict[str, Array]:
    rows = int(np.searchsorted(part[tick], first))
    return {name: array[:rows] for name, array in part.items()}


def _described(column: Column, stage: RunInfo, array: Array) -> dict[str, Any]:
    text: dict[str, Any] = {"unit": column.unit, "meaning": column.meaning, "axes": column.axes}
    if "nodes" not in column.axes:
        text["components"] = column.components(stage.names_along, array.shape[1:])
    return text
