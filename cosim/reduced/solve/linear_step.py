"""A chain at rest to first order, for `cosim.soft.solve.linear_step`: a frame moves by (dr, phi)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, cross_matrix
from cosim.reduced.sections.assembly import CENTER, FIGURES, change_frames, figures_of
from cosim.reduced.sections.section_strains import Bed
from cosim.reduced.solve.clamp import FrameClamp, node_motion
from cosim.reduced.solve.newton import ChainSolver, whole_tangent
from cosim.reduced.solve.stability import chain_stiffness
from cosim.reduced.solve.time_step import commanded, given_tensions, with_tensions
from cosim.soft.body.loads import Loads
from cosim.soft.solve.linear_step import LinearStep, LoadName, RestingBody
from cosim.soft.solve.step_begin import BedNumbers

_PROBE_Pa = 1.0
_PROBE = 1e-5  # of a motion, for centre and inertia


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

    def linear_step(self, bed: BedNumbers) -> LinearStep:
        """Return a step of the chain.

        Args:
            bed: numbers of inertia and losses in it.
        """
        names, slopes = self._by_loads()
        size = 6 * len(self.frames)
        nodes = node_motion(self.solver.section, self.frames, self.pressure_Pa)
        nodes = nodes.reshape(len(nodes), 3, size)
        tangent = chain_stiffness(self.solver, self.frames, self.loads, self.pressure_Pa)
        body = RestingBody(
            tangent, self._mass(), np.zeros((size, size)), self._carried(), slopes,
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

    def _mass(self) -> Array:
        """Return the mass matrix (6 f, 6 f)."""
        given = given_tensions(self.solver, self.frames, self.loads, self.pressure_Pa)
        moving, still = (
            whole_tangent(self.solver, self.frames, given, self.pressure_Pa, Bed(share, self.frames))
            for share in (1.0, 0.0)
        )
        return moving - still

    def _by_loads(self) -> tuple[tuple[LoadName, ...], Array]:
        """Return what loads can be commanded, and the gradient's derivatives (6 f, loads) by them."""
        solver, names, columns = self.solver, list[LoadName](), list[Array]()
        given, _ = given_tensions(solver, self.frames, self.loads, self.pressure_Pa)
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
        given, _ = given_tensions(self.solver, self.frames, self.loads, self.pressure_Pa)
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
            step.reshape(-1)[k] = _PROBE
            for way in (1.0, -1.0):
                change_frames(self.frames, step, way, moved)
                ends.append(figures_of(moved, self.clamp.free, mass, nothing)[CENTER:FIGURES])
            columns.append((ends[0] - ends[1]) / (2.0 * _PROBE))
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
