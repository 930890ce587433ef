"""The directory of a run: `scenario.toml`, `summary.json`, `recording.rrd`, `arrays.parquet`,
`frames.parquet`, `checkpoint.npz`.

A run that went on after an interruption has a recording for each part: `recording-2.rrd` and so on; they
belong together and open as one. So do the files of arrays, which end a part at every checkpoint as well. The
checkpoint is there while the run can go on.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Mapping
from hashlib import sha256
from itertools import count
from pathlib import Path
from tempfile import mkstemp
from types import TracebackType
from typing import Any, final

from cosim.app.output_directory import OutputDirectory, written_names
from cosim.base.whole_files import write_whole
from cosim.config.schema.scenario import Scenario
from cosim.config.writing import scenario_text
from cosim.errors import InputError, OutputError

RECORDING = "recording.rrd"
SCENARIO = "scenario.toml"
SUMMARY = "summary.json"
CHECKPOINT = "checkpoint.npz"
ARRAYS = "arrays.parquet"
FRAMES = "frames.parquet"


def default_directory(scenario_name: str) -> Path:
    """Return a directory under `runs/` that does not exist yet, named after scenario and local time."""
    stem = f"{scenario_name}-{time.strftime('%Y%m%d-%H%M%S')}"
    candidates = (Path("runs", stem if count == 1 else f"{stem}-{count}") for count in range(1, 1000))
    return next(candidate for candidate in candidates if not candidate.exists())


def check_directory(directory: Path) -> None:
    """Check that a run may be written to a directory: new, empty, or that of an earlier run.

    Raises:
        InputError: it is a file, holds other things, or a run is being written there.
    """
    with OutputDirectory(directory):
        pass


def recordings(directory: Path) -> list[Path]:
    """Return the recordings of the run in a directory, in order; of a copy without marker, by their names."""
    return parts(directory, RECORDING)


def parts(directory: Path, first: str) -> list[Path]:
    """Return the parts of a recording or of arrays, in order; of a copy without marker, by their names.

    Args:
        directory: of a run.
        first: name of the first part, such as recording.rrd.
    """
    written = written_names(directory)
    stem, _, suffix = first.partition(".")
    name = re.compile(rf"{stem}(?:-([2-9]|[1-9]\d+))?\.{suffix}")
    found = [
        (int(match[1] or 1), path)
        for path in directory.glob(f"{stem}*.{suffix}")
        if (match := name.fullmatch(path.name)) and (written is None or path.name in written)
    ]
    return [path for _, path in sorted(found)]


def scenario_digest(scenario: Scenario) -> str:
    """Return the SHA-256 digest of a scenario as `scenario.toml` has it."""
    return sha256(scenario_text(scenario).encode()).hexdigest()


@final
class RunFiles:
    """Writes the files of one run; an earlier run in the same directory is replaced.

    Attributes: `loaded`, digests of the scenario and of the files that the run was built from, by names.

    Args:
        directory: made if it does not exist; no other run writes to it until the block is left.
        resume: whether the run in it goes on.

    Raises:
        InputError: on entering: see `check_directory`.
    """

    def __init__(self, directory: Path, *, resume: bool = False) -> None:
        self.directory = directory
        self.loaded: dict[str, str] = {}
        self._out = OutputDirectory(directory, adopt=resume)

    def __enter__(self) -> RunFiles:
        self._out.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._out.__exit__(kind, error, trace)

    def note_loaded(self, scenario: Scenario, read: Mapping[str, str]) -> None:
        """Take in what the run was built from.

        Args:
            scenario: as it runs.
            read: files that building has read, see `files_read`.
        """
        self.loaded = {SCENARIO: scenario_digest(scenario), **read}

    def next_part(self, first: str) -> Path:
        """Return the path of the next part of a recording or of arrays: the first that does not exist yet.

        Args:
            first: name of the first part, such as recording.rrd.
        """
        stem, _, suffix = first.partition(".")
        names = (f"{stem}-{number}.{suffix}" if number > 1 else first for number in count(1))
        name = next(name for name in names if not (self.directory / name).exists())
        self._out.claim(name)
        return self.directory / name

    def begin(self, scenario: Scenario) -> None:
        """Make the directory, remove an earlier run's files and write the resolved scenario.

        Raises:
            InputError: the directory cannot be made or written, or a file there is not an earlier run's; then
                nothing was removed.
        """
        text = scenario_text(scenario)
        self._out.make()
        try:
            self._out.claim(SCENARIO, SUMMARY, CHECKPOINT)
            self._out.remove_written()
            self._out.claim(SCENARIO, SUMMARY, CHECKPOINT)
            self._out.write(SCENARIO, text)
        except InputError:
            self._out.discard()
            raise

    def go_on(self) -> None:
        """Take away the summary of the part before: the run is not over."""
        self._out.make()
        self._out.claim(SCENARIO, SUMMARY, CHECKPOINT)
        (self.directory / SUMMARY).unlink(missing_ok=True)

    def finish(self, summary: dict[str, Any]) -> None:
        """Write the summary; a reader sees all of it or none.

        Raises:
            OutputError: it cannot be written there; the text says where it is instead.
        """
        text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
        try:
            self.directory.mkdir(parents=True, exist_ok=True)  # somebody may have taken it away
            write_whole(self.directory / SUMMARY, text + "\n")
        except OSError as error:
            raise OutputError(
                f"{self.directory / SUMMARY}: cannot be written: {error.strerror}; {_saved_elsewhere(text)}"
            ) from error


def _saved_elsewhere(text: str) -> str:
    """Save a summary in the directory of temporary files; return where it is."""
    try:
        number, path = mkstemp(prefix="cosim-summary-", suffix=".json")
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(text + "\n")
    except OSError as error:
        return f"nor in the directory of temporary files: {error.strerror}"
    return f"the figures are in {path}"
