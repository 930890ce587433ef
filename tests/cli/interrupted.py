"""`cosim run` interrupted and resumed, on the made-up simulation."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cosim.app import driver, preparation
from cosim.cli.main import main
from cosim.recording.recorder import RecordingPart
from tests.cli.test_run import REFERENCE, NotingRecorder, files_in, summary_of

WALL = {"startup_s", "wall_s", "command_s", "compiling_s", "real_time_factor", "resumed_at_ticks"}


def figures(directory: Path) -> dict[str, Any]:
    """Return what of a summary does not depend on the clock on the wall."""
    return {key: value for key, value in summary_of(directory).items() if key not in WALL}


def interrupt_at(last: int, times: int = 1) -> Callable[[int], None]:
    """Return what sends Ctrl-C while a tick is computed."""

    def at_tick(tick: int) -> None:
        if tick == last:
            for _ in range(times):
                os.kill(os.getpid(), signal.SIGINT)

    return at_tick


class Command:
    """`cosim run` on the made-up simulation; `parts` is what the recorders were made with."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, made_up_build: Any, directory: Path) -> None:
        self._patch, self._build, self.directory = monkeypatch, made_up_build, directory
        self.scenario: str = REFERENCE
        self.parts: list[RecordingPart] = []
        self.recorders: list[NotingRecorder] = []

    def __call__(self, *arguments: str, at_tick: Callable[[int], None] = lambda tick: None) -> int:
        self._patch.setattr(preparation, "build_simulation", self._build(at_tick))
        self._patch.setattr(driver, "rerun_recorder", self._recorder)
        return main(["run", *arguments])

    def _recorder(self, path: Path, settings: Any, part: RecordingPart) -> NotingRecorder:
        self.parts.append(part)
        self.recorders.append(NotingRecorder(path))
        return self.recorders[-1]

    def start(self, *arguments: str, at_tick: Callable[[int], None] = lambda tick: None) -> int:
        """Run the scenario from its start."""
        return self(self.scenario, "--out", str(self.directory), *arguments, at_tick=at_tick)

    def resume(self, *arguments: str, at_tick: Callable[[int], None] = lambda tick: None) -> int:
        """Go on."""
        return self("--resume", str(self.directory), *arguments, at_tick=at_tick)

    def names(self) -> list[str]:
        """Return the names of the files, but for the marker."""
        return files_in(self.directory)
