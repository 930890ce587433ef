"""The rows of a sweep, one line of JSON each, written as they come: what a killed sweep goes on from."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO, final

from cosim.base.resources import is_file
from cosim.base.state_check import check_state
from cosim.errors import InputError, OutputError
from cosim.sweeps.task import LOST, Row


@final
class Journal:
    """Rows by the names of their designs' contents.

    Args:
        path: of the file; it is made, or gone on with.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows = {name: row for name, row in _read(path) if row.status != LOST}
        self._file: TextIO | None = None

    def __enter__(self) -> Journal:
        try:
            self._file = self._path.open("a", encoding="utf-8")
            if self._file.tell():
                self._file.write("\n")  # whoever was killed may have left half a line
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def add(self, name: str, row: Row) -> None:
        """Take in a row; it is on disk when this returns.

        Raises:
            OutputError: it cannot be written.
        """
        assert self._file is not None, "a journal is entered first"
        self.rows[name] = row
        try:
            table = {"design": name, **asdict(row)}
            self._file.write(json.dumps({**table, "digest": _digest(table)}) + "\n")
            self._file.flush()
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error


def _digest(table: dict[str, Any]) -> str:
    """Return what tells a row from a damaged one."""
    return sha256(json.dumps(table).encode()).hexdigest()[:16]


def _read(path: Path) -> list[tuple[str, Row]]:
    """Return the rows of a file; what is no whole row, as in half a line, is computed again.

    Raises:
        InputError: it cannot be read.
    """
    if not is_file(path):
        return []
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    found = []
    for line in lines:
        with suppress(ValueError, TypeError, AttributeError, KeyError, RecursionError, InputError):
            table = json.loads(line)
            if table.pop("digest") != _digest(table):
                continue
            name, row = table.pop("design"), Row(**table)
            check_state((name, row), None, tuple[str, Row], finite=False)
            found.append((name, row))
    return found
