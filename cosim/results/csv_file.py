"""The arrays of a run as one table of numbers: a row per tick, a column per component."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.whole_files import whole_file
from cosim.errors import OutputError
from cosim.results.array_texts import array_texts
from cosim.results.result import COLUMNS, RunResult


def write_csv(result: RunResult, path: Path) -> None:
    """Write all that has a row per tick; heads are such as `tip_position.x [m]`, numbers are whole.

    Args:
        result: of a run.
        path: of the file.

    Raises:
        OutputError: it cannot be written.
    """
    import pyarrow as pa  # here: it takes as long to load as half a run's start
    from pyarrow import csv

    columns: dict[str, Any] = {}
    for name in COLUMNS:
        text, array = array_texts(RunResult)[name], getattr(result, name)
        unit = "" if text.unit == "1" else f" [{text.unit}]"
        heads = [f"{name}.{part}{unit}" for part in text.components(result.stage, array.shape[1:])]
        if array.ndim == 1:
            heads = [f"{name}{unit}"]
        values = np.ascontiguousarray(array.reshape(len(array), len(heads)).T)
        columns.update(zip(heads, map(pa.array, values), strict=True))
    try:
        with whole_file(path) as file:
            csv.write_csv(pa.table(columns), file, csv.WriteOptions(quoting_style="none"))
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
