"""The error of ticks in the motion of a soft body, mode by mode. Near the state at rest at a phase's end each
of the lowest modes, with amplitude y, satisfies y'' + a y' + w^2 y = f with damping a, frequency w and force
f. The run's integrator has solved the same for its amplitude x with differences instead of derivatives, which
gives f. The exact response to this f, linear within a tick, is integrated from the start of the run; its
difference at the end is the error of the mode. A body that is hardly filled oscillates more slowly than at
the end, so lower frequencies are tried too, and the largest error counts. Modes: Ritz vectors of the tip's
compliance, of the response to their inertia, and so on. Source: Wilson, Yuan and Dickens, Dynamic analysis by
direct superposition of Ritz vectors, Earthquake Engineering and Structural Dynamics 10 (1982).
"""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.robots.shape_moments import ShapeMoments
from cosim.soft.body.body import SoftBody
from cosim.soft.solve import stability
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.step_scheme import StepOptions

_ROUNDS: Final = 4
"""Rounds of three Ritz vectors each."""
_SLOWER: Final = (1.0, 0.7)
"""Factors on the frequencies at the end; 0.7 is half the stiffness."""
_DAMPED: Final = 0.99
"""Largest damping of a mode, over critical damping."""


def tip_pulls(body: SoftBody) -> Array:
    """Return forces (3, n, 3) that pull the tip by 1 N along each axis."""
    pull = np.zeros((3, body.nodes, 3))
    for axis in range(3):
        pull[axis, body.tip, axis] = 1.0 / len(body.tip)
    return pull


@final
@dataclass(frozen=True)
class Modes:
    """Lowest modes of a body at a state at rest.

    Args:
        rest: (n, 3) [m], the nodes there.
        frequency: (k,) [rad/s], circular.
        shape: (k, n, 3), with a mass of 1 kg.
        losses: (k,) [1/s], of materials; see `material_losses`.
    """

    rest: Array
    frequency: Array
    shape: Array
    losses: Array

    @classmethod
    def of(cls, side: FilmRobot, rest: Equilibrium) -> "Modes | None":
        """Return the modes at a state at rest; None if its tangent is not positive definite."""
        solver, body, state = side.equilibrium_solver.solver, side.body, rest.state
        frame = rest.world_from_flange.rotation
        if not solver.factorise(state.positions, state.memory, rest.loads, None, frame):
            return None
        mass, like = np.repeat(body.node_mass, 3), (3, body.nodes, 3)
        answers = solver.linear.solve_all(tip_pulls(body)).reshape(3, -1)
        basis, of_inertia = np.zeros((0, mass.size)), np.zeros((0, mass.size))
        for _ in range(_ROUNDS):
            for answer in answers:
                vector = answer
                for _again in range(2):  # rounding errors leave a part of the others
                    vector = vector - (basis * mass @ vector) @ basis
                basis = np.vstack([basis, vector / np.sqrt(mass @ vector**2)])
            answers = solver.linear.solve_all((basis[-3:] * mass).reshape(like)).reshape(3, -1)
            of_inertia = np.vstack([of_inertia, answers])
        flexibility = basis * mass @ of_inertia.T
        values, parts = np.linalg.eigh((flexibility + flexibility.T) / 2.0)
        shapes = (parts.T @ basis).reshape(-1, body.nodes, 3)
        shapes = shapes[values > 0.0]
        losses = np.array(stability.material_losses(solver.film, state.positions, shapes))
        return cls(state.positions, 1.0 / np.sqrt(values[values > 0.0]), shapes, losses)


@final
class Swings:
    """Compares the motion of a body, tick by tick, with exact oscillations.

    Args:
        body: the body.
        moments: (ticks + 1, m, 3) [kg^1/2 m], see `ShapeMoments`; the first are of a body at rest.
        tick_s: [s].
        options: of the ticks.
    """

    def __init__(self, body: SoftBody, moments: Array, tick_s: float, options: StepOptions) -> None:
        self._tick_s, self._options = tick_s, options
        self._along, self._moments = ShapeMoments(body).along, moments

    def apart(self, modes: Modes, ticks: int) -> Array:
        """Return the error (k, n, 3) [m] of each mode.

        Args:
            modes: of the body.
            ticks: number of ticks.
        """
        moved = self._moments[: ticks + 1] - self._along @ modes.rest
        amplitude = np.tensordot(moved, self._along @ modes.shape, ((1, 2), (1, 2)))
        away = [self._apart(amplitude, slower * modes.frequency, modes.losses) for slower in _SLOWER]
        return np.asarray(np.max(away, axis=0)[:, None, None] * modes.shape)

    def _apart(self, x: Array, frequency: Array, losses: Array) -> Array:
        """Return the errors (k,) of amplitudes (ticks, k) at the end, at frequencies (k,)."""
        h, declared = self._tick_s, (self._options.damping_per_s + losses) / 2.0
        damping = np.minimum(declared, _DAMPED * frequency)
        speed = self._derivative(np.concatenate([np.repeat(x[:1], 4, axis=0), x]))
        force = self._derivative(speed)[-len(x) :] + 2.0 * damping * speed[-len(x) :] + frequency**2 * x
        turning = np.sqrt(frequency**2 - damping**2)
        root = -damping + 1j * turning  # of swing = y' - conj(root) y, which is swing' = root swing + f
        grown = np.exp(root * h)
        whole, rising = (grown - 1.0) / root, (grown - 1.0 - root * h) / (root**2 * h)
        swing = -root.conj() * x[0]
        for push in whole * force[:-1] + rising * np.diff(force, axis=0):
            swing = grown * swing + push
        return np.asarray(np.abs(swing - speed[-1] + root.conj() * x[-1]) / turning)

    def _derivative(self, x: Array) -> Array:
        """Return the integrator's derivative (n - 1 or n - 2, k) of amplitudes (n, k)."""
        if self._options.integrator == "implicit_euler":
            return np.asarray(np.diff(x, axis=0) / self._tick_s)
        return np.asarray((3.0 * x[2:] - 4.0 * x[1:-1] + x[:-2]) / (2.0 * self._tick_s))
