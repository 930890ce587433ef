"""Takes pictures of a recording with Rerun's viewer, and writes them as a video file."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, final

import numpy as np
import rerun
from rerun.experimental import ViewerClient

from cosim.base.video import encoded, encoder
from cosim.errors import InputError, OutputError
from cosim.recording.entity_paths import TIMELINE
from cosim.recording.viewer import Viewer, start_viewer

SIZE: Final = (1600, 900)
_WAIT_S: Final = 120.0
_PAUSE_S: Final = 0.1


@final
class Pictures:
    """Takes pictures of a recording, as a context manager.

    Args:
        recordings: files of one run, in order.
        size: (2,) of the pictures [pixels].
        view: name of the only view to show, such as "Scene"; None for the whole layout.

    Raises:
        InputError: when entered: there is no such view; the message names the views.
        OutputError: when entered: there is no graphics driver, the recording cannot be read, or rerun-sdk is
            too old.
    """

    def __init__(
        self, recordings: Sequence[Path], size: tuple[int, int] = SIZE, view: str | None = None
    ) -> None:
        self._recordings, self._size, self._view = recordings, size, view
        self._viewer: Viewer | None = None
        self._client: Any = None
        self.end_s = 0.0

    def __enter__(self) -> "Pictures":
        if not hasattr(ViewerClient, "get_state"):
            raise OutputError(
                f"pictures and videos need rerun-sdk 0.41 or later, {rerun.__version__} is installed: "
                "pip install 'rerun-sdk>=0.41'; recordings and live views work as they are"
            )
        self._viewer = start_viewer("nowhere", self._recordings, size=self._size)
        try:
            self._client = self._connected()
            self.end_s = self._loaded()
            if self._view is not None:
                self._show_only(self._view)
            self._wait_until_drawn()
        except BaseException:
            self._viewer.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._viewer is not None, "entered before"
        self._viewer.stop()

    def at(self, time_s: float) -> bytes:
        """Return the picture at a simulated time, as a PNG.

        Args:
            time_s: simulated time [s]; after the end of the run, the last picture.

        Raises:
            OutputError: the viewer has ended.
        """
        moment = np.timedelta64(round(min(time_s, self.end_s) * 1e9), "ns")
        self._answer(lambda: self._client.set_time(TIMELINE, duration=moment, play_state="paused"))
        return bytes(self._answer(self._client.take_screenshot))

    def _answer(self, request: Callable[[], Any]) -> Any:
        """Return the answer of the viewer to a request, which is repeated until the viewer is ready.

        Raises:
            OutputError: the viewer has ended, or does not answer in time.
        """
        assert self._viewer is not None, "entered before"
        until = time.monotonic() + _WAIT_S
        while True:
            try:
                return request()
            except ConnectionError as error:
                self._viewer.check()
                if time.monotonic() > until:
                    raise OutputError(f"Rerun's viewer does not answer: {error}") from error
                time.sleep(_PAUSE_S)

    def _connected(self) -> Any:
        assert self._viewer is not None, "entered before"
        address = self._viewer.address
        client = self._answer(lambda: ViewerClient.connect(address))
        self._answer(client.get_state)
        return client

    def _loaded(self) -> float:
        """Wait for the recording, and return its last simulated time [s].

        Raises:
            OutputError: it cannot be read, or has no frames.
        """
        until = time.monotonic() + _WAIT_S
        while time.monotonic() < until:
            state = self._answer(self._client.get_state)
            ends = [line.end for one in state.recordings for line in one.timelines if line.name == TIMELINE]
            if ends and state.views and not state.loading:
                return float(max(ends)) * 1e-9
            faults = [
                entry.message for entry in self._answer(self._client.get_logs) if entry.level == "ERROR"
            ]
            if faults:
                raise OutputError(f"{self._recordings[0]}: cannot be read: {faults[0]}")
            time.sleep(_PAUSE_S)
        raise OutputError(f"{self._recordings[0]}: holds no frame of a run")

    def _show_only(self, name: str) -> None:
        views = {view.name: view.view_id for view in self._answer(self._client.get_state).views}
        if name not in views:
            raise InputError(f"there is no view '{name}'; there are {', '.join(sorted(views))}")
        layout = self._answer(lambda: self._client.get_blueprint("recording")).blueprint
        layout.setdefault("/viewport", {}).setdefault("ViewportBlueprint", {})["maximized"] = views[name]
        self._answer(lambda: self._client.set_blueprint(layout, "recording"))

    def _wait_until_drawn(self) -> None:
        """Wait until two successive pictures are equal, as the viewer draws loaded data with a delay."""
        before, until = b"", time.monotonic() + _WAIT_S
        while (now := self.at(self.end_s)) != before and time.monotonic() < until:
            before = now
            time.sleep(_PAUSE_S)


def write_video(
    recordings: Sequence[Path],
    path: Path,
    *,
    size: tuple[int, int] = SIZE,
    view: str | None = None,
    frames_per_s: float = 25.0,
    speed: float = 1.0,
    shown: Callable[[int, int], None] = lambda done, frames: None,
) -> int:
    """Write a video of a whole recording, and return its number of frames.

    Args:
        recordings: files of one run, in order.
        path: of the video; its suffix is the format, such as .mp4. The file appears when it is complete.
        size: (2,) of a frame [pixels]; both even.
        view: name of the only view to show; None for the whole layout.
        frames_per_s: of the video.
        speed: simulated seconds per second of the video.
        shown: called with the number of drawn frames and of all frames.

    Raises:
        InputError: a value cannot be used, there is no such view, or imageio-ffmpeg is not installed.
        OutputError: there is no graphics driver, or the file cannot be written.
    """
    if not (0.0 < frames_per_s < np.inf and 0.0 < speed < np.inf):
        raise InputError(f"{frames_per_s:g} frames per second, speed {speed:g}: both must be above 0")
    if min(size) < 2 or any(length % 2 for length in size):
        raise InputError(f"size {size[0]}x{size[1]}: width and height must be even numbers")
    encoder()  # a missing encoder is an error before any frame is drawn
    step_s = speed / frames_per_s
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", f"{frames_per_s:g}"]
    with Pictures(recordings, size, view) as pictures, encoded(path, source) as write:
        times = np.arange(0.0, pictures.end_s + 0.5 * step_s, step_s)
        for count, time_s in enumerate(times, 1):
            write(pictures.at(float(time_s)))
            shown(count, len(times))
    return len(times)
