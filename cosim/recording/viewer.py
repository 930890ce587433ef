"""Starts Rerun's viewer: in a window, on a page for a browser of this machine, or without a display, for
pictures. It listens only on the loopback address.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Final, Literal, final
from urllib.parse import quote

import rerun_cli

from cosim.errors import InputError, OutputError

LOOPBACK: Final = "127.0.0.1"
"""The only address that a viewer listens on, so that a run is not visible in the network."""
DATA_PORT: Final = 9876
PAGE_PORT: Final = 9090
Shown = Literal["window", "page", "nowhere"]
_START_S: Final = 60.0
_QUIET: Final = "warn,re_renderer=error,egui_wgpu=error"
"""Levels of Rust's log. Messages of a software renderer would cover the picture."""
_OPTIONS: Final[dict[Shown, tuple[str, ...]]] = {
    "window": ("--hide-welcome-screen", "--expect-data-soon"),
    "page": ("--serve-web",),
    "nowhere": ("--headless", "--hide-welcome-screen"),
}


@final
@dataclass(frozen=True)
class Viewer:
    """A running viewer; made by `start_viewer`.

    Args:
        process: of the viewer, in a session of its own, so that Ctrl-C in a run does not end it.
        address: address that receives recordings.
        page: address of the page for a browser; None for other viewers.
        output: file with its log.
    """

    process: subprocess.Popen[bytes]
    address: str
    page: str | None
    output: IO[bytes]

    def check(self) -> None:
        """Check that the viewer still runs.

        Raises:
            OutputError: it has ended.
        """
        if self.process.poll() is not None:
            self.output.seek(0)
            raise OutputError(
                f"Rerun's viewer has ended: {_reason(self.output.read().decode(errors='replace'))}"
            )

    def wait(self) -> None:
        """Wait until the viewer has ended."""
        self.process.wait()

    def stop(self) -> None:
        """End the viewer; does nothing if it has ended."""
        self.output.close()
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
        remedy: for the message of the error.
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
    """Start a viewer, and wait until it accepts data.

    Args:
        shown: in a window, on a page for a browser on this machine, or nowhere, for pictures.
        files: recordings that it opens.
        size: (2,) of the window [pixels].

    Raises:
        OutputError: the viewer ends at once, or does not answer.
    """
    port = _free_port(DATA_PORT if shown == "page" else 0)
    page_port = _free_port(PAGE_PORT) if shown == "page" else None
    options = [*_OPTIONS[shown], "--bind", LOOPBACK, "--port", str(port)]
    if page_port is not None:
        options += ["--web-viewer-port", str(page_port)]
    if size is not None:
        options += ["--window-size", f"{size[0]}x{size[1]}"]
    output = TemporaryFile()  # noqa: SIM115 (as long as the viewer)
    address = f"rerun+http://{LOOPBACK}:{port}/proxy"
    page = None if page_port is None else f"http://{LOOPBACK}:{page_port}/?url={quote(address, safe='')}"
    viewer = Viewer(_started([*options, *map(str, files)], output), address, page, output)
    for opened in (port, page_port):
        if opened is not None:
            _wait_for(viewer, opened)
    return viewer


def _started(options: Sequence[str], output: IO[bytes]) -> subprocess.Popen[bytes]:
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    # not the Python script of that name, which does not end the program when it is ended
    program = Path(str(rerun_cli.__file__)).with_name(name)
    environment: dict[str, Any] = {"RUST_LOG": _QUIET, **os.environ}
    if environment["RUST_LOG"] == "off":  # of the command line; the log says why a viewer has ended
        environment["RUST_LOG"] = _QUIET
    try:
        return subprocess.Popen(
            [str(program), *options],
            stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment, start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise OutputError(f"{program}: Rerun's viewer cannot be started: {error.strerror}") from error


def _wait_for(viewer: Viewer, port: int) -> None:
    """Wait until the viewer listens on a port.

    Raises:
        OutputError: the viewer has ended, or does not listen in time.
    """
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        viewer.check()
        with socket.socket() as client:
            if client.connect_ex((LOOPBACK, port)) == 0:
                return
        time.sleep(0.05)
    viewer.stop()
    raise OutputError(f"Rerun's viewer has not answered within {_START_S:g} s")


def _reason(output: str) -> str:
    """Return the line of a viewer's log with the reason of its end."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    if any(mark in line for line in lines for mark in ("graphics adapter", "render context")):
        return (
            "there is no Vulkan driver to draw with; a software one is enough "
            "(Debian and Ubuntu: apt-get install libvulkan1 mesa-vulkan-drivers)"
        )
    errors = [line for line in lines if "rror" in line or "panick" in line] or lines
    return errors[0] if errors else "its log is empty"


def _free_port(wanted: int) -> int:
    """Return the wanted port if it is free, otherwise any free port."""
    for port in (wanted, 0):
        with socket.socket() as server:
            try:
                server.bind((LOOPBACK, port))
            except OSError:
                continue
            return int(server.getsockname()[1])
    raise OutputError(f"no port of {LOOPBACK} is free")
