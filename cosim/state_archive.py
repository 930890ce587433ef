"""Saved states on disk: arrays and JSON in one .npz file, made from the dataclasses themselves.

Whatever is made of frozen dataclasses, enums, arrays, numbers, texts, tuples, lists, dictionaries by text and
None is written and read back bit for bit; an array that occurs twice is stored once, and is one array again.
Nothing is executed in reading: a class is looked up among the modules that are loaded already, and only a
frozen dataclass or an enum is made.
"""

from __future__ import annotations

import enum
import json
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cosim.errors import InputError
from cosim.whole_files import whole_file

ARCHIVE_SCHEMA = 1
_STRUCTURE = "structure"


def write_archive(path: Path, header: Mapping[str, Any], state: Any) -> None:
    """Write a state; a reader of the path sees all of it, or what was there before.

    Args:
        path: of the file.
        header: JSON values that say whose state it is; read back by `read_header`.
        state: see the module.

    Raises:
        TypeError: a part of the state is of a kind that cannot be written; the text names it.
    """
    encoder = _Encoder()
    structure = {"schema": ARCHIVE_SCHEMA, "header": dict(header), "state": encoder.encode(state, "state")}
    text = np.frombuffer(json.dumps(structure).encode(), dtype=np.uint8)
    with whole_file(path) as file:
        np.savez(file, allow_pickle=False, **{_STRUCTURE: text}, **encoder.named)


def read_header(path: Path) -> dict[str, Any]:
    """Return the header of an archive; nothing else is read.

    Raises:
        InputError: no archive, or one of another schema.
    """
    header: dict[str, Any] = _read(path, whole=False)[0]["header"]
    return header


def read_archive(path: Path) -> Any:
    """Return the state in an archive. What it is made of must have been imported.

    Raises:
        InputError: no archive, one of another schema, or one whose classes are unknown or have changed.
    """
    structure, arrays = _read(path, whole=True)
    return _decode(structure["state"], arrays)


def _read(path: Path, *, whole: bool) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            structure = json.loads(archive[_STRUCTURE].tobytes())
            arrays = {name: archive[name] for name in archive.files} if whole else {}
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: is no saved state that can be read: {error}") from error
    found = structure.get("schema") if isinstance(structure, dict) else None
    if found != ARCHIVE_SCHEMA:
        raise InputError(f"{path}: has schema {found}; this cosim reads {ARCHIVE_SCHEMA}")
    return structure, arrays


@final
class _Encoder:
    """Turns values into JSON and gathers their arrays; `named` holds them by their names."""

    def __init__(self) -> None:
        self.named: dict[str, NDArray[Any]] = {}
        self._names: dict[int, str] = {}

    def encode(self, value: Any, place: str) -> Any:
        """Return JSON for a value; `place` says where in the state it is."""
        if value is None or (isinstance(value, bool | int | str) and not isinstance(value, enum.Enum)):
            return value
        if isinstance(value, float):
            return float(value)
        if isinstance(value, np.generic):
            return self.encode(value.item(), place)
        if isinstance(value, np.ndarray):
            return {"array": self._name(value, place)}
        if isinstance(value, tuple | list):
            items = [self.encode(item, f"{place}[{k}]") for k, item in enumerate(value)]
            return {"tuple" if isinstance(value, tuple) else "list": items}
        if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
            return {"dict": {key: self.encode(item, f"{place}.{key}") for key, item in value.items()}}
        if isinstance(value, enum.Enum):
            return {"enum": _class_name(type(value), place), "name": value.name}
        if _is_frozen(type(value)):
            held = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
            inner = {name: self.encode(item, f"{place}.{name}") for name, item in held.items()}
            return {"class": _class_name(type(value), place), "fields": inner}
        raise TypeError(f"{place} is a {type(value).__name__}, which no saved state can hold")

    def _name(self, array: NDArray[Any], place: str) -> str:
        if array.dtype.hasobject:
            raise TypeError(f"{place} is an array of objects, which no saved state can hold")
        name = self._names.setdefault(id(array), f"array_{len(self._names)}")
        self.named[name] = array
        return name


def _is_frozen(kind: type) -> bool:
    parameters = getattr(kind, "__dataclass_params__", None)
    return is_dataclass(kind) and parameters is not None and bool(parameters.frozen)


def _class_name(kind: type, place: str) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    if _find_class(name) is not kind:
        raise TypeError(f"{place} is a {kind.__qualname__}, which is not at the top level of its module")
    return name


def _find_class(name: str) -> type | None:
    """Return a frozen dataclass or an enum of a loaded module; None for anything else."""
    module, _, own = name.partition(":")
    kind = getattr(sys.modules.get(module), own, None)
    if isinstance(kind, type) and (_is_frozen(kind) or issubclass(kind, enum.Enum)):
        return kind
    return None


def _decode(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[value["array"]]
    if "tuple" in value:
        return tuple(_decode(item, arrays) for item in value["tuple"])
    if "list" in value:
        return [_decode(item, arrays) for item in value["list"]]
    if "dict" in value:
        return {key: _decode(item, arrays) for key, item in value["dict"].items()}
    name = value["enum"] if "enum" in value else value["class"]
    kind = _find_class(name)
    if kind is None:
        raise InputError(f"the saved state holds a {name}, which this program does not know")
    try:
        if issubclass(kind, enum.Enum):
            return kind[value["name"]]
        return kind(**{key: _decode(item, arrays) for key, item in value["fields"].items()})
    except (KeyError, TypeError) as error:
        raise InputError(f"the saved {name} is of another version: {error}") from error
