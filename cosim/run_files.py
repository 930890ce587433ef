"""The directory of a run: `scenario.toml`, `summary.json`, `recording.rrd`, `checkpoint.npz`.

A run that went on after an interruption has a recording for each part: `recording-2.rrd` and so on; they
belong together and open as one. The checkpoint is there while the run can go on.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any, final

from cosim.errors import InputError
from cosim.scenario.schema import Scenario
from cosim.scenario.writing import scenario_text

RECORDING = "recording.rrd"
SCENARIO = "scenario.toml"
SUMMARY = "summary.json"
CHECKPOINT = "checkpoint.npz"


def default_directory(scenario_name: str) -> Path:
    """Return a directory under `runs/` that does not exist yet, named after scenario and local time."""
    stem = f"{scenario_name}-{time.strftime('%Y%m%d-%H%M%S')}"
    candidates = (Path("runs", stem if count == 1 else f"{stem}-{count}") for count in range(1, 1000))
    return next(candidate for candidate in candidates if not candidate.exists())


def check_directory(directory: Path) -> None:
    """Check that a run may be written to a directory: new, empty, or that of an earlier run.

    Raises:
        InputError: it is a file, or it holds other things; nothing is ever deleted but an earlier run.
    """
    if not directory.exists():
        return
    if not directory.is_dir():
        raise InputError(f"--out {directory}: is a file; give a directory")
    names = {path.name for path in directory.iterdir()}
    if names and not names & {SCENARIO, SUMMARY}:
        raise InputError(
            f"--out {directory}: holds files that are not a run's; give a new or empty directory"
        )


def recordings(directory: Path) -> list[Path]:
    """Return the recordings of the run in a directory, in order."""
    parts = sorted(directory.glob("recording-*.rrd"), key=lambda path: (len(path.name), path.name))
    return [path for path in (directory / RECORDING, *parts) if path.is_file()]


@final
class RunFiles:
    """Writes the files of one run; an earlier run in the same directory is replaced.

    Args:
        directory: made if it does not exist.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def next_recording(self) -> Path:
        """Return the path of the recording to write: the first one that does not exist yet."""
        count = len(recordings(self.directory))
        return self.directory / (f"recording-{count + 1}.rrd" if count else RECORDING)

    def begin(self, scenario: Scenario) -> None:
        """Make the directory, remove an earlier run's files and write the resolved scenario.

        Raises:
            InputError: the directory cannot be made or written.
        """
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            for path in recordings(self.directory):
                path.unlink()
            for name in (SUMMARY, CHECKPOINT):
                (self.directory / name).unlink(missing_ok=True)
            (self.directory / SCENARIO).write_text(scenario_text(scenario), encoding="utf-8")
        except OSError as error:
            raise InputError(f"--out {self.directory}: cannot be written: {error.strerror}") from error

    def go_on(self) -> None:
        """Take away the summary of the part before: the run is not over."""
        (self.directory / SUMMARY).unlink(missing_ok=True)

    def finish(self, summary: dict[str, Any]) -> None:
        """Write the summary; a reader sees all of it or none."""
        unfinished = self.directory / (SUMMARY + ".part")
        text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
        unfinished.write_text(text + "\n", encoding="utf-8")
        os.replace(unfinished, self.directory / SUMMARY)
