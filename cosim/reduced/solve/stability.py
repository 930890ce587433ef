"""Stability of a chain of frames at an equilibrium, from its small tangent."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeVar, final

import numpy as np
import scipy

from cosim.base.frames import Array, Mask
from cosim.reduced.sections.chain_arrays import InertiaTerm
from cosim.reduced.sections.chain_shape import change_frames
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.reduced.solve.clamp import FrameClamp, node_motion
from cosim.reduced.solve.commanded_cables import point_of
from cosim.reduced.solve.tangent import ChainPoint, whole_tangent
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import describe_largest
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import branching
from cosim.soft.solve.branching import LowestMode
from cosim.soft.solve.stability import (
    is_driven,
    load_margin,
    natural_frequencies,
    nodal_loads,
    tip_displacement,
)

Slope = TypeVar("Slope", float, Array)
PROBE_Pa: Final = 1.0
"""Half of the interval of difference quotients by pressure."""
_STEP: Final = 1e-3  # of the loads, up and down
_ROUNDS: Final = 4  # until a gas has its pressure to rounding


@final
@dataclass(frozen=True)
class RestingChain:
    """A chain at rest under loads; losses along cables are held.

    Args:
        solver: of the chain.
        clamp: frames held by the flange.
        frames: (f, 4, 3).
        loads: active loads.
        pressure_Pa: of the gas.
    """

    solver: ChainSolver
    clamp: FrameClamp
    frames: Array
    loads: Loads
    pressure_Pa: float

    @cached_property
    def point(self) -> ChainPoint:
        """The same with the tensions of commanded cables."""
        return point_of(self.solver, self.frames, self.loads, self.pressure_Pa)

    @cached_property
    def gradient(self) -> Array:
        """(f, 6) [N, N m], of the potential."""
        return self.gradient_at(self.pressure_Pa)

    def gradient_at(self, pressure_Pa: float) -> Array:
        """Return the gradient (f, 6) at another pressure of the gas."""
        return self.solver.evaluate(self.frames, self.point.loads, pressure_Pa)

    @cached_property
    def tangent(self) -> Array:
        """(6 f, 6 f), including sealed gas and commanded lengths."""
        at_constant_gas, gas = whole_tangent(self.solver, self.point), self.solver.section.gas(self.loads)
        if gas is None:
            return at_constant_gas
        # energy at a pressure is less by p V: its slope is -V, of its gradient -dV
        ends = (self.pressure_Pa + PROBE_Pa, self.pressure_Pa - PROBE_Pa)
        swelling = _slope([self._volume(self.frames, p) for p in ends])
        slope = _slope([self.gradient_at(p).ravel() for p in ends])
        volume = self._volume(self.frames, self.pressure_Pa)
        falls = gas.exponent * gas.absolute_pressure(volume) / volume
        return np.asarray(at_constant_gas + falls / (1.0 + falls * swelling) * np.outer(slope, slope))

    def _volume(self, frames: Array, pressure_Pa: float) -> float:
        return float(self.solver.volume(frames, pressure_Pa)[0])

    @cached_property
    def mass(self) -> Array:
        """Mass matrix (6 f, 6 f)."""
        with_inertia, without_inertia = (
            whole_tangent(self.solver, self.point, InertiaTerm(factor, self.frames)) for factor in (1.0, 0.0)
        )
        return with_inertia - without_inertia

    @cached_property
    def motion(self) -> Array:
        """(n, 3, 6 f), see `node_motion`."""
        derivatives = node_motion(self.solver.section, self.frames, self.pressure_Pa)
        return derivatives.reshape(len(derivatives), 3, -1)

    @cached_property
    def _free(self) -> Mask:
        return np.repeat(self.clamp.free, 6)

    @cached_property
    def _matrix(self) -> Array:
        """Tangent of the free frames."""
        return np.asarray(self.tangent[np.ix_(self._free, self._free)])

    @property
    def negative_pivots(self) -> int:
        """Number of directions in which the potential decreases."""
        return int((np.linalg.eigvalsh(self._matrix) < 0.0).sum())

    @property
    def unstable(self) -> branching.Branching | None:
        """The direction of instability; None where it is stable."""
        lowest = self.lowest_mode
        return None if lowest.value > 0.0 else self.describe_instability(lowest, self.negative_pivots)

    @property
    def lowest_mode(self) -> LowestMode:
        """The lowest eigenvalue, with the mode of the film's nodes."""
        return self._lowest[0]

    def describe_instability(self, lowest: LowestMode, ways: int) -> branching.Branching:
        """Return the description of a branching along a mode, with the number of unstable directions."""
        pressures = (self.pressure_Pa,) * self.solver.section.copies
        return branching.Branching(
            1.0, pressures, self.point.loads.cable_tension_N, lowest.place, lowest.direction, lowest.extent,
            ways, None, None, branching.UNDECIDED, losses_held=self.solver.loads.losses_follow_shape,
        )  # fmt: skip

    def assess_stability(self, film: FilmPotential) -> branching.StabilityReport:
        """Return margins and natural frequencies, or the instability.

        Args:
            film: potential of the film.
        """
        losses_held, unstable = self.solver.loads.losses_follow_shape, self.unstable
        if unstable is not None:
            return branching.StabilityReport(None, np.inf, 0.0, losses_held=losses_held, unstable=unstable)
        section, frames, count = self.solver.section, self.frames, len(self.frames)
        (_, mode), motion, tip = self._lowest, self.motion, section.body.tip
        x = section.positions(frames, self.pressure_Pa)
        pressed = replace(
            self.loads, pressure_Pa=(self.pressure_Pa,) * section.copies, gas=(), cable_length_m=()
        )
        size = branching.DISTURBED * np.linalg.norm(nodal_loads(film, x, film.memory, pressed), axis=1)
        disturbed = np.tensordot(size, motion, 1)[:, self._free]
        tip_responses = motion[tip][:, :, self._free] @ np.linalg.solve(self._matrix, disturbed.T)
        response = np.linalg.solve(self._matrix, self._more_load(_STEP) / _STEP)
        step = np.zeros((count, 6))
        step.reshape(-1)[self._free] = response
        moved_frames, stiffness = np.empty_like(frames), []
        for change in (-_STEP, _STEP):
            change_frames(frames, step, change, moved_frames)
            loads, pressure = self._grown(change, moved_frames)
            changed = replace(self, frames=moved_frames, loads=loads, pressure_Pa=pressure)
            stiffness.append(float(mode @ changed._matrix @ mode))
        fall = (stiffness[0] - stiffness[1]) / (2.0 * _STEP)
        mass = self.mass[np.ix_(self._free, self._free)]
        pushed = is_driven(
            *(float(a @ mass @ b) for a, b in ((mode, response), (mode, mode), (response, response)))
        )
        last = min(branching.MODES, len(mass)) - 1
        values = scipy.linalg.eigh(self._matrix, mass, eigvals_only=True, subset_by_index=(0, last))
        modes = natural_frequencies(values.tolist())
        return branching.StabilityReport(
            modes[0], tip_displacement(np.arange(len(tip)), tip_responses),
            *load_margin(float(mode @ self._matrix @ mode), fall, driven=pushed), losses_held,
            frequencies_Hz=modes,
        )  # fmt: skip

    @cached_property
    def _lowest(self) -> tuple[LowestMode, Array]:
        """The lowest eigenvalue of K v = e M v with its mode of the film's nodes, and v."""
        mass = self.mass[np.ix_(self._free, self._free)]
        eigenvalue, vector = scipy.linalg.eigh(self._matrix, mass, subset_by_index=(0, 0))
        section, vector_of_all = self.solver.section, np.zeros(len(self._free))
        vector_of_all[self._free] = vector[:, 0]
        motion = self.motion @ vector_of_all
        scale = motion.ravel()[np.argmax(np.abs(motion))]
        x, free = section.positions(self.frames, self.pressure_Pa), np.ones(motion.shape, np.bool_)
        mode, place = motion / scale, describe_largest(section.body, x, motion, free)
        return LowestMode(float(eigenvalue[0]), mode, place), vector[:, 0]

    def _grown(self, change: float, frames: Array) -> tuple[Loads, float]:
        """Return loads grown by a fraction, and the gas pressure that they have at frames (f, 4, 3)."""
        volumes, pressure = self.solver.volume(self.frames, self.pressure_Pa), self.pressure_Pa
        loads = self.loads.grown(change, tuple(volumes.tolist()))
        section = self.solver.section
        gas = section.gas(loads)
        if gas is None:
            return loads, section.pressure(loads)
        for _ in range(_ROUNDS):
            ends = [self._volume(frames, pressure + probe_Pa) for probe_Pa in (PROBE_Pa, -PROBE_Pa)]
            swelling, volume = _slope(ends), 0.5 * (ends[0] + ends[1])
            falls = gas.exponent * gas.absolute_pressure(volume) / volume
            pressure += (gas.gauge_pressure(volume) - pressure) / (1.0 + falls * swelling)
        return loads, pressure

    def _more_load(self, change: float) -> Array:
        """Return the forces [N, N m] that loads grown by a fraction add to the free frames."""
        gradients = []
        for loads, pressure in (self._grown(0.0, self.frames), self._grown(change, self.frames)):
            pulled = point_of(self.solver, self.frames, loads, pressure).loads
            gradients.append(self.solver.evaluate(self.frames, pulled, pressure).ravel()[self._free])
        return np.asarray(gradients[0] - gradients[1])


def _slope(ends: Sequence[Slope]) -> Slope:
    """Return the slope by pressure from values at both ends of a probe."""
    return (ends[0] - ends[1]) / (2.0 * PROBE_Pa)
