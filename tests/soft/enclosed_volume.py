"""The volume that a surface encloses, independent of the gas that fills it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cosim.base.frames import Array, IntArray


def enclosed_volume(positions: Array, triangles: IntArray, caps: Sequence[IntArray] = ()) -> float:
    """Return the volume sum det(a, b, c) / 6 inside a surface closed by caps.

    A cap is the fan of triangles (mean of its ring, ring[i], ring[i + 1]). With every hole capped the
    result does not depend on the origin; normals pointing outward make it positive.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3) node indices.
        caps: rings of node indices, each (r,), ordered so that their fans face outward.

    Returns:
        Volume [m^3].
    """
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    volume = np.einsum("ta,ta->", a, np.cross(b, c))
    for cap in caps:
        ring = positions[cap]
        volume += ring.mean(axis=0) @ np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
    return float(volume / 6.0)
