"""Puts together the table of a soft robot from the files that it starts from and attaches."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, final

from cosim.base.resources import is_file, soft_robot_path
from cosim.config.toml.key_paths import describe, join, label
from cosim.config.toml.overrides import merge
from cosim.config.toml.reading import only_readable, read_table
from cosim.errors import InputError, ScenarioError

MOST_FILES: Final = 64
LONGEST_CHAIN: Final = 8


@final
class RobotFiles:
    """The files of one soft robot: each is read once, and none may lead to itself."""

    def __init__(self) -> None:
        self._read: dict[Path, dict[str, Any]] = {}
        self._used = 0

    def expand(self, value: Any, folder: Path, path: str, chain: tuple[Path, ...] = ()) -> Any:
        """Return the full table of a soft robot given by name, path, or changes to a file.

        Args:
            value: as in the file; what is neither a text nor a table is returned as it is.
            folder: that relative paths start from.
            path: of the value, for messages.
            chain: files that led here.

        Raises:
            ScenarioError: a file is wrong or not there, leads to itself, or there are too many.
        """
        if isinstance(value, str):
            return self.table(value, folder, path, chain)
        return self.complete(value, folder, path, chain) if isinstance(value, Mapping) else value

    def complete(
        self, table: Mapping[str, Any], folder: Path, path: str, chain: tuple[Path, ...] = ()
    ) -> dict[str, Any]:
        """Return a soft robot's table with the files that it and its attachments start from put in."""
        full: dict[str, Any] = only_readable(table)
        if "file" in full:
            file = full.pop("file")
            if not isinstance(file, str):
                raise ScenarioError(f"{path}.file", f"expected a name or path, got {describe(file)}")
            full = merge(self.table(file, folder, f"{path}.file", chain), full)
        entries = full.get("attach")
        for place, entry in enumerate(entries if isinstance(entries, list) else (), start=1):
            if isinstance(entry, dict) and "robot" in entry:
                where = join(join(f"{path}.attach", label(entry, place)), "robot")
                entry["robot"] = self.expand(entry["robot"], folder, where, chain)
        return full

    def table(self, name: str, folder: Path, path: str, chain: tuple[Path, ...] = ()) -> dict[str, Any]:
        """Return the full table of a soft robot's file, given by name or path."""
        beside = folder / name
        try:
            file = beside if beside.suffix == ".toml" and is_file(beside) else soft_robot_path(name)
        except InputError as error:
            raise ScenarioError(path, str(error)) from error
        here = file.resolve()
        if here in chain:
            raise ScenarioError(path, f"'{name}' leads back to itself; a soft robot cannot hold itself")
        if len(chain) >= LONGEST_CHAIN:
            raise ScenarioError(path, f"'{name}' comes after {LONGEST_CHAIN} files that lead to one another")
        self._used += 1
        if self._used > MOST_FILES:
            raise ScenarioError(path, f"is one robot too many; at most {MOST_FILES} files make a soft robot")
        if here not in self._read:
            self._read[here] = read_table(file)
        return self.complete(self._read[here], file.parent, path.removesuffix(".file"), (*chain, here))
