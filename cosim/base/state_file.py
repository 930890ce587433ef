"""States on disk: a tree, see `cosim.base.state`, as one .npz file of arrays and a JSON text.

A tree is written and read back bit for bit; an array that occurs twice is stored once, and is one array
again. Reading executes nothing: a class is looked up among the modules that are loaded already, and only
frozen dataclasses, named tuples and enums are made.
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

from cosim.base import caches, writing
from cosim.base.state import entries, field_names, is_record
from cosim.errors import InputError

Kind = TypeVar("Kind")
STATE_SCHEMA = 1
_STRUCTURE, _SUFFIX = "structure", ".npy"
_DAMAGE = (
    ArithmeticError, AttributeError, LookupError, MemoryError, NotImplementedError, RuntimeError, SyntaxError,
    TypeError, ValueError, EOFError, zlib.error, struct.error,
)  # fmt: skip
"""What reading a damaged or made-up file may raise."""


def save(target: Path | BinaryIO, tree: Any, header: Mapping[str, Any] | None = None) -> None:
    """Write a state; a reader of a path sees all of it, or what was there before.

    Args:
        target: path of the file, or a stream.
        tree: the state.
        header: JSON values that `load_header` reads alone.

    Raises:
        TypeError: a part of the state is of a kind that cannot be written; the text names it.
    """
    arrays: dict[int, tuple[str, NDArray[Any]]] = {}
    structure = {
        "schema": STATE_SCHEMA,
        "header": dict(header or {}),
        "state": _encoded(tree, "state", arrays),
    }
    text = np.frombuffer(json.dumps(structure).encode(), dtype=np.uint8)
    with writing.whole_file(target) if isinstance(target, Path) else nullcontext(target) as file:
        np.savez(file, allow_pickle=False, **{_STRUCTURE: text}, **dict(arrays.values()))


def load(source: Path | BinaryIO) -> Any:
    """Return the state in a file or stream. The modules of its classes must have been imported.

    Raises:
        InputError: it holds no state, one of another schema, or one of classes that are unknown or changed.
    """
    structure, arrays = _read(source, whole=True)
    try:
        return _decoded(structure["state"], arrays)
    except (InputError, *_DAMAGE) as error:
        raise InputError(f"{source}: {_one_line(error)}") from error


def load_header(path: Path) -> dict[str, Any]:
    """Return the header of a state's file; nothing else is read.

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
        """How many ticks had been taken."""

    @final
    def write(self, path: str | Path) -> None:
        """Write the state to a file, from which the simulation that saved it, or one like it, can continue.

        Args:
            path: of the file, an archive of NumPy (.npz).

        Raises:
            OutputError: it cannot be written.
        """
        with writing.writing(path):
            save(Path(path), self, {"tick": self._ticks})


def kept_or_made(cache: str, name: str, kind: type[Kind], make: Callable[[], Kind]) -> Kind:
    """Return a state that is kept on disk; made, and then kept where it can be, if it is not there.

    Args:
        cache: of `caches.KINDS`.
        name: of all that it depends on.
        kind: of the state.
        make: makes it; one that is no plain data is not kept.
    """

    def unpacked(data: bytes) -> Kind:
        found = load(io.BytesIO(data))
        if not isinstance(found, kind):
            raise TypeError(f"a {type(found).__name__} is no {kind.__name__}")
        return found

    found = caches.kept(cache, f"{name}.kept", unpacked)
    if found is None:
        found, stream = make(), io.BytesIO()
        with suppress(TypeError):
            save(stream, found)
            caches.keep(cache, f"{name}.kept", stream.getvalue())
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
    if found != STATE_SCHEMA or not isinstance(structure.get("header"), dict):
        raise InputError(f"{path}: has schema {str(found)[:40]}; this cosim reads {STATE_SCHEMA}")
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


def _encoded(tree: Any, place: str, arrays: dict[int, tuple[str, NDArray[Any]]]) -> Any:
    """Return JSON for a part of a state, `place` in it; its arrays join `arrays`, by identity, with names."""
    if isinstance(tree, np.generic):
        tree = tree.item()
    if isinstance(tree, enum.Enum):
        return {"enum": _class_name(type(tree), place), "name": tree.name}
    if tree is None or isinstance(tree, bool | int | float | str):
        return tree
    if isinstance(tree, np.ndarray):
        if tree.dtype.hasobject:
            raise TypeError(f"{place} is an array of objects, which no saved state can hold")
        return {"array": arrays.setdefault(id(tree), (f"array_{len(arrays)}", tree))[0]}
    parts, kinds = entries(tree), set(map(type, tree)) if isinstance(tree, Mapping) else set()
    if parts is None or kinds - {str, int} or len(kinds) > 1:
        raise TypeError(f"{place} is a {type(tree).__name__}, which no saved state can hold")
    inner = {name: _encoded(part, place + name, arrays) for name, part in parts}
    if isinstance(tree, Mapping):
        return {"by_number" if int in kinds else "dict": dict(zip(tree, inner.values(), strict=True))}
    if not is_record(type(tree)):
        return {"tuple" if isinstance(tree, tuple) else "list": list(inner.values())}
    own = dict(zip(field_names(type(tree)), inner.values(), strict=True))
    return {"class": _class_name(type(tree), place), "fields": own}


def _class_name(kind: type, place: str) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    if _find_class(name) is not kind:
        raise TypeError(f"{place} is a {kind.__qualname__}, which is not at the top level of its module")
    return name


def _find_class(name: str) -> type | None:
    """Return a frozen dataclass, a named tuple or an enum of a loaded module; None for anything else."""
    module, _, own = name.partition(":")
    kind = getattr(sys.modules.get(module), own, None)
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
        if known ^ saved.keys():  # a default would stand for what was not known when it was saved
            raise KeyError(f"other fields: {', '.join(sorted(known ^ saved.keys()))}")
        return kind(**{key: _decoded(item, arrays) for key, item in saved.items()})
    except (KeyError, TypeError) as error:
        raise InputError(f"the saved {name} is of another version: {error}") from error
