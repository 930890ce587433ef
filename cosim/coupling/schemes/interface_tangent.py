"""How the soft side's loads answer small motions of the flange and of touched bodies within a tick.

A small motion xi of the bodies moves their contact points by G xi and loads the film with P xi,
P = W^T C G (W: weights of the contact points, C: stiffness of each contact). The film follows by
X = K^-1 P, K the tangent of the step. What the film answers on the bodies is -(G^T C G - P^T X) xi; what
of it arrives at the flange is, by the balance of the whole film, E^T (P - W^T C W X - c m X) xi, E its
rigid motions, c the weight of inertia in the step's scheme: 1 / h^2 with implicit Euler, 9 / (4 h^2) with
BDF2, damping besides. The flange's own part is that of a rigid soft side, c E^T m E.
"""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.contact.contact_motion import rigid_motions, spread
from cosim.coupling.soft_sides.soft_side import SoftSide


def contact_tangent(
    exchange: ContactExchange, soft: SoftSide, bodies: IntArray, points: Array, step_s: float
) -> Array | None:
    """Return S (6 + 6 b, 6 + 6 b) with change of loads = -S xi, the flange's own block left zero.

    Args:
        exchange: with the planes of the step just taken.
        soft: after that step.
        bodies: (b,) that can move.
        points: (1 + b, 3) [m], that wrenches are about: of the flange, then of each body.
        step_s: h [s].

    Returns:
        None where nothing that can move is touched, or the soft side's tangent is indefinite.
    """
    planes, x = exchange.planes, soft.state.positions
    if planes is None:
        return None
    owner = planes.body
    stiffness = planes.stiffnesses(x)
    mine = np.flatnonzero(np.isin(owner, bodies) & (np.abs(stiffness).max(axis=(1, 2), initial=0.0) > 0.0))
    if not len(mine):
        return None
    nodes, weights = planes.nodes[mine], planes.weights[mine]
    point = np.einsum("ka,kar->kr", weights, x[nodes])
    place = np.searchsorted(bodies, owner[mine])
    touched = np.unique(place)
    size = 6 * (1 + len(bodies))
    columns = (6 + 6 * touched[:, None] + np.arange(6)).ravel()
    moved = np.zeros((len(mine), 3, len(touched), 6))
    moved[np.arange(len(mine)), :, np.searchsorted(touched, place)] = rigid_motions(point, points[1 + place])
    motion = moved.reshape(len(mine), 3, -1)
    push = np.einsum("krs,ksj->krj", stiffness[mine], motion)
    forces = spread(nodes, weights, push, len(x))
    following = soft.response(forces, planes, step_s)
    if following is None:
        return None
    tangent = np.zeros((size, size))
    own_block = np.einsum("kri,krj->ij", motion, push) - np.einsum("inr,jnr->ij", forces, following)
    tangent[np.ix_(columns, columns)] = own_block
    all_nodes, all_weights = planes.nodes, planes.weights
    followed = np.einsum("ka,jkar->krj", all_weights, following[:, all_nodes])
    held = spread(all_nodes, all_weights, np.einsum("krs,ksj->krj", stiffness, followed), len(x))
    kept = forces - held - soft.inertia_weight(step_s) * soft.body.node_mass[:, None] * following
    arriving = np.einsum("nri,jnr->ij", rigid_motions(x, points[0]), kept)
    tangent[:6, columns] = -arriving
    tangent[columns, :6] = -arriving.T
    return tangent
