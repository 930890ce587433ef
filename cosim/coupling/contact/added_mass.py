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

Of bodies that hang on joints (hinged planks, segments of a wire) D bounds h^2 S by blocks:
D_b = theta h^2 S_bb for every touched body, theta the least factor for which the blocks are not below the
whole. They act through the joints, J^T c D J on the mass matrix, where r = max eig(J M^-1 J^T D) exceeds the
bound b: c = 1 / b - 1 / r is the least factor with which
max eig(J (M + J^T c D J)^-1 J^T D) = r / (1 + c r) does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final, Protocol, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.coupling.contact.contact_arrays import AGE
from cosim.coupling.contact.contact_exchange import RENEW_ABOVE, ContactExchange
from cosim.rigid.scene.bodies import Bodies
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.state import SoftState


def rigid_motions(points: Array, origins: Array) -> Array:
    """Return how points (k, 3) [m] move (k, 3, 6) with translation and rotation about origins: [1, -S(arm)].

    Args:
        points: (k, 3) [m].
        origins: (3,) [m], of all, or (k, 3), of each.
    """
    motion = np.zeros((len(points), 3, 6))
    motion[:, :, :3] = np.eye(3)
    x, y, z = (points - origins).T
    motion[:, 0, 4], motion[:, 0, 5] = z, -y
    motion[:, 1, 3], motion[:, 1, 5] = -z, x
    motion[:, 2, 3], motion[:, 2, 4] = y, -x
    return motion


def spread(nodes: IntArray, weights: Array, push: Array, count: int) -> Array:
    """Return forces (j, n, 3) [N] on nodes from forces at contact points.

    Args:
        nodes: (k, 3) that each point combines.
        weights: (k, 3).
        push: (k, 3, j) [N], j cases.
        count: n.
    """
    total = np.zeros((count, push.shape[2], 3))
    for a in range(nodes.shape[1]):
        np.add.at(total, nodes[:, a], weights[:, a, None, None] * push.transpose(0, 2, 1))
    return np.ascontiguousarray(total.transpose(1, 0, 2))


RATIO_BOUND = 1.0
"""Algorithmic mass over a body's inertia above which the explicit exchange can grow."""
_RENEW_AFTER_S, _FEWEST_TICKS, _MOST_TICKS = 0.1, 10, 50


def ticks_to_renewal(tick_s: float) -> int:
    """Return after how many ticks of a length [s] S is found anew where nothing else asks for it."""
    return min(max(_FEWEST_TICKS, round(_RENEW_AFTER_S / tick_s)), _MOST_TICKS)


class Yielding(Protocol):
    """What gives way to forces on its nodes within a tick: the soft side."""

    @property
    def state(self) -> SoftState:
        """State after the newest step."""

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return (m, n, 3) [m] under forces (m, n, 3) [N]; None where the tangent is indefinite."""


def body_stiffness(
    scene: Bodies,
    soft: Yielding,
    planes: ContactPlanes,
    tangents: Array,
    bodies: IntArray,
    tick_s: float,
) -> Array:
    """Return S = G^T (K - K W H^-1 W^T K) G (6 b, 6 b): change of contact loads per motion of the bodies.

    G moves the contact points with the bodies, K are the contacts' tangents, W^T spreads forces to the
    nodes, H is the tangent of the film's time step.

    Args:
        scene: its bodies.
        soft: soft side, after its step.
        planes: contacts with slack stick springs.
        tangents: K (k, 3, 3) [N/m], of all contacts.
        bodies: (b,) touched ones.
        tick_s: length of the step [s].

    Returns:
        For each body along world axes [N/m], then about its own axes [N m], about its origin.
    """
    mine = np.flatnonzero(np.isin(planes.body, bodies))
    place = np.searchsorted(bodies, planes.body[mine])
    positions = soft.state.positions
    nodes, weights = planes.nodes[mine], planes.weights[mine]
    points = np.einsum("ka,kar->kr", weights, positions[nodes])
    with_body = rigid_motions(points, scene.origins(bodies)[place])
    with_body[:, :, 3:] = with_body[:, :, 3:] @ scene.rotations(bodies)[place]
    moved = np.zeros((len(mine), 3, len(bodies), 6))  # the points with their body: G = [1, -S(arm) R]
    moved[np.arange(len(mine)), :, place] = with_body
    motion = moved.reshape(len(mine), 3, -1)
    push = np.einsum("krs,ksj->krj", tangents[mine], motion)
    forces = spread(nodes, weights, push, len(positions))
    stiffness = np.einsum("kri,krj->ij", motion, push)
    following = soft.response(forces, planes, tick_s)
    if following is not None:
        stiffness -= np.einsum("inr,jnr->ij", forces, following)
    return np.asarray(stiffness)


@final
@dataclass(frozen=True)
class JointedMassState:
    """Where a `JointedMass` is: the arguments are its attributes of these names."""

    touched: Annotated[IntArray, ("k",)]
    stiffness: Annotated[Array, ("k",)]
    age: int
    ratio: float


@final
class JointedMass:
    """Keeps what bodies on joints carry up to date, if there are `any`.

    Args:
        exchange: contacts.
        soft: soft side.
        tick_s: h [s].
    """

    def __init__(self, exchange: ContactExchange, soft: Yielding, tick_s: float) -> None:
        self._exchange, self._soft, self._tick_s = exchange, soft, tick_s
        self.any = len(exchange.bodies.on_joints(np.unique(exchange.query.body))) > 0
        self._touched: IntArray = np.zeros(0, np.int64)
        self._stiffness = np.zeros(0)  # of the contacts alone when D was last renewed
        self._age, self._renew_after = 0, ticks_to_renewal(tick_s)
        self.ratio = 0.0

    def update(self, planes: ContactPlanes | None, held_N_m: Array, *, carry: bool = True) -> None:
        """Bring the carried mass up to date after a soft step.

        Args:
            planes: contacts with slack stick springs; None for none.
            held_N_m: (bodies,), of the contacts with each body.
            carry: whether bodies do carry it; otherwise only its ratio to them is found.
        """
        bodies = self._exchange.bodies
        if not self.any:
            return
        touched = bodies.on_joints(np.flatnonzero(held_N_m))
        total = held_N_m[touched]
        self._age += 1
        same = np.array_equal(touched, self._touched) and not (total > RENEW_ABOVE * self._stiffness).any()
        if same and (self._age < self._renew_after or not len(touched)):
            return
        self._age, self._touched, self._stiffness, self.ratio = 0, touched, total, 0.0
        if planes is None or not len(touched):
            bodies.carried.carry(touched, np.zeros((0, 6, 6)))
            return
        inertia = self._inertia(planes, touched)
        mobility = bodies.carried.mobility(touched)
        places = np.arange(6 * len(touched)).reshape(-1, 6)
        joint = np.zeros_like(mobility)
        for block, own in zip(inertia, places, strict=True):
            joint[np.ix_(own, own)] = block
        self.ratio = float(np.linalg.eigvals(mobility @ joint).real.max())
        if carry and self.ratio > RATIO_BOUND:
            bodies.carried.carry(touched, (1.0 / RATIO_BOUND - 1.0 / self.ratio) * inertia)
        else:
            bodies.carried.carry(touched[:0], inertia[:0])

    def save_state(self) -> JointedMassState:
        """Return what the next update depends on."""
        return JointedMassState(self._touched, self._stiffness, self._age, self.ratio)

    def restore_state(self, state: JointedMassState) -> None:
        """Return to a state of `save_state`; the scene, which carries the mass, has been restored before."""
        self._touched, self._stiffness = state.touched, state.stiffness
        self._age, self.ratio = state.age, state.ratio

    def _inertia(self, planes: ContactPlanes, touched: IntArray) -> Array:
        """Return D (b, 6, 6), body axes."""
        tangents = planes.tangents(self._soft.state.positions)
        whole = body_stiffness(self._exchange.bodies, self._soft, planes, tangents, touched, self._tick_s)
        blocks = bounding_blocks(whole)
        turn = np.tile(np.eye(6), (len(touched), 1, 1))
        turn[:, :3, :3] = self._exchange.bodies.rotations(touched)
        return np.asarray(self._tick_s**2 * np.einsum("bji,bjk,bkl->bil", turn, blocks, turn))


def bounding_blocks(matrix: Array) -> Array:
    """Return the least multiple (b, 6, 6) of a matrix's diagonal blocks that is not below the matrix.

    Args:
        matrix: (6 b, 6 b), symmetric and not indefinite.
    """
    count = len(matrix) // 6
    blocks = np.array([matrix[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(count)])
    blocks = 0.5 * (blocks + blocks.transpose(0, 2, 1))
    value, vector = np.linalg.eigh(blocks)
    # directions that no contact resists are left out of the ratio, they are not in the whole either
    kept = value > 1e-9 * value.max()
    inverse = np.where(kept, 1.0 / np.sqrt(np.where(kept, value, 1.0)), 0.0)
    scaled = np.zeros_like(matrix)
    for k in range(count):
        scaled[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = vector[k] * inverse[k]
    largest = float(np.linalg.eigvalsh(scaled.T @ matrix @ scaled).max(initial=0.0))
    return np.asarray(
        max(largest, 1.0) * np.einsum("bij,bj,bkj->bik", vector, np.maximum(value, 0.0), vector)
    )


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
