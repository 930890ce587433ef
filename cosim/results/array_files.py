"""The arrays of a run on disk: written part by part while it lasts, read back as one.

Arrays as columns of Parquet files: an array of any shape is one column, one row per tick or frame.

Rows of several numbers are fixed-shape tensors, which any reader of Arrow knows as lists of fixed length.
What a column holds stands in its metadata, what the file is of in that of the file.

What does not change during a run, as values of JSON in the files of its arrays.

What only engines can tell (the film's stress at given nodes) and what is only drawn is not kept.

A part of a run that resumed from a checkpoint begins there; what an earlier part holds of later ticks is
passed over.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cosim._version import __version__
from cosim.base.column import Column
from cosim.base.frames import Array
from cosim.base.whole_files import whole_file
from cosim.base.writing import writing
from cosim.devices.device_report import DeviceNames, SensorNames
from cosim.errors import InputError
from cosim.plan.decision import Decision
from cosim.results.result import COLUMNS, FRAME_COLUMNS, IMAGE_COLUMNS, CameraImages, frame_rows
from cosim.telemetry.camera_image import CameraInfo
from cosim.telemetry.run_info import ObjectInfo, RunInfo

if TYPE_CHECKING:
    import pyarrow as pa


_OWN: Final = b"cosim"
"""Key of what cosim says in the metadata of files and columns."""
_DIGEST: Final = b"cosim_sha256"
"""Key of the digest of that, by which damage is found."""
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
    # few numbers occur twice: dictionaries cost eight times the time, and room; bytes that belong together
    # side by side, exponents above all, save a quarter of the room
    how: dict[str, Any] = {
        "compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True,
        "write_page_checksum": True,
    }  # fmt: skip
    with writing(path), whole_file(path) as file:
        parquet.write_table(table, file, **how)


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


def _column(array: Array) -> "pa.Array":
    import pyarrow as pa

    if array.ndim == 1:
        return pa.array(array)
    if 0 in array.shape[1:]:  # nothing to write, and Arrow has no lists of length 0
        return pa.nulls(len(array))
    return pa.FixedShapeTensorArray.from_numpy_ndarray(np.ascontiguousarray(array))


def _array(column: "pa.ChunkedArray", said: Mapping[str, Any]) -> Array:
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
        raise InputError(f"{path}: is damaged: its description is not the one that was written")
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


_NOT_KEPT: Final = (
    "membrane_stress", "hinge_energy_share", "stiffener_strain", "shapes", "arm", "tip_paths", "decay",
    "energy", "tip_measured_by", "tip_directions", "stored_m", "frames_length", "drawn",
)  # fmt: skip
_KEPT: Final = tuple(field.name for field in fields(RunInfo) if field.name not in _NOT_KEPT)


def stored_stage(stage: RunInfo) -> dict[str, Any]:
    """Return a stage as values of JSON."""
    return {name: _plain(getattr(stage, name)) for name in _KEPT}


def stage_of(stored: Mapping[str, Any]) -> RunInfo:
    """Return the stage that `stored_stage` was given, without what is not kept.

    Raises:
        InputError: it is none.
    """
    if missing := [name for name in _KEPT if name not in stored]:
        raise InputError(f"the description of the run lacks {', '.join(missing)}")
    made: dict[str, Any] = {name: _tuples(stored[name]) for name in _KEPT}
    made["soft_triangles"] = np.array(stored["soft_triangles"], np.int64).reshape(-1, 3)
    made["cables"] = tuple(np.array(nodes, np.int64) for nodes in stored["cables"])
    made["gravity"] = np.array(stored["gravity"], np.float64)
    made["modelled"] = tuple(Decision(**entry) for entry in stored["modelled"])
    made["sensors"] = tuple(
        SensorNames(**{key: _tuples(value) for key, value in entry.items()}) for entry in stored["sensors"]
    )
    made["objects"] = tuple(
        ObjectInfo(**{key: _tuples(value) for key, value in entry.items()}) for entry in stored["objects"]
    )
    made["cameras"] = tuple(
        CameraInfo(**{key: _tuples(value) for key, value in entry.items()}) for entry in stored["cameras"]
    )
    if stored["devices"] is not None:
        made["devices"] = DeviceNames(**{key: _tuples(value) for key, value in stored["devices"].items()})
    return RunInfo(**made, shapes=(), membrane_stress=_no_stress)


def _no_stress(_positions: Array) -> Array:
    raise InputError(
        "the film's stress is not kept in files; build the run's scenario to compute it: "
        'cosim.Simulation("DIR/scenario.toml").stage.membrane_stress(positions)'
    )


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


ARRAYS_SCHEMA: Final = 1


def write_arrays(
    ticks: Path, frames: Path, stage: RunInfo, frames_per_s: float, arrays: Mapping[str, Array]
) -> None:
    """Write a part of a run.

    Args:
        ticks: file of what has a row per tick.
        frames: file of what has a row per frame.
        stage: of the run.
        frames_per_s: how often node positions are kept, in simulated time.
        arrays: all of them, by name.

    Raises:
        OutputError: they cannot be written.
    """
    header = {
        "schema": ARRAYS_SCHEMA,
        "cosim_version": __version__,
        "frames_per_s": frames_per_s,
        "stage": stored_stage(stage),
    }
    for path, columns in ((frames, FRAME_COLUMNS), (ticks, COLUMNS)):
        texts = {name: _array_said(column, stage, arrays[name]) for name, column in columns.items()}
        write_columns(path, {name: arrays[name] for name in columns}, texts, header)


def write_images(path: Path, camera: str, images: CameraImages) -> None:
    """Write pictures of a camera.

    Args:
        path: of the file.
        camera: its name.
        images: at least one.

    Raises:
        OutputError: they cannot be written.
    """
    texts = {
        name: {"unit": column.unit, "meaning": column.meaning, "axes": column.axes}
        for name, column in IMAGE_COLUMNS.items()
    }
    write_columns(path, images.arrays, texts, {"schema": ARRAYS_SCHEMA, "camera": camera})


def read_images(paths: Sequence[Path], camera: str) -> CameraImages | None:
    """Return the pictures of a camera in some files; None where there are none.

    Raises:
        InputError: one cannot be read, or lacks an array.
    """
    own = [path for path in paths if read_header(path).get("camera") == camera]
    return CameraImages(read_parts(own, IMAGE_COLUMNS, "tick")) if own else None


def read_stage(path: Path) -> RunInfo:
    """Return the stage of the run that a file of arrays belongs to.

    Raises:
        InputError: it cannot be read, or is of another schema.
    """
    header = read_header(path)
    if header.get("schema") != ARRAYS_SCHEMA:
        raise InputError(
            f"{path}: has schema {header.get('schema')}, of cosim {header.get('cosim_version')}; this cosim, "
            f"{__version__}, reads {ARRAYS_SCHEMA}"
        )
    try:
        return stage_of(header["stage"])
    except (InputError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error


def read_parts(paths: Sequence[Path], names: Iterable[str], tick: str) -> dict[str, Any]:
    """Return the arrays of the parts of a run as one.

    Args:
        paths: of the parts, in order.
        names: of the arrays.
        tick: which of them counts the ticks.

    Raises:
        InputError: one cannot be read, or lacks an array.
    """
    found: list[dict[str, Array]] = []
    for path in paths:
        part = read_columns(path)
        if missing := [name for name in names if name not in part]:
            raise InputError(f"{path}: lacks {', '.join(missing)}")
        if len(part[tick]):
            found = [_before(earlier, tick, part[tick][0]) for earlier in found]
            found.append(part)
    if not found:
        return {name: np.zeros(0) for name in names}
    return {name: np.concatenate([part[name] for part in found]) for name in names}


def check_rows(
    arrays: Mapping[str, Array], ticks: Sequence[Path], frames: Sequence[Path], last: int, remedy: str
) -> None:
    """Check that there is a row for each tick of a run, and one for each of its frames.

    Args:
        arrays: of all parts.
        ticks: files of what has a row per tick.
        frames: files of what has a row per frame.
        last: tick of the run; a run that failed at its start has no rows.
        remedy: what to do where rows are missing.

    Raises:
        InputError: there are fewer, more, or others.
    """
    tick, frame_tick = arrays["tick"], arrays["frame_tick"]
    wanted = range(last + 1 if last or len(tick) else 0)  # a damaged summary may count any number
    _check_same(ticks, tick, wanted, f"the run's summary counts ticks 0 to {last}", remedy)
    frames_per_s = read_header(frames[-1]).get("frames_per_s")
    if frames_per_s is not None:  # in files since this was written
        kept = tick[frame_rows(arrays["time_s"], frames_per_s)]
        _check_same(frames, frame_tick, kept, f"{frames_per_s:g} frames/s were kept", remedy)


def _check_same(files: Sequence[Path], found: Any, wanted: Any, why: str, remedy: str) -> None:
    if len(found) != len(wanted):
        problem = f"{len(found)} rows; must have {len(wanted)}"
    elif not np.array_equal(found, wanted):
        problem = f"rows of other ticks than it must have, {len(wanted)} of them"
    else:
        return
    names = ", ".join([str(files[0]), *(file.name for file in files[1:])])
    raise InputError(f"{names}: {'have' if len(files) > 1 else 'has'} {problem}, since {why}; {remedy}")


def _before(part: dict[str, Array], tick: str, first: int) -> dict[str, Array]:
    rows = int(np.searchsorted(part[tick], first))
    return {name: array[:rows] for name, array in part.items()}


def _array_said(column: Column, stage: RunInfo, array: Array) -> dict[str, Any]:
    said: dict[str, Any] = {"unit": column.unit, "meaning": column.meaning, "axes": column.axes}
    if "nodes" not in column.axes:
        said["components"] = column.components(stage.names_along, array.shape[1:])
    return said
