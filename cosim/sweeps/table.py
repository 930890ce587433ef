"""The table of a sweep in Parquet: a row per design, columns with units."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from cosim.base.resources import is_file
from cosim.base.whole_files import whole_file
from cosim.base.writing import writing
from cosim.config.toml.keys import unit_of, unit_text
from cosim.errors import InputError
from cosim.sweeps.designs import Design
from cosim.sweeps.run_figures import PHASES

TABLE: Final = "sweep.parquet"
_DIGEST: Final = b"cosim_sha256"
_PLAIN: Final = (bool, int, float, str)
_COLUMNS: Final = {
    "design": "index in the study, counted from 0",
    "status": "completed, failed, interrupted, refused (cannot be built) or lost (its worker died)",
    "reason": "why it is not completed",
    "identity": "hash of scenario and code",
}


def write_table(
    path: Path, keys: Sequence[str], designs: Sequence[Design], figures: Sequence[str] = ()
) -> None:
    """Write the table; the same designs and rows give the same bytes.

    Args:
        path: of the file.
        keys: key paths that vary.
        designs: in the order of the study.
        figures: names of the numbers; empty: those of the run and of its last phase.

    Raises:
        InputError: no design has one of the figures.
        OutputError: the file cannot be written.
    """
    import pyarrow as pa  # here: loading it takes half as long as a run's start
    from pyarrow import parquet

    columns: dict[str, tuple[list[Any], str, str]] = {}
    for name, values in _columns(keys, designs, _chosen(designs, figures)):
        columns[name] = (values, _unit(name), _COLUMNS.get(name) or _meaning(name, keys))
    arrays = [pa.array(_of_one_type(values)) for values, _, _ in columns.values()]
    schema = pa.schema(
        [
            pa.field(name, array.type, metadata={"unit": unit, "meaning": meaning})
            for array, (name, (_, unit, meaning)) in zip(arrays, columns.items(), strict=True)
        ]
    )
    table = pa.table(arrays, schema)
    table = table.replace_schema_metadata({_DIGEST: _digest(table)})
    with writing(path), whole_file(path) as file:
        parquet.write_table(table, file, compression="zstd", write_page_checksum=True)


def open_sweep(directory: str | Path) -> Any:
    """Return the table of a sweep as a pandas.DataFrame; `frame.attrs["units"]` has the unit of each column.

    Args:
        directory: of the sweep.

    Raises:
        InputError: there is no table, it cannot be read, or pandas is not installed.
    """
    from pyarrow import lib, parquet

    path = Path(directory) / TABLE
    if not is_file(path):
        raise InputError(f"{directory}: has no {TABLE}; {_again(directory)}")
    try:
        table = parquet.read_table(path, page_checksum_verification=True)
        units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
        written = (table.schema.metadata or {}).get(_DIGEST)
        if written is not None and written.decode() != _digest(table):
            raise InputError(f"{path}: its rows are not those that were written; {_again(directory)}")
    except (OSError, lib.ArrowException, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is no table of a sweep: {error}; {_again(directory)}") from error
    try:
        frame = table.to_pandas()
    except ImportError:
        raise InputError("tables of sweeps need pandas: pip install 'cosim[sweep]'") from None
    frame.attrs["units"] = units
    return frame


def _again(directory: str | Path) -> str:
    return f"make one: cosim sweep STUDY.toml --out {directory}"


def _digest(table: Any) -> str:
    """Return a digest of the rows of a table."""
    digest = sha256()
    for name, column in zip(table.column_names, table.columns, strict=True):
        digest.update(f"{name} {column.type} {column.to_pylist()!r}\n".encode())
    return digest.hexdigest()


def _columns(
    keys: Sequence[str], designs: Sequence[Design], figures: Sequence[str]
) -> Iterable[tuple[str, list[Any]]]:
    yield "design", list(range(len(designs)))
    for key in keys:
        yield key, [design.varied.get(key) for design in designs]
    yield "status", [design.row.status for design in designs]
    yield "reason", [design.row.reason for design in designs]
    for name in figures:
        yield name, [(design.row.figures or {}).get(name) for design in designs]
    yield "identity", [design.identity or None for design in designs]


def _chosen(designs: Sequence[Design], figures: Sequence[str]) -> list[str]:
    """Return the names of the chosen figures, and of those below them.

    Raises:
        InputError: no design has one of the figures.
    """
    known = list(dict.fromkeys(name for design in designs for name in design.row.figures or {}))
    if not figures or not known:
        return [name for name in known if not name.startswith(PHASES)]
    chosen: list[str] = []
    for figure in figures:
        matching = [name for name in known if name == figure or name.startswith(f"{figure}.")]
        if not matching:
            raise InputError(f"figures: no design has '{figure}'; there are {', '.join(known)}")
        chosen += matching
    return list(dict.fromkeys(chosen))


def _unit(name: str) -> str:
    """Return the unit of the innermost part of a name that has a unit; "1" without any."""
    units = (unit_text(unit_of(part)) or "1" for part in reversed(name.split(".")))
    return next((unit for unit in units if unit != "1"), "1")


def _meaning(name: str, keys: Sequence[str]) -> str:
    return f"key {name} of the scenario" if name in keys else f"{name} of summary.json, or measured"


def _of_one_type(values: list[Any]) -> list[Any]:
    """Return values of one type: unchanged, as floats, or all as JSON."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1 and all(kind in _PLAIN for kind in kinds):
        return values
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else json.dumps(value) for value in values]
