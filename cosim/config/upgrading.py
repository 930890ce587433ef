"""Rewrites older scenario and robot files: keys are renamed or dropped, all else stays.

Finds the keys of a TOML text, so that some can be changed and all the rest stays as it is.
"""

import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from cosim.base import files, resources
from cosim.config.loading import is_scenario
from cosim.config.toml import parsing, reading
from cosim.errors import ScenarioError

_GAP: Final = re.compile(r"(?:[\s\ufeff]|#[^\n]*)*")
_KEY: Final = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*"|'[^']*'""")
_BETWEEN: Final = re.compile(r"[ \t]*\.[ \t]*")
_ASSIGNED: Final = re.compile(r"[ \t]*=[ \t]*")
_SCALAR: Final = re.compile(
    r'"""(?:\\[\s\S]|(?!""")[^\\])*"{3,5}' r"|'''[\s\S]*?'{3,5}"
    r'|"(?:[^"\\]|\\.)*"' r"|'[^']*'" r"|[^,\]}#\r\n]+"
)  # fmt: skip


class KeySpan(NamedTuple):
    """Where a key stands in a text.

    Args:
        path: keys of its tables and its own; entries of lists have no part in it.
        start: of its first character.
        end: after its last one.
        value: the text of its value; empty for tables, lists, and the parts of a dotted key before the last.
        value_start: of that.
    """

    path: tuple[str, ...]
    start: int
    end: int
    value: str
    value_start: int


def key_spans(text: str) -> Iterator[KeySpan]:
    """Yield the keys of a TOML text in their order; those of headers as well.

    Args:
        text: that `tomllib` reads.
    """
    return _Scanner(text).keys()


class _Scanner:
    """Goes through a text that is known to be TOML."""

    def __init__(self, text: str) -> None:
        self._text, self._at = text, 0

    def keys(self) -> Iterator[KeySpan]:
        """Yield all keys."""
        table: tuple[str, ...] = ()
        while self._letter():
            if self._letter() == "[":
                self._skip("[")
                parts = self._dotted(())
                yield from parts
                table = parts[-1].path
                self._skip("]")
            else:
                yield from self._assignment(table)

    def _assignment(self, table: tuple[str, ...]) -> Iterator[KeySpan]:
        *outer, key = self._dotted(table)
        yield from outer
        self._pass(_ASSIGNED)
        if self._letter() in ("[", "{"):
            yield key
            yield from self._value(key.path)
        else:
            start = self._at
            yield key._replace(value=self._pass(_SCALAR).rstrip(), value_start=start)

    def _value(self, path: tuple[str, ...]) -> Iterator[KeySpan]:
        opened = self._letter()
        if opened not in ("[", "{"):
            self._pass(_SCALAR)
            return
        self._at += 1
        while self._letter() not in ("]", "}"):
            yield from self._value(path) if opened == "[" else self._assignment(path)
            self._skip(",")
        self._at += 1

    def _dotted(self, table: tuple[str, ...]) -> list[KeySpan]:
        """Return the parts of a key, from where the scanner is."""
        self._letter()
        found: list[KeySpan] = []
        while not found or self._pass(_BETWEEN):
            start, word = self._at, self._pass(_KEY)
            table = (*table, *tomllib.loads(f"{word} = 0"))
            found.append(KeySpan(table, start, self._at, "", self._at))
        return found

    def _letter(self) -> str:
        """Return the next letter that is neither space nor comment; empty at the end."""
        self._pass(_GAP)
        return self._text[self._at : self._at + 1]

    def _skip(self, letter: str) -> None:
        while self._letter() == letter:
            self._at += 1

    def _pass(self, pattern: re.Pattern[str]) -> str:
        """Go beyond what a pattern matches here, and return it."""
        found = pattern.match(self._text, self._at)
        if found is None:
            return ""
        self._at = found.end()
        return found.group()


_BEFORE: Final = parsing.SCHEMA - 1
_WRITABLE: Final = 0o222  # by anybody: root may write to all files, and is not meant to
_CARRIED: Final = ("attach", "robot")


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
    for span in key_spans(text):
        kind = _kind_of(span.path[:-1], scenario)
        new = parsing.RENAMED.get(kind, {}).get(span.path[-1])
        if new is not None:
            changes.append((span.start, span.end, new))
        if scenario and span.path in parsing.DROPPED:
            changes.append((*_line_of(text, span), ""))
        if (
            kind
            and span.path[-1] == "schema"
            and span.value
            and _is_before(_loaded(f"x = {span.value}")["x"])
        ):
            changes.append((span.value_start, span.value_start + len(span.value), str(parsing.SCHEMA)))
    made = text
    for start, end, new in reversed(changes):
        made = made[:start] + new + made[end:]
    if _told(_loaded(made)) != _told(_renamed(table, (), scenario)):
        raise ValueError("more than keys would change")
    return made, len(changes)


def _told(table: Mapping[str, Any]) -> str:
    """Return what a file tells; a table without keys, as may be left of one, tells nothing."""
    return repr({key: value for key, value in table.items() if value != {}})


def _line_of(text: str, span: KeySpan) -> tuple[int, int]:
    """Return where the line of a key begins and ends; nothing else may stand on it but a comment."""
    begin, end = text.rfind("\n", 0, span.start) + 1, span.value_start + len(span.value)
    newline = text.find("\n", end)
    after = len(text) if newline < 0 else newline + 1
    rest = text[end:after].strip()
    if not span.value or "{" in text[begin : span.start] or (rest and not rest.startswith("#")):
        raise ValueError(f"'{'.'.join(span.path)}' is no more, and not alone on its line")
    return begin, after


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
    names = parsing.RENAMED.get(kind, {})
    made = {
        names.get(key, key): _renamed(item, (*path, key), scenario)
        for key, item in value.items()
        if not (scenario and (*path, key) in parsing.DROPPED)
    }
    if kind and _is_before(made.get("schema")):
        made["schema"] = parsing.SCHEMA
    return made


def _is_before(number: Any) -> bool:
    return number == _BEFORE and type(number) is int


def _loaded(text: str) -> dict[str, Any]:
    return tomllib.loads(text.removeprefix("\ufeff").replace("\r\n", "\n"))
