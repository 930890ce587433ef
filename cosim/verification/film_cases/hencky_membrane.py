"""A flat circular membrane, clamped at its edge, under pressure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure
from cosim.verification.support.meshes import quarter_disc
from cosim.verification.support.specimen import UNLOADED, Specimen

FILM = Film(300e6, 0.3, 1e-4)
RADIUS_M = 0.1
PRESSURE_PA = 20.0
COARSE, FINE = 10, 20


def coefficients(poisson_ratio: float) -> tuple[float, float, float]:
    """Return (W, S0, v):  w0 = W a q, sigma0 = S0 E q^2, V = v a^3 q  with q = (p a / E t)^(1/3).

    Equilibrium and compatibility in r / a, with s the radial stress over E q^2 and w the height over a q:
        s w' = -r / 2,    r (r s' + 2 s)' = r s'' r + 3 r s' = -(w')^2 / 2,
    so r s'' + 3 s' = -r / (8 s^2); s'(0) = 0; at the edge u = 0, so r s' + (1 - nu) s = 0.
    """

    def integrate(centre: float) -> np.ndarray:
        def rates(r: float, y: np.ndarray) -> list[float]:
            s, ds, _, _ = y
            slope = -0.5 * r / s
            return [ds, -1.0 / (8.0 * s * s) - 3.0 * ds / r, slope, np.pi * r * r * -slope]

        begin = 1e-6
        first = [centre - begin**2 / (64.0 * centre**2), -begin / (32.0 * centre**2), 0.0, 0.0]
        end = solve_ivp(rates, (begin, 1.0), first, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        return np.asarray(end)

    def edge(centre: float) -> float:
        s, ds, _, _ = integrate(centre)
        return float(ds + (1.0 - poisson_ratio) * s)

    centre = float(brentq(edge, 0.3, 1.0, xtol=1e-13))
    _, _, height, volume = integrate(centre)
    return -float(height), centre, float(volume)


def inflated(rings: int) -> tuple[float, float, float]:
    """Return (w0 / a, stress at the centre [Pa], volume [m^3])."""
    shape = quarter_disc(RADIUS_M, rings)
    body = SoftBody.from_arrays(shape.positions, shape.triangles, FILM)
    radius = np.linalg.norm(shape.positions, axis=1)
    clamped = shape.symmetry | (radius > RADIUS_M * (1.0 - 1e-9))[:, None]
    specimen = Specimen(body, clamped, NewtonOptions(tolerance_N=1e-9))
    bulge = shape.positions.copy()
    bulge[:, 2] = 0.03 * RADIUS_M * (1.0 - (radius / RADIUS_M) ** 2)
    found = specimen.solve(specimen.drawn(bulge), replace(UNLOADED, pressure_Pa=(PRESSURE_PA,)))
    x = found.state.positions
    volume = 4.0 * specimen.system.volume
    middle = np.flatnonzero((body.triangles == 0).any(axis=1))
    stress = float(body.principal_stress(x)[middle].mean())
    return float(x[0, 2]) / RADIUS_M, stress, volume


@final
@dataclass(frozen=True)
class HenckyMembrane(Case):
    """Height, stress and volume; the load is small enough for Hencky's shallow slopes (w0 / a = 0.026).

    The constants are not looked up: the equations are integrated.
    """

    name: ClassVar[str] = "hencky_membrane"
    title: ClassVar[str] = "Clamped circular membrane under pressure"
    source: ClassVar[str] = "Hencky, Z. Math. Phys. 63 (1915) 311; Foeppl's equations integrated numerically"

    def run(self) -> tuple[Figure, ...]:
        height, stress, volume = coefficients(FILM.poisson_ratio)
        q = (PRESSURE_PA * RADIUS_M / (FILM.young_modulus_Pa * FILM.thickness_m)) ** (1.0 / 3.0)
        exact = (height * q, stress * FILM.young_modulus_Pa * q * q, volume * RADIUS_M**3 * q)
        coarse, fine = inflated(COARSE), inflated(FINE)
        names = (("w0 / a", "1"), ("stress at the centre", "Pa"), ("volume", "m^3"))
        return tuple(
            Figure.refined(name, unit, c, f, r, 1e-2)
            for (name, unit), c, f, r in zip(names, coarse, fine, exact, strict=True)
        )
