"""Reads TOML files that may be anybody's: bounded in size, depth and length before they are used."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cosim.config.toml.parsing import join, label
from cosim.errors import ScenarioError

LARGEST_FILE_BYTES: Final = 4_000_000
DEEPEST: Final = 24
LONGEST_KEY: Final = 100
LONGEST_TEXT: Final = 10_000
LONGEST_LIST: Final = 10_000
LARGEST_INTEGER: Final = 2**63 - 1
"""What TOML asks every reader to hold."""


def read_table(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; a byte order mark is skipped.

    Raises:
        ScenarioError: the file cannot be read, is too large, or is not TOML; `path` is the file's name. Or a
            value is too deep, long or large: see `check_values`.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(LARGEST_FILE_BYTES + 1)
        if len(data) > LARGEST_FILE_BYTES:
            raise ScenarioError(
                str(path), f"is longer than {LARGEST_FILE_BYTES} bytes, which no scenario or robot needs"
            )
        table = tomllib.loads(data.decode("utf-8-sig").replace("\r\n", "\n"))
    except OSError as error:
        raise ScenarioError(str(path), f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(str(path), f"is not UTF-8 text: byte {error.start}") from error
    except RecursionError:
        raise ScenarioError(str(path), f"is nested too deeply; at most {DEEPEST} levels are read") from None
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(str(path), f"is not TOML: {error}") from error
    except ValueError as error:
        most = sys.get_int_max_str_digits()
        raise ScenarioError(str(path), f"holds a whole number of more than {most} digits") from error
    check_values(table)
    return table


def check_values(table: Mapping[str, Any], path: str = "") -> None:
    """Check that nothing in nested tables is deeper, longer or larger than the program can hold or show.

    Args:
        table: as TOML gives it.
        path: of the table, for messages.

    Raises:
        ScenarioError: the first value that is.
    """
    open_values: list[tuple[Any, str, int]] = [(table, path, 0)]
    while open_values:
        value, place, depth = open_values.pop()
        problem = _problem(value, depth)
        if problem is not None:
            raise ScenarioError(place, problem)
        if isinstance(value, Mapping):
            for key, item in reversed(list(value.items())):
                if len(key) > LONGEST_KEY:
                    shown = f"{key[:LONGEST_KEY]}..."
                    raise ScenarioError(
                        join(place, shown), f"has {len(key)} characters; keys have at most {LONGEST_KEY}"
                    )
                open_values.append((item, join(place, key), depth + 1))
        elif isinstance(value, list):
            entries = reversed(list(enumerate(value, start=1)))
            open_values += [(item, join(place, label(item, k)), depth + 1) for k, item in entries]


def _problem(value: Any, depth: int) -> str | None:
    if depth > DEEPEST:
        return f"is nested too deeply; at most {DEEPEST} levels are read"
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"is a text of {len(value)} characters; at most {LONGEST_TEXT} are read"
    if isinstance(value, list) and len(value) > LONGEST_LIST:
        return f"is a list of {len(value)} entries; at most {LONGEST_LIST} are read"
    if isinstance(value, int) and not -LARGEST_INTEGER <= value <= LARGEST_INTEGER:
        return f"is a whole number of {value.bit_length()} bits; at most 63 and a sign are read"
    return None
