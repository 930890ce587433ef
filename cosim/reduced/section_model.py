"""The condensed model of one stack of units: what the film between rings answers, over its working range."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.reduced.sections.assembly import GasTables, chain_points, combine_points, gas_volumes
from cosim.reduced.sections.ring_frames import RingFrames
from cosim.reduced.sections.section_energy import COEFFICIENTS, HIGH, POLYNOMIAL, PressureSpline
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas

STRAINS: Final = ("shear", "length", "bending", "twist")
"""Kinds of strain in `SectionModel.held_out`."""
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
        held_out: (p, 9), of each sampled pressure [Pa] the median and the largest error of the forces of each
            of `STRAINS`, at samples that were not fitted, over their root mean square there, of all sections.
        samples: that were solved.
        failures: poses at which the film had no equilibrium.
        tips: (k, 3), of loads that the model was not built from the pressure [Pa], the distance [m] of its
            tip from the film's, infinite where it has no equilibrium, and the film's length [m].
    """

    spline: PressureSpline
    energy: Array
    length: Array
    gas: Array
    nodes: Array
    held_out: Array
    samples: int
    failures: int
    tips: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def tip_error_m(self) -> float:
        """Largest distance [m] of the tip from the film's; not a number before it was compared."""
        return float(self.tips[:, 1].max()) if len(self.tips) else float("nan")

    @property
    def tip_error(self) -> float:
        """The same over the film's length."""
        return float((self.tips[:, 1] / self.tips[:, 2]).max()) if len(self.tips) else float("nan")

    def times(self, copies: int) -> SectionModel:
        """Return the model of so many copies side by side."""
        energy, length = np.tile(self.energy, (1, copies, 1)), np.tile(self.length, (1, copies))
        return replace(self, energy=energy, length=length, nodes=np.tile(self.nodes, (1, copies, 1, 1)))


@final
class SectionBody:
    """A stack of units as a chain of frames, or copies of it as chains side by side.

    Args:
        body: whose film it is.
        model: condensed from that film, of one copy.
    """

    def __init__(self, body: SoftBody, model: SectionModel) -> None:
        folds = bool(model.energy[:, :, POLYNOMIAL:COEFFICIENTS].any())
        self.frames = replace(RingFrames.of(body), folds=folds)
        self.copies = self.frames.copies
        self.body, self.model = body, model.times(self.copies)
        model = self.model
        self.mass = self.frames.masses(body.node_mass, body.positions)
        self.mass_kg = float(self.mass[:, 0, 0].sum())
        self._one = model.length.shape[1] // self.copies
        size = model.spline.size
        self._energies = np.ascontiguousarray(model.energy.reshape(size, -1))
        self._lengths = np.ascontiguousarray(model.length)
        self._films = np.ascontiguousarray(model.nodes.reshape(size, -1))
        self._nodes = np.zeros((body.nodes, 2, 4))
        self._nodes_at = self._pressure = np.nan
        self.coefficients: Array = np.zeros(model.energy.shape[1:])
        self.inverse_length: Array = np.zeros(model.length.shape[1])
        self.terms = model.spline.terms(0.0)

    @cached_property
    def reach_m(self) -> float:
        """A distance [m] from the flange's origin that no node exceeds: all sections stretched to their ends.

        Nodes are between their frames, and no farther from the axis than drawn, as gas draws rims inwards.
        """
        spline, model = self.model.spline, self.model
        over = np.array([spline.basis(pressure)[0] for pressure in spline.pressures(_REACH_PRESSURES)])
        stretch = np.einsum("pk,ks->ps", over, model.energy[:, :, HIGH])
        ends = ((over @ model.length) * (1.0 + stretch))[:, : self._one]
        frames = self.frames
        base, nodes = (
            frames.drawn[frames.chains[0].start],
            self.body.positions[: len(frames.before) // self.copies],
        )
        radius = float(np.linalg.norm((nodes - base[0]) @ base[1:3].T, axis=1).max())
        return float(np.linalg.norm(base[0])) + _REACH_MARGIN * (float(ends.sum(axis=1).max()) + radius)

    @property
    def chain(self) -> tuple[Array, Array, IntArray, Array, Array]:
        """Coefficients (s, c), 1 / L (s,) [1/m], near (s,), rims and masses (f, 4, 4) for the kernels."""
        return self.coefficients, self.inverse_length, self.frames.near, self.frames.rims, self.mass

    @property
    def tables(self) -> tuple[Array, Array]:
        """Coefficients (size, s c) and lengths (size, s) [m] over the spline of pressure."""
        return self._energies, self._lengths

    @property
    def node_table(self) -> Array:
        """(size, 8 n), what `node_weights` are over the spline of pressure."""
        return self._films

    def set_pressure(self, pressure_Pa: float) -> None:
        """Bring coefficients and lengths to a pressure."""
        if pressure_Pa == self._pressure:
            return
        self._pressure = pressure_Pa
        self.terms = self.model.spline.terms(pressure_Pa)
        self.terms.values(self._energies, self.coefficients.reshape(-1))
        self.terms.values(self._lengths, self.inverse_length)
        np.divide(1.0, self.inverse_length, out=self.inverse_length)

    def volume(self, frames: Array) -> Array:
        """Return the volumes (copies,) [m^3] enclosed at frames (f, 4, 3), at the pressure that is set."""
        found: Array = self.volumes(frames[None], np.array([self._pressure]))[0]
        return found

    def pressure(self, loads: Loads) -> float:
        """Return the gauge pressure [Pa] that loads give the gas.

        Raises:
            InputError: copies are given different ones.
        """
        given = loads.pressures(self.copies)
        if min(given) != max(given):
            raise InputError(
                f"pressures of copies are {min(given):g} to {max(given):g} Pa; section models of copies have "
                "one for all; use fidelity = 'lumped'"
            )
        return given[0]

    def gas(self, loads: Loads) -> SealedGas | None:
        """Return the sealed gas of loads; None where its pressure is given.

        Raises:
            InputError: there are copies, whose gases would have their own pressures.
        """
        gases = loads.gases(self.copies)
        if self.copies > 1 and any(gas is not None for gas in gases):
            raise InputError("section models of copies need given pressures; use fidelity = 'lumped'")
        return gases[0]

    def straight(self, pressure_Pa: float) -> Array:
        """Return the frames (f, 4, 3) of a straight chain with sections in the middle of their range."""
        frames = self.frames.drawn.copy()
        length = self.model.spline.basis(pressure_Pa)[0] @ self.model.length
        return self.frames.strained(frames, np.outer(length, (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)))

    def stretched(self, frames: Array, before_Pa: float, after_Pa: float) -> Array:
        """Return the frames (f, 4, 3) at another pressure, each section at the same place in its range."""
        spline, length = self.model.spline, self.model.length
        values = self.frames.strains(frames)
        values[:, 2] *= (spline.basis(after_Pa)[0] @ length) / (spline.basis(before_Pa)[0] @ length)
        return self.frames.strained(frames, values)

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
        """Return the volumes (k, copies) [m^3] enclosed by chains (k, f, 4, 3) at pressures (k,)."""
        tables = GasTables(self._energies, self._lengths, self.model.gas, self.frames.near, self.frames.rims)
        result = np.empty((len(frames), self.copies))
        gas_volumes(frames, pressure_Pa, self.model.spline, tables, result)
        return result

    def spread(self, nodal: Array, pressure_Pa: float) -> Array:
        """Return the loads (f, 4, 3) on the frames' points of forces (n, 3) [N] on the nodes."""
        weights, before = self.node_weights(pressure_Pa), self.frames.before
        loads = np.zeros((len(self.frames), 4, 3))
        np.add.at(loads, before, weights[:, 0, :, None] * nodal[:, None, :])
        np.add.at(loads, before + 1, weights[:, 1, :, None] * nodal[:, None, :])
        return loads
