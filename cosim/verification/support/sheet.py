"""A film that curves about one axis only: a quarter of the section of a long tube or pouch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.specimen import UNLOADED

PRESSURE_PA = 1000.0


@final
@dataclass(frozen=True)
class Sheet:
    """A film along x without bending stiffness; the axis is y, and no node leaves its plane y = const.

    It runs from the plane of symmetry x = 0 to the seam on the plane of symmetry z = 0. Nodes 2 s and
    2 s + 1 are section s. With p W / E t of 3e-5 it hardly stretches.

    Args:
        panels: along x.
        length_m: half the flat width.
        depth_m: along y.
    """

    panels: int
    length_m: float = 0.1
    depth_m: float = 0.01

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return 2 * (self.panels + 1)

    @property
    def flat_width_m(self) -> float:
        """Width W of the flat tube [m], seam to seam."""
        return 2.0 * self.length_m

    def body(self) -> SoftBody:
        """Return the film, stress free when flat."""
        a = 2 * np.arange(self.panels)
        # the diagonals alternate, so that both nodes of a section carry the same pressure on average
        odd = (np.arange(self.panels) % 2 == 1)[:, None]
        first = np.where(odd, np.stack([a, a + 2, a + 3], 1), np.stack([a, a + 2, a + 1], 1))
        second = np.where(odd, np.stack([a, a + 3, a + 1], 1), np.stack([a + 1, a + 2, a + 3], 1))
        triangles = np.concatenate([first, second])
        return SoftBody.from_arrays(self.flat(), triangles, Film(6.7e9, 0.0, 1e-3))

    def flat(self) -> Array:
        """Return the flat shape (n, 3) [m]."""
        positions = np.zeros((self.nodes, 3))
        positions[:, 0] = np.repeat(np.linspace(0.0, self.length_m, self.panels + 1), 2)
        positions[1::2, 1] = self.depth_m
        return positions

    def bent(self, flat: float, radius: float) -> Array:
        """Return positions (n, 3) [m]: a flat piece, then an arc of a radius [m] that ends at z = 0."""
        positions = self.flat()
        s = np.maximum(positions[:, 0] - flat, 0.0) / radius
        positions[:, 0] = np.minimum(positions[:, 0], flat) + radius * np.sin(s)
        positions[:, 2] = radius * np.cos(s)
        positions[:, 2] -= positions[-1, 2]
        return positions

    def symmetry(self) -> Mask:
        """Return (n, 3) bool: x at the first section, z at the seam, y everywhere."""
        held = np.zeros((self.nodes, 3), dtype=bool)
        held[:, 1] = True
        held[:2, 0] = True
        held[-2:, 2] = True
        return held

    def loads(self) -> Loads:
        """Return the loads of the pressure.

        The model measures volume as cones from the origin. The end at y = 0 contributes nothing, the one at
        y = depth a third of the prism, and no film stands for it: the film measures two thirds of the
        volume, whatever its shape, and takes three halves of the pressure to do the gas's work.
        """
        return replace(UNLOADED, pressure_Pa=(1.5 * PRESSURE_PA,))

    def section_area(self, film_volume: float) -> float:
        """Return the area [m^2] of the whole section from the film's measure of a quarter's volume [m^3]."""
        return 4.0 * 1.5 * film_volume / self.depth_m

    def options(self) -> NewtonOptions:
        """Return bounds for Newton's method: 1e-7 of a panel's load."""
        load = PRESSURE_PA * self.depth_m * self.length_m / self.panels
        return NewtonOptions(tolerance_N=max(1e-7 * load, 1e-8), iterations_max=400, step_max_m=0.02)
