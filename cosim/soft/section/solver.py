"""Newton's method for a chain of frames under the loads of a soft body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.errors import InputError
from cosim.frames import Array, Mask
from cosim.soft.body import Loads
from cosim.soft.newton import Outcome
from cosim.soft.section.assembly import assemble, minimise
from cosim.soft.section.chain_contact import FrameContacts
from cosim.soft.section.model import SectionBody

_OUTCOMES = (
    Outcome.CONVERGED,
    Outcome.ITERATION_LIMIT,
    Outcome.NOT_FINITE,
    Outcome.INDEFINITE,
    Outcome.NO_DESCENT,
)
_GAS_ROUNDS_MAX = 30
_GAS_TOLERANCE = 1e-9  # of the absolute pressure
_GAS_STEP = 0.02  # the same, in one round


@final
@dataclass(frozen=True)
class Bed:
    """Inertia of an implicit step: coefficient [1/s^2], target (f, 4, 3) [m]."""

    coefficient: float
    target: Array


@final
@dataclass(frozen=True)
class ChainResult:
    """Where Newton's method ended.

    Args:
        frames: (f, 4, 3).
        gradient: (f, 6) [N, N m] of the potential by (dr, phi) of each frame, inertia included.
        outcome: how it ended.
        residual_N: largest out-of-balance force of a free frame, or moment over its lever.
        iterations: linear solves.
        potential_J: there.
        shifted: solves that met an indefinite tangent.
        pressure_Pa: gauge pressure of the gas.
    """

    frames: Array
    gradient: Array
    outcome: Outcome
    residual_N: float
    iterations: int
    potential_J: float
    shifted: int
    pressure_Pa: float


@final
class ChainSolver:
    """Solves one section body; owns the workspace.

    Args:
        section: what is solved.
    """

    def __init__(self, section: SectionBody) -> None:
        self.section = section
        count = len(section.frames)
        self.diagonal = np.zeros((count, 6, 6))
        self.off = np.zeros((count, 6, 6))
        self.lever_m = float(
            np.mean([np.linalg.norm(shape, axis=1).mean() for shape in section.frames.shapes])
        )
        self._pressure = 0.0
        self._route()
        self._load_key: tuple[object, ...] = ()
        self._load = np.zeros((count, 4, 3))
        self._eyelets_at = np.nan
        self._eyelets = np.zeros((len(self._far), 2, 3))
        self._no_target = np.zeros((count, 4, 3))
        self._nothing = FrameContacts.none()

    def _route(self) -> None:
        """Find the frames of all cable segments; eyelets sit on rings of neighbouring units."""
        body, frames = self.section.body, self.section.frames
        self._segments = np.concatenate([np.zeros((0, 2), np.int64), *(c.segments for c in body.cables)])
        own = frames.before + (frames.share > 0.5)
        far = own[self._segments[:, 1]]
        on_rings = np.isin(frames.share[self._segments], (0.0, 1.0)).all()
        if not on_rings or (own[self._segments[:, 0]] != far - 1).any():
            raise InputError(
                "section models need every cable to run from unit to next unit through outer rings"
            )
        self._far = far.astype(np.int64)
        side = (frames.share[self._segments] > 0.5).astype(int)
        table = self.section.model.nodes[:, self._segments, side, 1:]
        self._eyelet_table = np.ascontiguousarray(table).reshape(len(table), -1)
        self._ratios = [cable.tension_ratio(body.positions) for cable in body.cables]

    @property
    def pressure_Pa(self) -> float:
        """Gauge pressure of the gas in the last solution."""
        return self._pressure

    def solve(
        self,
        start: Array,
        free: Mask,
        loads: Loads,
        tolerance_N: float,
        iterations_max: int,
        bed: Bed | None = None,
    ) -> ChainResult:
        """Find the stationary point of the potential near `start`.

        Args:
            start: (f, 4, 3), held frames where they shall be.
            free: (f,) frames that can move.
            loads: that act; nodal forces go to the frames beside each node.
            tolerance_N: residual at which it is done.
            iterations_max: bound.
            bed: of an implicit step; None in statics.
        """
        gas = loads.gases(1)[0]
        if gas is None:
            return self._solve(start, free, loads, loads.pressures(1)[0], tolerance_N, iterations_max, bed)
        # the pressure that the gas has at the volume that it gives the chamber, by secants
        pressure, step, before = self._pressure, 0.0, 0.0
        for _ in range(_GAS_ROUNDS_MAX):
            found = self._solve(start, free, loads, pressure, tolerance_N, iterations_max, bed)
            off = gas.gauge_pressure(self.section.volume(found.frames)) - pressure
            whole = abs(pressure) + gas.ambient_Pa
            if abs(off) <= _GAS_TOLERANCE * whole or found.outcome is not Outcome.CONVERGED:
                break
            slope = (off - before) / step if step else -1.0
            # more pressure, more volume: the true slope is below -1
            step = float(np.clip(-off / min(slope, -1.0), -_GAS_STEP * whole, _GAS_STEP * whole))
            before, start, pressure = off, found.frames, pressure + step
        return found

    def evaluate(
        self,
        frames: Array,
        loads: Loads,
        pressure_Pa: float,
        bed: Bed | None = None,
        *,
        hessian: bool = False,
    ) -> Array:
        """Return the gradient (f, 6); with `hessian`, fill `diagonal` and `off` as well.

        Args:
            frames: (f, 4, 3).
            loads: that act.
            pressure_Pa: of the gas.
            bed: of an implicit step; None in statics.
            hessian: whether to fill the blocks.
        """
        section = self.section
        section.set_pressure(pressure_Pa)
        gradient, touched = np.empty((len(frames), 6)), self._touched(loads, pressure_Pa)
        assemble(
            frames, section.coefficients, section.inverse_length, section.mass,
            self._loads(loads, pressure_Pa),
            0.0 if bed is None else bed.coefficient, self._no_target if bed is None else bed.target,
            self._far, self._offsets(pressure_Pa), self._tension(frames, loads, pressure_Pa),
            touched.first, touched.rows, touched.widths, gradient, self.diagonal, self.off, hessian,
        )  # fmt: skip
        return gradient

    def volume(self, frames: Array, pressure_Pa: float) -> float:
        """Return the enclosed volume [m^3] of frames (f, 4, 3) at a gauge pressure."""
        self.section.set_pressure(pressure_Pa)
        return self.section.volume(frames)

    def _solve(
        self,
        start: Array,
        free: Mask,
        loads: Loads,
        pressure: float,
        tolerance_N: float,
        limit: int,
        bed: Bed | None,
    ) -> ChainResult:
        section = self.section
        section.set_pressure(pressure)
        self._pressure = pressure
        frames, gradient, touched = start.copy(), np.empty((len(start), 6)), self._touched(loads, pressure)
        outcome, iterations, residual, potential, shifted = minimise(
            frames, free, section.coefficients, section.inverse_length, section.mass,
            self._loads(loads, pressure),
            0.0 if bed is None else bed.coefficient, self._no_target if bed is None else bed.target,
            self._far, self._offsets(pressure), self._tension(frames, loads, pressure),
            touched.first, touched.rows, touched.widths, gradient, self.diagonal, self.off,
            np.array((tolerance_N, self.lever_m)), limit,
        )  # fmt: skip
        return ChainResult(
            frames, gradient, _OUTCOMES[outcome], residual, iterations, potential, shifted, pressure
        )

    def _touched(self, loads: Loads, pressure: float) -> FrameContacts:
        if loads.contact is None:
            return self._nothing
        return FrameContacts.of(self.section, loads.contact, pressure)

    def _loads(self, loads: Loads, pressure: float) -> Array:
        key = (loads.gravity, id(loads.nodal_force), None if loads.nodal_force is None else pressure)
        if key != self._load_key:
            self._load_key, self._kept = key, loads.nodal_force
            self._load = self.section.mass[:, 0, :, None] * np.array(loads.gravity)
            if loads.nodal_force is not None:
                self._load += self.section.spread(loads.nodal_force, pressure)
        return self._load

    def _offsets(self, pressure: float) -> Array:
        """Return the eyelets (k, 2, 3) [m] of all segments in their frames."""
        if pressure != self._eyelets_at and len(self._far):
            self._eyelets_at = pressure
            self._eyelets = np.dot(self.section.basis[:1], self._eyelet_table).reshape(-1, 2, 3)
        return self._eyelets

    def _tension(self, frames: Array, loads: Loads, pressure: float) -> Array:
        if any(length is not None for length in loads.cable_length_m):
            raise InputError("section models take cable tensions, not lengths; use fidelity = 'lumped'")
        if any(cable.friction_coefficient for cable in self.section.body.cables):
            x = self.section.positions(frames, pressure)
            self._ratios = [cable.tension_ratio(x) for cable in self.section.body.cables]
        if not self._ratios:
            return np.zeros(0)
        pulls = zip(self._ratios, loads.cable_tension_N, strict=True)
        return np.concatenate([tension * ratio for ratio, tension in pulls])
