"""A picture of a run's recording, as Rerun's viewer shows it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import final

from cosim.app.run_files import RECORDING, recordings
from cosim.base.resources import is_file
from cosim.errors import InputError
from cosim.results.result import RunResult


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
    """Return the recordings of a run, in order.

    Args:
        run: directory of the run, a .rrd file, or a run that wrote a recording.

    Raises:
        InputError: there is none.
    """
    if isinstance(run, RunResult):
        if run.directory is None:
            raise InputError("the run wrote no files; record it: cosim.run(..., recording=True)")
        run = run.directory
    path = Path(run)
    is_folder = os.path.isdir(path)  # False too where no name can be that long
    found = recordings(path) if is_folder else [path]
    if not found or not is_file(found[0]):
        missing = path / RECORDING if is_folder else path
        raise InputError(f"no recording at {missing}; make one: cosim run SCENARIO --out {path}")
    return found
