"""A linearised film at rest, reduced to few of its motions, for `cosim.soft.solve.linear_step`.

Coordinates are the flange's motion (dr, phi), with which all nodes move, and amplitudes of motions V of the
free nodes, orthonormal by mass. V spans the slowest natural modes, the static response to each load, and the
lag behind the flange as that accelerates. So modes in V and slow changes are exact; faster modes respond
statically. With as many modes as free components the model is complete.
Source: Craig and Kurdila, Fundamentals of Structural Dynamics, chapter 17 (static and natural modes).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix
from cosim.errors import InputError
from cosim.soft.body.loads import Loads
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.solve import frozen_tangent, lowest_mode, newton, step_prediction
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.linear_step import LinearStep, LoadName, RestingBody
from cosim.soft.solve.state import SoftState

_SAME: Final = 1e-7  # singular value over the largest one, below which motions are linearly dependent
_MOVED_m: Final = 1e-7
_PRESSED_Pa, _PULLED_N = 1e4, 1.0  # steps of differences; the gradient is linear in both


@final
@dataclass(frozen=True)
class RestingFilm:
    """A film at rest under loads.

    Args:
        solver: Newton's method of symmetric tangents for the body; its factorisation is lost.
        clamp: nodes held by the flange.
        flange: its pose.
        state: of the film.
        loads: that act.
    """

    solver: newton.NewtonSolver
    clamp: Clamp
    flange: Pose
    state: SoftState
    loads: Loads

    def linear_step(self, coefficients: step_prediction.StepCoefficients, motions: int) -> LinearStep:
        """Return a step of the film.

        Args:
            coefficients: of the step.
            motions: number of natural modes in V, at most.

        Raises:
            InputError: nodes have no mass, or ends are open.
        """
        film, mass = self.solver.film, self.solver.film.body.node_mass
        if not (mass > 0.0).all():
            raise InputError("a linear model needs mass on all nodes; set soft_robot.mass or densities")
        if not film.conservative:
            raise InputError("a linear model needs closed ends: set model.closed = true")
        names, slopes, gradient_at_rest = self._by_loads()
        self._gradient(self.loads, hessian=True)
        tangent = frozen_tangent.FrozenTangent.of(film, self.state.positions)
        carried = self._carried()
        pushes = np.concatenate([slopes, tangent.times(carried), mass[:, None, None] * carried], axis=2)
        v = np.concatenate([carried, self._motions(pushes, motions)], axis=2)
        flat = v.reshape(-1, v.shape[2])
        stiffness = flat.T @ tangent.times(v).reshape(flat.shape)
        inertia = flat.T @ (np.repeat(mass, 3)[:, None] * flat)
        held = np.arange(v.shape[2]) < 6
        tip = np.concatenate([v[film.body.tip].mean(axis=0), np.zeros((3, len(names)))], axis=1)
        flange_motions = np.eye(v.shape[2])[:, :6]
        body = RestingBody(
            stiffness, inertia, self._losses(v), flange_motions, flat.T @ slopes.reshape(len(flat), -1),
            held, self._supplied(gradient_at_rest), self._moments(v), names, tip, v,
        )  # fmt: skip
        return body.linear_step(coefficients)

    def _gradient(self, loads: Loads, *, hessian: bool = False) -> Array:
        film, state = self.solver.film, self.state
        losses = film.losses_at(state.positions, loads, state.memory)
        film.evaluate(state.positions, loads, losses, state.memory, hessian=hessian)
        return film.gradient.copy()

    def _by_loads(self) -> tuple[tuple[LoadName, ...], Array, Array]:
        """Return the commanded loads, the gradient's derivatives (n, 3, loads) by them, and the gradient."""
        loads, count = self.loads, self.solver.film.gas.count
        gradient, pressures = self._gradient(loads), loads.pressures(count)
        pulls = loads.cable_tension_N
        names, columns = list[LoadName](), list[Array]()
        for k, gas in enumerate(loads.gases(count)):
            if gas is None:
                changed = (*pressures[:k], pressures[k] + _PRESSED_Pa, *pressures[k + 1 :])
                names.append(("pressure_Pa", k))
                columns.append((self._gradient(replace(loads, pressure_Pa=changed)) - gradient) / _PRESSED_Pa)
        lengths = loads.cable_length_m or (None,) * len(pulls)
        for k in (k for k, length in enumerate(lengths) if length is None):
            changed = (*pulls[:k], pulls[k] + _PULLED_N, *pulls[k + 1 :])
            names.append(("cable_tension_N", k))
            columns.append((self._gradient(replace(loads, cable_tension_N=changed)) - gradient) / _PULLED_N)
        slopes = np.array(columns).reshape(len(columns), *gradient.shape)
        return tuple(names), np.moveaxis(slopes, 0, 2), gradient

    def _carried(self) -> Array:
        """Return the motion of nodes (n, 3, 6) that move with the flange's (dr, phi)."""
        arms = self.state.positions - self.flange.translation
        rigid_motions = np.zeros((len(arms), 3, 6))
        rigid_motions[:, :, :3] = np.eye(3)
        rigid_motions[:, :, 3:] = [-cross_matrix(arm) for arm in arms]
        return rigid_motions

    def _motions(self, pushes: Array, count: int) -> Array:
        """Return V (n, 3, k), orthonormal by mass.

        Args:
            pushes: (n, 3, pushes) [N], whose static responses V includes.
            count: of natural modes.
        """
        solver, mass = self.solver, self.solver.film.body.node_mass
        root = np.sqrt(mass)[:, None, None]
        if count >= np.count_nonzero(solver.free):
            free = np.flatnonzero(solver.free)
            return np.eye(solver.free.size)[:, free].reshape(*solver.free.shape, -1) / root
        frame = self.flange.rotation
        slowest = lowest_mode.lowest_mode(solver, self.state, self.loads, frame, mass, count)
        loaded = np.ascontiguousarray(np.moveaxis(np.where(solver.free[..., None], pushes, 0.0), 2, 0))
        shapes = np.concatenate([slowest.shapes, solver.linear.solve_all(loaded)])
        weighted = np.where(solver.free[..., None], root * np.moveaxis(shapes, 0, 2), 0.0)
        columns = weighted.reshape(-1, len(shapes))
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        left_vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        basis = left_vectors[:, sizes > _SAME * sizes[0]]
        return basis.reshape(*solver.free.shape, -1) / root

    def _losses(self, v: Array) -> Array:
        """Return the viscous losses (k, k) of materials for motions v (n, 3, k)."""
        film, x = self.solver.film, self.state.positions
        rates = StrainRates.of(film.body)
        if rates is None:
            return np.zeros((v.shape[2], v.shape[2]))
        rates.begin(x, None, 1.0)
        steps = _MOVED_m / np.abs(v).max(axis=(0, 1))
        ends = [
            [rates.gradient(np.ascontiguousarray(x + sign * step * v[:, :, k])) for sign in (1.0, -1.0)]
            for k, step in enumerate(steps)
        ]
        forces = np.array(
            [
                (forward - backward).ravel() / (2.0 * step)
                for (forward, backward), step in zip(ends, steps, strict=True)
            ]
        )
        losses = forces @ v.reshape(-1, v.shape[2])
        return np.asarray(0.5 * (losses + losses.T))

    def _supplied(self, gradient_at_rest: Array) -> Callable[[Array, Array], Array]:
        """Return the change of the flange's reaction as a function, see `RestingBody`.

        Lever arms of held nodes turn with the flange; the residual of free nodes is zero.

        Args:
            gradient_at_rest: (n, 3) [N].
        """
        reaction = self.clamp.reaction(gradient_at_rest)
        arms = self.state.positions[self.clamp.nodes] - self.flange.translation
        turns = [np.cross(np.cross(axis, arms), reaction).sum(axis=0) for axis in np.eye(3)]

        def supplied(gradient: Array, end: Array) -> Array:
            reaction_change = gradient[:6].copy()
            reaction_change[3:] += np.array(turns).T @ end[3:6]
            return reaction_change

        return supplied

    def _moments(self, v: Array) -> Array:
        """Return the derivatives (12, k) of centre and inertia about it."""
        mass, x = self.solver.film.body.node_mass, self.state.positions
        center = np.einsum("n,nrk->rk", mass, v) / mass.sum()
        from_center = x - mass @ x / mass.sum()
        mixed = np.einsum("n,nr,nsk->rsk", mass, from_center, v)
        inertia = 2.0 * np.einsum("rrk,st->stk", mixed, np.eye(3)) - mixed - mixed.swapaxes(0, 1)
        return np.concatenate([center, inertia.reshape(9, -1)])
