"""The designs of a study: what each of them sets, by key path."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from itertools import product
from typing import Any, Final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kept_parts import KeptParts
from cosim.config.loading import load_scenario
from cosim.config.studies.study_table import RangeTable, SamplesTable, StudyTable
from cosim.errors import MOST_LINES, InputError, ScenarioError

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


def check_designs(study: StudyTable) -> None:
    """Check that each design of a study can be loaded and built; nothing is run.

    Args:
        study: checked by `load_study`.

    Raises:
        ScenarioError: what is wrong, by design and key; what several designs share stands there once.
    """
    from cosim.build.file_checks import check_built  # here: it loads the engines

    designs, kept, found = designs_of(study), KeptParts(), dict[str, list[int]]()
    for number, varied in enumerate(designs, 1):
        try:
            check_built(load_scenario(study.scenario, {**study.set, **varied}), kept)
        except InputError as error:
            for place, problem in getattr(error, "faults", (("", str(error)),)):
                found.setdefault(f"{place}: {problem}" if place else problem, []).append(number)
    if not found:
        return
    faults = [(_named(numbers, designs), problem) for problem, numbers in found.items()]
    if len(faults) > MOST_LINES:
        faults[MOST_LINES:] = [("", f"... and {len(faults) - MOST_LINES} more")]
    raise ScenarioError(*faults[0], further=tuple(faults[1:]))


def _named(numbers: list[int], designs: list[dict[str, Any]]) -> str:
    """Return the designs of some numbers, for a message: the first one with what it sets."""
    if len(numbers) == len(designs):
        return f"all {len(designs)} designs"
    values = ", ".join(f"{key} = {value!r}" for key, value in designs[numbers[0] - 1].items())
    others = f", and {len(numbers) - 1} more" if len(numbers) > 1 else ""
    return f"design {numbers[0]} of {len(designs)} ({values}){others}"


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
