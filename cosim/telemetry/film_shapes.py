"""Shapes of the film at the ends of some ticks, read on first access, all ticks together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any, final

import numpy as np

from cosim.base.frames import Array, IntArray, read_only
from cosim.coupling.shape_figures import ShapeFigures

if TYPE_CHECKING:
    from cosim.coupling.robots.shape_reader import ShapeReader


@final
@dataclass(frozen=True, eq=False)
class FilmShapes:
    """Shapes of the film at the ends of k ticks; reading all together is much faster than one by one.

    Args:
        _reader: of the shapes; None if they have been read.
        _shapes: k shapes for the reader, which later ticks do not change; or (k, nodes, 3) [m].
        _known: figures of the shapes; None if they have not been read.
    """

    _reader: ShapeReader | None
    _shapes: Any
    _known: ShapeFigures | None = None

    def __post_init__(self) -> None:
        if self._reader is None:
            vars(self)["_shapes"] = read_only(self._shapes)

    @classmethod
    def joined(cls, parts: Sequence[FilmShapes]) -> FilmShapes:
        """Return some films as one, at least one, in order."""
        if any(part._reader is not parts[0]._reader for part in parts):
            parts = [part.read() for part in parts]
        reader, known = parts[0]._reader, None
        shapes = [part._shapes for part in parts]
        if any(part._known is not None for part in parts):
            columns = [vars(part.figures).values() for part in parts]
            known = ShapeFigures(*map(np.concatenate, zip(*columns, strict=True)))
        return cls(reader, np.concatenate(shapes) if reader is None else [*chain(*shapes)], known)

    @cached_property
    def figures(self) -> ShapeFigures:
        """Figures of all shapes."""
        if self._known is not None:
            return self._known
        assert self._reader is not None, "shapes that have been read have figures"
        return self._reader.figures(self._shapes)

    @property
    def tip_position(self) -> Array:
        """Tips (k, 3) [m] of all shapes; of shapes that have not been read, only the tips are read."""
        if self._reader is None or "figures" in vars(self):
            return self.figures.tip_position
        return self._reader.tips(self._shapes)

    def some(self, rows: IntArray) -> FilmShapes:
        """Return some of the shapes, by their rows."""
        known = self._known if self._reader is None else vars(self).get("figures", self._known)
        shapes = self._shapes[rows] if self._reader is None else [self._shapes[k] for k in rows.tolist()]
        return FilmShapes(self._reader, shapes, known and known.select(rows))

    def node_position(self, rows: slice = slice(None)) -> Array:
        """Return the film's nodes (k, nodes, 3) [m] at some of the ticks."""
        shapes = self._shapes[rows]
        return np.array(shapes) if self._reader is None else self._reader.films(shapes)

    def moments(self) -> Array:
        """Return the moments (k, m, 3) [kg^1/2 m] of all shapes; m = 0 if they are unknown."""
        if self._reader is None:
            return np.zeros((len(self._shapes), 0, 3))
        return self._reader.moments(self._shapes)

    def read(self) -> FilmShapes:
        """Return the same without the reader."""
        return FilmShapes(None, self.node_position(), self.figures)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the shapes, read, to be pickled."""
        return FilmShapes, (None, self.node_position(), self.figures)
