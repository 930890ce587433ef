"""Arrays of any shape as columns of a Parquet file: rows of several numbers are fixed-shape tensors, which
all readers of Arrow read as lists of fixed length; metadata describe file and columns.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cosim.base.frames import Array
from cosim.base.whole_files import whole_file
from cosim.base.writing import writing
from cosim.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

_OWN: Final = b"cosim"
"""Key of cosim's description in the metadata of files and columns."""
_DIGEST: Final = b"cosim_sha256"
"""Key of the description's digest, which detects damage."""
_OPEN: Final = ("unit", "meaning")
"""Parts of a column's description that are metadata by themselves, for other programs."""


def write_columns(
    path: Path,
    columns: Mapping[str, Array],
    texts: Mapping[str, Mapping[str, Any]],
    header: Mapping[str, Any],
) -> None:
    """Write arrays with the same number of rows; a reader sees all of them or none.

    Args:
        path: of the file.
        columns: arrays by name; rows are numbers, or arrays of any shape.
        texts: description of each column: texts "unit" and "meaning", and other values of JSON.
        header: description of the file, values of JSON.

    Raises:
        OutputError: the file cannot be written.
    """
    import pyarrow as pa  # here: loading it takes half as long as a run's start
    from pyarrow import parquet

    arrays, fields = [], []
    for name, array in columns.items():
        arrays.append(_column(array))
        described = {**texts[name], "shape": array.shape[1:], "dtype": str(array.dtype)}
        metadata = {key.encode(): described.pop(key).encode() for key in _OPEN}
        fields.append(pa.field(name, arrays[-1].type, metadata={**metadata, **_metadata(described)}))
    table = pa.table(arrays, pa.schema(fields, _metadata(header)))
    # few numbers occur twice: dictionaries would take eight times the time, and more space; bytes of equal
    # significance side by side, exponents above all, save a quarter of the space
    how: dict[str, Any] = {
        "compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True,
        "write_page_checksum": True,
    }  # fmt: skip
    with writing(path), whole_file(path) as file:
        parquet.write_table(table, file, **how)


def read_header(path: Path) -> dict[str, Any]:
    """Return the description of a file.

    Raises:
        InputError: the file cannot be read, or cosim did not write it.
    """
    from pyarrow import parquet

    with _naming(path):
        return _description(parquet.read_schema(path).metadata, path)


def read_columns(path: Path) -> dict[str, Array]:
    """Return the arrays of a file.

    Raises:
        InputError: the file cannot be read, or cosim did not write it.
    """
    from pyarrow import parquet

    with _naming(path):
        table = parquet.read_table(path, memory_map=False, page_checksum_verification=True)
        return {
            field.name: _array(table[field.name], _description(field.metadata, path))
            for field in table.schema
        }


def _column(array: Array) -> "pa.Array":
    import pyarrow as pa

    if array.ndim == 1:
        return pa.array(array)
    if 0 in array.shape[1:]:  # Arrow has no lists of length 0
        return pa.nulls(len(array))
    return pa.FixedShapeTensorArray.from_numpy_ndarray(np.ascontiguousarray(array))


def _array(column: "pa.ChunkedArray", description: Mapping[str, Any]) -> Array:
    import pyarrow as pa

    shape, dtype = (len(column), *description["shape"]), np.dtype(description["dtype"])
    if 0 in shape:
        return np.zeros(shape, dtype)
    whole = column.combine_chunks()
    if len(shape) > 1:
        whole = whole.storage.flatten()
    if whole.type != pa.from_numpy_dtype(dtype) or whole.null_count:
        raise ValueError(f"a column has type {whole.type} and {whole.null_count} gaps, not type {dtype}")
    return np.array(whole.to_numpy(zero_copy_only=False), dtype).reshape(shape)


def _metadata(description: Mapping[str, Any]) -> dict[bytes, bytes]:
    """Return the metadata of a description."""
    text = json.dumps(description).encode()
    return {_OWN: text, _DIGEST: sha256(text).hexdigest().encode()}


def _description(metadata: Mapping[bytes, bytes] | None, path: Path) -> dict[str, Any]:
    """Return the description in metadata.

    Raises:
        InputError: the file is missing or damaged.
    """
    if metadata is None or _OWN not in metadata:
        raise InputError(f"{path}: was not written by cosim")
    if metadata.get(_DIGEST, b"") not in (b"", sha256(metadata[_OWN]).hexdigest().encode()):
        raise InputError(
            f"{path}: is damaged: its description is not the one that was written; run its scenario again"
        )
    description: dict[str, Any] = json.loads(metadata[_OWN])
    return description


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn any error of a damaged file into an InputError with the file's name."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        text = (str(error).splitlines() or [""])[0][:200]
        raise InputError(f"{path}: cannot be read: {text}") from error
