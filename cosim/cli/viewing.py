"""The commands `cosim view` and `cosim video`, and the live view of `cosim run --live`."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, final

from cosim.app.ended_run import found_recordings
from cosim.cli.interruption import Interruption
from cosim.cli.screen import draw, tell
from cosim.config.schema.settings import RecordingTable
from cosim.errors import InputError
from cosim.recording.pictures import SIZE, write_video
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.recording.rerun_recorder import RerunRecorder
from cosim.recording.viewer import Shown, Viewer, check_display, start_viewer

ON_A_PAGE: Final = (
    "--web shows it in a browser, also in one elsewhere: "
    "ssh -L 9090:127.0.0.1:9090 -L 9876:127.0.0.1:9876 HOST"
)


def view_command(directory: Path, *, web: bool) -> int:
    """Open a recording in a window, or on a page for a browser until Ctrl-C; return the exit code.

    Args:
        directory: of the run, or a .rrd file.
        web: whether to open it on a page for a browser.

    Raises:
        InputError: there is no recording, or no display.
        OutputError: the viewer does not start.
    """
    found = found_recordings(directory)
    if web:
        _serve(start_viewer("page", found))
        return 0
    check_display(f"{ON_A_PAGE}; cosim video {directory} OUT.mp4 draws without a display")
    start_viewer("window", found).wait()
    return 0


def video_command(options: argparse.Namespace) -> int:
    """Write a video of a recording; return the exit code.

    Raises:
        InputError: there is no recording, or an option cannot be used.
        OutputError: there is no graphics driver, or the video cannot be written.
    """
    found = found_recordings(options.directory)
    if not options.out.parent.is_dir():
        raise InputError(f"{options.out}: there is no directory {options.out.parent}")
    size = _size(options.size)
    terminal = sys.stderr.isatty()

    def shown(done: int, frames: int) -> None:
        if terminal:
            draw(f"\r\x1b[Kframe {done} of {frames}" + "\n" * (done == frames), sys.stderr)

    frames = write_video(
        found,
        options.out,
        size=size,
        view=options.view,
        frames_per_s=options.fps,
        speed=options.speed,
        shown=shown,
    )
    print(f"{options.out}: {frames} frames, {frames / options.fps:.1f} s")
    return 0


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise InputError(f"--size {text}: give WIDTHxHEIGHT in pixels, such as {SIZE[0]}x{SIZE[1]}")
    return int(width), int(height)


@final
class LiveView:
    """Shows a run in a viewer while it is simulated.

    Args:
        shown: "window"; or "page" for a browser, until Ctrl-C after the run.

    Raises:
        InputError: there is no display for a window.
    """

    def __init__(self, shown: Shown) -> None:
        if shown == "window":
            check_display(ON_A_PAGE)
        self._shown: Shown = shown
        self._viewer: Viewer | None = None

    def recorder(self, path: Path, settings: RecordingTable, part: RecordingPart) -> Recorder:
        """Start the viewer, and return the recorder that writes the file and shows the run."""
        self._viewer = start_viewer(self._shown)
        if self._viewer.page is not None:
            tell(f"shown at {self._viewer.page}")
        return RerunRecorder(path, frames_per_s=settings.frames_per_s, part=part, viewer=self._viewer.address)

    def serve_on(self) -> None:
        """Leave the page open until Ctrl-C; a window needs no process of cosim."""
        if self._viewer is not None and self._viewer.page is not None:
            _serve(self._viewer)

    def close(self) -> None:
        """End the viewer of a page."""
        if self._viewer is not None and self._viewer.page is not None:
            self._viewer.stop()


def _serve(viewer: Viewer) -> None:
    """Wait until the viewer ends; Ctrl-C or SIGTERM ends it."""
    tell(f"shown at {viewer.page} on this machine alone; Ctrl-C ends it")
    try:
        with Interruption():
            viewer.wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.stop()


@contextmanager
def live_view(*, web: bool, recording: bool) -> Iterator[LiveView]:
    """Open a live view of a run, in a window or for a browser.

    Raises:
        InputError: there is no display, or the run is not recorded.
    """
    if not recording:
        raise InputError("--no-recording: a live view shows the recording; leave one of them out")
    view = LiveView("page" if web else "window")
    try:
        yield view
    finally:
        view.close()
