"""A directory for results, with one writer at a time. A marker file lists the files that were written there;
only these are replaced or deleted. The writer locks the marker; the lock ends with its process.
"""

import errno
import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import Final, TextIO, final

from cosim.base import platform
from cosim.base.whole_files import unfinished_files, write_whole
from cosim.errors import InputError

MARKER: Final = ".cosim"
_HEADER: Final = "# cosim wrote the files named here; what is written here next may replace them.\n"
_SHOWN: Final = 3
"""File names in a message."""


def written_names(path: Path) -> frozenset[str] | None:
    """Return the names of the files that were written to a directory; None without a marker."""
    try:
        return frozenset(_entries((path / MARKER).read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError):
        return None


@final
class OutputDirectory:
    """A directory for results; locked as soon as it exists, until the block is left.

    Args:
        path: of the directory.
        adopt: whether a directory without a marker, such as a copy, counts as one of results.

    Raises:
        InputError: on entering and in `make`: it is a file, has files that are not known to be results,
            another process writes to it, or it cannot be written.
    """

    def __init__(self, path: Path, *, adopt: bool = False) -> None:
        self.path, self._adopt = path, adopt
        self._marker: TextIO | None = None
        self._is_new = False

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
        """Make and mark the directory, if necessary."""
        if self._marker is not None:
            return
        try:
            self._is_new = not self.path.exists()
            self.path.mkdir(parents=True, exist_ok=True)
            self._check()
            self._lock()
        except OSError as error:
            raise self._unwritable(error) from error

    def begin(self, name: str, text: str, *others: str) -> None:
        """Make the directory, remove the files of the writer before, and write a first file.

        Args:
            name: of that file.
            text: its content.
            others: names of files that will be written.

        Raises:
            InputError: the directory cannot be made or written, or a file there is not one of results;
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
        """Remove the marker and the directory, if they are new and there are no other files."""
        if self._is_new:
            with suppress(OSError):
                (self.path / MARKER).unlink()
                self.path.rmdir()

    def claim(self, *names: str) -> None:
        """Add files that will be written to the marker.

        Raises:
            InputError: a file with this name exists that cosim did not write, or that was changed later.
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
        """Write a claimed file; it will not be replaced if it is changed later.

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
        """Delete the files that the marker lists, complete or not.

        Raises:
            InputError: a file cannot be deleted.
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
            names = sorted(path.name for path in self.path.iterdir()) if self.path.is_dir() else None
            exists = names is not None or self.path.exists()
        except (OSError, ValueError) as error:  # the name is too long, not permitted, or no path
            raise self._unwritable(error) from error
        if names is not None:
            if names and MARKER not in names and not self._adopt:
                shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
                raise InputError(
                    f"--out {self.path}: has files that are not known to be results of cosim ({shown}); "
                    "give a new or empty directory"
                )
        elif exists:
            raise InputError(f"--out {self.path}: is a file; give a directory")

    def _lock(self) -> None:
        try:
            marker = (self.path / MARKER).open("a+", encoding="utf-8", errors="replace")
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            platform.lock_file(marker.fileno())
        except BlockingIOError:
            marker.close()
            raise InputError(
                f"--out {self.path}: another process is writing there; wait for it, or give another directory"
            ) from None
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
                f"--out {path}: was changed after it was written; move it, or give another directory"
            )

    def _unwritable(self, error: OSError | ValueError) -> InputError:
        problem = getattr(error, "strerror", None) or error
        if getattr(error, "errno", None) == errno.ENAMETOOLONG:
            problem = f"{problem}: most systems allow 255 bytes for a folder's name; give a shorter one"
        return InputError(f"--out {self.path}: cannot be written: {problem}")


def _entries(text: str) -> dict[str, set[str]]:
    """Return the digests of each file that a marker lists; empty if the file may have any content."""
    entries: dict[str, set[str]] = {}
    for line in text.splitlines():
        if line and not line.startswith("#"):
            name, _, digest = line.partition(" ")
            if Path(name).name != name:
                continue  # a path to another directory, which cosim does not write
            entries.setdefault(name, set()).update([digest] if digest else [])
    return entries
