"""The condensed model of one stack of units: what the film between rings answers, over its working range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.reduced.sections.assembly import chain_points, combine_points, gas_volumes
from cosim.reduced.sections.ring_frames import RingFrames, frames_from_strains, strains
from cosim.reduced.sections.section_energy import HIGH, PressureSpline
from cosim.soft.body.body import SoftBody

_REACH_PRESSURES = 20
_REACH_MARGIN = 1.05  # of lengths along the axes over those across: sections are sheared a little


@final
@dataclass(frozen=True)
class SectionModel:
    """Coefficients over pressure; functions of pressure are splines with `spline.size` coefficients.

    Args:
        spline: over the range of pressure.
        energy: (size, s, COEFFICIENTS + 3), see `energy`; the last three are the limits.
        length: (size, s) [m], L of each section.
        gas: (size,) [J], what the energies of the sections leave out of the gas' potential -int V dp.
        nodes: (size, n, 2, 4), each node as a combination of the points of the two frames beside it.
        force_error: (6,), relative, of the sections' forces over samples that were not fitted.
        samples: that were solved.
        failures: poses at which the film had no equilibrium.
        tip_error: relative to the length, largest over loads that the model was not built from; infinite
            where it has no equilibrium, not a number before it was compared.
        tip_error_m: the same in metres.
    """

    spline: PressureSpline
    energy: Array
    length: Array
    gas: Array
    nodes: Array
    force_error: Array
    samples: int
    failures: int
    tip_error: float = float("nan")
    tip_error_m: float = float("nan")


@final
class SectionBody:
    """A stack of units as a chain of frames.

    Args:
        body: whose film it is.
        model: condensed from that film.
    """

    def __init__(self, body: SoftBody, model: SectionModel) -> None:
        self.body, self.model = body, model
        self.frames = RingFrames.of(body)
        self.mass = self.frames.masses(body.node_mass, body.positions)
        self.mass_kg = float(self.mass[:, 0, 0].sum())
        size = model.spline.size
        self._energies = np.ascontiguousarray(model.energy.reshape(size, -1))
        self._lengths = np.ascontiguousarray(model.length)
        self._films = np.ascontiguousarray(model.nodes.reshape(size, -1))
        self._nodes = np.zeros((body.nodes, 2, 4))
        self._nodes_at = self._pressure = np.nan
        self.coefficients: Array = np.zeros(model.energy.shape[1:])
        self.inverse_length: Array = np.zeros(model.length.shape[1])
        self.terms = model.spline.terms(0.0)

    @property
    def reach_m(self) -> float:
        """A distance [m] from the flange's origin that no node exceeds: all sections stretched to their ends.

        Nodes are between their frames, and no farther from the axis than drawn, as gas draws rims inwards.
        """
        spline, model = self.model.spline, self.model
        over = np.array([spline.basis(pressure)[0] for pressure in spline.pressures(_REACH_PRESSURES)])
        stretch = np.einsum("pk,ks->ps", over, model.energy[:, :, HIGH])
        length = float(((over @ model.length) * (1.0 + stretch)).sum(axis=1).max())
        radius = float(np.linalg.norm(self.body.positions[:, :2], axis=1).max())
        return _REACH_MARGIN * (length + radius)

    @property
    def chain(self) -> tuple[Array, Array, Array]:
        """Coefficients (s, c), 1 / L (s,) [1/m] and masses (f, 4, 4) as the kernels take them."""
        return self.coefficients, self.inverse_length, self.mass

    @property
    def tables(self) -> tuple[Array, Array]:
        """Coefficients (size, s c) and lengths (size, s) [m] over the spline of pressure."""
        return self._energies, self._lengths

    def set_pressure(self, pressure_Pa: float) -> None:
        """Bring coefficients and lengths to a pressure."""
        if pressure_Pa == self._pressure:
            return
        self._pressure = pressure_Pa
        self.terms = self.model.spline.terms(pressure_Pa)
        self.terms.values(self._energies, self.coefficients.reshape(-1))
        self.terms.values(self._lengths, self.inverse_length)
        np.divide(1.0, self.inverse_length, out=self.inverse_length)

    def volume(self, frames: Array) -> float:
        """Return the enclosed volume [m^3] at frames (f, 4, 3), at the pressure that is set."""
        return float(self.volumes(frames[None], np.array([self._pressure]))[0])

    def straight(self, pressure_Pa: float) -> Array:
        """Return the frames (f, 4, 3) of a straight chain with sections in the middle of their range."""
        frames = self.frames.drawn.copy()
        frames[1:, 0, 2] = np.cumsum(self.model.spline.basis(pressure_Pa)[0] @ self.model.length)
        return frames

    def stretched(self, frames: Array, before_Pa: float, after_Pa: float) -> Array:
        """Return the frames (f, 4, 3) at another pressure, each section at the same place in its range."""
        spline, length = self.model.spline, self.model.length
        values = strains(frames[:-1], frames[1:])
        values[:, 2] *= (spline.basis(after_Pa)[0] @ length) / (spline.basis(before_Pa)[0] @ length)
        return frames_from_strains(frames[0], values)

    def node_weights(self, pressure_Pa: float) -> Array:
        """Return (n, 2, 4): each node as a combination of the points of the frames beside it."""
        if pressure_Pa != self._nodes_at:
            self._nodes_at = pressure_Pa
            self.model.spline.terms(pressure_Pa).values(self._films, self._nodes.reshape(-1))
        return self._nodes

    def positions(self, frames: Array, pressure_Pa: float) -> Array:
        """Return the nodes (n, 3) [m] of the film on frames (f, 4, 3)."""
        result = np.empty((len(self._nodes), 3))
        combine_points(frames, self.frames.before, self.node_weights(pressure_Pa), result)
        return result

    def films(self, frames: Array, pressure_Pa: Array) -> Array:
        """Return the nodes (k, n, 3) [m] of the film on chains (k, f, 4, 3) at pressures (k,)."""
        return self.points(frames, pressure_Pa, self._films, self.frames.before)

    def points(self, frames: Array, pressure_Pa: Array, table: Array, before: IntArray) -> Array:
        """Return points (k, n, 3) [m] of chains (k, f, 4, 3) at pressures (k,).

        Args:
            frames: (k, f, 4, 3).
            pressure_Pa: (k,).
            table: (size, 8 n), combinations as in `SectionModel.nodes`.
            before: (n,), the first of the two frames that each point is between.
        """
        result = np.empty((len(frames), len(before), 3))
        chain_points(frames, pressure_Pa, self.model.spline, table, before, result)
        return result

    def volumes(self, frames: Array, pressure_Pa: Array) -> Array:
        """Return the enclosed volumes (k,) [m^3] of chains (k, f, 4, 3) at pressures (k,)."""
        model = self.model
        found = gas_volumes(frames, pressure_Pa, model.spline, self._energies, self._lengths, model.gas)
        return np.asarray(found)

    def spread(self, nodal: Array, pressure_Pa: float) -> Array:
        """Return the loads (f, 4, 3) on the frames' points of forces (n, 3) [N] on the nodes."""
        weights, before = self.node_weights(pressure_Pa), self.frames.before
        loads = np.zeros((len(self.frames), 4, 3))
        np.add.at(loads, before, weights[:, 0, :, None] * nodal[:, None, :])
        np.add.at(loads, before + 1, weights[:, 1, :, None] * nodal[:, None, :])
        return loads
