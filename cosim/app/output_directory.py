"""A directory that results are written to: marked, with one writer at a time, and no foreign file lost.

The marker names the files that were written there; only these are ever replaced or deleted. The writer holds
a lock on it, which the system takes back when the process ends, however it does.
"""

import errno
import fcntl
import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import TextIO, final

from cosim.base.whole_files import unfinished_files, write_whole
from cosim.errors import InputError

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
