"""`cosim export`: what a run saw, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from cosim.app.loaded_run import load_run
from cosim.app.output_directory import OutputDirectory
from cosim.cli.screen import printable
from cosim.errors import InputError, OutputError
from cosim.results.csv_file import write_csv
from cosim.results.curves import figure_kind
from cosim.results.film_vtk import COLLECTION, write_film

CSV: Final = "arrays.csv"
PLOT: Final = "curves.png"


def export_command(
    directory: Path, out: Path | None, *, csv: bool, vtk: bool, plot: bool, times_s: Sequence[float] = ()
) -> None:
    """Write files of a run for other programs, and print where they are.

    Args:
        directory: of the run.
        out: directory of the files; None: that of the run.
        csv: all that has a row per tick, as a table.
        vtk: the deformed film.
        plot: the usual curves.
        times_s: of the film; none: all frames.

    Raises:
        InputError: there is no such run or time, or nothing was asked for.
        OutputError: a file cannot be written.
    """
    if not (csv or vtk or plot):
        raise InputError("export: say what to write: --csv, --vtk, --plot, or several of them")
    if times_s and not vtk:
        raise InputError("--at: chooses times of the film; give --vtk as well")
    if plot:
        figure_kind()
    result = load_run(directory)
    with OutputDirectory(directory if out is None else out) as target:
        target.make()
        if csv:
            target.claim(CSV)
            write_csv(result, target.path / CSV)
            _tell(target.path / CSV)
        if plot:
            target.claim(PLOT)
            try:
                result.plot().savefig(target.path / PLOT, dpi=110)
            except OSError as error:
                raise OutputError(f"{target.path / PLOT}: cannot be written: {error.strerror}") from error
            _tell(target.path / PLOT)
        if vtk:
            written = write_film(result, target.path, times_s, target.claim)
            _tell(target.path / COLLECTION, f", {len(written) - 1} times; open it in ParaView")


def _tell(path: Path, more: str = "") -> None:
    print(printable(f"{path}{more}"))
