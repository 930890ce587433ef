"""Colours of the film: its stress on a perceptual scale, softly lit so that the shape reads."""

from __future__ import annotations

from typing import Final, final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cosim.frames import Array, IntArray
from cosim.recording.colours import stress_scale

_LIGHT: Final = np.array([0.35, -0.62, 0.70]) / np.linalg.norm([0.35, -0.62, 0.70])
_AMBIENT: Final = 0.62
"""Light that reaches every face: high, so that shading does not hide the scale."""


@final
class MembraneColours:
    """Turns stress per triangle into packed colours per node.

    The light is worked into the colours: logging normals instead would double the file.

    Args:
        triangles: (m, 3) node indices, outward orientation.
        nodes: number of nodes.
        stress_range_Pa: stress of the first and last colour of the scale [Pa].
    """

    def __init__(self, triangles: IntArray, nodes: int, stress_range_Pa: tuple[float, float]) -> None:
        self._triangles = triangles
        self._range = stress_range_Pa
        self._scale = stress_scale()[:, :3].astype(np.float64)
        corners = triangles.ravel()
        share = 1.0 / np.maximum(np.bincount(corners, minlength=nodes), 1)
        owners = np.repeat(np.arange(len(triangles)), 3)
        self._mean = csr_array((share[corners], (corners, owners)), shape=(nodes, len(triangles)))
        self._on_triangles = np.empty((len(triangles), 4))

    def packed(self, positions: Array, stress: Array) -> NDArray[np.uint32]:
        """Return the colour of each node as 0xRRGGBBAA.

        Args:
            positions: (n, 3) [m], world.
            stress: (m,) [Pa]; each node shows the mean of its triangles.
        """
        a, b, c = (positions[self._triangles[:, k]] for k in range(3))
        values = self._on_triangles
        values[:, 0] = stress
        _cross(b - a, c - a, values[:, 1:])
        at_nodes = self._mean @ values
        low, high = self._range
        place = np.clip((at_nodes[:, 0] - low) / (high - low), 0.0, 1.0)
        index = (place * (len(self._scale) - 1) + 0.5).astype(np.int64)
        rgb = (self._scale[index] * _brightness(at_nodes[:, 1:])[:, None]).astype(np.uint32)
        return np.asarray((rgb[:, 0] << 24) | (rgb[:, 1] << 16) | (rgb[:, 2] << 8) | np.uint32(0xFF))


def _cross(u: Array, v: Array, out: Array) -> None:
    """Fill out (m, 3) with u x v; numpy.cross takes three times as long."""
    out[:, 0] = u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1]
    out[:, 1] = u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2]
    out[:, 2] = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def _brightness(normals: Array) -> Array:
    """Half-Lambert light on normals of any length (n, 3): (n,), ambient to 1."""
    length = np.sqrt((normals * normals).sum(axis=1))
    facing = normals @ _LIGHT / np.maximum(length, 1e-30)
    return np.asarray(_AMBIENT + (1.0 - _AMBIENT) * (0.5 + 0.5 * facing))
