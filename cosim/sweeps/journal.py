"""The rows of a sweep, one line of JSON each, written as they come: what a killed sweep goes on from."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, fields
from pathlib import Path
from types import TracebackType
from typing import TextIO, final

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
            self._file.write(json.dumps({"design": name, **asdict(row)}) + "\n")
            self._file.flush()
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error


def _read(path: Path) -> list[tuple[str, Row]]:
    known = {field.name for field in fields(Row)}
    found = []
    if path.is_file():
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            with suppress(ValueError, TypeError, AttributeError, KeyError):  # half a line
                table = json.loads(line)
                found.append((str(table.pop("design")), Row(**{k: table[k] for k in known & table.keys()})))
    return found
