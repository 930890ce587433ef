"""Makes kinds of tables known that are not part of cosim: those of a module, and of installed packages.

A package offers its kinds as entry points; a module is named by who runs a scenario. A file cannot name
either: reading one runs no code that was not there before.
"""

from __future__ import annotations

import importlib.util
import inspect
import sys
from contextlib import suppress
from dataclasses import is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from cosim.base.files_read import note_file
from cosim.config.toml.registered_kinds import KindTable, name_of, register_kind
from cosim.errors import InputError

GROUP: Final = "cosim.kinds"
"""Of entry points; each names a module that holds kinds, or a kind."""


@cache
def register_installed() -> None:
    """Register the kinds that installed packages offer, once.

    Raises:
        InputError: one cannot be imported, or holds no kind.
    """
    from importlib.metadata import entry_points  # here, because it takes long to load

    for entry in sorted(entry_points(group=GROUP)):
        what = f"entry point '{entry.name}' of the group {GROUP} ({entry.value})"
        _register(_loaded(what, entry.load), what)


def register_module(name: str) -> None:
    """Register every kind that a module holds.

    Args:
        name: of a module that can be imported, or path of a .py file.

    Raises:
        InputError: there is no such module, it cannot be imported, or holds no kind.
    """
    load = (lambda: _of_file(Path(name))) if name.endswith(".py") else (lambda: import_module(name))
    _register(_loaded(f"--import {name}", load), f"--import {name}")


def note_kinds(value: Any) -> None:
    """Note the modules of all kinds in a scenario that are not those of cosim, see `files_read`."""
    if isinstance(value, KindTable) and not type(value).__module__.startswith("cosim."):
        with suppress(OSError, TypeError):  # typed in at a prompt
            note_file(Path(inspect.getfile(type(value))))
    parts = vars(value).values() if is_dataclass(value) else value
    for part in parts:
        if is_dataclass(part) or (isinstance(part, tuple) and part and not isinstance(part[0], float)):
            note_kinds(part)


def _loaded(what: str, load: Any) -> Any:
    try:
        return load()
    except Exception as error:  # whatever a module of someone's own raises
        raise InputError(f"{what}: cannot be imported: {type(error).__name__}: {error}") from error


def _of_file(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    if path.stem in sys.modules:
        raise ImportError(f"a module called '{path.stem}' is loaded already; give the file another name")
    sys.modules[path.stem] = module  # where dataclasses look their annotations up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[path.stem]
        raise
    return module


def _register(loaded: Any, what: str) -> None:
    found = [
        entry
        for entry in (vars(loaded).values() if isinstance(loaded, ModuleType) else (loaded,))
        if isinstance(entry, type) and issubclass(entry, KindTable) and entry is not KindTable
    ]
    kinds = [table for table in found if name_of(table) is not None]
    if not kinds:
        raise InputError(f"{what}: holds no kind of tables, such as a subclass of ElementTable")
    for table in kinds:
        register_kind(table)
