"""A narrow strip as an elastica: flat panels joined by rotational springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.specimen import Specimen

PANEL_FACTOR = 1e4
"""Stiffness of the fold along a panel's diagonal, in units of that between panels.

Between panels acts k = E b t^3 / (12 D), D the length of a panel: all that plane bending needs. Cut
into two triangles, a panel may also fold along its diagonal; plane bending does not use that fold, but a
soft one would let each panel twist, and the strip would bend too easily: by 1 / PANEL_FACTOR or so.
"""


@final
@dataclass(frozen=True)
class Strip:
    """A strip along x, width along y, clamped at x = 0.

    The clamped panel lies at x < 0. The fold at the clamp stands for half a panel only, so its stiffness is
    doubled: then the error falls with the square of the panels' length.

    Args:
        panels: between the clamp and the tip.
        length_m: L.
        width_m: b.
        film: Poisson's ratio zero, as for a beam.
        density: mass per area [kg/m^2].
        hinged: whether it resists bending at all.
    """

    panels: int
    length_m: float = 1.0
    width_m: float = 0.05
    film: Film = Film(1e9, 0.0, 5e-3)
    density: float = 0.0
    hinged: bool = True

    @property
    def bending_stiffness(self) -> float:
        """EI = E b t^3 / 12 [N m^2]."""
        return self.film.bending_stiffness_Nm * self.width_m

    @property
    def panel_m(self) -> float:
        """Length of a panel [m]."""
        return self.length_m / self.panels

    @property
    def tip(self) -> IntArray:
        """(2,) nodes at the end."""
        return np.array([2 * self.panels + 2, 2 * self.panels + 3])

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return 2 * (self.panels + 2)

    def body(self) -> SoftBody:
        """Return the strip, stress free when straight; its nodes 2 s and 2 s + 1 are section s."""
        x = self.panel_m * np.arange(-1, self.panels + 1)
        positions = np.zeros((self.nodes, 3))
        positions[:, 0] = np.repeat(x, 2)
        positions[1::2, 1] = self.width_m
        a = 2 * np.arange(self.panels + 1)
        triangles = np.stack([np.stack([a, a + 2, a + 1], 1), np.stack([a + 1, a + 2, a + 3], 1)], 1).reshape(
            -1, 3
        )
        hinges = interior_hinges(triangles)
        across = hinges[:, 1] // 2 == hinges[:, 2] // 2
        between = self.bending_stiffness / self.panel_m
        stiffness = np.where(across, between, PANEL_FACTOR * between)
        stiffness[across & (hinges[:, 1] == 2)] *= 2.0
        return SoftBody.from_arrays(
            positions,
            triangles,
            self.film,
            hinge_nodes=hinges if self.hinged else None,
            hinge_stiffness=stiffness if self.hinged else 0.0,
            node_mass=self.node_mass(),
        )

    def node_mass(self) -> Array:
        """Return the mass of each node (n,) [kg]: half a panel's from either side."""
        mass = np.full(self.panels + 2, self.density * self.width_m * self.panel_m)
        mass[[0, 1, -1]] *= 0.5
        return np.repeat(0.5 * mass, 2)

    def clamped(self) -> Mask:
        """Return (n,) bool, the clamped panel."""
        return np.arange(self.nodes) < 4

    def specimen(self) -> Specimen:
        """Return the clamped strip; forces are solved to 1e-7 of EI / L^2."""
        tolerance = 1e-7 * self.bending_stiffness / self.length_m**2
        options = NewtonOptions(tolerance_N=tolerance, step_max_m=0.5 * self.length_m, iterations_max=200)
        return Specimen(self.body(), self.clamped(), options)

    def tip_force(self, force: tuple[float, float, float]) -> Array:
        """Return nodal forces (n, 3) [N] with `force` shared by the tip's nodes."""
        result = np.zeros((self.nodes, 3))
        result[self.tip] = 0.5 * np.array(force)
        return result

    def deflection(self, positions: Array) -> tuple[float, float, float]:
        """Return x, z [m] of the tip and the slope [rad] of the last panel."""
        before, end = positions[self.tip - 2].mean(axis=0), positions[self.tip].mean(axis=0)
        run = end - before
        return float(end[0]), float(end[2]), float(np.arctan2(run[2], run[0]))
