"""How stiffly a film holds on to the bodies that it touches, contacts and film in series."""

from __future__ import annotations

import numpy as np

from cosim.coupling.contact import ContactExchange
from cosim.coupling.soft_side import SoftSide
from cosim.frames import Array, IntArray, cross_matrix
from cosim.soft.contact import ContactPlanes


def body_stiffness(
    exchange: ContactExchange,
    soft: SoftSide,
    planes: ContactPlanes,
    tangents: Array,
    bodies: IntArray,
    tick_s: float,
) -> Array:
    """Return S = G^T (K - K W H^-1 W^T K) G (6 b, 6 b): change of contact loads per motion of the bodies.

    G moves the contact points with the bodies, K are the contacts' tangents, W^T spreads forces to the
    nodes, H is the tangent of the film's time step.

    Args:
        exchange: contacts.
        soft: soft side, after its step.
        planes: contacts with slack stick springs.
        tangents: K (k, 3, 3) [N/m], of all contacts.
        bodies: (b,) touched ones.
        tick_s: length of the step [s].

    Returns:
        For each body along world axes [N/m], then about its own axes [N m], about its origin.
    """
    owner = exchange.query.body[exchange.shape]
    mine = np.flatnonzero(np.isin(owner, bodies))
    place = np.searchsorted(bodies, owner[mine])
    positions = soft.state.positions
    nodes, weights = planes.nodes[mine], planes.weights[mine]
    arm = np.einsum("ka,kar->kr", weights, positions[nodes]) - exchange.bodies.origins(bodies)[place]
    turns = exchange.bodies.rotations(bodies)[place]
    moved = np.zeros((len(mine), 3, len(bodies), 6))  # the points with their body: G = [1, -S(arm) R]
    at = np.arange(len(mine))
    moved[at, :, place, :3] = np.eye(3)
    moved[at, :, place, 3:] = [-cross_matrix(a) @ turn for a, turn in zip(arm, turns, strict=True)]
    motion = moved.reshape(len(mine), 3, -1)
    push = np.einsum("krs,ksj->krj", tangents[mine], motion)
    pushed = np.zeros((len(positions), motion.shape[2], 3))
    for a in range(3):
        np.add.at(pushed, nodes[:, a], weights[:, a, None, None] * push.transpose(0, 2, 1))
    forces = np.ascontiguousarray(pushed.transpose(1, 0, 2))
    stiffness = np.einsum("kri,krj->ij", motion, push)
    following = soft.response(forces, planes, tick_s)
    if following is not None:
        stiffness -= np.einsum("inr,jnr->ij", forces, following)
    return np.asarray(stiffness)
