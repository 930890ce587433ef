"""Open ends of a surface: their rims, in the order of the caps that close them."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import IntArray
from cosim.errors import MeshError
from cosim.soft.geometry.surface import directed_edges


def rims(triangles: IntArray) -> tuple[IntArray, ...]:
    """Return the nodes of each rim, so that a fan (centre, rim[i], rim[i + 1]) faces outward.

    Args:
        triangles: (m, 3) node indices, normals pointing out of the gas.

    Raises:
        MeshError: two rims meet in a node.
    """
    edges = directed_edges(triangles)
    count = int(triangles.max()) + 1
    alone = ~np.isin(edges[:, 1] * count + edges[:, 0], edges[:, 0] * count + edges[:, 1])
    # a cap runs along its rim the other way than the film
    following = dict(zip(edges[alone, 1].tolist(), edges[alone, 0].tolist(), strict=True))
    if len(following) < alone.sum():
        ends, times = np.unique(edges[alone, 1], return_counts=True)
        raise MeshError(f"two rims of the film meet in node {ends[times > 1][0]}; they must not")
    found = []
    while following:
        first, here = following.popitem()
        rim = [first]
        while here != first:
            rim.append(here)
            here = following.pop(here)
        found.append(np.array(rim, dtype=np.int64))
    return tuple(sorted(found, key=lambda rim: int(rim.min())))
