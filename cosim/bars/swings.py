"""How far ticks have brought the motion of a soft body off, mode by mode.

Near the state at rest at a phase's end the body swings in its lowest modes, each by itself, y its share:
y'' + a y' + w^2 y = f, with damping a, frequency w, and whatever force f there is. How the run has moved says
which force that was: its integrator has solved the same for its share x, with differences in place of
derivatives. The same force, linear within a tick, is answered exactly, from the start of the run on; by how
much the two swings are apart at the end is the error of the mode. A body that is hardly filled yet swings
more slowly than at the end; so the same is done with lower frequencies, and the largest error counts.
Modes: Ritz vectors of the tip's answers to pulls on it, of the answers to their inertia, and so on.
Source: Wilson, Yuan and Dickens, Dynamic analysis by direct superposition of Ritz vectors, Earthquake
Engineering and Structural Dynamics 10 (1982).
"""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.robots.shape_moments import ShapeMoments
from cosim.soft.body.body import SoftBody
from cosim.soft.solve import stability
from cosim.soft.solve.state import Equilibrium, StepOptions

_ROUNDS: Final = 4  # of three Ritz vectors each
_SLOWER: Final = (1.0, 0.7)  # times the frequencies at the end: half the stiffness
_DAMPED: Final = 0.99  # share of the critical damping that a mode has at most


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
        """Return those at a state at rest; None where its tangent is not positive definite."""
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
                for _again in range(2):  # rounding leaves a part of the others
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
    """Compares how a body has moved, tick by tick, with exact swings.

    Args:
        body: that has moved.
        moments: (ticks + 1, m, 3) [kg^1/2 m], see `ShapeMoments`; the first are of a body at rest.
        tick_s: [s].
        options: of the ticks.
    """

    def __init__(self, body: SoftBody, moments: Array, tick_s: float, options: StepOptions) -> None:
        self._tick_s, self._options = tick_s, options
        self._along, self._moments = ShapeMoments(body).along, moments

    def apart(self, modes: Modes, ticks: int) -> Array:
        """Return shapes (k, n, 3) [m]: by how much each mode's swing is off.

        Args:
            modes: of the body.
            ticks: after how many.
        """
        moved = self._moments[: ticks + 1] - self._along @ modes.rest
        share = np.tensordot(moved, self._along @ modes.shape, ((1, 2), (1, 2)))
        away = [self._apart(share, slower * modes.frequency, modes.losses) for slower in _SLOWER]
        return np.asarray(np.max(away, axis=0)[:, None, None] * modes.shape)

    def _apart(self, x: Array, frequency: Array, losses: Array) -> Array:
        """Return how far swings (ticks, k) are off at the end, as amplitudes, at frequencies (k,)."""
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
        """Return the derivative (n - 1 or n - 2, k) of shares (n, k), as the integrator has it."""
        if self._options.integrator == "implicit_euler":
            return np.asarray(np.diff(x, axis=0) / self._tick_s)
        return np.asarray((3.0 * x[2:] - 4.0 * x[1:-1] + x[:-2]) / (2.0 * self._tick_s))
