"""The gas chambers of a body: what they enclose, and what the caps that a body lacks add to its stiffness.

They follow from the body's film, caps and chambers, and are no element beside them; what the gas adds to the
potential is in `film_terms`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.elements.pressure import cap_stiffness, fill_volumes


@final
class GasChambers:
    """Film triangles and caps of each chamber.

    Args:
        enclosures: film triangles (t, 3) and caps of each chamber.
    """

    def __init__(self, enclosures: Iterable[tuple[IntArray, Sequence[IntArray]]]) -> None:
        none = np.zeros(0, np.int64)
        self._chambers = [
            (
                np.ascontiguousarray(triangles),
                np.concatenate([none, *caps]),
                np.cumsum([0, *map(len, caps)]),
                caps,
            )
            for triangles, caps in enclosures
        ]
        self.count = len(self._chambers)

    def enclosed_volumes(self, shapes: Array) -> Array:
        """Return the volume (k, chambers) [m^3] of each chamber in shapes (k, n, 3) [m]."""
        found = np.empty((self.count, len(shapes)))
        for (triangles, rings, starts, _), out in zip(self._chambers, found, strict=True):
            fill_volumes(shapes, triangles, rings, starts, out)
        return found.T.copy()

    def open_cap_stiffness(self, positions: Array, pressures_Pa: Array) -> list[tuple[IntArray, Array]]:
        """Return what missing caps add to the stiffness, by ring.

        Args:
            positions: (n, 3) [m].
            pressures_Pa: (chambers,), gauge.
        """
        pairs = zip(self._chambers, pressures_Pa.tolist(), strict=True)
        return [
            (ring, cap_stiffness(positions, ring, pressure))
            for (*_, caps), pressure in pairs
            for ring in caps
        ]
