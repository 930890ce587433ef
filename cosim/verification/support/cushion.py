"""A cushion of two flat films welded along their edge: an eighth of it, inflated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.meshes import Shape
from cosim.verification.support.specimen import UNLOADED, Specimen

_FRACTIONS = (1.0, 0.1, 0.01, 1e-3)
"""Compressive stiffness on the way to the tension field, each solved from the one before."""


@final
@dataclass(frozen=True)
class Cushion:
    """An inflated cushion.

    Args:
        body: the upper film's quarter.
        positions: (n, 3) [m], inflated.
        volume: of the whole cushion [m^3].
        residual_N: of the equilibrium.
    """

    body: SoftBody
    positions: Array
    volume: float
    residual_N: float

    @property
    def height(self) -> float:
        """Rise of the centre of the upper film [m], half the thickness of the cushion."""
        return float(self.positions[0, 2])


def inflated_cushion(shape: Shape, edge: Mask, film: Film, pressure_Pa: float, rise_m: float) -> Cushion:
    """Inflate two equal films that meet in the plane z = 0.

    Args:
        shape: quarter of the flat film, node 0 at its centre.
        edge: (n,) bool, nodes of the weld: free in its plane.
        film: material; law "tension_field" is approached through falling compressive stiffness.
        pressure_Pa: of the gas.
        rise_m: first guess of the centre's height.

    Raises:
        ConvergenceError: no equilibrium was found.
    """
    held = shape.symmetry.copy()
    held[edge, 2] = True
    flat = shape.positions
    size = float(flat.max())
    x = flat.copy()
    x[:, 2] = rise_m * (1.0 - (flat[:, 0] / size) ** 2) * (1.0 - (flat[:, 1] / size) ** 2)
    x[edge, 2] = 0.0
    steps = [replace(film, compressive_fraction=f) for f in _FRACTIONS] if film.law == "tension_field" else []
    loads = replace(UNLOADED, pressure_Pa=(pressure_Pa,))
    tolerance = 1e-7 * pressure_Pa * size**2
    options = NewtonOptions(tolerance_N=tolerance, iterations_max=2000, step_max_m=0.1 * size)
    for material in [*steps, film]:
        body = SoftBody.from_arrays(flat, shape.triangles, material)
        specimen = Specimen(body, held, options)
        found = specimen.solve(specimen.drawn(x), loads)
        x = found.state.positions
    return Cushion(body, x, 8.0 * specimen.system.volume, found.residual_N)


def square_edge(positions: Array) -> Mask:
    """Return (n,) bool: the nodes on the two outer edges of a quarter square."""
    side = float(positions[:, 0].max())
    return np.asarray((positions[:, :2] > side * (1.0 - 1e-9)).any(axis=1))
