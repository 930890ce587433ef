"""One thing changed in a checkpoint: what a damaged disk, another program or somebody's malice may leave."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Parts = dict[str, np.ndarray[Any, Any]]
Random = np.random.Generator


def read_parts(path: Path) -> tuple[dict[str, Any], Parts]:
    """Return the structure of a checkpoint and its arrays by name."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return json.loads(arrays.pop("structure").tobytes()), arrays


def written(structure: Any, arrays: Parts, **options: Any) -> bytes:
    """Return the bytes of an archive."""
    stream = io.BytesIO()
    text = structure if isinstance(structure, bytes) else json.dumps(structure).encode()
    save: Any = np.savez_compressed if options.get("packed") else np.savez
    save(stream, structure=np.frombuffer(text, np.uint8), **arrays)
    return stream.getvalue()


def forge(path: Path, random: Random) -> tuple[str, bytes]:
    """Return what was done, and the bytes of a checkpoint with one thing changed."""
    kind = str(random.choice(list(_FORGERIES)))
    return kind, _FORGERIES[kind](path, random)


def _of_arrays(change: Callable[[Any, Random], Any]) -> Callable[[Path, Random], bytes]:
    def forgery(path: Path, random: Random) -> bytes:
        structure, arrays = read_parts(path)
        name = str(random.choice(sorted(arrays)))
        arrays[name] = change(arrays[name], random)
        return written(structure, arrays)

    return forgery


def _flipped(array: Any, random: Random) -> Any:
    data = bytearray(array.tobytes())
    for _ in range(int(random.integers(1, 9)) if data else 0):
        data[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))
    return np.frombuffer(bytes(data), array.dtype).reshape(array.shape)


def _filled(value: float) -> Callable[[Any, Random], Any]:
    def change(array: Any, random: Random) -> Any:
        changed = np.array(array)
        if changed.size:
            with np.errstate(all="ignore"):
                changed.flat[int(random.integers(changed.size))] = np.array(value).astype(changed.dtype)
        return changed

    return change


def _whole_numbers(path: Path, random: Random) -> bytes:
    structure, arrays = read_parts(path)
    names = [name for name, array in sorted(arrays.items()) if array.dtype.kind == "i" and array.size]
    if names:
        name = str(random.choice(names))
        arrays[name] = np.array(arrays[name])
        arrays[name].flat[int(random.integers(arrays[name].size))] = random.choice(
            [-1, -(2**40), 10**6, 2**62, 7000]
        )
    return written(structure, arrays)


def _of_structure(change: Callable[[Any, Random], None]) -> Callable[[Path, Random], bytes]:
    def forgery(path: Path, random: Random) -> bytes:
        structure, arrays = read_parts(path)
        change(structure, random)
        return written(structure, arrays)

    return forgery


def places_of(value: Any) -> list[tuple[Any, Any]]:
    """Return (container, key) of everything within a JSON value."""
    entries = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    return [place for key, item in list(entries) for place in ((value, key), *places_of(item))]


def _exchange(structure: Any, random: Random) -> None:
    places = places_of(structure["state"])
    (there, key), (here, other) = (places[int(random.integers(len(places)))] for _ in range(2))
    there[key] = json.loads(json.dumps(here[other]))


def _replace(structure: Any, random: Random) -> None:
    values: list[Any] = [
        None, True, -1, 10**400, 1e308, float("nan"), "", "x" * 10**5, [], {}, {"array": "no"}, {"tuple": 3},
        {"class": "os:system", "fields": {}}, {"enum": "x", "name": 1},
    ]  # fmt: skip
    places = places_of(structure["state"])
    container, key = places[int(random.integers(len(places)))]
    container[key] = values[int(random.integers(len(values)))]


def _drop(structure: Any, random: Random) -> None:
    places = places_of(structure)
    container, key = places[int(random.integers(len(places)))]
    del container[key]


def _header(structure: Any, random: Random) -> None:
    key = str(random.choice(sorted(structure["header"])))
    values: list[Any] = [None, -1, "text", [], {}, 10**30]
    structure["header"][key] = values[int(random.integers(len(values)))]


def _version(structure: Any, random: Random) -> None:
    structure["schema"] = [0, 2, -1, None, "1", 10**30, [1]][int(random.integers(7))]


def _torn(path: Path, random: Random) -> bytes:
    data = path.read_bytes()
    return data[: int(random.integers(len(data)))]


def _bits(path: Path, random: Random) -> bytes:
    data = bytearray(path.read_bytes())
    for _ in range(int(random.integers(1, 33))):
        data[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))
    return bytes(data)


def _missing(path: Path, random: Random) -> bytes:
    structure, arrays = read_parts(path)
    del arrays[str(random.choice(sorted(arrays)))]
    return written(structure, arrays)


def _added(path: Path, random: Random) -> bytes:
    structure, arrays = read_parts(path)
    return written(structure, arrays | {"more": np.zeros(int(random.integers(10**5)))})


def _swapped(path: Path, random: Random) -> bytes:
    structure, arrays = read_parts(path)
    a, b = (str(name) for name in random.choice(sorted(arrays), 2, replace=False))
    arrays[a], arrays[b] = arrays[b], arrays[a]
    return written(structure, arrays)


def _objects(path: Path, random: Random) -> bytes:
    structure, arrays = read_parts(path)
    arrays[str(random.choice(sorted(arrays)))] = np.array([{"a": 1}, None], dtype=object)
    return written(structure, arrays)


def _deep(path: Path, random: Random) -> bytes:
    arrays = read_parts(path)[1]
    depth = int(random.choice([900, 10**5]))
    return written(b'{"schema": 1, "header": {}, "state": ' + b"[" * depth + b"]" * depth + b"}", arrays)


def _bomb(path: Path, random: Random) -> bytes:
    structure, _ = read_parts(path)
    stream = io.BytesIO(written(structure, {}))
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
        )
        archive.writestr("array_0.npy", header.getvalue() + bytes(10**8))
    return stream.getvalue()


def _lying_size(path: Path, random: Random) -> bytes:
    data = path.read_bytes()
    at = data.find(b"'shape': (", int(random.integers(len(data) // 2)))
    return data if at < 0 else data[: at + 10] + b"9" + data[at + 11 :]


def _cast(kind: type[np.generic]) -> Callable[[Any, Random], Any]:
    """Return what makes other numbers of an array; texts, which are no numbers, are cut."""
    return lambda array, random: array.astype("U3" if array.dtype.kind == "U" else kind)


_FORGERIES: dict[str, Callable[[Path, Random], bytes]] = {
    "bits of the file": _bits,
    "torn": _torn,
    "bits of an array": _of_arrays(_flipped),
    "half an array": _of_arrays(lambda array, random: array.reshape(-1)[: array.size // 2]),
    "a longer array": _of_arrays(lambda array, random: np.resize(array, (max(1, array.size) * 3,))),
    "rows left out": _of_arrays(lambda array, random: array[:-1] if array.ndim else array[None]),
    "turned": _of_arrays(lambda array, random: np.array(array).T.copy()),
    "by columns": _of_arrays(lambda array, random: np.asfortranarray(array)),
    "nothing in it": _of_arrays(lambda array, random: array.reshape(-1)[:0]),
    "single precision": _of_arrays(_cast(np.float32)),
    "bytes reversed": _of_arrays(lambda array, random: array.astype(array.dtype.newbyteorder())),
    "texts": _of_arrays(lambda array, random: array.astype("U8")),
    "complex": _of_arrays(_cast(np.complex128)),
    "not a number": _of_arrays(_filled(float("nan"))),
    "infinite": _of_arrays(_filled(float("inf"))),
    "huge": _of_arrays(_filled(1e300)),
    "whole numbers": _whole_numbers,
    "array missing": _missing,
    "array added": _added,
    "arrays swapped": _swapped,
    "objects": _objects,
    "parts exchanged": _of_structure(_exchange),
    "part replaced": _of_structure(_replace),
    "part missing": _of_structure(_drop),
    "header": _of_structure(_header),
    "version": _of_structure(_version),
    "packed": lambda path, random: written(*read_parts(path), packed=True),
    "deep": _deep,
    "bomb": _bomb,
    "size that lies": _lying_size,
}
