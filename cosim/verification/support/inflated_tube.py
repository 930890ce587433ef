"""An inflated tube, its measures, the loads of a beam on it and the flexibility of beam theory."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium
from cosim.verification.support.meshes import held_on_axis, tube
from cosim.verification.support.specimen import UNLOADED, Specimen

FILM = Film(300e6, 0.3, 1e-4)
RADIUS_M, LENGTH_M = 0.04, 0.4
PRESSURE_PA = 10e3
FORCE_N = 0.2
SIDES, ROWS = 48, 96
_OPTIONS = NewtonOptions(tolerance_N=1e-7, iterations_max=100)


@final
@dataclass(frozen=True)
class InflatedTube:
    """The tube under pressure, and its measures there: the formulas refer to them.

    Args:
        body: the tube, closed by caps.
        state: under pressure, free of other loads.
        radius: [m].
        length: [m].
        thickness: [m]; the film's volume is kept up to its Poisson strain.
    """

    body: SoftBody
    state: Equilibrium
    radius: float
    length: float
    thickness: float

    @classmethod
    def make(cls) -> InflatedTube:
        """Inflate the tube with its first ring free to grow in its plane."""
        positions, triangles = tube(RADIUS_M, LENGTH_M, SIDES, ROWS)
        caps = (np.arange(SIDES)[::-1].copy(), ROWS * SIDES + np.arange(SIDES))
        body = SoftBody.from_arrays(positions, triangles, FILM, caps=caps)
        specimen = Specimen(body, held_on_axis(SIDES, body.nodes), _OPTIONS)
        found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(PRESSURE_PA,)))
        x = found.state.positions
        radius = float(np.hypot(x[:, 0], x[:, 1]).mean())
        length = float(x[caps[1], 2].mean())
        stretch = radius / RADIUS_M - 1.0 + length / LENGTH_M - 1.0
        nu = FILM.poisson_ratio
        return cls(body, found, radius, length, FILM.thickness_m * (1.0 - nu / (1.0 - nu) * stretch))

    def ring(self, row: int) -> slice:
        """Return the nodes of a ring."""
        return slice(row * SIDES, (row + 1) * SIDES)

    def shear_force(self, row: int, force: float) -> Array:
        """Return nodal forces (n, 3) [N] of a force along -x, spread over a ring as the shear flow of a tube.

        The shear flow of a thin tube is F sin(angle to the force) / (pi R), along the tangent.
        """
        angle = 2.0 * math.pi * np.arange(SIDES) / SIDES
        tangent = np.stack([-np.sin(angle), np.cos(angle), np.zeros(SIDES)], axis=1)
        result = np.zeros((self.body.nodes, 3))
        result[self.ring(row)] = (2.0 * force / SIDES * np.sin(angle))[:, None] * tangent
        return result

    def bent(self, held: Mask, forces: Array) -> tuple[Equilibrium, Array]:
        """Return the equilibrium under further forces, held where it is, and the displacement (n, 3) [m]."""
        specimen = Specimen(self.body, held, _OPTIONS)
        found = specimen.solve(self.state.state, replace(self.state.loads, nodal_force=forces))
        return found, found.state.positions - self.state.state.positions

    def flexibility(self) -> tuple[float, float]:
        """Return (bending, shear): 1 / ((E + P/S) I) and 1 / (P + k G S), with k = 1/2."""
        r, t = self.radius, self.thickness
        pull, section = PRESSURE_PA * math.pi * r**2, 2.0 * math.pi * r * t
        shear = FILM.young_modulus_Pa / (2.0 * (1.0 + FILM.poisson_ratio))
        inertia = math.pi * r**3 * t
        bending = 1.0 / ((FILM.young_modulus_Pa + pull / section) * inertia)
        return bending, 1.0 / (pull + 0.5 * shear * section)

    def wrinkling_moment(self, found: Equilibrium, force: float) -> float:
        """Return the moment [N m] at which the axial stress would vanish on one side, by proportion.

        Along the tube's middle the axial stress is a + b cos(angle); a belongs to the pressure, b to the
        moment there.
        """
        triangles = self.body.triangles
        drawn = self.body.positions[triangles].mean(axis=1)
        chosen = np.flatnonzero(np.abs(drawn[:, 2] - 0.5 * LENGTH_M) < 0.1 * LENGTH_M)
        stress = _axial_stress(self.body, found.state.positions)[chosen]
        lever = self.length * (1.0 - drawn[chosen, 2] / LENGTH_M)
        angle = np.arctan2(drawn[chosen, 1], drawn[chosen, 0])
        # centroids lie inside the circle: cos(angle) r is their true distance from the neutral axis
        distance = np.hypot(drawn[chosen, 0], drawn[chosen, 1]) / RADIUS_M * np.cos(angle)
        matrix = np.stack([np.ones_like(distance), force * lever * distance], axis=1)
        pressure_part, per_moment = np.linalg.lstsq(matrix, stress, rcond=None)[0]
        return abs(float(pressure_part / per_moment))


def _axial_stress(body: SoftBody, positions: Array) -> Array:
    """Return the second Piola-Kirchhoff stress (m,) [Pa] along the drawn axis z."""
    (membranes,) = body.membranes
    edge = body.positions[membranes.triangles]
    # the triangle's own first axis runs along its first edge, the second is normal to it in its plane
    first = edge[:, 1] - edge[:, 0]
    first /= np.linalg.norm(first, axis=1)[:, None]
    normal = np.cross(edge[:, 1] - edge[:, 0], edge[:, 2] - edge[:, 0])
    second = np.cross(normal / np.linalg.norm(normal, axis=1)[:, None], first)
    cosine, sine = first[:, 2], second[:, 2]
    stress = membranes.strain(positions) @ membranes.film.membrane_stiffness.T / membranes.film.thickness_m
    s = stress
    return np.asarray(cosine**2 * s[:, 0] + sine**2 * s[:, 1] + 2.0 * cosine * sine * s[:, 2])
