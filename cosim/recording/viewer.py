"""Rerun's viewer as its own process: in a window, in a browser, or without a display."""

from __future__ import annotations

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
