"""Builds the full table of a soft robot from its file, the files that this one starts from or attaches, and
the changes to them.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, final

from cosim.base.resources import is_file, soft_robot_path
from cosim.config.toml import keys, reading
from cosim.config.toml.rules import Faults, errors_at
from cosim.errors import ScenarioError

MOST_FILES: Final = 64
LONGEST_CHAIN: Final = 8


@final
class RobotFiles:
    """Reads the files of one soft robot: each file once, and none may lead to itself."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._read: dict[Path, dict[str, Any]] = {}
        self._used = 0

    def expand(self, value: Any, folder: Path, path: str, chain: tuple[Path, ...] = ()) -> Any:
        """Return the full table of a soft robot given by name, path, or changes to a file.

        A missing file is a fault, and the robot's table is not checked further.

        Args:
            value: as in the file; a value that is neither a text nor a table is returned unchanged.
            folder: that relative paths start from.
            path: of the value, for messages.
            chain: files that led to this value.

        Raises:
            ScenarioError: a file is wrong, leads to itself, or there are too many.
        """
        if isinstance(value, str):
            return self._based(value, {}, folder, path, chain)
        return self._complete(value, folder, path, chain) if isinstance(value, Mapping) else value

    def _complete(
        self, table: Mapping[str, Any], folder: Path, path: str, chain: tuple[Path, ...]
    ) -> dict[str, Any]:
        """Return a soft robot's table merged with the files that it and its attachments start from."""
        full: dict[str, Any] = reading.plain(table, path, self._faults.unread)
        body = full.get("body")
        if isinstance(body, dict) and isinstance(body.get("file"), str) and is_file(folder / body["file"]):
            body["file"] = str((folder / body["file"]).resolve())
        if "file" in full:
            full = self._based(full.pop("file"), full, folder, f"{path}.file", chain)
        entries = full.get("attach")
        for place, entry in enumerate(entries if isinstance(entries, list) else (), start=1):
            if isinstance(entry, dict) and "robot" in entry:
                where = keys.join(keys.join(f"{path}.attach", keys.label(entry, place)), "robot")
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
        if not self._faults.is_unread(path):
            with self._faults:
                file = _robot_file(name, folder, path)
        if file is None:
            self._faults.unread[path.removesuffix(".file")] = ""
            return changes
        return reading.merge(self._table(file, name, path, chain), changes)

    def _table(self, file: Path, name: str, path: str, chain: tuple[Path, ...]) -> dict[str, Any]:
        resolved = file.resolve()
        if resolved in chain:
            raise ScenarioError(path, f"'{name}' leads back to itself; a soft robot cannot hold itself")
        if len(chain) >= LONGEST_CHAIN:
            raise ScenarioError(path, f"'{name}' comes after {LONGEST_CHAIN} files that lead to one another")
        if resolved not in self._read:
            self._read[resolved] = reading.read_table(file)
        chain = (*chain, resolved)
        return self._complete(self._read[resolved], file.parent, path.removesuffix(".file"), chain)


def _robot_file(name: Any, folder: Path, path: str) -> Path:
    """Return the file of a soft robot given by name or path.

    Args:
        name: as in the file that names it.
        folder: that relative paths start from.
        path: of the key, for messages.

    Raises:
        ScenarioError: the name is not a text, or there is no such file.
    """
    if not isinstance(name, str):
        raise ScenarioError(path, f"expected a name or path, got {keys.describe(name)}")
    beside = folder / name
    with errors_at(path):
        return beside if beside.suffix == ".toml" and is_file(beside) else soft_robot_path(name)
