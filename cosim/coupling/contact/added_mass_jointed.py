"""The algorithmic mass of a film on bodies that hang on joints: hinged planks, segments of a wire.

As for free bodies (see `body_mass`) D bounds h^2 S, here by blocks: D_b = theta h^2 S_bb for every touched
body, theta the least factor for which the blocks are not below the whole. They act through the joints,
J^T c D J on the mass matrix, where r = max eig(J M^-1 J^T D) exceeds the bound b: c = 1 / b - 1 / r is the
least factor with which max eig(J (M + J^T c D J)^-1 J^T D) = r / (1 + c r) does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.coupling.contact.body_stiffness import (
    RATIO_BOUND,
    RENEW_ABOVE,
    Yielding,
    body_stiffness,
    ticks_to_renewal,
)
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.soft.contact.obstacle_contact import ContactPlanes


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
