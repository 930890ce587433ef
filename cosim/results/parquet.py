"""Arrays as columns of Parquet files: an array of any shape is one column, one row per tick or frame.

Rows of several numbers are fixed-shape tensors, which any reader of Arrow knows as lists of fixed length.
What a column holds stands in its metadata, what the file is of in that of the file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cosim.base.frames import Array
from cosim.base.whole_files import whole_file
from cosim.errors import InputError, OutputError

if TYPE_CHECKING:
    import pyarrow as pa

_OWN: Final = b"cosim"
"""Key of what cosim says in the metadata of files and columns."""
_DIGEST: Final = b"cosim_sha256"
"""Key of the digest of that, which tells damage from what was written."""
_OPEN: Final = ("unit", "meaning")
"""What other programs find in the metadata of a column by itself."""


def write_columns(
    path: Path,
    columns: Mapping[str, Array],
    texts: Mapping[str, Mapping[str, Any]],
    header: Mapping[str, Any],
) -> None:
    """Write arrays of equally many rows; a reader sees all of them or none.

    Args:
        path: of the file.
        columns: by name; of one number per row, or of any shape.
        texts: what to say of each column: texts "unit" and "meaning", and other values of JSON.
        header: what to say of the file, as values of JSON.

    Raises:
        OutputError: it cannot be written.
    """
    import pyarrow as pa  # here: it takes as long to load as half a run's start
    from pyarrow import parquet

    arrays, fields = [], []
    for name, array in columns.items():
        arrays.append(_column(array))
        own = {**texts[name], "shape": array.shape[1:], "dtype": str(array.dtype)}
        metadata = {key.encode(): own.pop(key).encode() for key in _OPEN}
        fields.append(pa.field(name, arrays[-1].type, metadata={**metadata, **_said(own)}))
    table = pa.table(arrays, pa.schema(fields, _said(header)))
    # few numbers occur twice: dictionaries cost eight times the time, and room
    how: dict[str, Any] = {"compression": "zstd", "use_dictionary": False, "write_page_checksum": True}
    try:
        with whole_file(path) as file:
            parquet.write_table(table, file, **how)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def read_header(path: Path) -> dict[str, Any]:
    """Return what a file says of itself.

    Raises:
        InputError: it cannot be read, or cosim did not write it.
    """
    from pyarrow import parquet

    with _naming(path):
        return _own(parquet.read_schema(path).metadata, path)


def read_columns(path: Path) -> dict[str, Array]:
    """Return the arrays of a file, as they were.

    Raises:
        InputError: it cannot be read, or cosim did not write it.
    """
    from pyarrow import parquet

    with _naming(path):
        table = parquet.read_table(path, memory_map=False, page_checksum_verification=True)
        return {field.name: _array(table[field.name], _own(field.metadata, path)) for field in table.schema}


def read_texts(path: Path) -> dict[str, dict[str, Any]]:
    """Return what `write_columns` was given to say of the columns, by name.

    Raises:
        InputError: it cannot be read, or cosim did not write it.
    """
    from pyarrow import parquet

    with _naming(path):
        return {
            field.name: {key: field.metadata[key.encode()].decode() for key in _OPEN}
            | _own(field.metadata, path)
            for field in parquet.read_schema(path)
        }


def _column(array: Array) -> pa.Array:
    import pyarrow as pa

    if array.ndim == 1:
        return pa.array(array)
    if 0 in array.shape[1:]:  # nothing to write, and Arrow has no lists of length 0
        return pa.nulls(len(array))
    return pa.FixedShapeTensorArray.from_numpy_ndarray(np.ascontiguousarray(array))


def _array(column: pa.ChunkedArray, said: Mapping[str, Any]) -> Array:
    import pyarrow as pa

    shape, dtype = (len(column), *said["shape"]), np.dtype(said["dtype"])
    if 0 in shape:
        return np.zeros(shape, dtype)
    whole = column.combine_chunks()
    if len(shape) > 1:
        whole = whole.storage.flatten()
    if whole.type != pa.from_numpy_dtype(dtype) or whole.null_count:
        raise ValueError(f"a column holds {whole.type} and {whole.null_count} gaps, not {dtype}")
    return np.array(whole.to_numpy(zero_copy_only=False), dtype).reshape(shape)


def _said(own: Mapping[str, Any]) -> dict[bytes, bytes]:
    """Return metadata that `_own` reads."""
    text = json.dumps(own).encode()
    return {_OWN: text, _DIGEST: sha256(text).hexdigest().encode()}


def _own(metadata: Mapping[bytes, bytes] | None, path: Path) -> dict[str, Any]:
    if metadata is None or _OWN not in metadata:
        raise InputError(f"{path}: was not written by cosim")
    if metadata.get(_DIGEST, b"") not in (b"", sha256(metadata[_OWN]).hexdigest().encode()):
        raise InputError(f"{path}: is damaged: what it says of itself is not what was written")
    found: dict[str, Any] = json.loads(metadata[_OWN])
    return found


class _naming:  # noqa: N801  # a context manager
    """Turn whatever a damaged file raises into one line with its name."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        """Begin to read."""

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, Exception) and not isinstance(error, InputError):
            text = (str(error).splitlines() or [""])[0][:200]
            raise InputError(f"{self._path}: cannot be read: {text}") from error
