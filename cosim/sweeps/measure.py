"""Custom columns of a sweep: a function of a run's result, with a name by which all workers import it."""

import inspect
import pickle
from collections.abc import Callable, Mapping
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeAlias

from cosim.config.plugins import module_of_file
from cosim.errors import InputError
from cosim.results.result import RunResult

Measure: TypeAlias = Callable[[RunResult], Mapping[str, float]]
"""Returns further columns of a run, by names that end in their unit."""
_KINDS: Final = (int, float, bool)


@cache
def measure_named(name: str) -> Measure:
    """Return a function by its name.

    Args:
        name: "module:function" or "file.py:function".

    Raises:
        InputError: there is no such function.
    """
    path, _, function = name.rpartition(":")
    try:
        module = module_of_file(Path(path)) if path.endswith(".py") else import_module(path)
    except Exception as error:  # a user's module may raise anything
        raise InputError(
            f"measure = {name!r}: cannot be imported: {type(error).__name__}: {error}"
        ) from error
    found = getattr(module, function, None)
    if not callable(found):
        raise InputError(f"measure = {name!r}: {path} has no function '{function}'")
    measure: Measure = found
    return measure


def check_sendable(measure: Measure) -> None:
    """Check that a function can be sent to other processes.

    Raises:
        InputError: it is defined within another function, or has no name.
    """
    try:
        pickle.dumps(measure)
    except Exception as error:  # pickle may raise anything
        raise InputError(
            f"measure: cannot be sent to other processes: define it in a module, by its own name ({error})"
        ) from error


def measure_identity(measure: Measure) -> str:
    """Return a hash of the function's name and file."""
    try:
        text = Path(inspect.getsourcefile(measure) or "").read_text(encoding="utf-8")
    except (OSError, TypeError):
        text = ""
    return sha256(f"{getattr(measure, '__qualname__', measure)}\n{text}".encode()).hexdigest()[:16]


def measured(measure: Measure, result: RunResult) -> dict[str, float]:
    """Return the columns of a function.

    Raises:
        InputError: it does not return numbers by name.
    """
    returned = measure(result)
    if not isinstance(returned, Mapping):
        raise InputError(f"the measure returned a {type(returned).__name__}; return numbers by name")
    columns = {}
    for name, value in returned.items():
        plain: Any = value.item() if hasattr(value, "item") and getattr(value, "size", 0) == 1 else value
        if not isinstance(plain, _KINDS):
            raise InputError(f"the measure returned for {name} a {type(value).__name__}; return a number")
        columns[str(name)] = plain
    return columns
