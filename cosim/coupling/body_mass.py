"""The algorithmic mass with which a film answers a free body that it touches, carried as armature.

A contact force that is one tick old must not drive a body lighter than the film's own answer: over a tick h a
change dv of the body's velocity changes the contact force by -S h dv, S the stiffness of contacts and film in
series, film inertia included. The body carries D = theta diag(h^2 S) as extra inertia, theta the least
factor for which D is not below h^2 S. The price: it also is that much more inert while it is touched.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.coupling.contact import ContactExchange
from cosim.coupling.soft_side import SoftSide
from cosim.frames import Array, cross_matrix
from cosim.soft.contact import ContactPlanes

_RENEW_EVERY_TICKS = 10
_RATIO_BOUND = 1.0  # above it the explicit exchange can grow


@final
@dataclass(frozen=True)
class BodyMassState:
    """Where a `BodyMass` is: the arguments are its attributes of these names."""

    touching: Array
    renewed: Array
    added: Array
    age: int
    ratio: float


@final
class BodyMass:
    """Keeps the armature of the free bodies up to date.

    Args:
        exchange: contacts.
        soft: soft side.
        tick_s: h [s].
    """

    def __init__(self, exchange: ContactExchange, soft: SoftSide, tick_s: float) -> None:
        self._exchange, self._soft, self._tick_s = exchange, soft, tick_s
        free = exchange.bodies.free
        self._inertia = exchange.bodies.inertia(free)
        self._touching = np.zeros(len(free))  # stiffness of the contacts alone when D was last renewed
        self._renewed = np.zeros((len(free), 6))
        self._added = np.zeros((len(free), 6))
        self._age = 0
        self.ratio = 0.0

    def update(self) -> None:
        """Bring the carried mass up to date after a soft step."""
        planes = self._exchange.sticking
        if planes is None or not len(self._inertia):
            if self.ratio:
                self._carry(np.zeros_like(self._added))
                self._touching[:] = 0.0
                self.ratio = 0.0
            return
        tangents = planes.tangents(self._soft.state.positions)
        stiffness = np.trace(tangents, axis1=1, axis2=2)
        owner = self._exchange.query.body[self._exchange.shape]
        total = np.array([stiffness[owner == body].sum() for body in self._exchange.bodies.free])
        self._age += 1
        # contacts that have come since make it stiffer, at most in proportion
        grown = (total > 1.2 * self._touching).any()
        if grown or self._age >= _RENEW_EVERY_TICKS:
            self._age = 0
            self._touching = total
            for k in range(len(total)):
                self._renewed[k] = self._mass(k, planes, tangents) if total[k] > 0.0 else 0.0
        ratio = (self._renewed / self._inertia).max(axis=1)
        self.ratio = float(ratio.max(initial=0.0))
        heavy = (ratio > _RATIO_BOUND) & (total > 0.0)
        self._carry(np.where(heavy[:, None], self._renewed, 0.0))

    def save_state(self) -> BodyMassState:
        """Return what the next update depends on."""
        return BodyMassState(self._touching.copy(), self._renewed.copy(), self._added, self._age, self.ratio)

    def restore_state(self, state: BodyMassState) -> None:
        """Return to a state of `save_state`; the scene, which carries the mass, has been restored before."""
        self._touching, self._renewed = state.touching.copy(), state.renewed.copy()
        self._added, self._age, self.ratio = state.added, state.age, state.ratio

    def added_to(self, name: str) -> Array:
        """Return what a free body carries (6,): along world axes [kg], then about body axes [kg m^2]."""
        bodies = self._exchange.bodies
        return np.array(self._added[bodies.names(bodies.free).index(name)])

    def _carry(self, added: Array) -> None:
        if (added != self._added).any():
            self._exchange.bodies.set_added_armature(added)
            self._added = added

    def _mass(self, k: int, planes: ContactPlanes, tangents: Array) -> Array:
        """Return D (6,) of the k-th free body: along world axes, then about body axes."""
        exchange, positions = self._exchange, self._soft.state.positions
        body = exchange.bodies.free[k : k + 1]
        mine = np.flatnonzero(exchange.query.body[exchange.shape] == body[0])
        nodes, weights = planes.nodes[mine], planes.weights[mine]
        point = np.einsum("ka,kar->kr", weights, positions[nodes])
        arm = point - exchange.bodies.origins(body)
        motion = np.zeros((len(mine), 3, 6))  # of the points with the body: G = [1, -S(arm) R]
        motion[:, :, :3] = np.eye(3)
        turn = exchange.bodies.rotations(body)[0]
        motion[:, :, 3:] = [-cross_matrix(a) @ turn for a in arm]
        push = np.einsum("krs,ksj->krj", tangents[mine], motion)
        pushed = np.zeros((len(positions), 6, 3))
        for a in range(3):
            np.add.at(pushed, nodes[:, a], weights[:, a, None, None] * push.transpose(0, 2, 1))
        forces = np.ascontiguousarray(pushed.transpose(1, 0, 2))
        following = self._soft.response(forces, planes, self._tick_s)
        stiffness = np.einsum("kri,krj->ij", motion, push)
        if following is not None:
            stiffness -= np.einsum("inr,jnr->ij", forces, following)
        return self._tick_s**2 * bounding_diagonal(stiffness)


def bounding_diagonal(matrix: Array) -> Array:
    """Return the least multiple (n,) of a matrix's diagonal that is not below the matrix.

    Args:
        matrix: (n, n), symmetric and not indefinite.
    """
    diagonal = np.maximum(np.diag(matrix), 0.0)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    largest = float(np.linalg.eigvalsh(scale[:, None] * matrix * scale).max(initial=0.0))
    return np.asarray(max(largest, 1.0) * diagonal)
