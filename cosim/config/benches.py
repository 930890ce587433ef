"""Tables of bench files, with measured curves and the robot's unknown values (`cosim identify`), and of
design studies, with free values, a goal and limits (`cosim design`).
"""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

from annotated_types import Interval, Len

from cosim.base.files import read_text
from cosim.base.resources import is_file, list_scenarios
from cosim.config.studies import flat
from cosim.config.toml import parsing, reading
from cosim.config.toml.keys import listing, unknown_name_message
from cosim.config.toml.quantities import Name, Number, Positive, Text
from cosim.config.toml.rules import Fault, Faults, Violations, check, rule
from cosim.config.toml.tables import Table
from cosim.errors import InputError, ScenarioError

_UNITS: Final[dict[str, tuple[str, float]]] = {
    "Pa": ("Pa", 1.0), "hPa": ("Pa", 1e2), "mbar": ("Pa", 1e2), "kPa": ("Pa", 1e3), "bar": ("Pa", 1e5),
    "MPa": ("Pa", 1e6), "psi": ("Pa", 6894.757), "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3),
    "um": ("m", 1e-6), "rad": ("rad", 1.0), "deg": ("rad", math.pi / 180.0), "N": ("N", 1.0),
    "mN": ("N", 1e-3), "kN": ("N", 1e3), "kg": ("kg", 1.0), "g": ("kg", 1e-3), "m3": ("m^3", 1.0),
    "l": ("m^3", 1e-3), "ml": ("m^3", 1e-6), "cm3": ("m^3", 1e-6), "mm3": ("m^3", 1e-9), "Nm": ("N m", 1.0),
    "Nmm": ("N m", 1e-3),
}  # fmt: skip
"""Ending of a column's name -> its SI unit, and the factor that converts its numbers to it."""


def unit_of_column(column: str) -> tuple[str, float]:
    """Return the SI unit of a column and the factor that converts to it; "1" and 1 without a unit."""
    return _UNITS.get(column.rpartition("_")[2], ("1", 1.0))


@dataclass(frozen=True)
class FreeTable(Table):
    """A value that may change.

    Args:
        key: of the soft robot, such as "soft_robot.film.young_modulus_Pa"; in a design study also a name that
            loads have in place of a number.
        low: lower bound.
        high: upper bound, above low.
        also: further keys that have the same value, such as the factors of several cables; the opposite
            value with a minus before the key, such as corners of a pattern that is symmetric about x = 0.
        start: value at which the search begins; omitted: that of the robot's file.
    """

    key: Text
    low: Number
    high: Number
    also: tuple[Text, ...] = ()
    start: Number | None = None

    @rule
    def _has_room(self) -> Violations:
        if not self.low < self.high:
            yield Fault("high", f"is {self.high:g}; must be above low, {self.low:g}")


@final
@dataclass(frozen=True)
class UnknownTable(FreeTable):
    """An unknown value that is identified.

    Args:
        prior_sd: standard deviation of the prior, a normal distribution about start; omitted: no prior.
    """

    prior_sd: Positive | None = None


@final
@dataclass(frozen=True)
class SeriesTable(Table):
    """A measured curve; one row of its file is one equilibrium.

    Args:
        name: of the curve.
        file: CSV in the folder of the bench file; the first line names the columns, whose names end in their
            units, such as pressure_kPa.
        quantity: the measured quantity, an output of `cosim.sensitivity` such as "length_m".
        measured: column with its values.
        loads: by load, the column with its values, or a number: "pressure_Pa", "cable_tension_N.CABLE",
            "cable_length_m.CABLE", and dead loads "force_N.RING.x", .y or .z, world axes.
        noise: standard deviation of the measured values, in the unit of their column.
        relative: whether only changes were measured: their zero is unknown, and identified with the values.
        hold_out: every n-th row is left out of the fit and predicted by it; 0: none.
    """

    name: Name
    file: Text
    quantity: Text
    measured: Text
    loads: Mapping[str, Any]
    noise: Positive
    relative: bool = False
    hold_out: Annotated[int, Interval(ge=0)] = 5


@final
@dataclass(frozen=True)
class BenchTable(Table):
    """A bench: a scenario, the unknown values, and the measured curves.

    Args:
        scenario: name of one that comes with cosim, or path of a .toml file: its soft robot, the flange's
            pose, gravity and contact; its phases are not run.
        set: values by key path, on top of it.
        parameter: `[[parameter]]` in the file.
        series: `[[series]]` in the file.
    """

    scenario: Text
    parameter: Annotated[tuple[UnknownTable, ...], Len(min_length=1)]
    series: Annotated[tuple[SeriesTable, ...], Len(min_length=1)]
    set: Mapping[str, Any] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Series:
    """A measured curve in SI units.

    Args:
        table: of the bench file.
        loads: by load, its value in each row.
        values: measured, in the unit of the quantity.
        noise: standard deviation of them.
        unit: SI unit of the measured column.
        others: the file's other columns by name, multiplied by the factor of the measured column.
    """

    table: SeriesTable
    loads: Mapping[str, tuple[float, ...]]
    values: tuple[float, ...]
    noise: float
    unit: str
    others: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def load_bench(source: str | Path) -> tuple[BenchTable, tuple[Series, ...]]:
    """Return a checked bench and its curves.

    Args:
        source: path of a .toml file; paths in it start from its folder.

    Raises:
        InputError: there is no such file.
        ScenarioError: keys or values are wrong, or a file of a series is.
    """
    path = Path(source)
    if not is_file(path):
        raise InputError(f"no bench {str(source)!r}; give the path of a .toml file")
    faults = Faults()
    bench = parsing.parse(BenchTable, reading.read_table(path), "", faults)
    check(bench, "", None, (), faults)
    faults.raise_all()
    found = []
    for entry in bench.series:
        with faults:
            found.append(_series(replace(entry, loads=flat(entry.loads)), path.parent))
    faults.raise_all()
    changes: dict[str, Any] = {"set": flat(bench.set)}
    if bench.scenario not in list_scenarios():
        changes["scenario"] = str(path.parent / bench.scenario)
    return replace(bench, **changes), tuple(found)


def _series(table: SeriesTable, folder: Path) -> Series:
    key = f"series.{table.name}"
    columns = _columns(folder / table.file, f"{key}.file")
    count = len(next(iter(columns.values())))
    loads = {}
    for load, given in table.loads.items():
        if isinstance(given, int | float) and not isinstance(given, bool):
            loads[load] = (float(given),) * count
        else:
            loads[load] = _column(columns, given, load, f"{key}.loads.{load}")[0]
    values, scale, unit = _column(columns, table.measured, table.quantity, f"{key}.measured")
    if count < 2:
        raise ScenarioError(f"{key}.file", f"{table.file} has {count} rows; a curve needs two at least")
    others = {
        name: tuple(scale * value for value in column)
        for name, column in columns.items()
        if name != table.measured
    }
    return Series(table, loads, values, scale * table.noise, unit, others)


def _column(
    columns: Mapping[str, tuple[float, ...]], name: Any, of: str, key: str
) -> tuple[tuple[float, ...], float, str]:
    """Return a column in SI units, the factor to these, and the unit.

    Args:
        columns: of the file.
        name: of the column.
        of: load or quantity that the column has the values of.
        key: of the bench file that names the column.

    Raises:
        ScenarioError: there is no such column, or its unit is not that of the load or quantity.
    """
    if name not in columns:
        raise ScenarioError(key, f"no column {name!r}; there are {listing(tuple(columns))}")
    unit, scale = unit_of_column(name)
    wanted, _ = unit_of_column(of.partition(".")[0])
    if unit != wanted:
        raise ScenarioError(key, f"column {name!r} is in {unit}, but {of} is in {wanted}")
    return tuple(scale * value for value in columns[name]), scale, unit


def _columns(file: Path, key: str) -> dict[str, tuple[float, ...]]:
    """Return the columns of a CSV file by name; lines that begin with # are skipped.

    Raises:
        ScenarioError: it cannot be read, a name is there twice, or a row lacks numbers.
    """
    try:
        lines = [line for line in read_text(file).splitlines() if line.strip() and line[0] != "#"]
    except OSError as error:
        raise ScenarioError(key, f"{file.name!r} cannot be read: {error.strerror}") from error
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(lines)]
        table = [[float(cell) for cell in row] for row in rows[1:]]
    except (ValueError, csv.Error) as error:
        raise ScenarioError(key, f"{file.name}: {error}") from error
    if not rows:
        raise ScenarioError(key, f"{file.name} is empty; its first line names the columns")
    twice = [name for name in rows[0] if rows[0].count(name) > 1]
    if twice:
        raise ScenarioError(key, f"{file.name} has the column {twice[0]!r} twice; rename one")
    wrong = [
        k for k, row in enumerate(table, 2) if len(row) != len(rows[0]) or not all(map(math.isfinite, row))
    ]
    if wrong:
        raise ScenarioError(key, f"{file.name}, row {wrong[0]}: must be {len(rows[0])} finite numbers")
    return {name: tuple(row[k] for row in table) for k, name in enumerate(rows[0])}


@final
@dataclass(frozen=True)
class CaseTable(Table):
    """An equilibrium that the study solves.

    Args:
        name: of the equilibrium.
        loads: values by load, or names of parameters: "pressure_Pa", "cable_tension_N.CABLE",
            "cable_length_m.CABLE", and dead loads "force_N.RING.x", .y or .z, world axes (numbers alone).
    """

    name: Name
    loads: Mapping[str, Any]


@final
@dataclass(frozen=True)
class GoalTable(Table):
    """The quantity that the study minimises or maximises.

    Args:
        quantity: an output of `cosim.sensitivity`, such as "tip_position_m.z", "mass_kg", "frame_strain".
        case: name of its equilibrium; omitted: the first.
        minus: name of an equilibrium whose value is subtracted; omitted: none.
        sense: "least" minimises, "most" maximises.
    """

    quantity: Text
    case: Text | None = None
    minus: Text | None = None
    sense: Literal["least", "most"] = "least"


@final
@dataclass(frozen=True)
class LimitTable(Table):
    """A limit on a quantity; exactly one of at_least, at_most and equal is given.

    Args:
        quantity: see `GoalTable`.
        case: see `GoalTable`.
        minus: see `GoalTable`.
        at_least: lower bound.
        at_most: upper bound.
        equal: required value.
    """

    quantity: Text
    case: Text | None = None
    minus: Text | None = None
    at_least: Number | None = None
    at_most: Number | None = None
    equal: Number | None = None

    @rule
    def _has_a_bound(self) -> Violations:
        if sum(bound is not None for bound in (self.at_least, self.at_most, self.equal)) != 1:
            yield Fault("quantity", f"{self.quantity} needs one of at_least, at_most and equal")

    @property
    def bound(self) -> float:
        """The lower bound, the upper bound, or the required value, whichever is given."""
        given = [value for value in (self.at_least, self.at_most, self.equal) if value is not None]
        return given[0]


@final
@dataclass(frozen=True)
class ChoiceTable(Table):
    """One of several kinds of the robot; each is optimised, and the best one is the result.

    Args:
        name: of the choice.
        set: values by key path, such as the number of units with the cables that run through them.
    """

    name: Name
    set: Mapping[str, Any]


@final
@dataclass(frozen=True)
class DesignStudyTable(Table):
    """A design study.

    Args:
        scenario: name of one that comes with cosim, or path of a .toml file: its soft robot, the flange's
            pose, gravity and contact; its phases are not run.
        parameter: `[[parameter]]` in the file.
        case: `[[case]]` in the file.
        goal: the quantity to minimise or maximise.
        limit: `[[limit]]` in the file.
        choice: `[[choice]]` in the file.
        set: values by key path, on top of the scenario.
        evaluations: largest number of solved designs, for each start of each choice.
        starts: number of searches for each choice: from the file's values first, then from random ones.
        seed: of the random values.
    """

    scenario: Text
    parameter: Annotated[tuple[FreeTable, ...], Len(min_length=1)]
    case: Annotated[tuple[CaseTable, ...], Len(min_length=1)]
    goal: GoalTable
    limit: tuple[LimitTable, ...] = ()
    choice: tuple[ChoiceTable, ...] = ()
    set: Mapping[str, Any] = field(default_factory=dict)
    evaluations: Annotated[int, Interval(ge=2, le=10_000)] = 30
    starts: Annotated[int, Interval(ge=1, le=1000)] = 1
    seed: Annotated[int, Interval(ge=0, lt=2**31)] = 0


def load_design_study(source: str | Path) -> DesignStudyTable:
    """Return a checked design study.

    Args:
        source: path of a .toml file; paths in it start from its folder.

    Raises:
        InputError: there is no such file.
        ScenarioError: keys or values are wrong.
    """
    path = Path(source)
    if not is_file(path):
        raise InputError(f"no design study {str(source)!r}; give the path of a .toml file")
    faults = Faults()
    study = parsing.parse(DesignStudyTable, reading.read_table(path), "", faults)
    check(study, "", None, (), faults)
    faults.raise_all()
    cases = tuple(replace(case, loads=flat(case.loads)) for case in study.case)
    names = tuple(case.name for case in cases)
    for case in cases:
        for load, value in case.loads.items():
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise ScenarioError(
                    f"case.{case.name}.loads.{load}", f"is {value!r:.40}; give a number or a parameter"
                )
    wanted: tuple[GoalTable | LimitTable, ...] = (study.goal, *study.limit)
    for entry in wanted:
        for key in ("case", "minus"):
            name = getattr(entry, key)
            if name is not None and name not in names:
                raise ScenarioError(f"{entry.quantity}: {key}", unknown_name_message("case", name, names))
    changes: dict[str, Any] = {
        "set": flat(study.set),
        "case": cases,
        "choice": tuple(replace(choice, set=flat(choice.set)) for choice in study.choice),
    }
    if study.scenario not in list_scenarios():
        changes["scenario"] = str(path.parent / study.scenario)
    return replace(study, **changes)
