"""A run that has ended: loaded from its directory, and its recording as Rerun's viewer shows it."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final, get_args

from cosim.app import run_files
from cosim.app.run_files import ARRAYS, CHECKPOINT, FRAMES, RECORDING, SCENARIO, SUMMARY, parts, recordings
from cosim.base.resources import is_file
from cosim.config.several_arms import has_arms
from cosim.errors import InputError
from cosim.results.array_files import check_rows, read_images, read_parts, read_stage
from cosim.results.result import COLUMNS, FRAME_COLUMNS, RunResult, as_html
from cosim.telemetry.summary import Status, phase_cells


def load_run(directory: str | Path) -> RunResult:
    """Return the record of a run: its arrays as they were in memory, its summary, and names of all parts.

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
    images = {
        one.name: read_images(parts(where, run_files.images_file(one.name)), one.name)
        for one in stage.cameras
    }
    seen = {name: found for name, found in images.items() if found is not None}
    return RunResult(stage, summary, where, arrays, seen)


def _summary(where: Path) -> dict[str, Any]:
    path = where / SUMMARY
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        if (where / CHECKPOINT).is_file():
            raise InputError(
                f"{where}: the run has not ended; resume it: cosim run --resume {where}"
            ) from None
        if _is_of_several(where):
            arms = [folder.parent.name for folder in sorted(where.glob(f"*/{SUMMARY}"))]
            raise InputError(
                f"{where}: holds the runs of several arms, {', '.join(arms)}: give the directory of one, "
                f"such as {where / arms[0] if arms else where / 'ARM'}"
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


def _is_of_several(where: Path) -> bool:
    """Return whether a directory is that of a run of several arms, each of which has one within it."""
    return is_file(where / SCENARIO) and has_arms(where / SCENARIO)


def _check_figures(summary: dict[str, Any]) -> None:
    """Raise what is raised where figures are missing or of another kind, by showing them."""
    as_html("", summary)
    status, ticks = summary["status"], summary["ticks"]
    if status not in get_args(Status) or type(ticks) is not int or not 0 <= ticks < 2**53:
        raise ValueError(f"status {status!r:.80}, ticks {ticks!r:.80}")
    for phase in summary["phases"]:
        phase_cells(phase)


def _again(where: Path) -> str:
    return f"run it again: cosim run {where / SCENARIO}"


@final
@dataclass(frozen=True, repr=False)
class Picture:
    """A picture; notebooks show it.

    Args:
        png: the file's content.
    """

    png: bytes

    def save(self, path: str | Path) -> None:
        """Write the picture to a file.

        Args:
            path: ends in .png.

        Raises:
            OSError: it cannot be written.
        """
        Path(path).write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        """Return one line: how large it is."""
        return f"Picture of {len(self.png)} bytes; save(path) writes it"


def picture(
    run: str | Path | RunResult,
    time_s: float = float("inf"),
    *,
    view: str | None = None,
    size: tuple[int, int] = (1600, 900),
) -> Picture:
    """Return a picture of a run's recording at some time; no display is needed.

    Args:
        run: directory of the run, a .rrd file, or a run that wrote a recording.
        time_s: simulated time; after the end stands the last picture.
        view: name of the only view to show, such as "Scene"; None for all of them, as laid out.
        size: (2,) width and height [pixels].

    Raises:
        InputError: there is no recording, or no such view; the text names those there are.
        OutputError: there is no driver to draw with, or the recording cannot be read.
    """
    from cosim.recording.pictures import Pictures  # here: few runs draw anything

    with Pictures(found_recordings(run), size, view) as pictures:
        return Picture(pictures.at(time_s))


def found_recordings(run: str | Path | RunResult) -> list[Path]:
    """Return the recordings of a run, in order; of an arm among several those of all arms.

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
    is_folder = os.path.isdir(path)  # False too where no name can be that long
    found = recordings(path) if is_folder else [path]
    if not found and _is_of_several(path.absolute().parent):
        found = recordings(path.absolute().parent)
    if not found or not is_file(found[0]):
        missing = path / RECORDING if is_folder else path
        raise InputError(f"no recording at {missing}; make one: cosim run SCENARIO --out {path}")
    return found
