"""The rows of a sweep on disk, a line of JSON each, with which an interrupted sweep continues."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, TextIO, final

from cosim.base import resources, writing
from cosim.base.state_checks import check_state
from cosim.errors import InputError
from cosim.sweeps.designs import LOST, Row

JOURNAL: Final = "rows.jsonl"


@final
class Journal:
    """Rows by the identities of their designs.

    Args:
        path: of the file; made if it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows = {identity: row for identity, row in _read(path) if row.status != LOST}
        self._file: TextIO | None = None

    @contextmanager
    def open(self) -> Iterator[Journal]:
        """Open the file for further rows.

        Raises:
            InputError: the file cannot be written.
        """
        try:
            self._file = self._path.open("a", encoding="utf-8")
            if self._file.tell():
                self._file.write("\n")  # a process that was killed may have left half a line
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror}") from error
        try:
            yield self
        finally:
            with suppress(OSError):
                self._file.close()

    def add(self, identity: str, row: Row) -> None:
        """Add a row; it is on disk when this returns.

        Raises:
            OutputError: the file cannot be written.
        """
        assert self._file is not None, "open() comes before add()"
        self.rows[identity] = row
        with writing.writing(self._path):
            table = {"design": identity, **asdict(row)}
            self._file.write(json.dumps({**table, "digest": _digest(table)}) + "\n")
            self._file.flush()


def _digest(table: dict[str, Any]) -> str:
    """Return a digest of a row, which detects damage."""
    return sha256(json.dumps(table).encode()).hexdigest()[:16]


def _read(path: Path) -> list[tuple[str, Row]]:
    """Return the identities and rows of a file; incomplete rows, as in half a line, are skipped.

    Raises:
        InputError: the file cannot be read.
    """
    if not resources.is_file(path):
        return []
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    rows = []
    for line in lines:
        with suppress(ValueError, TypeError, AttributeError, KeyError, RecursionError, InputError):
            table = json.loads(line)
            if table.pop("digest") != _digest(table):
                continue
            identity, row = table.pop("design"), Row(**table)
            check_state((identity, row), None, tuple[str, Row], finite=False)
            rows.append((identity, row))
    return rows
