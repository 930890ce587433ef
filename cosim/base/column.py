"""Columns of a run: name, shape of a row, unit, meaning, figures of the summary, and view."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final, Literal, TypeVar, final, overload

import numpy as np
from numpy.typing import NDArray

from cosim.base.names import TERMS
from cosim.errors import InputError

_Kind = TypeVar("_Kind")
How = Literal["sum", "count", "largest", "since", "end"]
_INITIAL: Final[dict[str, float]] = {"sum": 0, "count": 0, "largest": 0.0, "since": np.nan}
_FIXED: Final[dict[str, Sequence[str]]] = {
    "3": ("x", "y", "z"),
    "4": ("w", "x", "y", "z"),
    "energies": [term.removesuffix("_J") for term in TERMS],
}
"""Names of the entries along axes that are the same in every run."""
_ZERO: Final = np.float64(0.0)


@final
@dataclass(frozen=True)
class RunFigure:
    """A figure of the summary that a column is reduced to.

    Args:
        name: key in summary.json.
        how: "sum"; "count" of the ticks that are not 0; "largest" magnitude; "since", the first time above 0;
            of every phase: "end", the value at its last tick.
        meaning: in words.
    """

    name: str
    how: How
    meaning: str

    @property
    def initial(self) -> float:
        """Its value before the first tick."""
        return _INITIAL[self.how]

    def after(self, before: float, values: NDArray[Any], time_s: NDArray[Any]) -> float:
        """Return the figure after further ticks; values that are not numbers do not count as largest.

        Args:
            before: its value before them.
            values: (n,), of the column.
            time_s: (n,).
        """
        if self.how == "largest":
            return np.fmax.reduce(np.abs(values), initial=before).item()
        if self.how == "since":
            found = values.any() and np.isnan(before)
            return time_s.item(int(np.argmax(values > 0))) if found else before
        return before + int(np.count_nonzero(values) if self.how == "count" else values.sum())


@final
@dataclass(frozen=True)
class View:
    """How recordings plot a column.

    Args:
        tab: of the recording.
        place: in the tab; plots are sorted by it.
        entity: path under `/plots`; one below another plot's path joins that plot.
        title: with the unit; empty if the curves join another plot.
        scale: from the column's unit to the title's.
        label: of a single curve; of several, what their numbers follow, if they have no names.
        colours: names of `cosim.recording.colours`, one a curve; none: those of a series.
        legend: whether the plot names its curves.
        peaks: whether crowded curves show their largest value rather than their range.
        log: whether the decimal logarithm is shown.
        numbered: whether several curves are numbered, though they have names.
    """

    tab: str
    place: int
    entity: str
    title: str
    scale: float = 1.0
    label: str = ""
    colours: tuple[str, ...] = ()
    legend: bool = True
    peaks: bool = False
    log: bool = False
    numbered: bool = False


class Columns:
    """A table of columns, class attributes each; instances hold their arrays, by name."""

    arrays: Mapping[str, NDArray[Any]]

    def value_of(self, column: "Column") -> Any:
        """Return the array of a column, or that computed from the others.

        Raises:
            AttributeError: it is stored, and not here.
        """
        found = self.arrays.get(column.name)
        if found is not None:
            return found
        if column.read is None:
            raise AttributeError(f"this {type(self).__name__} has no column '{column.name}'")
        return column.read(self)


@dataclass(frozen=True, eq=False, repr=False)
class TableRow(Columns):
    """A row of a table: its columns are attributes, single numbers, or arrays that nobody can write to.

    Args:
        table: of this row alone.
    """

    table: Columns

    def value_of(self, column: "Column") -> Any:
        """Return the value of a column in this row."""
        value = self.table.value_of(column)[0]
        if isinstance(value, np.ndarray):
            shown = value.view()
            shown.setflags(write=False)
        else:
            shown = value.item()
        # an instance's own attributes are found before those of its class, which know how to be computed
        vars(self)[column.name] = shown
        return shown

    def __repr__(self) -> str:
        """Return the stored columns, each with its value."""
        values = ", ".join(f"{name}={getattr(self, name)!r}" for name in self.table.arrays)
        return f"{type(self).__name__}({values})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what is pickled: the table, without what has been read of it."""
        return type(self), (self.table,)


@final
class Column:
    """A column: an attribute of a table, and of its instances the array that they hold, or compute.

    Args:
        axes: what the array runs over, such as "rows, bodies, 3": "rows", "frames" or "pictures", then names
            of what has an entry each, or numbers.
        unit: such as "m"; "1" without one.
        meaning: in words.
        reduce: figures of the summary.
        fill: value in rows that nothing fills; its type is that of the column's numbers.
        read: computes the column from other columns of some ticks; None for a stored column.
        view: how recordings plot it; None: they do not.
    """

    def __init__(
        self,
        axes: str,
        unit: str,
        meaning: str,
        *reduce: RunFigure,
        fill: np.generic = _ZERO,
        read: Callable[[Any], NDArray[Any]] | None = None,
        view: View | None = None,
    ) -> None:
        self.name = ""
        self.axes, self.unit, self.meaning = tuple(axes.split(", ")), unit, meaning
        self.fill, self.read, self.reduce, self.view = fill, read, reduce, view

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, held: None, owner: type) -> "Column": ...
    @overload
    def __get__(self, held: TableRow, owner: type) -> Any: ...
    @overload
    def __get__(self, held: Columns, owner: type) -> NDArray[Any]: ...
    def __get__(self, held: Columns | None, owner: type) -> Any:
        return self if held is None else held.value_of(self)

    def shape(self, sizes: Mapping[str, int]) -> tuple[int, ...] | None:
        """Return the shape of a row, with the sizes of axes by name; None where one is unknown."""
        along = [int(axis) if axis.isdigit() else sizes.get(axis) for axis in self.axes[1:]]
        known = [size for size in along if size is not None]
        return tuple(known) if len(known) == len(along) else None

    def components(self, names: Mapping[str, Sequence[str]], shape: tuple[int, ...]) -> list[str]:
        """Return a name for every number of a row, such as "tool.x"; none for a column of single numbers.

        Args:
            names: of the entries along axes, see `RunInfo.names_along`.
            shape: of a row.
        """
        if not shape:
            return []
        known = {**_FIXED, **names}
        along = [known.get(axis, ()) for axis in self.axes[1:]]
        pairs = zip(along, shape, strict=True)
        each = [found if len(found) == size else [*map(str, range(size))] for found, size in pairs]
        return [".".join(parts) for parts in product(*each)]

    def __repr__(self) -> str:
        """Return how docstrings and reference pages describe it."""
        shape = f"({', '.join(self.axes)}{',' * (len(self.axes) == 1)})"
        ends_in_it = self.unit == "1" or self.name.endswith(f"_{self.unit.replace('^', '')}")
        return f"{shape}{'' if ends_in_it else f' [{self.unit}]'}, {self.meaning}"


def columns_of(kind: type) -> dict[str, Column]:
    """Return the columns of a class by name, those of its bases first, in the order of their declaration."""
    found = {}
    for each in reversed(kind.__mro__):
        found.update({name: value for name, value in vars(each).items() if isinstance(value, Column)})
    return found


def room_for(kind: type, sizes: Mapping[str, int]) -> Callable[[int], dict[str, NDArray[Any]]]:
    """Return a function that makes arrays for some rows of a table's stored columns, by name.

    Args:
        kind: class of the table.
        sizes: entries along axes; columns along other ones are left out.
    """
    known = []
    for name, column in columns_of(kind).items():
        shape = None if column.read else column.shape(sizes)
        if shape is not None:
            known.append((name, shape, column.fill))
    filled = [(name, fill) for name, _, fill in known if fill]

    def room(rows: int) -> dict[str, NDArray[Any]]:
        arrays = {name: np.zeros((rows, *shape), fill.dtype) for name, shape, fill in known}
        for name, fill in filled:
            arrays[name].fill(fill)
        return arrays

    return room


def check_arrays(
    arrays: Mapping[str, NDArray[Any]], kind: type, rows: int, sizes: Mapping[str, int], place: str
) -> None:
    """Check the arrays of a table, as a file may hold them.

    Raises:
        InputError: one is missing, unknown, or of another kind or shape.
    """
    stored = {name: column for name, column in columns_of(kind).items() if column.read is None}
    if arrays.keys() != stored.keys():
        raise InputError(f"{place} has {', '.join(arrays)}, not {', '.join(stored)}")
    for name, column in stored.items():
        array, row = arrays[name], column.shape(sizes)
        if column.fill.dtype.kind != array.dtype.kind:
            raise InputError(f"{place}.{name} holds {array.dtype}, not {type(column.fill).__name__}")
        wanted = (rows, *(array.shape[1:] if row is None else row))
        if array.shape != wanted:
            raise InputError(f"{place}.{name} has shape {array.shape}, not {wanted}")


def listing_columns(kind: type[_Kind]) -> type[_Kind]:
    """Return a class with its columns listed in its docstring, each with shape, unit and meaning."""
    entries = [f"        {name}: {column!r}" for name, column in columns_of(kind).items()]
    kind.__doc__ = "\n".join([f"{kind.__doc__ or ''}\n    Attributes:", *entries, "    "])
    return kind


def figures_of(kind: type) -> Iterator[tuple[Column, RunFigure]]:
    """Yield the figures over all ticks of a class's columns, each with its column."""
    return ((column, figure) for column, figure in _reduced(kind) if figure.how != "end")


def ends_of(kind: type) -> Iterator[tuple[Column, RunFigure]]:
    """Yield the figures of a phase's end of a class's columns, each with its column."""
    return ((column, figure) for column, figure in _reduced(kind) if figure.how == "end")


def _reduced(kind: type) -> Iterator[tuple[Column, RunFigure]]:
    return ((column, figure) for column in columns_of(kind).values() for figure in column.reduce)
