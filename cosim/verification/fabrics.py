"""Known answers: woven film.

A closed cylinder of fabric whose yarns straighten, under pressure and twisted.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import root

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.fabric import Fabric
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.case import UNLOADED, Figure, Specimen, case, held_on_axis, tube

WARP_PA, WEFT_PA, SHEAR_PA, NU = 0.4e9, 0.7e9, 0.1e9, 0.2
STRAIGHT_PA, STRAIN = (1.5e9, 0.9e9), (0.004, 0.0008)  # the weft is straight, the warp is not
THICKNESS_M = 2e-4
FILM = Film(
    WARP_PA, NU, THICKNESS_M, "tension_field",
    fabric=Fabric(WEFT_PA, SHEAR_PA, (0.0, 0.0, 1.0), STRAIGHT_PA, STRAIN),
)  # fmt: skip
RADIUS_M, LENGTH_M, PRESSURE_PA = 0.04, 0.08, 5e3
SIDES, ROWS = 96, 24
TWIST_RAD = 2e-4
_OPTIONS = NewtonOptions(tolerance_N=1e-10)


def tensions(stretch: Array) -> Array:
    """Return N (2,) [N/m] along warp and weft from the stretches (2,), by the law as it is stated."""
    e = 0.5 * (stretch**2 - 1.0)
    drawn, straight, full = np.array([WARP_PA, WEFT_PA]), np.array(STRAIGHT_PA), np.array(STRAIN)
    grown = np.where(e < full, 0.5 * e**2 / full, e - 0.5 * full)  # both are pulled
    ratio = WEFT_PA / WARP_PA
    across = NU * ratio * np.array([[0.0, 1.0], [1.0, 0.0]]) + np.diag([1.0, ratio])
    stress = WARP_PA / (1.0 - NU**2 * ratio) * across @ e + (straight - drawn) * grown
    return np.asarray(THICKNESS_M * stress)


def expected() -> tuple[float, float, float]:
    """Return stretch along the axis and around it, and torque over twist [N m/rad].

    A tube of flat facets at the distance a from the axis carries pressure as a cylinder of radius a does:
        N_z l_z = p a l_t^2 / 2,   N_t = p a l_z,
        T / phi = P l_t^2 (G t l_t^2 a^2 + N_z R^2) / L + p A l_t^2 l_z L / (3 m^2),
    with its drawn girth P, section A, length L and rows m, the stretches l and the second Piola-Kirchhoff
    forces N. The last term is the volume that twisted facets, divided along a diagonal, lose.
    """
    a = RADIUS_M * math.cos(math.pi / SIDES)
    girth = 2.0 * SIDES * RADIUS_M * math.sin(math.pi / SIDES)

    def unbalanced(stretch: Array) -> Array:
        n, (lz, lt) = tensions(stretch), stretch
        return np.array([n[0] * lz - 0.5 * PRESSURE_PA * a * lt**2, n[1] - PRESSURE_PA * a * lz])

    stretch = root(unbalanced, [1.001, 1.001], tol=1e-14).x
    lz, lt = map(float, stretch)
    pull = float(tensions(stretch)[0])
    twisted = girth * (SHEAR_PA * THICKNESS_M * lt**2 * a**2 + pull * RADIUS_M**2) / LENGTH_M
    lost = PRESSURE_PA * 0.5 * a * girth * lz * LENGTH_M / (3.0 * ROWS**2)
    return lz, lt, lt**2 * (twisted + lost)


@case(
    "woven_cylinder",
    "Closed cylinder of fabric, inflated and twisted",
    "orthotropic plane stress, stretched: N_z = p a / 2, N_t = p a, T = 2 pi a^3 (G t + N_z) phi / L",
)
def woven_cylinder() -> tuple[Figure, ...]:
    """Growth under pressure and stiffness in torsion of a tube, warp along it, whose yarns straighten.

    The facets are flat and every triangle of them is strained alike, so the answers are exact for the mesh.
    """
    positions, triangles = tube(RADIUS_M, LENGTH_M, SIDES, ROWS)
    tip = ROWS * SIDES + np.arange(SIDES)
    body = SoftBody.from_arrays(positions, triangles, FILM, caps=(np.arange(SIDES)[::-1].copy(), tip))
    specimen = Specimen(body, held_on_axis(SIDES, body.nodes), _OPTIONS)
    found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(PRESSURE_PA,)))
    x = found.state.positions
    radius, length = float(np.hypot(x[:, 0], x[:, 1]).mean()), float(x[tip, 2].mean())
    held = np.zeros((body.nodes, 3), dtype=bool)
    held[:SIDES], held[tip, :2] = True, True
    twisted, torques = Specimen(body, held, _OPTIONS), []
    for twist in (TWIST_RAD, -TWIST_RAD):
        angle = twist * x[:, 2] / length
        turned = x.copy()
        turned[:, 0] = np.cos(angle) * x[:, 0] - np.sin(angle) * x[:, 1]
        turned[:, 1] = np.sin(angle) * x[:, 0] + np.cos(angle) * x[:, 1]
        end = twisted.solve(replace(found.state, positions=turned), found.loads)
        y, force = end.state.positions[tip], twisted.gradient(end)[tip]
        torques.append(float((y[:, 0] * force[:, 1] - y[:, 1] * force[:, 0]).sum()))
    lz, lt, stiffness = expected()
    return (
        Figure("dR / R", "1", radius / RADIUS_M - 1.0, lt - 1.0, 1e-6),
        Figure("dL / L", "1", length / LENGTH_M - 1.0, lz - 1.0, 1e-6),
        Figure("torque / twist", "N m/rad", 0.5 * (torques[0] - torques[1]) / TWIST_RAD, stiffness, 1e-6),
    )
