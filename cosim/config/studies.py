"""Tables of study files (`cosim sweep`): a scenario and the values that vary in it by key path, and the list
of designs that follow from them.
"""

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

import numpy as np
from annotated_types import Interval

from cosim.base.frames import Array
from cosim.base.resources import is_file, list_scenarios
from cosim.config.toml import parsing, reading
from cosim.config.toml.quantities import Count, Number, Text
from cosim.config.toml.rules import Faults
from cosim.config.toml.tables import Table
from cosim.errors import InputError, ScenarioError

MOST_DESIGNS: Final = 1_000_000


@final
@dataclass(frozen=True)
class RangeTable(Table):
    """A range of samples.

    Args:
        low: lower end.
        high: upper end, above low.
        scale: "linear": samples are spread evenly in the value; "log": in its logarithm.
        integer: whether samples are whole numbers, both ends included.
    """

    low: Number
    high: Number
    scale: Literal["linear", "log"] = "linear"
    integer: bool = False


@final
@dataclass(frozen=True)
class SamplesTable(Table):
    """Samples that fill a box evenly (scipy.stats.qmc).

    Args:
        count: number of samples.
        range: by key path: [low, high], or a table of low, high, scale ("linear" or "log") and integer.
        method: of sampling; Sobol's is balanced if the count is a power of 2.
        seed: of the samples; equal seeds give equal samples.
    """

    count: Count
    range: Mapping[str, Any]
    method: Literal["latin_hypercube", "sobol", "halton"] = "latin_hypercube"
    seed: Annotated[int, Interval(ge=0)] = 0


@final
@dataclass(frozen=True)
class StudyTable(Table):
    """A study: every entry of `design`, with every combination of `grid`, with every one of `samples`.

    Args:
        scenario: name of one that comes with cosim, or path of a .toml file, from the study's folder.
        set: values by key path, in all designs.
        grid: lists of values by key path; every combination is a design.
        design: tables of values by key path, one for each design.
        samples: of ranges of values.
        figures: columns of the table in addition to the varied keys, such as "sag_m", at the end of the run,
            or "phases.inflate.volume_m3"; omitted: all of the run and of its end.
        measure: function that returns more columns of a run: "module:function" or "file.py:function".
        keep_runs: whether the directory of every run is kept, with its arrays.
    """

    scenario: Text
    set: Mapping[str, Any] = field(default_factory=dict)
    grid: Mapping[str, Any] = field(default_factory=dict)
    design: tuple[Mapping[str, Any], ...] = ()
    samples: SamplesTable | None = None
    figures: tuple[str, ...] = ()
    measure: Text | None = None
    keep_runs: bool = False


def is_study(table: Mapping[str, Any]) -> bool:
    """Return whether a file's tables describe a study: whether a value varies in it."""
    return "scenario" in table and bool({"grid", "design", "samples"} & table.keys())


def is_search(table: Mapping[str, Any]) -> bool:
    """Return whether a file's tables describe a bench or a design study."""
    return "scenario" in table and bool({"parameter", "series", "case", "goal"} & table.keys())


def load_study(source: str | Path | Mapping[str, Any]) -> StudyTable:
    """Return a checked study; its tables have an entry for each key path, ranges are `RangeTable`.

    Args:
        source: path of a .toml file, or its table; paths in it start from the file's folder.

    Raises:
        InputError: there is no such file.
        ScenarioError: keys or values are wrong.
    """
    folder, faults = Path(), Faults()
    if isinstance(source, Mapping):
        table = dict(source)
    else:
        path = Path(source)
        if not is_file(path):
            raise InputError(f"no study {str(source)!r}; give the path of a .toml file")
        table, folder = reading.read_table(path), path.parent
    study = parsing.parse(StudyTable, table, "", faults)
    faults.raise_all()
    study = _with_key_paths(study, faults)
    _check(study, faults)
    faults.raise_all()
    return _with_paths_from(study, folder)


def _with_key_paths(study: StudyTable, faults: Faults) -> StudyTable:
    grid = flat(study.grid)
    for key, values in grid.items():
        if not isinstance(values, list) or not values:
            faults.add(f"grid.{key}", f"is {values!r}; give a list of values")
    changes: dict[str, Any] = {
        "set": flat(study.set), "grid": grid, "design": tuple(map(flat, study.design)),
    }  # fmt: skip
    if study.samples is not None:
        found = flat(study.samples.range, ends=frozenset({"low", "high"}))
        ranges = {}
        for key, value in found.items():
            with faults:
                ranges[key] = _range(key, value, faults)
        if not found:
            faults.add("samples.range", "is empty; give [low, high] for at least one key path")
        changes["samples"] = replace(study.samples, range=ranges)
    return replace(study, **changes)


def flat(table: Mapping[str, Any], *, ends: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return the values of nested tables by key path; a table that holds one of `ends` is a value."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping) and not ends & value.keys():
            found.update({f"{key}.{inner}": item for inner, item in flat(value, ends=ends).items()})
        else:
            found[key] = value
    return found


def _range(key: str, value: Any, faults: Faults) -> RangeTable:
    path = f"samples.range.{key}"
    if isinstance(value, list):
        if len(value) != 2 or not all(isinstance(end, int | float) for end in value):
            raise ScenarioError(path, f"is {value!r}; give [low, high], two numbers")
        value = {"low": float(value[0]), "high": float(value[1])}
    if not isinstance(value, Mapping):
        raise ScenarioError(path, f"is {value!r}; give [low, high], or a table with low and high")
    ends = {end: float(value[end]) for end in ("low", "high") if isinstance(value.get(end), int)}
    found = parsing.parse(RangeTable, {**value, **ends}, path, faults)
    if not found.low < found.high:
        raise ScenarioError(f"{path}.high", f"is {found.high:g}; must be above low, {found.low:g}")
    if found.scale == "log" and not found.low > 0.0:
        raise ScenarioError(f"{path}.low", f"is {found.low:g}; must be above 0 with scale = 'log'")
    if found.integer and not (found.low.is_integer() and found.high.is_integer()):
        raise ScenarioError(
            path, f"ends at {found.low:g} and {found.high:g}; integer = true needs whole numbers"
        )
    return found


def _check(study: StudyTable, faults: Faults) -> None:
    """Report keys that two parts of a study set, and a study that varies nothing."""
    sampled = study.samples.range if study.samples is not None else {}
    designs = {key for design in study.design for key in design}
    parts = {"set": study.set, "grid": study.grid, "design": designs, "samples.range": sampled}
    owner: dict[str, str] = {}
    for part, keys in parts.items():
        for key in keys:
            if key in owner:
                faults.add(f"{part}.{key}", f"is in {owner[key]} as well; remove it from one of them")
            owner.setdefault(key, part)
    if not (study.grid or study.design or sampled):
        faults.add("", "nothing is varied; give [grid], [[design]] or [samples]")


def _with_paths_from(study: StudyTable, folder: Path) -> StudyTable:
    """Return the study with paths that start from the working directory instead of the study's folder."""
    changes: dict[str, Any] = {}
    if study.scenario not in list_scenarios():
        changes["scenario"] = str(folder / study.scenario)
    if study.measure is not None and study.measure.partition(":")[0].endswith(".py"):
        changes["measure"] = str((folder / study.measure).resolve())
    changes["set"] = _with_robot_paths(study.set, folder)
    changes["design"] = tuple(_with_robot_paths(design, folder) for design in study.design)
    changes["grid"] = {
        key: [_with_robot_path(key, value, folder) for value in values] for key, values in study.grid.items()
    }
    return replace(study, **changes)


def _with_robot_paths(values: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    return {key: _with_robot_path(key, value, folder) for key, value in values.items()}


def _with_robot_path(key: str, value: Any, folder: Path) -> Any:
    """Return a value; the path of a robot's file in the study's folder gets that folder in front."""
    named = key in {"soft_robot", "robot"} and isinstance(value, str) and value.endswith(".toml")
    return str(folder / value) if named and is_file(folder / value) else value


def varied_keys(study: StudyTable) -> list[str]:
    """Return the key paths that differ between designs, in the order of the study."""
    sampled = study.samples.range if study.samples is not None else {}
    return list(dict.fromkeys([*(key for design in study.design for key in design), *study.grid, *sampled]))


def designs_of(study: StudyTable) -> list[dict[str, Any]]:
    """Return the values by key path of each design, without those of `set`.

    Samples vary fastest, entries of `design` slowest.

    Raises:
        InputError: there are more than `MOST_DESIGNS`.
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
    from scipy.stats import qmc  # imported here because it takes long to load

    engines = {"latin_hypercube": qmc.LatinHypercube, "sobol": qmc.Sobol, "halton": qmc.Halton}
    engine = engines[table.method](len(table.range), rng=table.seed)
    with warnings.catch_warnings():  # scipy warns of counts that are not a power of 2
        warnings.simplefilter("ignore", UserWarning)
        points: Array = engine.random(table.count)
    columns = [list(_scaled(points[:, k], entry)) for k, entry in enumerate(table.range.values())]
    return [dict(zip(table.range, row, strict=True)) for row in zip(*columns, strict=True)]


def _scaled(points: Array, entry: RangeTable) -> Iterator[float | int]:
    """Yield the values of a range at points (n,) from 0 to 1."""
    low, high = entry.low, entry.high + (1.0 if entry.integer else 0.0)
    values = low * (high / low) ** points if entry.scale == "log" else low + (high - low) * points
    if entry.integer:
        whole: list[int] = np.floor(values).astype(np.int64).tolist()
        yield from (min(value, int(entry.high)) for value in whole)
    else:
        yield from np.clip(values, entry.low, entry.high).tolist()
