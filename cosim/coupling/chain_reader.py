"""Reads shapes of a section arm off its frames, without making the film's nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.coupling.shape_reader import Rows, ShapeFigures, ShapeReader, ShapeRows
from cosim.frames import Array
from cosim.soft.center_line import hole_rings
from cosim.soft.section.assembly import gas_volume
from cosim.soft.section.model import SectionBody


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
        model, before, tip = section.model, section.frames.before, section.body.tip
        rings = hole_rings(section.body)
        self._section, self._tip = section, len(tip)
        self._energy = model.energy.reshape(len(model.energy), -1)
        # all nodes of a ring are beside the same two frames
        weights = np.concatenate([model.nodes[:, tip], model.nodes[:, rings].mean(axis=2)], axis=1)
        self._weights = np.ascontiguousarray(weights.reshape(len(weights), -1))
        # whose points follow one another
        self._points = (4 * before[[*tip, *rings[:, 0]]][:, None] + np.arange(8)).ravel()

    def positions(self, shape: ChainShape) -> Array:
        """Return the film's nodes (n, 3) [m] on the frames."""
        return self._section.positions(shape.frames, shape.pressure_Pa)

    def figures(self, shapes: Sequence[ChainShape]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        frames = np.concatenate([shape.frames for shape in shapes]).reshape(len(shapes), -1, 4, 3)
        return self.figures_of(frames, np.array([shape.pressure_Pa for shape in shapes]))

    def figures_of(self, frames: Array, pressure_Pa: Array) -> ShapeFigures:
        """Return the figures of chains with frames (k, f, 4, 3) at pressures (k,) [Pa]."""
        count = len(frames)
        basis = self._section.model.spline.bases(pressure_Pa)
        weights = (basis[:, 0] @ self._weights).reshape(count, -1, 8)
        points = frames.reshape(count, -1, 3).take(self._points, axis=1).reshape(count, -1, 8, 3)
        found = np.einsum("kna,knar->knr", weights, points)
        volumes = self._volumes(frames, basis)
        return ShapeFigures.of(found[:, : self._tip], found[:, self._tip :], volumes[:, None])

    def _volumes(self, frames: Array, basis: Array) -> Array:
        """Return the enclosed volumes (k,) [m^3] of chains (k, f, 4, 3) at their pressures."""
        model = self._section.model
        values, slopes = basis[:, 0], basis[:, 1]
        shape = (len(frames), *model.energy.shape[1:])
        coefficients, rates = (values @ self._energy).reshape(shape), (slopes @ self._energy).reshape(shape)
        inverse_length, length_rate = 1.0 / (values @ model.length), slopes @ model.length
        found = map(gas_volume, frames, coefficients, rates, inverse_length, length_rate)
        return np.array(list(found)) - slopes @ model.gas


@final
class ChainRows(ShapeRows):
    """Shapes of a section arm.

    Args:
        reader: of the arm.
        frames: (k, f, 4, 3).
        pressure_Pa: (k,), gauge.
    """

    def __init__(self, reader: ChainReader, frames: Array, pressure_Pa: Array) -> None:
        self._reader, self._frames, self._pressure_Pa = reader, frames, pressure_Pa

    @property
    def reader(self) -> ChainReader:
        return self._reader

    def shape(self, row: int) -> ChainShape:
        return ChainShape(self._frames[row].copy(), float(self._pressure_Pa[row]))

    def figures(self, rows: Rows) -> ShapeFigures:
        return self._reader.figures_of(self._frames[rows], self._pressure_Pa[rows])
