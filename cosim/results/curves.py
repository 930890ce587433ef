"""What each array of a run holds, and the usual curves of a run as a picture; needs matplotlib."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, Final, Protocol, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.names import texts_of
from cosim.config.toml.keys import unit_of, unit_text
from cosim.errors import InputError
from cosim.telemetry.snapshot import RunInfo

_ENTRY: Final = re.compile(r"\(([^)]*)\)(?: \[([^\]]*)\])?,? ?(.*)")
_XYZ: Final = ("x", "y", "z")
_WXYZ: Final = ("w", "x", "y", "z")


@final
@dataclass(frozen=True)
class ArrayText:
    """What an array holds.

    Args:
        name: of the array.
        axes: what it runs over: "rows" or "frames", then names of what has an entry each, or a number.
        unit: such as "m"; "1" without one.
        meaning: in words.
    """

    name: str
    axes: tuple[str, ...]
    unit: str
    meaning: str

    def components(self, stage: RunInfo, shape: tuple[int, ...]) -> list[str]:
        """Return a name for every number of a row, such as "tool.x"; none for an array of single numbers.

        Args:
            stage: of the run.
            shape: of a row.
        """
        if not shape:
            return []
        pairs = zip(self.axes[1:], shape, strict=True)
        return [".".join(names) for names in product(*(_names(axis, size, stage) for axis, size in pairs))]


@cache
def array_texts(kind: type) -> dict[str, ArrayText]:
    """Return what the arrays of a dataclass hold, by name: its fields that are documented with their axes.

    Args:
        kind: its arguments read as `name: (rows, 3) [unit], meaning`.
    """
    found = ((name, _ENTRY.fullmatch(entry)) for name, entry in texts_of(kind)[1].items())
    return {name: _text(name, *entry.groups()) for name, entry in found if entry is not None}


def unit_by_name(name: str) -> str:
    """Return the unit that a name ends in, as people write it; "1" for a name without one."""
    return unit_text(unit_of(name)) or "1"


def _text(name: str, axes: str, unit: str | None, meaning: str) -> ArrayText:
    listed = tuple(axis.strip() for axis in axes.split(",") if axis.strip())
    return ArrayText(name, listed, unit or unit_by_name(name), meaning)


def _names(axis: str, size: int, stage: RunInfo) -> Iterator[str]:
    """Yield the names of the entries along an axis; their places where they have none."""
    known = {
        "joints": stage.joint_names, "bodies": stage.body_names, "chambers": stage.chamber_names,
        "cables": stage.cable_names, "3": _XYZ, "4": _WXYZ,
    }.get(axis, ())  # fmt: skip
    yield from known if len(known) == size else map(str, range(size))


USUAL: Final = (
    "tip_position", "sag_m", "bending_angle_rad", "chamber_pressure_Pa", "cable_tension_N", "flange_force",
    "contact_force_N", "joint_position",
)  # fmt: skip
_PREFIXES: Final = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa"), "rad": (180.0 / np.pi, "degrees")}
_ACROSS: Final = 2


class Drawable(Protocol):
    """Arrays of a run; others than these are found by name."""

    @property
    def stage(self) -> RunInfo:
        """What does not change."""

    @property
    def status(self) -> str:
        """How the run ended."""

    @property
    def time_s(self) -> Array:
        """(rows,)."""

    @property
    def phase(self) -> IntArray:
        """(rows,)."""


@final
@dataclass(frozen=True)
class Panel:
    """The curves of one array.

    Args:
        title: of the array.
        unit: in which they are drawn.
        values: (rows, curves).
        labels: of the curves; none for a single one.
    """

    title: str
    unit: str
    values: Array
    labels: Sequence[str]


def panels(result: Drawable, names: Sequence[str] = ()) -> Iterator[Panel]:
    """Yield what is drawn of a run: the named arrays, or the usual ones that are not 0 throughout.

    Args:
        result: of a run.
        names: of arrays with a row per tick.

    Raises:
        InputError: there is no such array.
    """
    texts = {name: text for name, text in array_texts(type(result)).items() if text.axes[0] == "rows"}
    for name in names or USUAL:
        if name not in texts:
            raise InputError(f"there is no array '{name}' over the ticks; there are {', '.join(texts)}")
        array = getattr(result, name)
        if not array.size or not (names or np.nan_to_num(array).any()):
            continue
        scale, unit = _PREFIXES.get(texts[name].unit, (1.0, texts[name].unit))
        labels = texts[name].components(result.stage, array.shape[1:])
        title = name.removesuffix(f"_{texts[name].unit}").replace("_", " ")
        yield Panel(title, unit, scale * array.reshape(len(array), -1), labels if len(labels) > 1 else [])


def drawn(result: Drawable, names: Sequence[str] = ()) -> Any:
    """Return a matplotlib figure of a run's curves over time, phases marked.

    Args:
        result: of a run.
        names: of arrays; none: the usual ones.

    Raises:
        InputError: there is no such array, nothing to draw, or no matplotlib.
    """
    figure_class = figure_kind()
    shown = list(panels(result, names))
    if not shown:
        raise InputError(f"{result.stage.scenario}: the run has no ticks to draw")
    down = -(-len(shown) // _ACROSS)
    figure = figure_class(figsize=(11.0, 2.4 * down + 0.6), layout="constrained")
    axes = figure.subplots(down, min(len(shown), _ACROSS), sharex=True, squeeze=False).ravel()
    changes = result.time_s[np.flatnonzero(np.diff(result.phase))]
    for place, panel in zip(axes, shown, strict=False):
        place.plot(result.time_s, panel.values, lw=1.0, label=panel.labels or None)
        place.set_ylabel(panel.title if panel.unit == "1" else f"{panel.title} [{panel.unit}]")
        place.grid(alpha=0.3)
        if panel.labels:
            place.legend(fontsize=7)
        for time_s in changes:
            place.axvline(time_s, color="0.7", lw=0.8)
    for place in axes[len(shown) :]:
        place.remove()
    for place in axes[max(len(shown) - _ACROSS, 0) : len(shown)]:
        place.set_xlabel("time [s]")
        place.tick_params(labelbottom=True)
    figure.suptitle(f"{result.stage.title} ({result.status})", fontsize=10)
    return figure


def figure_kind() -> Any:
    """Return matplotlib's class of figures, which need no screen.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("plots need matplotlib: pip install 'cosim[plot]'") from None
    return Figure
