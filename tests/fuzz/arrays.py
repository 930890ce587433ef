"""All arrays that public attributes lead to, and saved states as values that can be compared."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import numpy as np

from cosim.app.simulation import SavedState


def state_content(saved: SavedState, path: Path) -> Any:
    """Return a saved state as values that can be compared; what was wall time is left out."""
    saved.write(path)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return _plain(json.loads(arrays["structure"].tobytes())["state"], arrays)


def _plain(value: Any, arrays: Mapping[str, Any]) -> Any:
    if isinstance(value, dict) and "array" in value:
        found = arrays[value["array"]]
        return found.shape, found.tobytes()
    if isinstance(value, dict):
        return {key: _plain(entry, arrays) for key, entry in value.items() if key != "tick_wall_s"}
    return [_plain(entry, arrays) for entry in value] if isinstance(value, list) else repr(value)


def arrays_of(value: Any, place: str, seen: dict[int, Any] | None = None) -> Iterator[tuple[str, Any]]:
    """Yield (where, array) of all arrays that the public attributes of an object of cosim lead to."""
    seen = {} if seen is None else seen
    if id(value) in seen:
        return
    seen[id(value)] = value
    if isinstance(value, np.ndarray):
        yield place, value
    elif isinstance(value, Mapping):
        for key in value:
            yield from arrays_of(value[key], f"{place}[{key!r}]", seen)
    elif isinstance(value, list | tuple | set | frozenset):
        for k, entry in enumerate(value):
            yield from arrays_of(entry, f"{place}[{k}]", seen)
    elif type(value).__module__.partition(".")[0] == "cosim" and not isinstance(value, type):
        for name in dir(value):
            if not name.startswith("_"):
                with catch_warnings(action="ignore", category=DeprecationWarning):
                    found = getattr(value, name, None)
                yield from arrays_of(found, f"{place}.{name}", seen)


def write_to_all(value: Any) -> None:
    """Write to all arrays that an object leads to, but to those that are read-only."""
    for _, array in list(arrays_of(value, "")):
        if array.flags.writeable and array.size:
            array[...] = 1 if array.dtype.kind in "iub" else 7.5 if array.dtype.kind == "f" else array.flat[0]
