"""Columns of one's own: a function of a run's result, named so that every worker finds it."""

from __future__ import annotations

import importlib.util
import inspect
import pickle
import sys
from collections.abc import Callable, Mapping
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from cosim.errors import InputError
from cosim.results.result import RunResult

Measure = Callable[[RunResult], Mapping[str, float]]
"""Returns more columns of a run, by names that end in their unit."""
_KINDS: Final = (int, float, bool)


@cache
def measure_named(name: str) -> Measure:
    """Return a function by its name.

    Args:
        name: "module:function" or "file.py:function".

    Raises:
        InputError: there is no such function.
    """
    place, _, function = name.rpartition(":")
    try:
        module = _of_file(Path(place)) if place.endswith(".py") else import_module(place)
    except Exception as error:  # whatever a module of someone's own raises
        raise InputError(
            f"measure = {name!r}: cannot be imported: {type(error).__name__}: {error}"
        ) from error
    found = getattr(module, function, None)
    if not callable(found):
        raise InputError(f"measure = {name!r}: {place} holds no function '{function}'")
    made: Measure = found
    return made


def check_travels(measure: Measure) -> None:
    """Check that a function can be sent to other processes.

    Raises:
        InputError: it is defined within another one, or is none that has a name.
    """
    try:
        pickle.dumps(measure)
    except Exception as error:  # pickle raises what it likes
        raise InputError(
            f"measure: cannot be sent to other processes: define it in a module, by its own name ({error})"
        ) from error


def measure_identity(measure: Measure) -> str:
    """Return a hash of the file that a function is in; of its name where there is none."""
    try:
        text = Path(inspect.getsourcefile(measure) or "").read_text(encoding="utf-8")
    except (OSError, TypeError):
        text = ""
    return sha256(f"{getattr(measure, '__qualname__', measure)}\n{text}".encode()).hexdigest()[:16]


def measured(measure: Measure, result: RunResult) -> dict[str, float]:
    """Return what a function says of a run.

    Raises:
        InputError: it returns something else than numbers by name.
    """
    found = measure(result)
    if not isinstance(found, Mapping):
        raise InputError(f"the measure returned a {type(found).__name__}; return numbers by name")
    columns = {}
    for name, value in found.items():
        plain: Any = value.item() if hasattr(value, "item") and getattr(value, "size", 0) == 1 else value
        if not isinstance(plain, _KINDS):
            raise InputError(f"the measure returned for {name} a {type(value).__name__}; return a number")
        columns[str(name)] = plain
    return columns


def _of_file(path: Path) -> Any:
    name = f"cosim_measure_{sha256(str(path.resolve()).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
