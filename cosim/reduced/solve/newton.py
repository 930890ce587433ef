"""Newton's method for a chain of frames under the loads of a soft body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import InputError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.sections.assembly import assemble, minimise
from cosim.reduced.solve.contact import FrameContacts
from cosim.reduced.solve.sealed_pressure import solve_sealed
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome

OUTCOMES = (
    Outcome.CONVERGED,
    Outcome.ITERATION_LIMIT,
    Outcome.NOT_FINITE,
    Outcome.INDEFINITE,
    Outcome.NO_DESCENT,
)
"""In the order of the kernels' numbers."""

Others: TypeAlias = tuple[IntArray, Array, Array, IntArray, Array, Array]
"""Cables and contacts as the kernels take them: of all cable segments the far frame (k,), the eyelets
(k, 2, 3) [m] in their frames and the tension (k,) [N]; then what `FrameContacts` holds."""


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
        self._factor = (np.zeros((count, 6, 6)), np.zeros((count, 6, 6)), False)
        self.lever_m = float(
            np.mean([np.linalg.norm(shape, axis=1).mean() for shape in section.frames.shapes])
        )
        self._route()
        self._gravity: tuple[float, float, float] | None = None
        self._nodal: tuple[Array | None, float] = (None, 0.0)
        self._load = np.zeros((count, 4, 3))
        self._eyelets_at = np.nan
        self._eyelets = np.zeros((len(self._far), 2, 3))
        self._tensions: tuple[float, ...] | None = None
        self._tension = np.zeros(len(self._far))
        self._still = np.zeros((count, 4, 3))
        self._nothing = FrameContacts.none()

    def _route(self) -> None:
        """Find the frames of all cable segments; eyelets sit on rings of neighbouring units."""
        body, frames = self.section.body, self.section.frames
        self._segments = np.concatenate([np.zeros((0, 2), np.int64), *(c.segments for c in body.cables)])
        own = frames.before + (frames.fraction > 0.5)
        far = own[self._segments[:, 1]]
        on_rings = np.isin(frames.fraction[self._segments], (0.0, 1.0)).all()
        if not on_rings or (own[self._segments[:, 0]] != far - 1).any():
            raise InputError(
                "section models need every cable to run from unit to next unit through outer rings"
            )
        self._far = far.astype(np.int64)
        side = (frames.fraction[self._segments] > 0.5).astype(int)
        table = self.section.model.nodes[:, self._segments, side, 1:]
        self._eyelet_table = np.ascontiguousarray(table).reshape(len(table), -1)
        self.losses_follow_shape = any(cable.friction_coefficient for cable in body.cables)
        self._ratios = [cable.tension_ratio(body.positions) for cable in body.cables]

    @property
    def eyelet_table(self) -> Array:
        """Eyelets of all cable segments in their frames (size, 6 k) [m], over the spline of pressure."""
        return self._eyelet_table

    def segment_tensions(self, tension_N: Array) -> Array:
        """Return the tension (n, k) [N] of all cable segments from those at the base ends (n, cables)."""
        pulls = [tension_N[:, c, None] * ratio for c, ratio in enumerate(self._ratios)]
        return np.concatenate([np.zeros((len(tension_N), 0)), *pulls], axis=1)

    def solve(
        self,
        start: Array,
        free: Mask,
        loads: Loads,
        tolerance_N: float,
        iterations_max: int,
        begin_Pa: float = 0.0,
    ) -> ChainResult:
        """Find the equilibrium near `start`.

        Args:
            start: (f, 4, 3), held frames where they shall be.
            free: (f,) frames that can move.
            loads: that act; nodal forces go to the frames beside each node.
            tolerance_N: residual at which it is done.
            iterations_max: bound.
            begin_Pa: gauge pressure at which the search for that of a sealed gas begins.
        """
        bounds = np.array((tolerance_N, self.lever_m))

        def attempt(pressure_Pa: float, before: ChainResult | None) -> ChainResult:
            frames = (start if before is None else before.frames).copy()
            gradient = np.empty((len(start), 6))
            load, others = self.acting(loads, pressure_Pa, frames)
            outcome, iterations, residual, potential, shifted, _ = minimise(
                frames, free, *self.section.chain, load, 0.0, self._still, *others,
                gradient, self.diagonal, self.off, *self._factor, bounds, iterations_max,
            )  # fmt: skip
            return ChainResult(
                frames, gradient, OUTCOMES[outcome], residual, iterations, potential, shifted, pressure_Pa
            )

        gas = loads.gases(1)[0]
        if gas is None:
            return attempt(loads.pressures(1)[0], None)
        return solve_sealed(gas, begin_Pa, self.section.volume, attempt)

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
        gradient = np.empty((len(frames), 6))
        load, others = self.acting(loads, pressure_Pa, frames)
        assemble(
            frames, *self.section.chain, load,
            0.0 if bed is None else bed.coefficient, self._still if bed is None else bed.target,
            *others, gradient, self.diagonal, self.off, hessian,
        )  # fmt: skip
        return gradient

    def volume(self, frames: Array, pressure_Pa: float) -> float:
        """Return the enclosed volume [m^3] of frames (f, 4, 3) at a gauge pressure."""
        self.section.set_pressure(pressure_Pa)
        return self.section.volume(frames)

    def acting(self, loads: Loads, pressure_Pa: float, frames: Array) -> tuple[Array, Others]:
        """Bring the section to a pressure and return what acts on it.

        Args:
            loads: given on the film.
            pressure_Pa: of the gas.
            frames: (f, 4, 3) near the solution; losses of cables that rub follow the shape.

        Returns:
            Dead loads (f, 4, 3) on the frames' points, cables and contacts; the solver owns them.

        Raises:
            InputError: a cable's length is commanded, or a triangle that may touch reaches across a frame.
        """
        section = self.section
        section.set_pressure(pressure_Pa)
        nodal = (loads.nodal_force, 0.0 if loads.nodal_force is None else pressure_Pa)
        if loads.gravity != self._gravity or nodal[0] is not self._nodal[0] or nodal[1] != self._nodal[1]:
            self._gravity, self._nodal = loads.gravity, nodal
            self._load = section.mass[:, 0, :, None] * np.array(loads.gravity)
            if loads.nodal_force is not None:
                self._load += section.spread(loads.nodal_force, pressure_Pa)
        if pressure_Pa != self._eyelets_at and len(self._far):
            self._eyelets_at = pressure_Pa
            section.terms.values(self._eyelet_table, self._eyelets.reshape(-1))
        if self._ratios:
            self._pull(loads, pressure_Pa, frames)
        touched = self._nothing
        if loads.contact is not None:
            touched = FrameContacts.of(section, loads.contact, pressure_Pa)
        cables = (self._far, self._eyelets, self._tension)
        return self._load, (*cables, touched.first, touched.rows, touched.widths)

    def _pull(self, loads: Loads, pressure_Pa: float, frames: Array) -> None:
        """Bring the tension of all segments up to date."""
        if loads.cable_length_m and any(length is not None for length in loads.cable_length_m):
            raise InputError("a chain is solved at tensions; `commanded_cables` finds those of given lengths")
        if self.losses_follow_shape:
            x = self.section.positions(frames, pressure_Pa)
            self._ratios = [cable.tension_ratio(x) for cable in self.section.body.cables]
        elif loads.cable_tension_N == self._tensions:
            return
        self._tensions = loads.cable_tension_N
        pulls = zip(self._ratios, loads.cable_tension_N, strict=True)
        self._tension = np.concatenate([tension * ratio for ratio, tension in pulls])
