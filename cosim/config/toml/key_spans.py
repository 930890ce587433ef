"""Finds the keys of a TOML text, so that some can be changed and all the rest stays as it is."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Final, NamedTuple

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
