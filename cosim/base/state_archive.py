"""Saved states on disk: arrays and JSON in one .npz file, made from the dataclasses themselves.

What can be saved and restored while it runs continues from a saved state bit-identically. A state is a frozen
dataclass of arrays, numbers, texts, tuples, None and further frozen dataclasses. It may share arrays with the
object it was taken from: whoever writes to an array in place saves a copy of it.

Whatever is made of frozen dataclasses, named tuples, enums, arrays, numbers, texts, tuples, lists,
dictionaries by text and None is written and read back bit for bit; an array that occurs twice is stored once,
and is one array again.
Nothing is executed in reading: a class is looked up among the modules that are loaded already, and only a
frozen dataclass, a named tuple or an enum is made.
"""

import enum
import io
import json
import math
import struct
import sys
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from cosim.base import caches, files, resources
from cosim.errors import InputError

Kind = TypeVar("Kind")
ARCHIVE_SCHEMA = 1
_STRUCTURE, _SUFFIX = "structure", ".npy"
_DAMAGE = (
    ArithmeticError, AttributeError, LookupError, MemoryError, NotImplementedError, RuntimeError, SyntaxError,
    TypeError, ValueError, EOFError, zlib.error, struct.error,
)  # fmt: skip
"""What reading a damaged or made-up file may raise."""


def write_archive(target: Path | BinaryIO, header: Mapping[str, Any], state: Any) -> None:
    """Write a state; a reader of a path sees all of it, or what was there before.

    Args:
        target: path of the file, or a stream.
        header: JSON values that say whose state it is; read back by `read_header`.
        state: see the module.

    Raises:
        TypeError: a part of the state is of a kind that cannot be written; the text names it.
    """
    encoder = _Encoder()
    structure = {"schema": ARCHIVE_SCHEMA, "header": dict(header), "state": encoder.encode(state, "state")}
    text = np.frombuffer(json.dumps(structure).encode(), dtype=np.uint8)
    with files.whole_file(target) if isinstance(target, Path) else nullcontext(target) as file:
        np.savez(file, allow_pickle=False, **{_STRUCTURE: text}, **encoder.named)


class WrittenState(ABC):
    """A saved state that can be written to a file."""

    @property
    @abstractmethod
    def _ticks(self) -> int:
        """How many ticks had been taken."""

    @final
    def write(self, path: str | Path) -> None:
        """Write the state to a file, from which the simulation that saved it, or one like it, can continue.

        Args:
            path: of the file, an archive of NumPy (.npz).

        Raises:
            OutputError: it cannot be written.
        """
        with resources.writing(path):
            write_archive(Path(path), {"tick": self._ticks}, self)


def read_header(path: Path) -> dict[str, Any]:
    """Return the header of an archive; nothing else is read.

    Raises:
        InputError: no archive, or one of another schema.
    """
    header: dict[str, Any] = _read(path, whole=False)[0]["header"]
    return header


def read_archive(source: Path | BinaryIO) -> Any:
    """Return the state in an archive, of a file or in a stream. What it is made of must have been imported.

    Raises:
        InputError: no archive, one of another schema, or one whose classes are unknown or have changed.
    """
    structure, arrays = _read(source, whole=True)
    try:
        return _decode(structure["state"], arrays)
    except (InputError, *_DAMAGE) as error:
        raise InputError(f"{source}: {_one_line(error)}") from error


def kept_or_made(cache: str, name: str, kind: type[Kind], make: Callable[[], Kind]) -> Kind:
    """Return a state that is kept on disk; made, and then kept where it can be, if it is not there.

    Args:
        cache: of `caches.KINDS`.
        name: of all that it depends on.
        kind: of the state.
        make: makes it; one that is no plain data is not kept.
    """
    found = caches.kept(cache, f"{name}.kept", partial(_unpacked, kind))
    if found is None:
        found, stream = make(), io.BytesIO()
        with suppress(TypeError):
            write_archive(stream, {}, found)
            caches.keep(cache, f"{name}.kept", stream.getvalue())
    return found


def _unpacked(kind: type[Kind], data: bytes) -> Kind:
    found = read_archive(io.BytesIO(data))
    if not isinstance(found, kind):
        raise TypeError(f"a {type(found).__name__} is no {kind.__name__}")
    return found


def _read(path: Path | BinaryIO, *, whole: bool) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    try:
        with zipfile.ZipFile(path) as archive:
            structure = json.loads(_array(archive, _STRUCTURE + _SUFFIX).tobytes())
            names = [name for name in archive.namelist() if name.endswith(_SUFFIX)] if whole else []
            arrays = {name.removesuffix(_SUFFIX): _array(archive, name) for name in names}
    except OSError as error:
        raise InputError(f"{path}: is no saved state that can be read: {error.strerror or error}") from error
    except (*_DAMAGE, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: is no saved state that can be read: {_one_line(error)}") from error
    found = structure.get("schema") if isinstance(structure, dict) else None
    if found != ARCHIVE_SCHEMA or not isinstance(structure.get("header"), dict):
        raise InputError(f"{path}: has schema {str(found)[:40]}; this cosim reads {ARCHIVE_SCHEMA}")
    return structure, arrays


def _array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Return an array stored as `numpy.savez` does it: as it is, so that it is no larger in memory.

    Raises:
        ValueError: it is packed, shorter or longer than it says, or made of objects.
    """
    entry = archive.getinfo(name)
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > entry.compress_size:
        raise ValueError(f"{name} is packed")
    data = archive.read(entry)
    stream = io.BytesIO(data)
    version = npy.read_magic(stream)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, by_columns, dtype = read_header(stream)
    wanted = math.prod(shape) * dtype.itemsize
    if dtype.hasobject or min(shape, default=0) < 0 or len(data) - stream.tell() != wanted:
        raise ValueError(f"{name} is not an array of shape {shape}")
    array = np.frombuffer(bytearray(data[stream.tell() :]), dtype)
    return array.reshape(shape, order="F" if by_columns else "C")


def _one_line(error: BaseException) -> str:
    """Return the first line of an error's text, or its kind where it has none."""
    return (str(error).splitlines() or [""])[0][:200] or type(error).__name__


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
        if isinstance(value, tuple | list) and not _is_record(type(value)):
            items = [self.encode(item, f"{place}[{k}]") for k, item in enumerate(value)]
            return {"tuple" if isinstance(value, tuple) else "list": items}
        if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
            return {"dict": {key: self.encode(item, f"{place}.{key}") for key, item in value.items()}}
        if isinstance(value, enum.Enum):
            return {"enum": _class_name(type(value), place), "name": value.name}
        if _is_record(type(value)):
            held = {name: getattr(value, name) for name in _field_names(type(value))}
            inner = {name: self.encode(item, f"{place}.{name}") for name, item in held.items()}
            return {"class": _class_name(type(value), place), "fields": inner}
        raise TypeError(f"{place} is a {type(value).__name__}, which no saved state can hold")

    def _name(self, array: NDArray[Any], place: str) -> str:
        if array.dtype.hasobject:
            raise TypeError(f"{place} is an array of objects, which no saved state can hold")
        name = self._names.setdefault(id(array), f"array_{len(self._names)}")
        self.named[name] = array
        return name


def _is_record(kind: type) -> bool:
    """Return whether a class is a frozen dataclass or a named tuple."""
    if issubclass(kind, tuple):
        return hasattr(kind, "_fields")
    parameters = getattr(kind, "__dataclass_params__", None)
    return is_dataclass(kind) and parameters is not None and bool(parameters.frozen)


def _field_names(kind: Any) -> tuple[str, ...]:
    if issubclass(kind, tuple):
        return tuple(kind._fields)
    return tuple(field.name for field in fields(kind) if field.init)


def _class_name(kind: type, place: str) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    if _find_class(name) is not kind:
        raise TypeError(f"{place} is a {kind.__qualname__}, which is not at the top level of its module")
    return name


def _find_class(name: str) -> type | None:
    """Return a frozen dataclass, a named tuple or an enum of a loaded module; None for anything else."""
    module, _, own = name.partition(":")
    kind = getattr(sys.modules.get(module), own, None)
    if isinstance(kind, type) and (_is_record(kind) or issubclass(kind, enum.Enum)):
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
        saved, known = value["fields"], set(_field_names(kind))
        if known ^ saved.keys():  # a default would stand for what was not known when it was saved
            raise KeyError(f"other fields: {', '.join(sorted(known ^ saved.keys()))}")
        return kind(**{key: _decode(item, arrays) for key, item in saved.items()})
    except (KeyError, TypeError) as error:
        raise InputError(f"the saved {name} is of another version: {error}") from error
