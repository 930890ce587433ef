"""Pictures of a run's recording, as Rerun's viewer shows it."""

from dataclasses import dataclass
from pathlib import Path
from typing import final

from cosim.app.ended_run import found_recordings
from cosim.results.result import RunResult


@final
@dataclass(frozen=True, repr=False)
class Picture:
    """A picture; notebooks show it.

    Args:
        png: content of the PNG file.
    """

    png: bytes

    def save(self, path: str | Path) -> None:
        """Write the picture to a file.

        Args:
            path: of the file, which ends in .png.

        Raises:
            OSError: it cannot be written.
        """
        Path(path).write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        """Return one line: its size."""
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
        time_s: simulated time; after the end, the last picture is shown.
        view: name of a single view, such as "Scene"; None for all views.
        size: (2,) width and height [pixels].

    Raises:
        InputError: there is no recording, or no such view; the message names all views.
        OutputError: no driver for drawing was found, or the recording cannot be read.
    """
    from cosim.recording.pictures import Pictures  # here: few runs draw pictures

    with Pictures(found_recordings(run), size, view) as pictures:
        return Picture(pictures.at(time_s))
