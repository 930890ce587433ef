"""Rewrites scenario and robot files of the previous schema number (`cosim upgrade`): it renames or drops old
keys, and leaves the rest of the text unchanged.
"""

import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

from cosim.base import whole_files, writing
from cosim.config.loading import is_scenario
from cosim.config.toml import old_keys, reading
from cosim.errors import ScenarioError

_BEFORE: Final = old_keys.SCHEMA - 1
_WRITABLE: Final = 0o222  # by anybody; os.access alone would let root rewrite a read-only file
_CARRIED: Final = ("attach", "robot")
_OLD: Final = {"schema", *(path[-1] for path in old_keys.DROPPED), *chain(*old_keys.RENAMED.values())}
_WORD: Final = re.compile(rf"""(?<![\w-])(["']?)({"|".join(sorted(_OLD))})\1(?![\w-])""")
_NUMBER: Final = re.compile(r"[ \t]*=[ \t]*([\w+]+)")


def upgrade_file(path: Path) -> int:
    """Rewrite a file in place and return the number of changed keys and values; with 0 it is unchanged.

    Args:
        path: of the file; of a symbolic link, its target is rewritten.

    Raises:
        ScenarioError: it is not TOML, is read-only, or has both an old key and the new one.
        OutputError: it cannot be written.
    """
    reading.read_table(path)
    text = path.read_bytes().decode("utf-8")
    try:
        new, count = upgraded(text)
    except ValueError as error:
        raise ScenarioError(str(path), f"cannot be rewritten, do it by hand: {error}") from None
    if count:
        if not path.stat().st_mode & _WRITABLE or not os.access(path, os.W_OK):
            raise ScenarioError(
                str(path), f"is read-only and not upgraded; allow it first: chmod u+w {path.resolve()}"
            )
        with writing.writing(path):
            whole_files.rewrite(path, new.encode("utf-8"))
    return count


def upgraded(text: str) -> tuple[str, int]:
    """Return a file's text with its keys renamed or dropped, and the number of changed keys and values.

    Raises:
        ValueError: a table has both an old key and the new one, or a dropped key is not alone on its line.
    """
    table = _loaded(text)
    scenario = is_scenario(table)
    changes = []
    for (*outer, key), value, word in _old_keys(text):
        kind = _kind_of(tuple(outer), scenario)
        if new := old_keys.RENAMED.get(kind, {}).get(key):
            changes.append((*word.span(), new))
        if scenario and (*outer, key) in old_keys.DROPPED:
            changes.append((*_line_of(text, word), ""))
        number = _NUMBER.match(text, word.end())
        if kind and key == "schema" and _is_before(value) and number:
            changes.append((*number.span(1), str(old_keys.SCHEMA)))
    made = text
    for start, end, new in reversed(changes):
        made = made[:start] + new + made[end:]
    if _content(_loaded(made)) != _content(_renamed(table, (), scenario)):
        raise ValueError("more than keys would change")
    return made, len(changes)


def _old_keys(text: str) -> list[tuple[tuple[str, ...], Any, re.Match[str]]]:
    """Return the words of `_WORD` that are keys: path (without list indices), value, and match in the text.

    Each word of the text gets a number, so that the TOML parser itself decides which of them are keys.
    """
    words = {f"{word[2]}-{at}-numbered": word for at, word in enumerate(_WORD.finditer(text))}
    names = iter(words)
    numbered = _loaded(_WORD.sub(lambda word: f"{word[1]}{next(names)}{word[1]}", text))

    def found(value: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any, re.Match[str]]]:
        for entry in value if isinstance(value, list) else ():
            yield from found(entry, path)
        for key, item in value.items() if isinstance(value, Mapping) else ():
            inner = (*path, words[key][2] if key in words else key)
            if key in words:
                yield inner, item, words[key]
            yield from found(item, inner)

    return sorted(found(numbered, ()), key=lambda one: one[2].start())


def _content(table: Mapping[str, Any]) -> str:
    """Return the content of a file for comparison, without empty tables, which dropped keys may leave."""
    return repr({key: value for key, value in table.items() if value != {}})


def _line_of(text: str, word: re.Match[str]) -> tuple[int, int]:
    """Return begin and end of the line of a key.

    Raises:
        ValueError: the key is not alone on its line.
    """
    begin, newline = text.rfind("\n", 0, word.start()) + 1, text.find("\n", word.end())
    if {"{", "["} & set(text[begin : word.start()]):
        raise ValueError(f"'{word[2]}' was removed, and is not alone on its line")
    return begin, len(text) if newline < 0 else newline + 1


def _kind_of(table: tuple[str, ...], scenario: bool) -> str:
    """Return the name of the class of the table at a path; empty for tables without old keys."""
    if scenario:
        if not table:
            return "Scenario"
        if table[0] != "soft_robot":
            return ""
        table = table[1:]
    while table[:2] == _CARRIED:
        table = table[2:]
    return "" if table else "SoftRobotTable"


def _renamed(value: Any, path: tuple[str, ...], scenario: bool) -> Any:
    """Return the tables with new keys, computed from the tables to verify the changed text."""
    if isinstance(value, list):
        return [_renamed(item, path, scenario) for item in value]
    if not isinstance(value, Mapping):
        return value
    kind = _kind_of(path, scenario)
    names = old_keys.RENAMED.get(kind, {})
    made = {
        names.get(key, key): _renamed(item, (*path, key), scenario)
        for key, item in value.items()
        if not (scenario and (*path, key) in old_keys.DROPPED)
    }
    if kind and _is_before(made.get("schema")):
        made["schema"] = old_keys.SCHEMA
    return made


def _is_before(number: Any) -> bool:
    return number == _BEFORE and type(number) is int


def _loaded(text: str) -> dict[str, Any]:
    return tomllib.loads(text.removeprefix("\ufeff").replace("\r\n", "\n"))
