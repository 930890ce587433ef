"""The designs of a study: what each of them sets, by key path."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from itertools import product
from typing import Any, Final

import numpy as np

from cosim.base.frames import Array
from cosim.config.studies.study_table import RangeTable, SamplesTable, StudyTable
from cosim.errors import InputError

MOST_DESIGNS: Final = 1_000_000


def varied_keys(study: StudyTable) -> list[str]:
    """Return the key paths that differ between designs, in the order of the study."""
    sampled = study.samples.range if study.samples is not None else {}
    return list(dict.fromkeys([*(key for design in study.design for key in design), *study.grid, *sampled]))


def designs_of(study: StudyTable) -> list[dict[str, Any]]:
    """Return what each design sets beside `set`; samples vary fastest, entries of `design` slowest.

    Raises:
        InputError: there are too many.
    """
    listed = list(study.design) or [{}]
    count = len(listed) * math.prod(map(len, study.grid.values()))
    count *= study.samples.count if study.samples is not None else 1
    if count > MOST_DESIGNS:
        raise InputError(f"the study has {count} designs; at most {MOST_DESIGNS} are run, vary less")
    samples = _samples(study.samples)
    grid = [dict(zip(study.grid, values, strict=True)) for values in product(*study.grid.values())]
    return [{**design, **point, **sample} for design, point, sample in product(listed, grid, samples)]


def _samples(table: SamplesTable | None) -> list[dict[str, Any]]:
    if table is None:
        return [{}]
    from scipy.stats import qmc  # here: it takes long to load

    engines = {"latin_hypercube": qmc.LatinHypercube, "sobol": qmc.Sobol, "halton": qmc.Halton}
    engine = engines[table.method](len(table.range), rng=table.seed)
    with warnings.catch_warnings():  # counts that are no power of 2 are as balanced as they can be
        warnings.simplefilter("ignore", UserWarning)
        points: Array = engine.random(table.count)
    columns = [list(_scaled(points[:, k], entry)) for k, entry in enumerate(table.range.values())]
    return [dict(zip(table.range, row, strict=True)) for row in zip(*columns, strict=True)]


def _scaled(points: Array, entry: RangeTable) -> Iterator[float | int]:
    """Yield points of 0 to 1 as values of a range."""
    low, high = entry.low, entry.high + (1.0 if entry.integer else 0.0)
    values = low * (high / low) ** points if entry.scale == "log" else low + (high - low) * points
    if entry.integer:
        whole: list[int] = np.floor(values).astype(np.int64).tolist()
        yield from (min(value, int(entry.high)) for value in whole)
    else:
        yield from np.clip(values, entry.low, entry.high).tolist()
