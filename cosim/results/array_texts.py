"""What each array of a run holds: shape, unit and meaning, as the docstring of their class says them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Final, final

from cosim.base.docstrings import texts_of
from cosim.config.toml.magnitudes import unit_of, unit_text
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
