"""The directory of a run: marked, one writer at a time; and its files.

Directories that results are written to: marked, one writer at a time, and nothing of anybody else lost.

The marker names the files that were written here; only these are ever replaced or deleted. Who writes holds a
lock on it, which the system takes back when the process ends, however it does.

The directory of a run: `scenario.toml`, `summary.json`, `recording.rrd`, `arrays.parquet`,
`frames.parquet`, `phase_ends.npz`, `checkpoint.npz`, and `camera_NAME.parquet` of each camera.

A run that resumed after an interruption has a recording for each part: `recording-2.rrd` and so on; they
belong together and open as one. So do the files of arrays, which end a part at every checkpoint as well. The
checkpoint is there while the run can continue.
"""

import errno
import fcntl
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
from types import TracebackType
from typing import Any, TextIO, final

from cosim.base import state_file
from cosim.base.whole_files import unfinished_files, write_whole
from cosim.config.loading import scenario_text
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError, OutputError
from cosim.telemetry.phase_ends import PhaseEnds

MARKER = ".cosim"
_HEADER = "# cosim wrote the files named here; what is written here next may replace them.\n"
_SHOWN = 3  # names in a message


def written_names(path: Path) -> frozenset[str] | None:
    """Return the names of the files that were written to a directory; None where it is not marked."""
    try:
        return frozenset(_entries((path / MARKER).read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError):
        return None


@final
class OutputDirectory:
    """A directory that results are written to; locked as soon as it is there, until the block is left.

    Args:
        path: of the directory.
        adopt: take it as one that results were written to, even if the marker is missing (in a copy).

    Raises:
        InputError: on entering and in `make`: it is a file, holds what is not known to be results, another
            process writes to it, or it cannot be written to.
    """

    def __init__(self, path: Path, *, adopt: bool = False) -> None:
        self.path, self._adopt = path, adopt
        self._marker: TextIO | None = None
        self._made_here = False

    def __enter__(self) -> "OutputDirectory":
        self._check()
        if (self.path / MARKER).is_file():
            self._lock()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._marker is not None:
            with suppress(OSError):  # a full disk has been reported by then
                self._marker.close()
            self._marker = None

    def make(self) -> None:
        """Make and mark the directory, unless it is."""
        if self._marker is not None:
            return
        try:
            self._made_here = not self.path.exists()
            self.path.mkdir(parents=True, exist_ok=True)
            self._check()
            self._lock()
        except OSError as error:
            raise self._unwritable(error) from error

    def begin(self, name: str, text: str, *others: str) -> None:
        """Make the directory, remove what was written here before, and write a first file.

        Args:
            name: of that file.
            text: in it.
            others: names of files that will be written.

        Raises:
            InputError: the directory cannot be made or written, or a file there was not written here; then
                nothing was removed.
        """
        self.make()
        try:
            self.claim(name, *others)
            self.remove_written()
            self.claim(name, *others)
            self.write(name, text)
        except InputError:
            self.discard()
            raise

    def discard(self) -> None:
        """Take the marker and the directory away again, if they are new and hold nothing else."""
        if self._made_here:
            with suppress(OSError):
                (self.path / MARKER).unlink()
                self.path.rmdir()

    def claim(self, *names: str) -> None:
        """Note that files are going to be written.

        Raises:
            InputError: there is such a file, which was not written here or has been changed since.
        """
        assert self._marker is not None, "make() comes before claim()"
        known = self._known()
        for name in names:
            self._refuse_foreign(name, known)
        try:
            self._marker.writelines(f"{name}\n" for name in names if name not in known)
            self._marker.flush()
        except OSError as error:
            raise self._unwritable(error) from error

    def write(self, name: str, text: str) -> None:
        """Write a claimed file that is not replaced once somebody has changed it.

        Raises:
            InputError: it cannot be written.
        """
        assert self._marker is not None, "make() comes before write()"
        try:
            self._marker.write(f"{name} {sha256(text.encode()).hexdigest()}\n")
            self._marker.flush()
            write_whole(self.path / name, text)
        except OSError as error:
            raise self._unwritable(error) from error

    def remove_written(self) -> None:
        """Delete the files that were written here before, with what was left half written of them.

        Raises:
            InputError: one cannot be deleted.
        """
        try:
            for name in self._known():
                for path in (self.path / name, *unfinished_files(self.path / name)):
                    path.unlink(missing_ok=True)
            assert self._marker is not None
            self._marker.truncate(0)
            self._marker.write(_HEADER)
            self._marker.flush()
        except OSError as error:
            raise self._unwritable(error) from error

    def _check(self) -> None:
        try:
            found = sorted(path.name for path in self.path.iterdir()) if self.path.is_dir() else None
            there = found is not None or self.path.exists()
        except (OSError, ValueError) as error:  # longer than names may be, not permitted, or no path at all
            raise self._unwritable(error) from error
        if found is not None:
            if found and MARKER not in found and not self._adopt:
                shown = ", ".join(found[:_SHOWN]) + (", ..." if len(found) > _SHOWN else "")
                raise InputError(
                    f"--out {self.path}: holds files that are not known to be results of cosim ({shown}); "
                    "give a new or empty directory"
                )
        elif there:
            raise InputError(f"--out {self.path}: is a file; give a directory")

    def _lock(self) -> None:
        try:
            marker = (self.path / MARKER).open("a+", encoding="utf-8", errors="replace")
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            fcntl.flock(marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            marker.close()
            raise InputError(
                f"--out {self.path}: another process is writing there; wait for it, or give another directory"
            ) from None
        except OSError:
            pass  # a file system without locks: better to write than not to
        self._marker = marker
        if os.fstat(marker.fileno()).st_size == 0:
            marker.write(_HEADER)
            marker.flush()

    def _known(self) -> dict[str, set[str]]:
        assert self._marker is not None
        self._marker.seek(0)
        return _entries(self._marker.read())

    def _refuse_foreign(self, name: str, known: dict[str, set[str]]) -> None:
        path = self.path / name
        if not path.exists() or self._adopt:
            return
        if name not in known:
            raise InputError(f"--out {path}: was not written by cosim; move it, or give another directory")
        if known[name] and sha256(path.read_bytes()).hexdigest() not in known[name]:
            raise InputError(
                f"--out {path}: has been changed since it was written; move it, or give another directory"
            )

    def _unwritable(self, error: OSError | ValueError) -> InputError:
        problem = getattr(error, "strerror", None) or error
        if getattr(error, "errno", None) == errno.ENAMETOOLONG:
            problem = f"{problem}: most systems allow 255 bytes for a folder's name; give a shorter one"
        return InputError(f"--out {self.path}: cannot be written: {problem}")


def _entries(text: str) -> dict[str, set[str]]:
    """Return the digests of each file that a marker names; none where any content will do."""
    found: dict[str, set[str]] = {}
    for line in text.splitlines():
        if line and not line.startswith("#"):
            name, _, digest = line.partition(" ")
            if Path(name).name != name:
                continue  # of a file elsewhere, which nobody has written here
            found.setdefault(name, set()).update([digest] if digest else [])
    return found


RECORDING = "recording.rrd"
SCENARIO = "scenario.toml"
SUMMARY = "summary.json"
CHECKPOINT = "checkpoint.npz"
ARRAYS = "arrays.parquet"
FRAMES = "frames.parquet"
PHASE_ENDS = "phase_ends.npz"


def images_file(camera: str) -> str:
    """Return the name of the first part of a camera's pictures."""
    return f"camera_{camera}.parquet"


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

    Attributes: `loaded`, digests of the scenario and of the files that the run was built from, by names;
    `out`, the directory, entered before anything is written: no other run writes to it until it is left.

    Args:
        directory: made if it does not exist.
        resume: whether the run in it continues.
    """

    def __init__(self, directory: Path, *, resume: bool = False) -> None:
        self.directory = directory
        self.loaded: dict[str, str] = {}
        self.out = OutputDirectory(directory, adopt=resume)

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
        self.out.claim(name)
        return self.directory / name

    def begin(self, scenario: Scenario) -> None:
        """Make the directory, remove an earlier run's files and write the resolved scenario.

        Raises:
            InputError: the directory cannot be made or written, or a file there is not an earlier run's; then
                nothing was removed.
        """
        self.out.begin(SCENARIO, scenario_text(scenario), SUMMARY, CHECKPOINT, PHASE_ENDS)

    def go_on(self) -> None:
        """Take away the summary of the part before: the run is not over."""
        self.out.make()
        self.out.claim(SCENARIO, SUMMARY, CHECKPOINT, PHASE_ENDS)
        (self.directory / SUMMARY).unlink(missing_ok=True)

    def write_ends(self, ends: PhaseEnds) -> None:
        """Write the phase ends; where they cannot be written, there are none."""
        with suppress(OSError):
            state_file.save(self.directory / PHASE_ENDS, ends)

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
