"""How firmly a chain of frames stands, by its small tangent, and one implicit step of it as a matrix."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np
from scipy.linalg import eigh

from cosim.base.frames import Array, Mask, cross_matrix
from cosim.reduced.sections.assembly import CENTER, FIGURES, change_frames, figures_of
from cosim.reduced.sections.section_strains import Bed
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.reduced.solve.clamp import FrameClamp, node_motion
from cosim.reduced.solve.commanded_cables import commanded, point_of, with_tensions
from cosim.reduced.solve.tangent import whole_tangent
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import place_of_largest
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import branching, stability, step_begin
from cosim.soft.solve.linear_step import LinearStep, LoadName, RestingBody
from cosim.soft.solve.stability import driven, margin_by, natural_frequencies, nodal_loads, tip_motion

_PROBE_Pa: Final = 1.0
_SHARE: Final = 1e-3  # of the loads, in a look ahead
_ROUNDS: Final = 4  # until a gas has its pressure to rounding
_MOTION_PROBE: Final = 1e-5  # of a motion, for centre and inertia


def chain_stiffness(solver: ChainSolver, frames: Array, loads: Loads, pressure_Pa: float) -> Array:
    """Return the tangent (6 f, 6 f) of a chain at rest, with sealed gas and commanded lengths in it.

    Args:
        solver: of the chain.
        frames: (f, 4, 3), where it is taken.
        loads: that act.
        pressure_Pa: of the gas.
    """
    at = point_of(solver, frames, loads, pressure_Pa)
    whole = whole_tangent(solver, at)
    gas = solver.section.gas(loads)
    if gas is None:
        return whole
    # energy at a pressure is less by p V: its slope is -V, of its gradient -dV
    ends = [
        (float(solver.volume(frames, p)[0]), solver.evaluate(frames, at.loads, p).ravel())
        for p in (pressure_Pa + _PROBE_Pa, pressure_Pa - _PROBE_Pa)
    ]
    swelling, slope = ((a - b) / (2.0 * _PROBE_Pa) for a, b in zip(*ends, strict=True))
    volume = float(solver.volume(frames, pressure_Pa)[0])
    falls = gas.exponent * gas.absolute_pressure(volume) / volume
    return whole + falls / (1.0 + falls * swelling) * np.outer(slope, slope)


def mass_matrix(solver: ChainSolver, frames: Array, loads: Loads, pressure_Pa: float) -> Array:
    """Return the mass matrix (6 f, 6 f) of a chain; arguments as for `chain_stiffness`."""
    at = point_of(solver, frames, loads, pressure_Pa)
    moving, still = (whole_tangent(solver, at, Bed(factor, frames)) for factor in (1.0, 0.0))
    return moving - still


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
    def unstable(self) -> branching.Branching | None:
        """In which direction it would give way; None where it is stable."""
        lowest = self.softest
        return None if lowest.value > 0.0 else self.named(lowest, self.negative_pivots)

    @property
    def softest(self) -> stability.Softest:
        """The lowest eigenvalue, with the mode of the film's nodes."""
        return self._lowest[0]

    def named(self, lowest: stability.Softest, ways: int) -> branching.Branching:
        """Return what is known of where it gives way along a mode, in so many independent directions."""
        tensions = point_of(self._solver, self._frames, self._loads, self._pressure).loads.cable_tension_N
        pressures = (self._pressure,) * self._solver.section.copies
        return branching.Branching(
            1.0, pressures, tensions, lowest.place, lowest.direction, lowest.extent,
            ways, None, None, branching.UNDECIDED, losses_held=self._solver.loads.losses_follow_shape,
        )  # fmt: skip

    def footing(self, film: FilmPotential) -> branching.Footing:
        """Return how firmly it stands.

        Args:
            film: of the film.
        """
        held, unstable = self._solver.loads.losses_follow_shape, self.unstable
        if unstable is not None:
            return branching.Footing(None, np.inf, 0.0, losses_held=held, unstable=unstable)
        section, frames, count = self._solver.section, self._frames, len(self._frames)
        (_, mode), motion, tip = self._lowest, self._motion, section.body.tip
        x = section.positions(frames, self._pressure)
        loads = replace(
            self._loads, pressure_Pa=(self._pressure,) * section.copies, gas=(), cable_length_m=()
        )
        size = branching.DISTURBED * np.linalg.norm(nodal_loads(film, x, film.memory, loads), axis=1)
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
        most = min(branching.MODES, len(mass)) - 1
        values = eigh(self._matrix, mass, eigvals_only=True, subset_by_index=(0, most))
        modes = natural_frequencies(values.tolist())
        return branching.Footing(
            modes[0], tip_motion(np.arange(len(tip)), answers),
            *margin_by(float(mode @ self._matrix @ mode), fall, driven=pushed), held, frequencies_Hz=modes,
        )  # fmt: skip

    @cached_property
    def _mass(self) -> Array:
        """Mass matrix of what can move."""
        found = mass_matrix(self._solver, self._frames, self._loads, self._pressure)
        return np.asarray(found[np.ix_(self._free, self._free)])

    @cached_property
    def _motion(self) -> Array:
        """(n, 3, 6 f), see `node_motion`."""
        found = node_motion(self._solver.section, self._frames, self._pressure)
        return found.reshape(len(found), 3, len(self._free))

    @cached_property
    def _lowest(self) -> tuple[stability.Softest, Array]:
        """The lowest eigenvalue of K v = e M v with its mode of the film's nodes, and v."""
        value, vector = eigh(self._matrix, self._mass, subset_by_index=(0, 0))
        section, whole = self._solver.section, np.zeros(len(self._free))
        whole[self._free] = vector[:, 0]
        motion = self._motion @ whole
        scale = motion.ravel()[np.argmax(np.abs(motion))]
        x, free = section.positions(self._frames, self._pressure), np.ones(motion.shape, np.bool_)
        mode, place = motion / scale, place_of_largest(section.body, x, motion, free)
        return stability.Softest(float(value[0]), mode, place), vector[:, 0]

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
            given = point_of(self._solver, self._frames, loads, pressure).loads
            found.append(self._solver.evaluate(self._frames, given, pressure).ravel()[self._free])
        return np.asarray(found[0] - found[1])

    def _tangent(self, frames: Array, loads: Loads, pressure_Pa: float) -> Array:
        whole = chain_stiffness(self._solver, frames, loads, pressure_Pa)
        return np.asarray(whole[np.ix_(self._free, self._free)])


@final
@dataclass(frozen=True)
class RestingChain:
    """A chain at rest under loads.

    Args:
        solver: of the chain.
        clamp: frames held by the flange.
        frames: (f, 4, 3).
        loads: that act.
        pressure_Pa: of the gas.
    """

    solver: ChainSolver
    clamp: FrameClamp
    frames: Array
    loads: Loads
    pressure_Pa: float

    def linear_step(self, bed: step_begin.BedNumbers) -> LinearStep:
        """Return a step of the chain.

        Args:
            bed: numbers of inertia and losses in it.
        """
        names, slopes = self._by_loads()
        size = 6 * len(self.frames)
        nodes = node_motion(self.solver.section, self.frames, self.pressure_Pa)
        nodes = nodes.reshape(len(nodes), 3, size)
        tangent = chain_stiffness(self.solver, self.frames, self.loads, self.pressure_Pa)
        mass = mass_matrix(self.solver, self.frames, self.loads, self.pressure_Pa)
        body = RestingBody(
            tangent, mass, np.zeros((size, size)), self._carried(), slopes,
            np.repeat(self.clamp.held, 6), self._supplied, self._moments(), names, self._tip(nodes, names),
            nodes,
        )  # fmt: skip
        return body.linear_step(bed)

    def _carried(self) -> Array:
        """Return R (6 f, 6): how frames move that go along with the flange."""
        found = np.zeros((len(self.frames), 6, 6))
        found[:] = np.eye(6)
        for own, frame in zip(found, self.frames, strict=True):
            own[:3, 3:] = -cross_matrix(frame[0] - self.frames[0, 0])
        return found.reshape(-1, 6)

    def _by_loads(self) -> tuple[tuple[LoadName, ...], Array]:
        """Return what loads can be commanded, and the gradient's derivatives (6 f, loads) by them."""
        solver, names, columns = self.solver, list[LoadName](), list[Array]()
        given = point_of(solver, self.frames, self.loads, self.pressure_Pa).loads
        if solver.section.gas(self.loads) is None:
            up, down = (
                solver.evaluate(self.frames, given, self.pressure_Pa + off) for off in (_PROBE_Pa, -_PROBE_Pa)
            )
            names.append(("pressure_Pa", 0))
            columns.append((up - down) / (2.0 * _PROBE_Pa))
        still = solver.evaluate(self.frames, given, self.pressure_Pa)
        for c in sorted({*range(len(given.cable_tension_N))} - {*commanded(self.loads)}):
            more = tuple(pull + (c == d) for d, pull in enumerate(given.cable_tension_N))
            names.append(("cable_tension_N", c))
            pulled = with_tensions(given, more)
            columns.append(solver.evaluate(self.frames, pulled, self.pressure_Pa) - still)
        size = 6 * len(self.frames)
        return tuple(names), np.array(columns).reshape(len(columns), size).T

    def _supplied(self, gradient: Array, end: Array) -> Array:
        """Return the change (6, columns) of what held frames are supplied with, about the flange.

        The gradient by (dr, phi) of a turned frame is that of before, its change by the symmetric tangent,
        and phi x g / 2, as turns do not commute. A lever turns with its frame.
        """
        given = point_of(self.solver, self.frames, self.loads, self.pressure_Pa).loads
        still, found = self.solver.evaluate(self.frames, given, self.pressure_Pa), np.zeros((6, end.shape[1]))
        for f in np.flatnonzero(self.clamp.held):
            own, moved = gradient[6 * f : 6 * f + 6], end[6 * f : 6 * f + 6]
            lever = self.frames[f, 0] - self.frames[0, 0]
            found += own
            found[3:] -= 0.5 * cross_matrix(still[f, 3:]) @ moved[3:]
            found[3:] += cross_matrix(lever) @ own[:3]
            found[3:] -= cross_matrix(still[f, :3]) @ (moved[:3] - end[:3])
        return found

    def _moments(self) -> Array:
        """Return the derivatives (12, 6 f) of centre and inertia of the mass."""
        count, mass = len(self.frames), self.solver.section.mass
        nothing, moved, columns = np.zeros((count, 6)), np.empty_like(self.frames), []
        for k in range(6 * count):
            step, ends = np.zeros((count, 6)), []
            step.reshape(-1)[k] = _MOTION_PROBE
            for way in (1.0, -1.0):
                change_frames(self.frames, step, way, moved)
                ends.append(figures_of(moved, self.clamp.free, mass, nothing)[CENTER:FIGURES])
            columns.append((ends[0] - ends[1]) / (2.0 * _MOTION_PROBE))
        return np.array(columns).T

    def _tip(self, nodes: Array, names: tuple[LoadName, ...]) -> Array:
        """Return the derivatives (3, 6 f + loads) of the tip's position."""
        section, tip = self.solver.section, self.solver.section.body.tip
        found = np.concatenate([nodes[tip].mean(axis=0), np.zeros((3, len(names)))], axis=1)
        if names and names[0] == ("pressure_Pa", 0):
            up, down = (
                section.positions(self.frames, self.pressure_Pa + off)[tip].mean(axis=0)
                for off in (_PROBE_Pa, -_PROBE_Pa)
            )
            found[:, nodes.shape[2]] = (up - down) / (2.0 * _PROBE_Pa)
        return found
