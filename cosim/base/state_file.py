"""Writes the state of a run, see `cosim.base.state`, to one .npz file of arrays and a JSON text, and reads it
back bit for bit. An array that occurs twice is stored once. Reading executes no code: classes are looked up
only in modules that are already imported, and must be frozen dataclasses, named tuples or enums.
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
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from cosim.base import caches, whole_files, writing
from cosim.base.state import entries, field_names, is_record
from cosim.errors import InputError

Kind = TypeVar("Kind")
STATE_SCHEMA = 1
_STRUCTURE, _SUFFIX = "structure", ".npy"
_DAMAGE = (
    ArithmeticError, AttributeError, LookupError, MemoryError, NotImplementedError, RuntimeError, SyntaxError,
    TypeError, ValueError, EOFError, zlib.error, struct.error,
)  # fmt: skip
"""Exceptions of reading a damaged or forged file."""


def save(target: Path | BinaryIO, tree: Any, header: Mapping[str, Any] | None = None) -> None:
    """Write a state to a file or stream; a file is replaced as a whole, at the end.

    Args:
        target: path of the file, or a stream.
        tree: the state.
        header: JSON values, which `load_header` reads without the state.

    Raises:
        TypeError: a part of the state is of a class that cannot be written; the message names it.
    """
    arrays: dict[int, tuple[str, NDArray[Any]]] = {}
    structure = {
        "schema": STATE_SCHEMA,
        "header": dict(header or {}),
        "state": _encoded(tree, "state", arrays),
    }
    text = np.frombuffer(json.dumps(structure).encode(), dtype=np.uint8)
    with whole_files.whole_file(target) if isinstance(target, Path) else nullcontext(target) as file:
        np.savez(file, allow_pickle=False, **{_STRUCTURE: text}, **dict(arrays.values()))


def load(source: Path | BinaryIO) -> Any:
    """Return the state in a file or stream. The modules of its classes must have been imported.

    Raises:
        InputError: it holds no state, a state of another schema, or classes that are unknown or changed.
    """
    structure, arrays = _read(source, whole=True)
    try:
        return _decoded(structure["state"], arrays)
    except (InputError, *_DAMAGE) as error:
        raise InputError(f"{source}: {_one_line(error)}") from error


def load_header(path: Path) -> dict[str, Any]:
    """Return the header of a state's file, without reading its arrays.

    Raises:
        InputError: it holds no state, or one of another schema.
    """
    header: dict[str, Any] = _read(path, whole=False)[0]["header"]
    return header


class WrittenState(ABC):
    """A saved state that can be written to a file."""

    @property
    @abstractmethod
    def _ticks(self) -> int:
        """Number of ticks that were simulated."""

    @final
    def write(self, path: str | Path) -> None:
        """Write the state to a file, from which this simulation, or an equally built one, can continue.

        Args:
            path: of the file, an archive of NumPy (.npz).

        Raises:
            OutputError: it cannot be written.
        """
        with writing.writing(path):
            save(Path(path), self, {"tick": self._ticks})


def load_or_make(cache: str, name: str, kind: type[Kind], make: Callable[[], Kind]) -> Kind:
    """Return a state from the cache on disk; if it is not there, it is made and written to the cache.

    Args:
        cache: of `caches.KINDS`.
        name: a hash of all that the state depends on.
        kind: class of the state.
        make: makes the state; a state that `save` refuses is not written to the cache.
    """

    def read(data: bytes) -> Kind:
        state = load(io.BytesIO(data))
        if not isinstance(state, kind):
            raise TypeError(f"a {type(state).__name__} is no {kind.__name__}")
        return state

    state = caches.load(cache, f"{name}.kept", read)
    if state is None:
        state, stream = make(), io.BytesIO()
        with suppress(TypeError):
            save(stream, state)
            caches.store(cache, f"{name}.kept", stream.getvalue())
    return state


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
    schema = structure.get("schema") if isinstance(structure, dict) else None
    if schema != STATE_SCHEMA or not isinstance(structure.get("header"), dict):
        raise InputError(f"{path}: has schema {str(schema)[:40]}; this cosim reads {STATE_SCHEMA}")
    return structure, arrays


def _array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Return an array of an archive, without compression, so that it is no larger in memory than in the file.

    Raises:
        ValueError: it is compressed, has another size than its header says, or contains Python objects.
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
    """Return the first line of an error's message, or its class if the message is empty."""
    return (str(error).splitlines() or [""])[0][:200] or type(error).__name__


def _encoded(tree: Any, path: str, arrays: dict[int, tuple[str, NDArray[Any]]]) -> Any:
    """Return JSON for the part of a state at a path; its arrays are added to `arrays`, by identity."""
    if isinstance(tree, np.generic):
        tree = tree.item()
    if isinstance(tree, enum.Enum):
        return {"enum": _class_name(type(tree), path), "name": tree.name}
    if tree is None or isinstance(tree, bool | int | float | str):
        return tree
    if isinstance(tree, np.ndarray):
        if tree.dtype.hasobject:
            raise TypeError(f"{path} is an array of objects, which no saved state can hold")
        return {"array": arrays.setdefault(id(tree), (f"array_{len(arrays)}", tree))[0]}
    parts, kinds = entries(tree), set(map(type, tree)) if isinstance(tree, Mapping) else set()
    if parts is None or kinds - {str, int} or len(kinds) > 1:
        raise TypeError(f"{path} is a {type(tree).__name__}, which no saved state can hold")
    inner = {name: _encoded(part, path + name, arrays) for name, part in parts}
    if isinstance(tree, Mapping):
        return {"by_number" if int in kinds else "dict": dict(zip(tree, inner.values(), strict=True))}
    if not is_record(type(tree)):
        return {"tuple" if isinstance(tree, tuple) else "list": list(inner.values())}
    values = dict(zip(field_names(type(tree)), inner.values(), strict=True))
    return {"class": _class_name(type(tree), path), "fields": values}


def _class_name(kind: type, path: str) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    if _find_class(name) is not kind:
        raise TypeError(f"{path} is a {kind.__qualname__}, which is not at the top level of its module")
    return name


def _find_class(name: str) -> type | None:
    """Return a frozen dataclass, named tuple or enum of an imported module; None for anything else."""
    module, _, class_name = name.partition(":")
    kind = getattr(sys.modules.get(module), class_name, None)
    if isinstance(kind, type) and (is_record(kind) or issubclass(kind, enum.Enum)):
        return kind
    return None


def _decoded(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[value["array"]]
    if "tuple" in value:
        return tuple(_decoded(item, arrays) for item in value["tuple"])
    if "list" in value:
        return [_decoded(item, arrays) for item in value["list"]]
    if "dict" in value:
        return {key: _decoded(item, arrays) for key, item in value["dict"].items()}
    if "by_number" in value:
        return {int(key): _decoded(item, arrays) for key, item in value["by_number"].items()}
    name = value["enum"] if "enum" in value else value["class"]
    kind = _find_class(name)
    if kind is None:
        raise InputError(f"the saved state holds a {name}, which this program does not know")
    try:
        if issubclass(kind, enum.Enum):
            return kind[value["name"]]
        saved, known = value["fields"], set(field_names(kind))
        if known ^ saved.keys():  # no default may replace a value that was not saved
            raise KeyError(f"other fields: {', '.join(sorted(known ^ saved.keys()))}")
        return kind(**{key: _decoded(item, arrays) for key, item in saved.items()})
    except (KeyError, TypeError) as error:
        raise InputError(f"the saved {name} is of another version: {error}") from error
