"""A run as one CSV table, a row per tick."""

from pathlib import Path
from typing import Any

import numpy as np

from cosim.base import whole_files, writing
from cosim.results.result import RunResult
from cosim.results.run_columns import COLUMNS


def write_csv(result: RunResult, path: Path) -> None:
    """Write all arrays with a row per tick, in full precision; heads are such as `tip_position.x [m]`.

    Args:
        result: of a run.
        path: of the file.

    Raises:
        OutputError: it cannot be written.
    """
    import pyarrow as pa  # here: it takes as long to load as half a run's start
    from pyarrow import csv

    columns: dict[str, Any] = {}
    for name, column in COLUMNS.items():
        array, names = getattr(result, name), result.stage.names_along
        unit = "" if column.unit == "1" else f" [{column.unit}]"
        heads = [f"{name}.{part}{unit}" for part in column.components(names, array.shape[1:])]
        if array.ndim == 1:
            heads = [f"{name}{unit}"]
        values = np.ascontiguousarray(array.reshape(len(array), len(heads)).T)
        columns.update(zip(heads, map(pa.array, values), strict=True))
    with writing.writing(path), whole_files.whole_file(path) as file:
        csv.write_csv(pa.table(columns), file, csv.WriteOptions(quoting_style="none"))
