"""Rerun's viewer, and pictures and videos that it makes of a recording.

A run's recording as a video file.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import IO, Any, Final, Literal, final
from urllib.parse import quote

import numpy as np
import rerun
import rerun_cli
from rerun.experimental import ViewerClient

from cosim.base.video import encoded, encoder
from cosim.errors import InputError, OutputError

LOOPBACK: Final = "127.0.0.1"
"""The only address that a viewer listens on: nobody else on the network sees a run."""
DATA_PORT: Final = 9876
PAGE_PORT: Final = 9090
Shown = Literal["window", "page", "nowhere"]
_START_S: Final = 60.0
_QUIET: Final = "warn,re_renderer=error,egui_wgpu=error"
"""Rust's levels of log: what a software renderer says of itself would cover the picture."""
_OPTIONS: Final[dict[Shown, tuple[str, ...]]] = {
    "window": ("--hide-welcome-screen", "--expect-data-soon"),
    "page": ("--serve-web",),
    "nowhere": ("--headless", "--hide-welcome-screen"),
}
SIZE: Final = (1600, 900)
_TIMELINE: Final = "sim_time"
_WAIT_S: Final = 120.0
_PAUSE_S: Final = 0.1


@final
@dataclass(frozen=True)
class Viewer:
    """A viewer that runs; made by `start_viewer`.

    Args:
        process: of the viewer, in its own session: it outlives a run that Ctrl-C ends.
        address: where recordings can be sent to.
        page: what to open in a browser; None for other viewers.
        said: what it writes.
    """

    process: subprocess.Popen[bytes]
    address: str
    page: str | None
    said: IO[bytes]

    def check(self) -> None:
        """Check that the viewer still runs.

        Raises:
            OutputError: it has ended.
        """
        if self.process.poll() is not None:
            self.said.seek(0)
            raise OutputError(
                f"Rerun's viewer has ended: {_reason(self.said.read().decode(errors='replace'))}"
            )

    def wait(self) -> None:
        """Return once the viewer has ended."""
        self.process.wait()

    def stop(self) -> None:
        """End the viewer; does nothing if it has ended."""
        self.said.close()
        if self.process.poll() is not None:
            return
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def check_display(remedy: str, environment: Mapping[str, str] = os.environ) -> None:
    """Check that a window can be opened.

    Args:
        remedy: what to do where it cannot.
        environment: variables, by name.

    Raises:
        InputError: there is no display.
    """
    named = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not any(environment.get(name) for name in named):
        raise InputError(
            f"there is no display to open a window on ({' and '.join(named)} are not set); {remedy}"
        )


def start_viewer(shown: Shown, files: Sequence[Path] = (), *, size: tuple[int, int] | None = None) -> Viewer:
    """Start a viewer, and wait until it takes data.

    Args:
        shown: in a window, on a page that a browser on this machine can open, or nowhere, for pictures.
        files: recordings that it opens.
        size: (2,) of the window [pixels].

    Raises:
        OutputError: it ends at once, or does not answer.
    """
    port = _free_port(DATA_PORT if shown == "page" else 0)
    page_port = _free_port(PAGE_PORT) if shown == "page" else None
    options = [*_OPTIONS[shown], "--bind", LOOPBACK, "--port", str(port)]
    if page_port is not None:
        options += ["--web-viewer-port", str(page_port)]
    if size is not None:
        options += ["--window-size", f"{size[0]}x{size[1]}"]
    said = TemporaryFile()  # noqa: SIM115 (as long as the viewer)
    address = f"rerun+http://{LOOPBACK}:{port}/proxy"
    page = None if page_port is None else f"http://{LOOPBACK}:{page_port}/?url={quote(address, safe='')}"
    viewer = Viewer(_started([*options, *map(str, files)], said), address, page, said)
    for awaited in (port, page_port):
        if awaited is not None:
            _wait_for(viewer, awaited)
    return viewer


def _started(options: Sequence[str], said: IO[bytes]) -> subprocess.Popen[bytes]:
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    # the program itself: the script of that name leaves its child alone when it is ended
    program = Path(str(rerun_cli.__file__)).with_name(name)
    environment: dict[str, Any] = {"RUST_LOG": _QUIET, **os.environ}
    if environment["RUST_LOG"] == "off":  # of the command line; a viewer's last words are its reason to end
        environment["RUST_LOG"] = _QUIET
    try:
        return subprocess.Popen(
            [str(program), *options],
            stdin=subprocess.DEVNULL, stdout=said, stderr=said, env=environment, start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise OutputError(f"{program}: Rerun's viewer cannot be started: {error.strerror}") from error


def _wait_for(viewer: Viewer, port: int) -> None:
    """Return once somebody listens on a port.

    Raises:
        OutputError: the viewer ends before, or does not in time.
    """
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        viewer.check()
        with socket.socket() as asked:
            if asked.connect_ex((LOOPBACK, port)) == 0:
                return
        time.sleep(0.05)
    viewer.stop()
    raise OutputError(f"Rerun's viewer has not answered within {_START_S:g} s")


def _reason(said: str) -> str:
    """Return the line of what a viewer said that tells why it ended."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    if any(mark in line for line in lines for mark in ("graphics adapter", "render context")):
        return (
            "there is no Vulkan driver to draw with; a software one is enough "
            "(Debian and Ubuntu: apt-get install libvulkan1 mesa-vulkan-drivers)"
        )
    told = [line for line in lines if "rror" in line or "panick" in line] or lines
    return told[0] if told else "it said nothing"


def _free_port(wanted: int) -> int:
    """Return a port if nobody has it, else any free one."""
    for port in (wanted, 0):
        with socket.socket() as tried:
            try:
                tried.bind((LOOPBACK, port))
            except OSError:
                continue
            return int(tried.getsockname()[1])
    raise OutputError(f"no port of {LOOPBACK} is free")


@final
class Pictures:
    """Takes pictures of a recording while entered.

    Args:
        recordings: files of one run, in order.
        size: (2,) of the pictures [pixels].
        view: name of the only view to show, such as "Scene"; None for all of them, as laid out.

    Raises:
        InputError: on entering: there is no such view; the text names those there are.
        OutputError: the same: there is no driver to draw with, the recording cannot be read, or rerun-sdk is
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
            time_s: seconds; after the end stands the last picture.

        Raises:
            OutputError: the viewer has ended.
        """
        moment = np.timedelta64(round(min(time_s, self.end_s) * 1e9), "ns")
        self._asked(lambda: self._client.set_time(_TIMELINE, duration=moment, play_state="paused"))
        return bytes(self._asked(self._client.take_screenshot))

    def _asked(self, ask: Any) -> Any:
        """Return what the viewer answers; it is asked again while it is not ready.

        Raises:
            OutputError: it has ended, or does not answer in time.
        """
        assert self._viewer is not None, "entered before"
        until = time.monotonic() + _WAIT_S
        while True:
            try:
                return ask()
            except ConnectionError as error:
                self._viewer.check()
                if time.monotonic() > until:
                    raise OutputError(f"Rerun's viewer does not answer: {error}") from error
                time.sleep(_PAUSE_S)

    def _connected(self) -> Any:
        assert self._viewer is not None, "entered before"
        address = self._viewer.address
        client = self._asked(lambda: ViewerClient.connect(address))
        self._asked(client.get_state)
        return client

    def _loaded(self) -> float:
        """Wait for the recording, and return where its time ends, in seconds.

        Raises:
            OutputError: it cannot be read, or has no frames.
        """
        until = time.monotonic() + _WAIT_S
        while time.monotonic() < until:
            state = self._asked(self._client.get_state)
            ends = [line.end for one in state.recordings for line in one.timelines if line.name == _TIMELINE]
            if ends and state.views and not state.loading:
                return float(max(ends)) * 1e-9
            faults = [entry.message for entry in self._asked(self._client.get_logs) if entry.level == "ERROR"]
            if faults:
                raise OutputError(f"{self._recordings[0]}: cannot be read: {faults[0]}")
            time.sleep(_PAUSE_S)
        raise OutputError(f"{self._recordings[0]}: holds no frame of a run")

    def _show_only(self, name: str) -> None:
        views = {view.name: view.view_id for view in self._asked(self._client.get_state).views}
        if name not in views:
            raise InputError(f"there is no view '{name}'; there are {', '.join(sorted(views))}")
        layout = self._asked(lambda: self._client.get_blueprint("recording")).blueprint
        layout.setdefault("/viewport", {}).setdefault("ViewportBlueprint", {})["maximized"] = views[name]
        self._asked(lambda: self._client.set_blueprint(layout, "recording"))

    def _wait_until_drawn(self) -> None:
        """Wait until two pictures in a row are the same: data are still fetched once they are loaded."""
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
    """Write a video of a recording, from its begin to its end, and return how many frames it has.

    Args:
        recordings: files of one run, in order.
        path: of the video; what it ends with says its kind, such as .mp4. Nothing is there until all is done.
        size: (2,) of a frame [pixels]; both even.
        view: name of the only view to show; None for all of them, as laid out.
        frames_per_s: of the video.
        speed: simulated seconds per second of the video.
        shown: told how many of how many frames are drawn.

    Raises:
        InputError: a value cannot be used, there is no such view, or imageio-ffmpeg is not installed.
        OutputError: there is no driver to draw with, or the file cannot be written.
    """
    if not (0.0 < frames_per_s < np.inf and 0.0 < speed < np.inf):
        raise InputError(f"{frames_per_s:g} frames per second, speed {speed:g}: both must be above 0")
    if min(size) < 2 or any(length % 2 for length in size):
        raise InputError(f"size {size[0]}x{size[1]}: width and height must be even numbers")
    encoder()  # told of before anything is drawn
    step_s = speed / frames_per_s
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", f"{frames_per_s:g}"]
    with Pictures(recordings, size, view) as pictures, encoded(path, source) as write:
        times = np.arange(0.0, pictures.end_s + 0.5 * step_s, step_s)
        for count, time_s in enumerate(times, 1):
            write(pictures.at(float(time_s)))
            shown(count, len(times))
    return len(times)
