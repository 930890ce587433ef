"""Rewrites older scenario and robot files: keys are renamed or dropped, all else stays."""

import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

from cosim.base import files, resources
from cosim.config.loading import is_scenario
from cosim.config.toml import old_keys, reading
from cosim.errors import ScenarioError

_BEFORE: Final = old_keys.SCHEMA - 1
_WRITABLE: Final = 0o222  # by anybody: root may write to all files, and is not meant to
_CARRIED: Final = ("attach", "robot")
_OLD: Final = {"schema", *(path[-1] for path in old_keys.DROPPED), *chain(*old_keys.RENAMED.values())}
_WORD: Final = re.compile(rf"""(?<![\w-])(["']?)({"|".join(sorted(_OLD))})\1(?![\w-])""")
_NUMBER: Final = re.compile(r"[ \t]*=[ \t]*([\w+]+)")


def upgrade_file(path: Path) -> int:
    """Rewrite a file in place and return how many keys and numbers were changed; 0 leaves it untouched.

    Args:
        path: of the file; of a symbolic link, the file that it leads to is rewritten.

    Raises:
        ScenarioError: it is not TOML, is read-only, or has an old key beside the new one.
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
        with resources.writing(path):
            files.rewrite(path, new.encode("utf-8"))
    return count


def upgraded(text: str) -> tuple[str, int]:
    """Return a file's text with its keys renamed or dropped, and how many keys and numbers were changed.

    Raises:
        ValueError: a table has an old key beside the new one, or a key to be dropped is not on its own line.
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
    if _told(_loaded(made)) != _told(_renamed(table, (), scenario)):
        raise ValueError("more than keys would change")
    return made, len(changes)


def _old_keys(text: str) -> list[tuple[tuple[str, ...], Any, re.Match[str]]]:
    """Return where words of `_WORD` are keys: path, value, and place; entries of lists are not in paths.

    Each such word of the text gets a number, so that the parser itself says which of them are keys.
    """
    words = {f"{word[2]}-{at}-numbered": word for at, word in enumerate(_WORD.finditer(text))}
    names = iter(words)
    numbered = _loaded(_WORD.sub(lambda word: f"{word[1]}{next(names)}{word[1]}", text))

    def found(value: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any, re.Match[str]]]:
        for entry in value if isinstance(value, list) else ():
            yield from found(entry, path)
        for key, item in value.items() if isinstance(value, Mapping) else ():
            here = (*path, words[key][2] if key in words else key)
            if key in words:
                yield here, item, words[key]
            yield from found(item, here)

    return sorted(found(numbered, ()), key=lambda one: one[2].start())


def _told(table: Mapping[str, Any]) -> str:
    """Return what a file tells; a table without keys, as may be left of one, tells nothing."""
    return repr({key: value for key, value in table.items() if value != {}})


def _line_of(text: str, word: re.Match[str]) -> tuple[int, int]:
    """Return where the line of a key begins and ends; the key has it alone."""
    begin, newline = text.rfind("\n", 0, word.start()) + 1, text.find("\n", word.end())
    if {"{", "["} & set(text[begin : word.start()]):
        raise ValueError(f"'{word[2]}' is no more, and not alone on its line")
    return begin, len(text) if newline < 0 else newline + 1


def _kind_of(table: tuple[str, ...], scenario: bool) -> str:
    """Return the class of a table at a path; empty for those without old keys."""
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
    """Return tables as they are with new keys, made from the tables and not from the text."""
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
