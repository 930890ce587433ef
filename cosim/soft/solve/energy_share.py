"""How the elastic energy of a body is shared between its film and its hinges."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.hinge import add_hinges
from cosim.soft.geometry.surface import dihedral_angle

_ROUNDING_J = 1e-15
_NO_TABLE = np.zeros((0, 0), np.int64)
_NO_BLOCKS = np.zeros((0, 3, 3))


def hinge_energy_share(body: SoftBody, positions: Array) -> float:
    """Return U_hinges / (U_hinges + U_film); 0 where there is no elastic energy.

    Args:
        body: whose film and hinges.
        positions: (n, 3) [m].
    """
    x, unused = np.ascontiguousarray(positions), np.zeros_like(positions)
    film = body.membranes.add(x, _NO_TABLE, unused, _NO_BLOCKS)
    hinges = body.hinges
    angles = dihedral_angle(body.positions, hinges.nodes)
    bending: float = add_hinges(
        x, hinges.nodes, hinges.stiffness, hinges.rest_angle, hinges.fold_barrier_rad, angles, _NO_TABLE,
        unused, _NO_BLOCKS, np.empty_like(angles),
    )  # fmt: skip
    total = film + bending
    return bending / total if total > _ROUNDING_J else 0.0
