"""How stiffly a film holds on to the bodies that it touches, contacts and film in series."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.coupling.contact.contact_motion import rigid_motions, spread
from cosim.rigid.scene.bodies import Bodies
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.state import SoftState

RATIO_BOUND = 1.0
"""Algorithmic mass over a body's inertia above which the explicit exchange can grow."""
RENEW_ABOVE = 1.2
"""Growth of the contacts' own stiffness beyond which S is found anew: it grows at most in proportion."""
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
