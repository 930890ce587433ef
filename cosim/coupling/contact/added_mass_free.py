"""The algorithmic mass with which a film answers a free body that it touches, carried as armature.

A contact force that is one tick old must not drive a body lighter than the film's own answer: over a tick h a
change dv of the body's velocity changes the contact force by -S h dv, S the stiffness of contacts and film in
series, film inertia included. D = theta diag(h^2 S) is not below h^2 S, theta the least factor for that. The
body carries what it lacks, A = max(0, D / bound - m), as extra inertia: with m + A it is no lighter than one
that needs to carry nothing. The price: it also is that much more inert while it is touched.

A body gains no energy in a bounce as long as A does not fall meanwhile: with the inertia m + A it came, with
m + A it leaves, no faster. So D is kept while any force acts, fades over a time far longer than a bounce, and
is found anew where that gives more. The first force of a touch F stops a body that comes with speed u against
film of speed w at most: D is at least h F / (u + w), unless the contacts alone, h^2 sum k, are softer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.contact.added_mass_jointed import JointedMass, JointedMassState
from cosim.coupling.contact.body_stiffness import (
    RATIO_BOUND,
    RENEW_ABOVE,
    Yielding,
    body_stiffness,
    ticks_to_renewal,
)
from cosim.coupling.contact.contact_arrays import AGE
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.soft.contact.obstacle_contact import ContactPlanes

_FADING_S: Final = 0.5
"""D falls to 1/e in this time where S has fallen; a bounce takes some 0.01 to 0.05 s."""


@final
@dataclass(frozen=True)
class BodyMassState:
    """Where a `BodyMass` is: the arguments are its attributes of these names."""

    touching: Array
    renewed: Array
    added: Array
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

    def __init__(self, exchange: ContactExchange, soft: Yielding, tick_s: float) -> None:
        self._exchange, self._soft, self._tick_s = exchange, soft, tick_s
        free = exchange.bodies.free
        self._inertia = exchange.bodies.inertia(free)
        # stiffness of the contacts alone when D was last renewed; which bodies keep anything
        self._touching, self._weighed = exchange.arrays.touching, exchange.arrays.weighed
        self._renewed = np.zeros((len(free), 6))
        self._added = np.zeros((len(free), 6))
        self._renew_after = ticks_to_renewal(tick_s)
        exchange.ask_for_weighing_after(self._renew_after)
        self._free_ratio = 0.0
        self._jointed = JointedMass(exchange, soft, tick_s)

    @property
    def ratio(self) -> float:
        """Largest algorithmic mass over inertia of a body that moves with it; its part above 1 is carried."""
        return max(self._free_ratio, self._jointed.ratio)

    def update(self, *, carry: bool = True) -> None:
        """Bring the carried mass up to date after a soft step, where that asks for it.

        Args:
            carry: whether bodies do carry it; otherwise only its ratio to them is found.
        """
        if not self._exchange.asks_for_weighing:
            return
        planes = self._exchange.sticking
        if planes is None:
            self._jointed.update(None, np.zeros(0), carry=carry)
            self._let_go()
            return
        self._jointed.update(planes, self._exchange.held_N_m, carry=carry)
        if len(self._inertia):
            self._update_free(planes, carry)
            self._weighed[:] = (self._touching != 0.0) | self._renewed.any(axis=1)

    def _let_go(self) -> None:
        if self._touching.any():
            self._carry(np.zeros_like(self._added))
            self._touching[:] = self._renewed[:] = self._free_ratio = 0.0
            self._weighed[:] = 0

    def _update_free(self, planes: ContactPlanes, carry: bool) -> None:
        bodies = self._exchange.bodies
        # friction may act for a tick after the last contact has come off
        loaded = bodies.free_loaded()
        ended = self._renewed[~loaded].any()
        self._touching[~loaded] = self._renewed[~loaded] = 0.0
        begins = loaded & (self._touching == 0.0)
        total = self._exchange.held_N_m[bodies.free]
        counts = self._exchange.arrays.counts
        due = counts[AGE] >= self._renew_after or (total > RENEW_ABOVE * self._touching).any()
        if not (due or ended or begins.any()):
            return
        if due:
            self._renewed *= math.exp(-int(counts[AGE]) * self._tick_s / _FADING_S)
            counts[AGE] = 0
            self._touching[:] = np.where(loaded, total, 0.0)
            tangents = planes.tangents(self._soft.state.positions)
            for k in np.flatnonzero(total > 0.0).tolist():
                self._renewed[k] = np.maximum(self._renewed[k], self._mass(k, planes, tangents))
        if begins.any():
            least = self._stopping_mass(total)[begins, None]
            self._renewed[begins, :3] = np.maximum(self._renewed[begins, :3], least)
        self._free_ratio = float((self._renewed / self._inertia).max(initial=0.0))
        lacking = np.maximum(self._renewed / RATIO_BOUND - self._inertia, 0.0)
        self._carry(np.where(loaded[:, None] & carry, lacking, 0.0))

    def _stopping_mass(self, stiffness: Array) -> Array:
        """Return with which D (free bodies,) [kg] the forces stop the bodies within a tick, or less.

        Args:
            stiffness: (free bodies,) [N/m], of the contacts alone.
        """
        bodies, h = self._exchange.bodies, self._tick_s
        impulse = h * np.linalg.norm(bodies.received(bodies.free)[:, :3], axis=1)
        speed = bodies.free_speeds() + self._exchange.film_speed_m_s
        most = h * h * stiffness
        return np.where(impulse < most * speed, impulse / np.where(speed > 0.0, speed, 1.0), most)

    def save_state(self) -> BodyMassState:
        """Return what the next update depends on."""
        free = self._touching.copy(), self._renewed.copy(), self._added, self._free_ratio
        return BodyMassState(*free, self._jointed.save_state())

    def restore_state(self, state: BodyMassState) -> None:
        """Return to a state of `save_state`; the scene, which carries the mass, has been restored before."""
        self._touching[:], self._renewed = state.touching, state.renewed.copy()
        self._weighed[:] = (self._touching != 0.0) | self._renewed.any(axis=1)
        self._added, self._free_ratio = state.added, state.free_ratio
        self._jointed.restore_state(state.jointed)

    def _carry(self, added: Array) -> None:
        if (added != self._added).any():
            self._exchange.bodies.set_added_armature(added)
            self._added = added

    def _mass(self, k: int, planes: ContactPlanes, tangents: Array) -> Array:
        """Return D (6,) of the k-th free body: along world axes, then about body axes."""
        body = self._exchange.bodies.free[k : k + 1]
        stiffness = body_stiffness(self._exchange.bodies, self._soft, planes, tangents, body, self._tick_s)
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
