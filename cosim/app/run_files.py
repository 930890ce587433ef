"""The files of a run. Recording and arrays of a resumed run have several parts, `recording-2.rrd` and so on,
which open as one; arrays begin another part at every checkpoint as well.
"""

import json
import os
import re
import time
from collections.abc import Mapping
from contextlib import suppress
from hashlib import sha256
from itertools import count
from pathlib import Path
from tempfile import mkstemp
from typing import Any, Final, final

from cosim.app.output_directory import OutputDirectory, written_names
from cosim.base import state_file
from cosim.base.whole_files import write_whole
from cosim.config.loading import scenario_text
from cosim.config.schema.scenario import Scenario
from cosim.errors import OutputError
from cosim.telemetry.phase_ends import PhaseEnds

RECORDING: Final = "recording.rrd"
SCENARIO: Final = "scenario.toml"
SUMMARY: Final = "summary.json"
CHECKPOINT: Final = "checkpoint.npz"
"""Exists as long as the run can be resumed."""
ARRAYS: Final = "arrays.parquet"
FRAMES: Final = "frames.parquet"
PHASE_ENDS: Final = "phase_ends.npz"


def images_file(camera: str) -> str:
    """Return the name of the first part of a camera's images."""
    return f"camera_{camera}.parquet"


def default_directory(scenario_name: str) -> Path:
    """Return a directory under `runs/` that does not exist yet, named after scenario and local time."""
    stem = f"{scenario_name}-{time.strftime('%Y%m%d-%H%M%S')}"
    candidates = (Path("runs", stem if count == 1 else f"{stem}-{count}") for count in range(1, 1000))
    return next(candidate for candidate in candidates if not candidate.exists())


def check_directory(directory: Path) -> None:
    """Check that a run may be written to a directory: new, empty, or that of an earlier run.

    Raises:
        InputError: it is a file, has other files, or a run is being written there.
    """
    with OutputDirectory(directory):
        pass


def recordings(directory: Path) -> list[Path]:
    """Return the recordings of the run in a directory, in order."""
    return parts(directory, RECORDING)


def parts(directory: Path, first: str) -> list[Path]:
    """Return the parts of a recording or of arrays, in order.

    In a copy without the marker of an output directory, these are all files with matching names.

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
    """Return the SHA-256 digest of a scenario's text in `scenario.toml`."""
    return sha256(scenario_text(scenario).encode()).hexdigest()


@final
class RunFiles:
    """Writes the files of a run; an earlier run in the same directory is replaced.

    Attributes: `loaded`, digests of the scenario and of the files that the run was built from, by name;
    `out`, the directory, locked for other runs as long as it is entered.

    Args:
        directory: made if it does not exist.
        resume: whether the run there is resumed.
    """

    def __init__(self, directory: Path, *, resume: bool = False) -> None:
        self.directory = directory
        self.loaded: dict[str, str] = {}
        self.out = OutputDirectory(directory, adopt=resume)

    def note_loaded(self, scenario: Scenario, read: Mapping[str, str]) -> None:
        """Set the digests of the files that the run was built from.

        Args:
            scenario: of the run.
            read: digests of files that were read while building, see `files_read`.
        """
        self.loaded = {SCENARIO: scenario_digest(scenario), **read}

    def next_part(self, first: str) -> Path:
        """Return the path of the next part of a recording or of arrays, the first that does not exist.

        Args:
            first: name of the first part, such as recording.rrd.
        """
        stem, _, suffix = first.partition(".")
        names = (f"{stem}-{number}.{suffix}" if number > 1 else first for number in count(1))
        name = next(name for name in names if not (self.directory / name).exists())
        self.out.claim(name)
        return self.directory / name

    def begin(self, scenario: Scenario) -> None:
        """Make the directory, remove the files of an earlier run and write the resolved scenario.

        Raises:
            InputError: the directory cannot be made or written, or has a file of no earlier run; nothing was
                removed.
        """
        self.out.begin(SCENARIO, scenario_text(scenario), SUMMARY, CHECKPOINT, PHASE_ENDS)

    def resume(self) -> None:
        """Remove the summary of the interrupted run."""
        self.out.make()
        self.out.claim(SCENARIO, SUMMARY, CHECKPOINT, PHASE_ENDS)
        (self.directory / SUMMARY).unlink(missing_ok=True)

    def write_ends(self, ends: PhaseEnds) -> None:
        """Write the phase ends, if possible."""
        with suppress(OSError):
            state_file.save(self.directory / PHASE_ENDS, ends)

    def finish(self, summary: dict[str, Any]) -> None:
        """Write the summary; a reader sees all of it or none.

        Raises:
            OutputError: it cannot be written there; the message has the path of another copy.
        """
        text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
        try:
            self.directory.mkdir(parents=True, exist_ok=True)  # it may have been removed
            write_whole(self.directory / SUMMARY, text + "\n")
        except OSError as error:
            raise OutputError(
                f"{self.directory / SUMMARY}: cannot be written: {error.strerror}; {_saved_elsewhere(text)}"
            ) from error


def _saved_elsewhere(text: str) -> str:
    """Write a summary to the directory of temporary files; return a text with its path."""
    try:
        number, path = mkstemp(prefix="cosim-summary-", suffix=".json")
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(text + "\n")
    except OSError as error:
        return f"nor in the directory of temporary files: {error.strerror}"
    return f"the figures are in {path}"
