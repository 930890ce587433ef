"""One implicit step of a chain as a matrix, about a shape at rest.

A frame moves by (dr, phi); xi (6 f,) is that of all frames, eta its rate. With the scheme of
`cosim.reduced.solve.chain_step`, base and speed from the last one or two states and the target
y = base + share (speed + alpha span u) of inertia, the free frames end where

    (K + c M) xi' = c M y - G du - (K + c M) R_h df,     eta' = (xi' - base) / span,

K the tangent with sealed gas and commanded lengths in it, M the mass matrix of the frames, R_h df the held
frames on the moved flange, G the gradient's derivative by pressure and tensions. At rest points and their
targets agree, so inertia has no geometric stiffness. Losses along cables are held.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array, cross_matrix
from cosim.reduced.sections.assembly import CENTER, FIGURES, change_frames, figures_of
from cosim.reduced.sections.section_strains import Bed
from cosim.reduced.solve.chain_step import ChainScheme
from cosim.reduced.solve.clamp import FrameClamp, node_motion
from cosim.reduced.solve.newton import ChainSolver, whole_tangent
from cosim.reduced.solve.stability import chain_stiffness
from cosim.reduced.solve.time_step import commanded, given_tensions, with_tensions
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import inertia_weight

_PROBE_Pa = 1.0
_PROBE = 1e-5  # of a motion, for centre and inertia

LoadName: TypeAlias = tuple[str, int]


@final
@dataclass(frozen=True)
class LinearStep:
    """How a step of a chain ends by how it begins, to first order.

    The state (m,) is xi, eta and, with two-step integrators, both one step before.

    Args:
        matrix: (m + FIGURES, m + 6 + loads), by the state, the flange's motion (dr, phi) up to the end, and
            the loads at the end; the last rows are the figures, see `fill_figures`.
        loads: what those are, and of which chamber or cable: ("pressure_Pa", 0), ("cable_tension_N", 1).
        tip: (3, 6 f + loads), the tip's position by xi and loads at the same instant.
        nodes: (n, 3, 6 f), the film's nodes by xi.
    """

    matrix: Array
    loads: tuple[LoadName, ...]
    tip: Array
    nodes: Array

    @property
    def states(self) -> int:
        """m, the number of states."""
        return self.matrix.shape[1] - 6 - len(self.loads)


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

    def linear_step(self, scheme: ChainScheme, two_steps: bool) -> LinearStep:
        """Return the step.

        Args:
            scheme: of the step.
            two_steps: whether it looks back over two.
        """
        names, slopes = self._by_loads()
        size, carried = 6 * len(self.frames), self._carried()
        count = size * (4 if two_steps else 2)
        columns = np.eye(count + 6 + len(names))
        begin = [columns[k * size : (k + 1) * size] for k in range(count // size)]
        flange, loads = columns[count : count + 6], columns[count + 6 :]
        span = 2.0 * scheme.h / 3.0 if two_steps else scheme.h
        base, speed = begin[0], begin[1]
        along = carried @ (flange - begin[0][:6]) / span
        if two_steps:
            base, speed = (
                (4.0 * last - first) / 3.0 for last, first in ((base, begin[2]), (speed, begin[3]))
            )
            along = (4.0 * along - carried @ (flange - begin[2][:6]) / span) / 3.0
        losses = scheme.damping + scheme.air_drag
        target = base + span / (1.0 + losses * span) * (speed + scheme.damping * span * along)
        mass, bed = self._mass(), inertia_weight(span, losses)
        tangent = chain_stiffness(self.solver, self.frames, self.loads, self.pressure_Pa) + bed * mass
        end, rest = carried @ flange, slopes @ loads - bed * (mass @ target)
        free, held = np.repeat(self.clamp.free, 6), np.repeat(self.clamp.held, 6)
        pushed = tangent[np.ix_(free, held)] @ end[held] + rest[free]
        end[free] = -np.linalg.solve(tangent[np.ix_(free, free)], pushed)
        rate = (end - base) / span
        dragged = scheme.damping * (carried.T @ (mass @ (rate - along)))
        wrench = dragged - self._supplied(tangent @ end + rest, end)
        rows = np.concatenate([end, rate, *begin[:2]])[:count]
        matrix = np.concatenate([rows, wrench, self._moments() @ end])
        nodes = node_motion(self.solver.section, self.frames, self.pressure_Pa)
        nodes = nodes.reshape(len(nodes), 3, size)
        return LinearStep(matrix, names, self._tip(nodes, names), nodes)

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
