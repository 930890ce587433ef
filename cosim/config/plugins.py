"""Registers kinds of tables that are not part of cosim: those of a module (`--import MODULE`), and those that
installed packages offer as entry points. A scenario's file can name neither, so reading a file never runs new
code.
"""

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

from cosim.base.files import note_file
from cosim.config.toml import tables
from cosim.errors import InputError

GROUP: Final = "cosim.kinds"
"""Of entry points; each names a module that holds kinds, or a kind."""


@cache
def register_installed() -> None:
    """Register the kinds of tables that installed packages offer, once per process.

    Raises:
        InputError: one cannot be imported, or holds no kind.
    """
    from importlib.metadata import entry_points  # imported here because it takes long to load

    for entry in sorted(entry_points(group=GROUP)):
        what = f"entry point '{entry.name}' of the group {GROUP} ({entry.value})"
        _register(_loaded(what, entry.load), what)


def register_module(name: str) -> None:
    """Register every kind of tables that a module defines.

    Args:
        name: of a module that can be imported, or path of a .py file.

    Raises:
        InputError: the module does not exist, cannot be imported, or defines no kind.
    """
    load = (lambda: module_of_file(Path(name))) if name.endswith(".py") else (lambda: import_module(name))
    _register(_loaded(f"--import {name}", load), f"--import {name}")


def note_kinds(value: Any) -> None:
    """Add the source files of a scenario's kinds that are not part of cosim to the files read by a run.

    Args:
        value: a table, or a tuple of tables.
    """
    if isinstance(value, tables.KindTable) and not type(value).__module__.startswith("cosim."):
        with suppress(OSError, TypeError):  # a class typed at a prompt has no file
            note_file(Path(inspect.getfile(type(value))))
    parts = vars(value).values() if is_dataclass(value) else value
    for part in parts:
        if is_dataclass(part) or (isinstance(part, tuple) and part and not isinstance(part[0], float)):
            note_kinds(part)


def _loaded(what: str, load: Any) -> Any:
    try:
        return load()
    except Exception as error:  # a user's module may raise anything
        raise InputError(f"{what}: cannot be imported: {type(error).__name__}: {error}") from error


def module_of_file(path: Path) -> ModuleType:
    """Return the module of a .py file; a file is loaded once.

    Raises:
        ImportError: there is no such file, or another module of that name is loaded.
    """
    name, file = path.stem, str(path.resolve())
    loaded = sys.modules.get(name)
    if loaded is not None and loaded.__file__ == file:
        return loaded
    if loaded is not None:
        raise ImportError(f"a module called '{name}' is loaded already; give the file another name")
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None, "its name ends in .py"
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(
        spec
    )  # where dataclasses look annotations up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _register(loaded: Any, what: str) -> None:
    found = [
        entry
        for entry in (vars(loaded).values() if isinstance(loaded, ModuleType) else (loaded,))
        if isinstance(entry, type) and issubclass(entry, tables.KindTable) and entry is not tables.KindTable
    ]
    kinds = [table for table in found if tables.name_of(table) is not None]
    if not kinds:
        raise InputError(f"{what}: holds no kind of tables, such as a subclass of ElementTable")
    for table in kinds:
        tables.register_kind(table)
