"""Colours of the film: its largest principal stress on a perceptual colour scale, with half-Lambert shading.
The scale is a straight line in OkLCh from indigo over teal to yellow, whose lightness rises evenly. Its range
is fixed, so that colours can be compared between runs.
"""

from typing import Annotated, Final, TypeAlias, final

import numba
import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Matrix, Vector
from cosim.base.kernels import kernel

Rgba: TypeAlias = NDArray[np.uint8]
# Ends of the stress scale in OkLCh: lightness, chroma, hue [degree]; indigo over teal to yellow.
_SCALE_FROM: Final = (0.36, 0.13, 285.0)
_SCALE_TO: Final = (0.94, 0.17, 103.0)
STRESS_RANGE_PA: Final = (0.0, 25e6)
"""Stress of the first and of the last colour [Pa]."""
_LIGHT: Final = np.array([0.35, -0.62, 0.70]) / np.linalg.norm([0.35, -0.62, 0.70])
_AMBIENT: Final = 0.62
"""Ambient light; high, so that shading does not hide the scale."""


def stress_scale(steps: int = 256) -> Rgba:
    """Return the colour scale; colours outside sRGB are clipped.

    Source: B. Ottosson, "A perceptual color space for image processing" (2020).

    Args:
        steps: number of colours.

    Returns:
        (steps, 4), opaque, low stress first.
    """
    fraction = np.linspace(0.0, 1.0, steps)[:, None]
    lightness, chroma, hue = (np.array(_SCALE_FROM) * (1.0 - fraction) + np.array(_SCALE_TO) * fraction).T
    linear = _linear_srgb(lightness, chroma, np.radians(hue))
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0) ** (1 / 2.4) - 0.055
    )
    rgba = np.full((steps, 4), 255, dtype=np.uint8)
    rgba[:, :3] = np.round(255.0 * np.clip(encoded, 0.0, 1.0))
    return rgba


def _linear_srgb(lightness: Array, chroma: Array, hue: Array) -> Array:
    """Convert OkLCh to linear sRGB (n, 3), not clipped."""
    a, b = chroma * np.cos(hue), chroma * np.sin(hue)
    cone_roots = np.stack(
        [
            lightness + 0.3963377774 * a + 0.2158037573 * b,
            lightness - 0.1055613458 * a - 0.0638541728 * b,
            lightness - 0.0894841775 * a - 1.2914855480 * b,
        ],
        axis=1,
    )
    to_srgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    return np.asarray(cone_roots**3 @ to_srgb.T)


@kernel(allocates=True)
def colour_nodes(
    x: Blocks,
    triangles: IndexTable,
    stress: Matrix,
    weight: Vector,
    scale: Matrix,
    packed: Annotated[NDArray[np.uint32], numba.uint32[:, ::1]],
) -> None:
    """Fill packed (k, n) with the colour of each node in k frames as 0xRRGGBBAA; see `MembraneColours`.

    weight: (n,) one over the number of triangles; scale: (colours, 3).
    """
    last, (low, high), light, ambient = scale.shape[0] - 1, STRESS_RANGE_PA, _LIGHT, _AMBIENT
    sums = np.empty((x.shape[1], 4))
    for f in range(x.shape[0]):
        sums[:] = 0.0
        for e in range(triangles.shape[0]):
            a, b, c = triangles[e, 0], triangles[e, 1], triangles[e, 2]
            u0, u1, u2 = x[f, b, 0] - x[f, a, 0], x[f, b, 1] - x[f, a, 1], x[f, b, 2] - x[f, a, 2]
            v0, v1, v2 = x[f, c, 0] - x[f, a, 0], x[f, c, 1] - x[f, a, 1], x[f, c, 2] - x[f, a, 2]
            n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
            for node in (a, b, c):
                sums[node, 0] += stress[f, e]
                sums[node, 1] += n0
                sums[node, 2] += n1
                sums[node, 3] += n2
        for i in range(x.shape[1]):
            position = (sums[i, 0] * weight[i] - low) / (high - low)
            index = 0
            if position > 0.0:  # False for NaN
                index = int(min(position, 1.0) * last + 0.5)
            n0, n1, n2 = sums[i, 1], sums[i, 2], sums[i, 3]
            length = max(np.sqrt(n0 * n0 + n1 * n1 + n2 * n2), 1e-30)
            facing = (n0 * light[0] + n1 * light[1] + n2 * light[2]) / length
            bright = ambient + (1.0 - ambient) * (0.5 + 0.5 * facing)  # half-Lambert
            red, green = int(scale[index, 0] * bright), int(scale[index, 1] * bright)
            packed[f, i] = (red << 24) | (green << 16) | (int(scale[index, 2] * bright) << 8) | 0xFF


@final
class MembraneColours:
    """Turns stress per triangle into packed colours per node.

    The shading is part of the colours, since normals would double the size of the file.

    Args:
        triangles: (m, 3) node indices, outward orientation.
        nodes: number of nodes.
    """

    def __init__(self, triangles: IntArray, nodes: int) -> None:
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int64)
        self._scale = stress_scale()[:, :3].astype(np.float64)
        self._weight = 1.0 / np.maximum(np.bincount(self._triangles.ravel(), minlength=nodes), 1)

    def packed(self, positions: Array, stress: Array) -> NDArray[np.uint32]:
        """Return the colour of each node in each frame (k, n) as 0xRRGGBBAA.

        Args:
            positions: (k, n, 3) [m], world.
            stress: (k, m) [Pa]; each node shows the mean of its triangles.
        """
        packed = np.empty(positions.shape[:2], dtype=np.uint32)
        colour_nodes(positions, self._triangles, stress, self._weight, self._scale, packed)
        return packed
