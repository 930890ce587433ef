"""Reads shapes of a section arm off its frames, without making the film's nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.soft_sides.shape_reader import Rows, ShapeFigures, ShapeReader, ShapeRows
from cosim.reduced.section_model import SectionBody
from cosim.soft.body.center_line import hole_rings


@final
@dataclass(frozen=True)
class ChainShape:
    """Shape of a section arm: frames (f, 4, 3) and the gauge pressure [Pa] that its nodes depend on."""

    frames: Array
    pressure_Pa: float


@final
class ChainReader(ShapeReader):
    """Reads chains; figures need the nodes of the tip and the centres of the hole rings, and no others.

    Args:
        section: whose chains.
    """

    def __init__(self, section: SectionBody) -> None:
        nodes, before, tip = section.model.nodes, section.frames.before, section.body.tip
        rings = hole_rings(section.body)
        self._section, self._tip = section, len(tip)
        # all nodes of a ring are beside the same two frames
        weights = np.concatenate([nodes[:, tip], nodes[:, rings].mean(axis=2)], axis=1)
        self._weights = np.ascontiguousarray(weights.reshape(len(weights), -1))
        self._before = before[[*tip, *rings[:, 0]]]

    def positions(self, shape: ChainShape) -> Array:
        """Return the film's nodes (n, 3) [m] on the frames."""
        return self._section.positions(shape.frames, shape.pressure_Pa)

    def films(self, shapes: Sequence[ChainShape]) -> Array:
        """Return the film's nodes (k, n, 3) [m] of some shapes."""
        return self._section.films(*_stacked(shapes))

    def figures(self, shapes: Sequence[ChainShape]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        return self.figures_of(*_stacked(shapes))

    def figures_of(self, frames: Array, pressure_Pa: Array) -> ShapeFigures:
        """Return the figures of chains with frames (k, f, 4, 3) at pressures (k,) [Pa]."""
        found = self._section.points(frames, pressure_Pa, self._weights, self._before)
        volumes = self._section.volumes(frames, pressure_Pa)
        return ShapeFigures.of(found, self._tip, volumes[:, None])

    def films_of(self, frames: Array, pressure_Pa: Array) -> Array:
        """Return the film's nodes (k, n, 3) [m] on chains with frames (k, f, 4, 3) at pressures (k,) [Pa]."""
        return self._section.films(frames, pressure_Pa)


def _stacked(shapes: Sequence[ChainShape]) -> tuple[Array, Array]:
    """Return frames (k, f, 4, 3) and pressures (k,) of some shapes."""
    frames = np.concatenate([shape.frames for shape in shapes]).reshape(len(shapes), -1, 4, 3)
    return frames, np.array([shape.pressure_Pa for shape in shapes])


@final
class ChainRows(ShapeRows):
    """Shapes of a section arm.

    Args:
        reader: of the arm.
        frames: (k, f, 4, 3).
        pressure_Pa: (k,), gauge.
    """

    def __init__(self, reader: ChainReader, frames: Array, pressure_Pa: Array) -> None:
        self._reader, self._pressure_Pa = reader, np.ascontiguousarray(pressure_Pa)
        self._frames = np.ascontiguousarray(frames)

    @property
    def reader(self) -> ChainReader:
        return self._reader

    def shape(self, row: int) -> ChainShape:
        return ChainShape(self._frames[row].copy(), float(self._pressure_Pa[row]))

    def films(self, rows: Rows) -> Array:
        return self._reader.films_of(self._frames[rows], self._pressure_Pa[rows])

    def figures(self, rows: Rows) -> ShapeFigures:
        return self._figures.of_rows(rows)

    @cached_property
    def _figures(self) -> ShapeFigures:
        return self._reader.figures_of(self._frames, self._pressure_Pa)  # of all, as most will be asked for
