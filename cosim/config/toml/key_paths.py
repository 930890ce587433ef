"""Paths of keys and words for values, as messages show them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import Field
from typing import Any, Final

LONGEST_SHOWN: Final = 60
LONGEST_NAME: Final = 64
LONGEST_KEY: Final = 100


def key_of(entry: Field[Any]) -> str:
    """Return the key in the file of a dataclass field."""
    return str(entry.metadata.get("alias", entry.name))


def join(path: str, key: str) -> str:
    """Return the path of a key inside a table; a key that would not show is put in quotes, as in TOML."""
    cut = key if len(key) <= LONGEST_KEY else f"{key[:LONGEST_KEY]}..."
    visible = cut if cut.isprintable() and cut and not set(key) & set(" .\"'") else json.dumps(cut)
    return f"{path}.{visible}" if path else visible


def label(item: Any, index: int) -> str:
    """Return the name of an entry of a list of tables, else (or if it is too long) its place from 1."""
    name = item.get("name") if isinstance(item, Mapping) else None
    return name if isinstance(name, str) and 0 < len(name) <= LONGEST_NAME else str(index)


def shown(value: Any) -> str:
    """Return a value as messages show it: texts in quotes, control characters escaped, long ones cut."""
    quoted = repr(value)
    return quoted if len(quoted) <= LONGEST_SHOWN else f"{quoted[: LONGEST_SHOWN - 3]}..."


def describe(value: Any) -> str:
    """Return a value with its kind, for messages."""
    kinds: tuple[tuple[type, str], ...] = (
        (bool, "the truth value"),
        (int, "the whole number"),
        (float, "the number"),
        (str, "the text"),
        (list, "the list"),
        (Mapping, "a table"),
    )
    kind = next((name for kind, name in kinds if isinstance(value, kind)), f"a {type(value).__name__}")
    if isinstance(value, Mapping):
        return kind
    return f"{kind} {str(value).lower() if isinstance(value, bool) else shown(value)}"
