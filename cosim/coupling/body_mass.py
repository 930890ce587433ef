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

from cosim.coupling.body_stiffness import RATIO_BOUND, RENEW_ABOVE, RENEW_EVERY_TICKS, body_stiffness
from cosim.coupling.contact import ContactExchange
from cosim.coupling.jointed_mass import JointedMass, JointedMassState
from cosim.coupling.soft_side import SoftSide
from cosim.frames import Array
from cosim.soft.contact import ContactPlanes


@final
@dataclass(frozen=True)
class BodyMassState:
    """Where a `BodyMass` is: the arguments are its attributes of these names."""

    touching: Array
    renewed: Array
    added: Array
    age: int
    free_ratio: float
    jointed: JointedMassState


@final
class BodyMass:
    """Keeps the armature of the free bodies, and what bodies on joints carry, up to date.

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
        self._free_ratio = 0.0
        self._jointed = JointedMass(exchange, soft, tick_s)

    @property
    def ratio(self) -> float:
        """Largest algorithmic mass over the inertia of a body that moves with it; carried above 1."""
        return max(self._free_ratio, self._jointed.ratio)

    def update(self, *, carry: bool = True) -> None:
        """Bring the carried mass up to date after a soft step.

        Args:
            carry: whether bodies do carry it; otherwise only its ratio to them is found.
        """
        planes = self._exchange.sticking
        if planes is None:
            self._jointed.update(None, np.zeros(0), carry=carry)
            self._let_go()
            return
        tangents = planes.tangents(self._soft.state.positions)
        stiffness = np.trace(tangents, axis1=1, axis2=2)
        self._jointed.update(planes, stiffness, carry=carry)
        if len(self._inertia):
            self._update_free(planes, tangents, stiffness, carry)

    def _let_go(self) -> None:
        if self._free_ratio:
            self._carry(np.zeros_like(self._added))
            self._touching[:] = 0.0
            self._free_ratio = 0.0

    def _update_free(self, planes: ContactPlanes, tangents: Array, stiffness: Array, carry: bool) -> None:
        owner = self._exchange.query.body[self._exchange.shape]
        total = np.array([stiffness[owner == body].sum() for body in self._exchange.bodies.free])
        self._age += 1
        grown = (total > RENEW_ABOVE * self._touching).any()
        if grown or self._age >= RENEW_EVERY_TICKS:
            self._age = 0
            self._touching = total
            for k in range(len(total)):
                self._renewed[k] = self._mass(k, planes, tangents) if total[k] > 0.0 else 0.0
        ratio = (self._renewed / self._inertia).max(axis=1)
        self._free_ratio = float(ratio.max(initial=0.0))
        heavy = (ratio > RATIO_BOUND) & (total > 0.0) & carry
        self._carry(np.where(heavy[:, None], self._renewed, 0.0))

    def save_state(self) -> BodyMassState:
        """Return what the next update depends on."""
        free = self._touching.copy(), self._renewed.copy(), self._added, self._age, self._free_ratio
        return BodyMassState(*free, self._jointed.save_state())

    def restore_state(self, state: BodyMassState) -> None:
        """Return to a state of `save_state`; the scene, which carries the mass, has been restored before."""
        self._touching, self._renewed = state.touching.copy(), state.renewed.copy()
        self._added, self._age, self._free_ratio = state.added, state.age, state.free_ratio
        self._jointed.restore_state(state.jointed)

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
        body = self._exchange.bodies.free[k : k + 1]
        stiffness = body_stiffness(self._exchange, self._soft, planes, tangents, body, self._tick_s)
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
