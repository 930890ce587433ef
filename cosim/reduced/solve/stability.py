"""How firmly a chain of frames stands: what `soft.solve.stability` says of a film, by its small tangent."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Final, final

import numpy as np
from scipy.linalg import eigh

from cosim.base.frames import Array, Mask
from cosim.reduced.sections.assembly import change_frames
from cosim.reduced.sections.section_strains import Bed
from cosim.reduced.solve.clamp import node_motion
from cosim.reduced.solve.newton import ChainSolver, whole_tangent
from cosim.reduced.solve.time_step import given_tensions
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import place_of_largest
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.branching import DISTURBED, MODES, UNDECIDED, Branching, Footing
from cosim.soft.solve.stability import (
    Softest,
    driven,
    margin_by,
    natural_frequencies,
    nodal_loads,
    tip_motion,
)

_PROBE_Pa: Final = 1.0
_SHARE: Final = 1e-3  # of the loads, in a look ahead
_ROUNDS: Final = 4  # until a gas has its pressure to rounding


def chain_stiffness(solver: ChainSolver, frames: Array, loads: Loads, pressure_Pa: float) -> Array:
    """Return the tangent (6 f, 6 f) of a chain at rest, with sealed gas and commanded lengths in it.

    Args:
        solver: of the chain.
        frames: (f, 4, 3), where it is taken.
        loads: that act.
        pressure_Pa: of the gas.
    """
    given = given_tensions(solver, frames, loads, pressure_Pa)
    whole = whole_tangent(solver, frames, given, pressure_Pa)
    gas = solver.section.gas(loads)
    if gas is None:
        return whole
    # energy at a pressure is less by p V: its slope is -V, of its gradient -dV
    ends = [
        (float(solver.volume(frames, p)[0]), solver.evaluate(frames, given[0], p).ravel())
        for p in (pressure_Pa + _PROBE_Pa, pressure_Pa - _PROBE_Pa)
    ]
    swelling, slope = ((a - b) / (2.0 * _PROBE_Pa) for a, b in zip(*ends, strict=True))
    volume = float(solver.volume(frames, pressure_Pa)[0])
    falls = gas.exponent * gas.absolute_pressure(volume) / volume
    return whole + falls / (1.0 + falls * swelling) * np.outer(slope, slope)


@final
class ChainStiffness:
    """The tangent of a chain at rest, with sealed gas and commanded lengths in it, losses along cables held.

    Args:
        solver: of the chain.
        frames: (f, 4, 3), where it is taken.
        free: (f,) frames that can move.
        loads: that act.
        pressure_Pa: of the gas.
    """

    def __init__(
        self, solver: ChainSolver, frames: Array, free: Mask, loads: Loads, pressure_Pa: float
    ) -> None:
        self._solver, self._frames, self._loads, self._pressure = solver, frames, loads, pressure_Pa
        self._free = np.repeat(free, 6)
        self._matrix = self._tangent(frames, loads, pressure_Pa)

    @property
    def negative_pivots(self) -> int:
        """In how many directions the potential falls."""
        return int((np.linalg.eigvalsh(self._matrix) < 0.0).sum())

    @property
    def unstable(self) -> Branching | None:
        """In which direction it would give way; None where it is stable."""
        lowest = self.softest
        return None if lowest.value > 0.0 else self.named(lowest, self.negative_pivots)

    @property
    def softest(self) -> Softest:
        """The lowest eigenvalue, with the mode of the film's nodes."""
        return self._lowest[0]

    def named(self, lowest: Softest, ways: int) -> Branching:
        """Return what is known of where it gives way along a mode, in so many independent directions."""
        tensions = given_tensions(self._solver, self._frames, self._loads, self._pressure)[0].cable_tension_N
        pressures = (self._pressure,) * self._solver.section.copies
        return Branching(
            1.0, pressures, tensions, lowest.place, lowest.direction, lowest.extent,
            ways, None, None, UNDECIDED, losses_held=self._solver.losses_follow_shape,
        )  # fmt: skip

    def footing(self, system: SoftSystem) -> Footing:
        """Return how firmly it stands.

        Args:
            system: of the film.
        """
        held, unstable = self._solver.losses_follow_shape, self.unstable
        if unstable is not None:
            return Footing(None, math.inf, 0.0, losses_held=held, unstable=unstable)
        section, frames, count = self._solver.section, self._frames, len(self._frames)
        (_, mode), motion, tip = self._lowest, self._motion, section.body.tip
        x = section.positions(frames, self._pressure)
        loads = replace(
            self._loads, pressure_Pa=(self._pressure,) * section.copies, gas=(), cable_length_m=()
        )
        size = DISTURBED * np.linalg.norm(nodal_loads(system, x, system.memory, loads), axis=1)
        disturbed = np.tensordot(size, motion, 1)[:, self._free]
        answers = motion[tip][:, :, self._free] @ np.linalg.solve(self._matrix, disturbed.T)
        answer = np.linalg.solve(self._matrix, self._more_load(_SHARE) / _SHARE)
        step = np.zeros((count, 6))
        step.reshape(-1)[self._free] = answer
        moved, stiffness = np.empty_like(frames), []
        for way in (-_SHARE, _SHARE):
            change_frames(frames, step, way, moved)
            stiffness.append(float(mode @ self._tangent(moved, *self._grown(way, moved)) @ mode))
        fall = (stiffness[0] - stiffness[1]) / (2.0 * _SHARE)
        mass = self._mass
        pushed = driven(*(float(a @ mass @ b) for a, b in ((mode, answer), (mode, mode), (answer, answer))))
        most = min(MODES, len(mass)) - 1
        values = eigh(self._matrix, mass, eigvals_only=True, subset_by_index=(0, most))
        modes = natural_frequencies(values.tolist())
        return Footing(
            modes[0], tip_motion(np.arange(len(tip)), answers),
            *margin_by(float(mode @ self._matrix @ mode), fall, driven=pushed), held, frequencies_Hz=modes,
        )  # fmt: skip

    @cached_property
    def _mass(self) -> Array:
        """Mass matrix of what can move."""
        still, moving = Bed(0.0, self._frames), Bed(1.0, self._frames)
        given = given_tensions(self._solver, self._frames, self._loads, self._pressure)
        found = [
            whole_tangent(self._solver, self._frames, given, self._pressure, bed) for bed in (moving, still)
        ]
        return (found[0] - found[1])[np.ix_(self._free, self._free)]

    @cached_property
    def _motion(self) -> Array:
        """(n, 3, 6 f), see `node_motion`."""
        found = node_motion(self._solver.section, self._frames, self._pressure)
        return found.reshape(len(found), 3, len(self._free))

    @cached_property
    def _lowest(self) -> tuple[Softest, Array]:
        """The lowest eigenvalue of K v = e M v with its mode of the film's nodes, and v."""
        value, vector = eigh(self._matrix, self._mass, subset_by_index=(0, 0))
        section, whole = self._solver.section, np.zeros(len(self._free))
        whole[self._free] = vector[:, 0]
        motion = self._motion @ whole
        scale = motion.ravel()[np.argmax(np.abs(motion))]
        x, free = section.positions(self._frames, self._pressure), np.ones(motion.shape, np.bool_)
        mode, place = motion / scale, place_of_largest(section.body, x, motion, free)
        return Softest(float(value[0]), mode, place), vector[:, 0]

    def _grown(self, share: float, frames: Array) -> tuple[Loads, float]:
        """Return loads grown by a share, and the gas pressure that they have at frames (f, 4, 3)."""
        volumes, pressure = self._solver.volume(self._frames, self._pressure), self._pressure
        loads = self._loads.grown(share, tuple(volumes.tolist()))
        section = self._solver.section
        gas = section.gas(loads)
        if gas is None:
            return loads, section.pressure(loads)
        for _ in range(_ROUNDS):
            ends = [float(self._solver.volume(frames, pressure + off)[0]) for off in (_PROBE_Pa, -_PROBE_Pa)]
            swelling, volume = (ends[0] - ends[1]) / (2.0 * _PROBE_Pa), 0.5 * (ends[0] + ends[1])
            falls = gas.exponent * gas.absolute_pressure(volume) / volume
            pressure += (gas.gauge_pressure(volume) - pressure) / (1.0 + falls * swelling)
        return loads, pressure

    def _more_load(self, share: float) -> Array:
        """Return the forces [N, N m] that loads grown by a share add on what can move."""
        found = []
        for loads, pressure in (self._grown(0.0, self._frames), self._grown(share, self._frames)):
            given, _ = given_tensions(self._solver, self._frames, loads, pressure)
            found.append(self._solver.evaluate(self._frames, given, pressure).ravel()[self._free])
        return np.asarray(found[0] - found[1])

    def _tangent(self, frames: Array, loads: Loads, pressure_Pa: float) -> Array:
        whole = chain_stiffness(self._solver, frames, loads, pressure_Pa)
        return np.asarray(whole[np.ix_(self._free, self._free)])
