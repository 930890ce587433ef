"""Woven film: its moduli and directions, and its yarns, which straighten as they are stretched.

Fabric has two directions, warp (1) and weft (2). With E_1, E_2 and G times the thickness, and nu the
contraction along the weft over the extension along the warp,
    N = C E,   C^-1 = [[1 / E_1, -nu / E_1, 0], [-nu / E_1, 1 / E_2, 0], [0, 0, 1 / G]],
positive definite where nu^2 < E_1 / E_2. Its yarns are crimped by the weave. Stretched by a strain e they
straighten, and their modulus grows in proportion to e from E_i to the straight one, H_i, at the strain s_i:
    added force per width = (H_i - E_i) e^2 / (2 s_i) for 0 < e < s_i,   (H_i - E_i) (e - s_i / 2) beyond.
Source: Jones, Mechanics of Composite Materials, 2nd ed., section 2.6; the straightening is chosen here.
"""

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import InputError, MeshError

_LEAST_WARP: Final = 1e-3  # of the warp's direction that has to lie in a triangle's plane


@final
@dataclass(frozen=True)
class Fabric:
    """Constants of woven film in addition to the modulus along its warp.

    Args:
        modulus_weft_Pa: E_2.
        shear_modulus_Pa: G.
        warp_direction: (3,), in the frame of the drawn body; projected on each triangle.
        straight_modulus_Pa: H_1 and H_2, of straight yarns; E_1 and E_2: the modulus does not grow.
        straight_strain: s_1 and s_2, at which yarns are straight.

    Raises:
        InputError: a constant out of its bounds.
    """

    modulus_weft_Pa: float
    shear_modulus_Pa: float
    warp_direction: tuple[float, float, float]
    straight_modulus_Pa: tuple[float, float]
    straight_strain: tuple[float, float] = (0.01, 0.01)

    def __post_init__(self) -> None:
        positive_constants = (self.modulus_weft_Pa, self.shear_modulus_Pa, *self.straight_strain)
        if not all(0.0 < constant < math.inf for constant in positive_constants):
            raise InputError(f"fabric has a constant that is not positive and finite: {self}")
        if not 0.0 < math.hypot(*self.warp_direction) < math.inf:
            raise InputError(f"warp_direction is {self.warp_direction}; it must have a length")

    def warps(self, normal: Array) -> Array:
        """Return the unit warps (m, 3) of triangles from their unit normals (m, 3).

        Raises:
            MeshError: the warp is normal to a triangle.
        """
        direction = np.array(self.warp_direction)
        unit = direction / np.linalg.norm(direction)
        warp = unit - (normal @ unit)[:, None] * normal
        length = np.linalg.norm(warp, axis=1)
        bad = np.flatnonzero(length < _LEAST_WARP)
        if len(bad):
            raise MeshError(
                f"warp_direction {direction.tolist()} is normal to {len(bad)} of {len(normal)} film "
                f"triangles, the first of which is triangle {bad[0]}; choose a direction that lies in the "
                "film, such as one of the sheets that it is cut from"
            )
        return np.asarray(warp / length[:, None])
