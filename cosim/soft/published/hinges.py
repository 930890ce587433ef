"""Which edges the paper's code leaves without springs.

Source: the hinge lists of its examples UR_Pneumatic (hexagonal) and Three_Unit_Compare (square units).
"""

import numpy as np

from cosim.base.frames import IntArray, Mask
from cosim.soft.geometry.named_mesh import NamedMesh

_DIAGONAL = frozenset({"mid corner", "outer edge"})
_CORNER_LINES = (frozenset({"hole", "mid corner"}), frozenset({"mid corner", "outer corner"}))


def without_spring(mesh: NamedMesh, hinges: IntArray) -> Mask:
    """Return which hinges (h,) the published models lack, on an unrefined mesh.

    In every chamber the edges from a mid ring's corner to an outer edge midpoint; in square ones also
    the lines along the corners, from hole to outer ring.

    Args:
        mesh: a stack of polygonal units.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
    """
    bare = {_DIAGONAL, *_CORNER_LINES} if len(mesh.ring(mesh.base_ring)) == 4 else {_DIAGONAL}
    places = _places(mesh)
    return np.array([frozenset({places[j], places[k]}) in bare for j, k in hinges[:, 1:3]], dtype=bool)


def _places(mesh: NamedMesh) -> list[str]:
    """Return where each node lies: "hole", or the ring and whether at a corner or an edge midpoint."""
    places = ["hole"] * len(mesh.positions)
    for name, ring in mesh.rings.items():
        kind = name.rpartition(".")[2]
        if kind in ("lower", "outer", "upper"):
            for place, node in enumerate(ring):
                ring_name = "outer" if kind == "outer" else "mid"
                places[node] = f"{ring_name} {'edge' if place % 2 else 'corner'}"
    return places
