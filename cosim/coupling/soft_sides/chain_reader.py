"""Reads shapes of a section arm off its frames, without making the film's nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final, overload

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.soft_sides.shape_figures import ShapeFigures
from cosim.coupling.soft_sides.shape_reader import ShapeReader, figures_at
from cosim.reduced.section_model import SectionBody
from cosim.soft.body.center_line import center_rings


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
        rings = center_rings(section.body)
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
        frames, pressure_Pa = _stacked(shapes)
        found = self._section.points(frames, pressure_Pa, self._weights, self._before)
        volumes = self._section.volumes(frames, pressure_Pa)
        return figures_at(found, self._tip, volumes[:, None])


@final
class ChainShapes(Sequence[ChainShape]):
    """Shapes of some ticks in a row, in arrays that nothing changes any more.

    Args:
        frames: (k, f, 4, 3).
        pressure_Pa: (k,), gauge.
    """

    def __init__(self, frames: Array, pressure_Pa: Array) -> None:
        self.frames, self.pressure_Pa = np.ascontiguousarray(frames), np.ascontiguousarray(pressure_Pa)

    def __len__(self) -> int:
        return len(self.frames)

    @overload
    def __getitem__(self, row: int) -> ChainShape: ...
    @overload
    def __getitem__(self, row: slice) -> ChainShapes: ...
    def __getitem__(self, row: int | slice) -> ChainShape | ChainShapes:
        """Return a shape, in arrays of its own, or some."""
        if isinstance(row, slice):
            return ChainShapes(self.frames[row], self.pressure_Pa[row])
        return ChainShape(self.frames[row].copy(), float(self.pressure_Pa[row]))


def _stacked(shapes: Sequence[ChainShape]) -> tuple[Array, Array]:
    """Return frames (k, f, 4, 3) and pressures (k,) of some shapes."""
    if isinstance(shapes, ChainShapes):
        return shapes.frames, shapes.pressure_Pa
    frames = np.concatenate([shape.frames for shape in shapes]).reshape(len(shapes), -1, 4, 3)
    return frames, np.array([shape.pressure_Pa for shape in shapes])
