"""What snapshots show of the film's shape, read when somebody asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.shown import Shown, read_only
from cosim.coupling.soft_sides.shape_figures import ShapeFigures

if TYPE_CHECKING:  # who only looks at snapshots needs no kernels
    from cosim.coupling.soft_sides.shape_reader import ShapeReader


@final
@dataclass(frozen=True, eq=False)
class FilmShape(Shown):
    """The film at the end of one tick.

    Args:
        node_position: (nodes, 3) [m], world.
        chamber_volume_m3: (chambers,).
        tip_position: (3,) [m], mean of the last hole ring.
        tip_direction: (3,), unit normal of the last hole ring, away from the base.
        center_line_m: length of the polyline through the centres of the hole rings.
    """

    node_position: Annotated[Array, ("film", 3)]
    chamber_volume_m3: Annotated[Array, ("chambers",)]
    tip_position: Annotated[Array, (3,)]
    tip_direction: Annotated[Array, (3,)]
    center_line_m: float
    _reader: ClassVar[None] = None

    @property
    def _shape(self) -> FilmShape:
        """Itself: there is nothing to read."""
        return self

    def read(self) -> FilmShape:
        """Return itself."""
        return self


@final
class UnreadFilmShape:
    """The same, each value read off the soft side's shape when it is asked for, and kept.

    Args:
        reader: of the shape.
        shape: as its reader needs it; nothing that happens later changes it.
    """

    def __init__(self, reader: ShapeReader, shape: Any) -> None:
        self._reader, self._shape = reader, shape

    @cached_property
    def node_position(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(read_only(self._reader.positions(self._shape)))

    @property
    def chamber_volume_m3(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(self._figures.volumes_m3[0])

    @property
    def tip_position(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(self._figures.tip_position[0])

    @property
    def tip_direction(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(self._figures.tip_direction[0])

    @property
    def center_line_m(self) -> float:
        """See `FilmShape`."""
        return float(self._figures.center_line_m[0])

    @cached_property
    def _figures(self) -> ShapeFigures:
        return self._reader.figures([self._shape])

    def read(self) -> FilmShape:
        """Return all values, without what reads them."""
        return FilmShape(
            self.node_position, self.chamber_volume_m3, self.tip_position, self.tip_direction,
            self.center_line_m,
        )  # fmt: skip

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what is pickled: the values."""
        return FilmShape, tuple(vars(self.read()).values())


Film: TypeAlias = FilmShape | UnreadFilmShape
"""The film at the end of one tick."""


@final
class FilmShapes:
    """The film at the ends of k ticks; read all together, which costs a fraction of one by one.

    Args:
        reader: of the shapes; None where these are read already.
        shapes: k, as the reader needs them, or `FilmShape`.
        figures: of the shapes; None where they are still to be read.
    """

    def __init__(
        self, reader: ShapeReader | None, shapes: Sequence[Any], figures: ShapeFigures | None = None
    ) -> None:
        self._reader, self._shapes, self._figures = reader, shapes, figures

    @classmethod
    def of(cls, films: Sequence[Film]) -> FilmShapes:
        """Return some shapes as one, at least one."""
        readers = {film._reader for film in films}
        if len(readers) > 1:  # of several runs
            return cls(None, [film.read() for film in films])
        return cls(readers.pop(), [film._shape for film in films])

    @classmethod
    def joined(cls, parts: Sequence[FilmShapes]) -> FilmShapes:
        """Return the shapes of some parts of one run, at least one part, in order."""
        shapes, reader = list(chain.from_iterable(part._shapes for part in parts)), parts[0]._reader
        if reader is not None and all(part._figures is None for part in parts):
            return cls(reader, shapes)
        columns = [vars(part.figures).values() for part in parts]
        figures = ShapeFigures(*map(np.concatenate, zip(*columns, strict=True)))
        return cls(reader, shapes, figures)

    def __getitem__(self, row: int) -> Film:
        shape = self._shapes[row]
        return shape if self._reader is None else UnreadFilmShape(self._reader, shape)

    @property
    def figures(self) -> ShapeFigures:
        """Figures of all shapes."""
        if self._figures is None:
            self._figures = self._read()
        return self._figures

    def some(self, rows: IntArray) -> FilmShapes:
        """Return some of the shapes, by their places."""
        return FilmShapes(self._reader, [self._shapes[k] for k in rows.tolist()], self.figures.some(rows))

    def node_position(self, rows: slice = slice(None)) -> Array:
        """Return the film's nodes (k, nodes, 3) [m] at some of the ticks."""
        shapes = self._shapes[rows]
        if self._reader is None:
            return np.stack([shape.node_position for shape in shapes])
        return self._reader.films(shapes)

    def _read(self) -> ShapeFigures:
        if self._reader is not None:
            return self._reader.figures(self._shapes)
        columns = ("tip_position", "tip_direction", "center_line_m", "chamber_volume_m3")
        return ShapeFigures(*(np.stack([getattr(shape, name) for shape in self._shapes]) for name in columns))
