"""Rows of sweeps: what travels to a worker and back, the figures of a run, and the table of all designs.

Custom columns: a function of a run's result, named so that every worker finds it.

The figures of a run as a flat row: numbers of its summary by name, of its last phase without a prefix.

The table of a sweep: a row per design, in Parquet with units; and its columns as a picture.

Columns of a sweep against one of them, as a picture; needs pandas and matplotlib.
"""

from __future__ import annotations

import inspect
import json
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, final

from cosim.base.resources import is_file
from cosim.base.whole_files import whole_file
from cosim.base.writing import writing
from cosim.config.plugins import module_of_file
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.keys import unit_of, unit_text
from cosim.errors import InputError
from cosim.results.result import RunResult, figure_kind

if TYPE_CHECKING:
    from cosim.telemetry.run_info import RunInfo
    from cosim.telemetry.tick_batch import TickBatch

Measure = Callable[[RunResult], Mapping[str, float]]
"""Returns more columns of a run, by names that end in their unit."""
_KINDS: Final = (int, float, bool)


@cache
def measure_named(name: str) -> Measure:
    """Return a function by its name.

    Args:
        name: "module:function" or "file.py:function".

    Raises:
        InputError: there is no such function.
    """
    place, _, function = name.rpartition(":")
    try:
        module = module_of_file(Path(place)) if place.endswith(".py") else import_module(place)
    except Exception as error:  # a user's module may raise anything
        raise InputError(
            f"measure = {name!r}: cannot be imported: {type(error).__name__}: {error}"
        ) from error
    found = getattr(module, function, None)
    if not callable(found):
        raise InputError(f"measure = {name!r}: {place} holds no function '{function}'")
    made: Measure = found
    return made


def check_travels(measure: Measure) -> None:
    """Check that a function can be sent to other processes.

    Raises:
        InputError: it is defined within another one, or is none that has a name.
    """
    try:
        pickle.dumps(measure)
    except Exception as error:  # pickle raises what it likes
        raise InputError(
            f"measure: cannot be sent to other processes: define it in a module, by its own name ({error})"
        ) from error


def measure_identity(measure: Measure) -> str:
    """Return a hash of the file that a function is in; else of its name."""
    try:
        text = Path(inspect.getsourcefile(measure) or "").read_text(encoding="utf-8")
    except (OSError, TypeError):
        text = ""
    return sha256(f"{getattr(measure, '__qualname__', measure)}\n{text}".encode()).hexdigest()[:16]


def measured(measure: Measure, result: RunResult) -> dict[str, float]:
    """Return what a function says of a run.

    Raises:
        InputError: it returns something else than numbers by name.
    """
    found = measure(result)
    if not isinstance(found, Mapping):
        raise InputError(f"the measure returned a {type(found).__name__}; return numbers by name")
    columns = {}
    for name, value in found.items():
        plain: Any = value.item() if hasattr(value, "item") and getattr(value, "size", 0) == 1 else value
        if not isinstance(plain, _KINDS):
            raise InputError(f"the measure returned for {name} a {type(value).__name__}; return a number")
        columns[str(name)] = plain
    return columns


LOST: Final = "lost"
"""Status of a design whose worker died."""


class DesignFollower(Protocol):
    """Follows the run of one design, in its worker; a dataclass whose fields, before the run, name it."""

    def open(self, stage: RunInfo) -> None:
        """The run begins."""

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""

    def stop(self) -> str | None:
        """Return why the run shall end now; None: it continues."""

    def close(self) -> None:
        """The run has ended, one way or another."""

    def figures(self) -> dict[str, Any]:
        """Return figures of a completed run, in JSON's own kinds."""


@final
@dataclass(frozen=True)
class Task:
    """A design to run, as it travels to a worker.

    Args:
        scenario: pickled, since its tables may be of kinds that `modules` make known.
        modules: to import first.
        measure: function of the result, or its name; None for none.
        directory: of the run's files; None keeps none.
        follower: of this run alone; None for none.
    """

    scenario: bytes
    modules: tuple[str, ...] = ()
    measure: Measure | str | None = None
    directory: str | None = None
    follower: DesignFollower | None = None

    @classmethod
    def of(cls, scenario: Scenario, **how: Any) -> Task:
        """Return the task of a checked scenario."""
        return cls(pickle.dumps(scenario), **how)


@final
@dataclass(frozen=True)
class Row:
    """What came out of a design.

    Args:
        status: "completed", "failed", "interrupted" (by its follower), "refused" (it cannot be built) or
            "lost" (its worker died).
        reason: why it is not completed.
        figures: numbers of the run, by name; up to where it failed.
        wall_s: wall time of the run, without what the first one of a process waits for.
        cpu_s: CPU time of the run, the same.
        worker: which process it was.
        files: digests of the files that building it read, by names; see `cosim.base.files`.
    """

    status: str
    reason: str | None = None
    figures: dict[str, Any] | None = None
    wall_s: float = 0.0
    cpu_s: float = 0.0
    worker: str = ""
    files: dict[str, str] = field(default_factory=dict)


PHASES: Final = "phases"
"""What names of the figures of every phase begin with."""
_OF_THE_CLOCK: Final = frozenset({"startup_s", "wall_s", "command_s", "real_time_factor"})
"""What differs from one time to the next."""
_PASSED_OVER: Final = frozenset(
    {"schema", "phases", "arm", "modelled", "expected_error", "warnings", "resumed_at_ticks"}
)
_XYZ: Final = ("x", "y", "z")
_VECTORS: Final[dict[str, tuple[str, ...]]] = {
    "flange_position_m": _XYZ, "tip_position_m": _XYZ, "tip_direction": _XYZ, "tip_target_m": _XYZ,
    "force_N": _XYZ, "torque_Nm": _XYZ, "flange_quaternion": ("w", *_XYZ),
}  # fmt: skip
"""Lists whose entries have names; those of others are counted from 1."""


def figures_of(summary: Mapping[str, Any]) -> dict[str, float | int | bool]:
    """Return the numbers of a summary that do not depend on the clock on the wall.

    Args:
        summary: as in summary.json.

    Returns:
        by key: of the run; of its last phase; and of every phase, as phases.NAME.KEY. Vectors have a key for
        each component, such as tip_position_m.z; what is not a number is left out.
    """
    phases = summary["phases"]
    own = {key: value for key, value in summary.items() if key not in _OF_THE_CLOCK | _PASSED_OVER}
    tables = [own, *phases[-1:], {PHASES: {phase["name"]: phase for phase in phases}}]
    found: dict[str, float | int | bool] = {}
    for table in tables:
        _gather(found, table, "")
    return found


def _gather(found: dict[str, float | int | bool], value: Any, path: str) -> None:
    if isinstance(value, int | float):
        found.setdefault(path, value)
    elif isinstance(value, list):
        names = _VECTORS.get(path.rpartition(".")[2], tuple(map(str, range(1, len(value) + 1))))
        value = dict(zip(names, value, strict=True))
    if isinstance(value, Mapping):
        for key, item in value.items():
            _gather(found, item, f"{path}.{key}" if path else key)


TABLE: Final = "sweep.parquet"
_DIGEST: Final = b"cosim_sha256"
_PLAIN: Final = (bool, int, float, str)
_OWN_COLUMNS: Final = {
    "design": "place in the study, counted from 0",
    "status": "completed, failed, interrupted, refused (cannot be built) or lost (its worker died)",
    "reason": "why it is not completed",
    "identity": "hash of scenario and code",
}


@final
@dataclass(frozen=True)
class Design:
    """A design with what came out of it.

    Args:
        varied: values by key path.
        identity: hash of its contents; empty where it cannot be loaded.
        row: what came out.
    """

    varied: Mapping[str, Any]
    identity: str
    row: Row


def write_table(
    path: Path, keys: Sequence[str], designs: Sequence[Design], figures: Sequence[str] = ()
) -> None:
    """Write the table; equal designs with equal rows give equal bytes.

    Args:
        path: of the file.
        keys: key paths that vary.
        designs: in the order of the study.
        figures: names of the numbers to show; none: those of the run and of its last phase.

    Raises:
        InputError: no design has one of the figures.
        OutputError: it cannot be written.
    """
    import pyarrow as pa  # here: it takes as long to load as half a run's start
    from pyarrow import parquet

    columns: dict[str, tuple[list[Any], str, str]] = {}
    for name, values in _columns(keys, designs, _chosen(designs, figures)):
        columns[name] = (values, _unit(name), _OWN_COLUMNS.get(name) or _meaning(name, keys))
    arrays = [pa.array(_alike(values)) for values, _, _ in columns.values()]
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
        InputError: no table, it cannot be read, or pandas is not installed.
    """
    from pyarrow import lib, parquet

    path = Path(directory) / TABLE
    if not is_file(path):
        raise InputError(f"{directory}: holds no {TABLE}; {_again(directory)}")
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
    """Return what tells the rows of a table from others."""
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
    """Return the names of the figures to show: those that begin with what was asked for.

    Raises:
        InputError: none does.
    """
    there = list(dict.fromkeys(name for design in designs for name in design.row.figures or {}))
    if not figures or not there:
        return [name for name in there if not name.startswith(PHASES)]
    chosen: list[str] = []
    for wanted in figures:
        found = [name for name in there if name == wanted or name.startswith(f"{wanted}.")]
        if not found:
            raise InputError(f"figures: no design has '{wanted}'; there are {', '.join(there)}")
        chosen += found
    return list(dict.fromkeys(chosen))


def _unit(name: str) -> str:
    """Return the unit of the innermost part of a name that has one; "1" where none has."""
    units = (unit_text(unit_of(part)) or "1" for part in reversed(name.split(".")))
    return next((unit for unit in units if unit != "1"), "1")


def _meaning(name: str, keys: Sequence[str]) -> str:
    return f"key {name} of the scenario" if name in keys else f"{name} of summary.json, or measured"


def _alike(values: list[Any]) -> list[Any]:
    """Return values of one kind: as they are, as numbers, or all as JSON."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1 and all(kind in _PLAIN for kind in kinds):
        return values
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else json.dumps(value) for value in values]


def plot_sweep(directory: str | Path, x: str, *ys: str, colour: str | None = None) -> Any:
    """Return a matplotlib figure of columns of a sweep; `figure.savefig(path)` writes it.

    Args:
        directory: of the sweep.
        x: column to the right.
        ys: columns upwards, each in its own axes.
        colour: column that colours the points; None for none.

    Raises:
        InputError: there is no such column of numbers, or pandas or matplotlib is not installed.
    """
    kind, frame = figure_kind(), open_sweep(directory)
    shown = frame[frame["status"] == "completed"]
    _check(shown, (x, *ys, *([colour] if colour else [])))
    if not ys:
        raise InputError("a plot needs a column to the right and at least one upwards")
    figure = kind(figsize=(6.0 * len(ys), 4.2), layout="constrained")
    for axes, y in zip(figure.subplots(1, len(ys), squeeze=False)[0], ys, strict=True):
        points = axes.scatter(shown[x], shown[y], c=None if colour is None else shown[colour], s=14)
        axes.set_xlabel(_labelled(frame, x))
        axes.set_ylabel(_labelled(frame, y))
        axes.grid(alpha=0.3)
    if colour is not None:
        figure.colorbar(points, ax=figure.axes, label=_labelled(frame, colour))
    figure.suptitle(f"{len(shown)} of {len(frame)} designs completed", fontsize=10)
    return figure


def _check(frame: Any, names: Sequence[str]) -> None:
    numbers = list(frame.select_dtypes("number").columns)
    for name in names:
        if name not in numbers:
            raise InputError(f"there is no column of numbers '{name}'; there are {', '.join(numbers)}")


def _labelled(frame: Any, name: str) -> str:
    unit = frame.attrs["units"][name]
    return name if unit == "1" else f"{name} [{unit}]"
