"""Puts together the table of a soft robot from the files that it starts from and attaches."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, final

from cosim.base.resources import is_file, soft_robot_path
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.faults import Faults
from cosim.config.toml.key_paths import describe, join, label
from cosim.config.toml.overrides import merge
from cosim.config.toml.parsing import with_unknown
from cosim.config.toml.reading import Unreadable, only_readable, read_table
from cosim.errors import InputError, ScenarioError

MOST_FILES: Final = 64
LONGEST_CHAIN: Final = 8


@final
class RobotFiles:
    """The files of one soft robot: each is read once, and none may lead to itself."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._read: dict[Path, dict[str, Any]] = {}
        self._used = 0

    def expand(self, value: Any, folder: Path, path: str, chain: tuple[Path, ...] = ()) -> Any:
        """Return the full table of a soft robot given by name, path, or changes to a file.

        A file that is not there is a fault; the table then holds UNKNOWN for all that is not given beside it.

        Args:
            value: as in the file; what is neither a text nor a table is returned as it is.
            folder: that relative paths start from.
            path: of the value, for messages.
            chain: files that led here.

        Raises:
            ScenarioError: a file is wrong, leads to itself, or there are too many.
        """
        if isinstance(value, str):
            return self._based(value, {}, folder, path, chain)
        return self._complete(value, folder, path, chain) if isinstance(value, Mapping) else value

    def _complete(
        self, table: Mapping[str, Any], folder: Path, path: str, chain: tuple[Path, ...]
    ) -> dict[str, Any]:
        """Return a soft robot's table with the files that it and its attachments start from put in."""
        full: dict[str, Any] = only_readable(table)
        body = full.get("body")
        if isinstance(body, dict) and isinstance(body.get("file"), str) and is_file(folder / body["file"]):
            body["file"] = str((folder / body["file"]).resolve())
        if "file" in full:
            full = self._based(full.pop("file"), full, folder, f"{path}.file", chain)
        entries = full.get("attach")
        for place, entry in enumerate(entries if isinstance(entries, list) else (), start=1):
            if isinstance(entry, dict) and "robot" in entry:
                where = join(join(f"{path}.attach", label(entry, place)), "robot")
                entry["robot"] = self.expand(entry["robot"], folder, where, chain)
        return full

    def _based(
        self, name: Any, changes: dict[str, Any], folder: Path, path: str, chain: tuple[Path, ...]
    ) -> dict[str, Any]:
        """Return the table of a soft robot's file, given by name or path, with changes on top."""
        self._used += 1
        if self._used > MOST_FILES:
            raise ScenarioError(path, f"is one robot too many; at most {MOST_FILES} files make a soft robot")
        file = None
        with self._faults:
            file = _found(name, folder, path)
        if file is None:
            return with_unknown(SoftRobotTable, changes)
        return merge(self._table(file, name, path, chain), changes)

    def _table(self, file: Path, name: str, path: str, chain: tuple[Path, ...]) -> dict[str, Any]:
        here = file.resolve()
        if here in chain:
            raise ScenarioError(path, f"'{name}' leads back to itself; a soft robot cannot hold itself")
        if len(chain) >= LONGEST_CHAIN:
            raise ScenarioError(path, f"'{name}' comes after {LONGEST_CHAIN} files that lead to one another")
        if here not in self._read:
            self._read[here] = read_table(file)
        return self._complete(self._read[here], file.parent, path.removesuffix(".file"), (*chain, here))


def _found(name: Any, folder: Path, path: str) -> Path:
    """Return the file of a soft robot.

    Raises:
        ScenarioError: the name is no text, or there is no such file.
    """
    if isinstance(name, Unreadable):
        raise ScenarioError(path, name.problem)
    if not isinstance(name, str):
        raise ScenarioError(path, f"expected a name or path, got {describe(name)}")
    beside = folder / name
    try:
        return beside if beside.suffix == ".toml" and is_file(beside) else soft_robot_path(name)
    except InputError as error:
        raise ScenarioError(path, str(error)) from error
