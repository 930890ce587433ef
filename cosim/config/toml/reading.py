"""Reads TOML files that may be anybody's: bounded in size, depth and length before they are used."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from cosim.base.files_read import read_file
from cosim.config.toml.faults import UNKNOWN
from cosim.errors import ScenarioError

LARGEST_FILE_BYTES: Final = 4_000_000
DEEPEST: Final = 24
LONGEST_TEXT: Final = 10_000
LONGEST_LIST: Final = 10_000
LARGEST_INTEGER: Final = 2**63 - 1
"""What TOML asks every reader to hold."""


@final
@dataclass(frozen=True, repr=False)
class Unreadable:
    """Stands for a value of a file that cannot be used, whatever its key.

    Args:
        problem: what is wrong with it.
    """

    problem: str

    def __repr__(self) -> str:
        """Return what stands for it in a list that is shown."""
        return "..."


def read_table(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file as `only_readable` makes them; a byte order mark is skipped.

    Raises:
        ScenarioError: the file cannot be read, is too large, or is not TOML; `path` is the file's name.
    """
    try:
        data = read_file(path, LARGEST_FILE_BYTES)
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
    readable: dict[str, Any] = only_readable(table)
    return readable


def only_readable(value: Any, depth: int = 0) -> Any:
    """Return a copy in which what is deeper, longer or larger than the program can hold is `Unreadable`.

    Tuples and arrays become lists.

    Args:
        value: as TOML gives it, or Python.
        depth: of the value in the table that is read.
    """
    if value is UNKNOWN or isinstance(value, Unreadable):
        return value
    problem = _problem(value, depth)
    if problem is not None:
        return Unreadable(problem)
    if isinstance(value, Mapping):
        return {str(key): only_readable(item, depth + 1) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return only_readable(value.tolist(), depth)
    if isinstance(value, list | tuple):
        return [only_readable(item, depth + 1) for item in value]
    return value


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
