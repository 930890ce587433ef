"""Known answers: shells and membranes under pressure, sealed gas, invariance of their potential.

A thin sphere and a thin closed cylinder under pressure.

A flat circular membrane, clamped at its edge, under pressure.

A rubber balloon, and the largest pressure that it bears.

A sphere filled with a given amount of gas: its pressure, and the frequency at which it breathes.

A weight on a column of sealed gas between stiff walls.

Potential of a chamber: the same after a rigid motion, and consistent with its derivatives.
"""

import math
from dataclasses import replace
from typing import get_args

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from cosim.base.frames import Array, rotation_from_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.gas import SealedGas, STANDARD_ATMOSPHERE_Pa
from cosim.soft.elements.material import Film, FilmLaw
from cosim.soft.geometry import polygonal_stack, surface
from cosim.soft.solve import assembly, newton_options
from cosim.verification.case import (
    UNLOADED,
    Figure,
    Specimen,
    case,
    held_on_axis,
    observed_order,
    octant_sphere,
    quarter_disc,
    tube,
)

FILM = Film(300e6, 0.3, 1e-4)
RADIUS_M, LENGTH_M = 0.04, 0.08
SPHERE_PA, CYLINDER_PA = 200.0, 100.0
RINGS, SIDES = (8, 16), (32, 64)


def inflated_sphere(rings: int) -> tuple[float, float]:
    """Return (dR / R from the enclosed volume, mean principal stress [Pa]) of an octant."""
    shape = octant_sphere(RADIUS_M, rings)
    body = SoftBody.from_arrays(shape.positions, shape.triangles, FILM)
    specimen = Specimen(body, shape.symmetry, newton_options.NewtonOptions(tolerance_N=1e-9))
    found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(SPHERE_PA,)))
    volume = specimen.system.volume
    specimen.system.evaluate(body.positions, UNLOADED, np.zeros(0), specimen.system.memory, hessian=False)
    stress = body.principal_stress(found.state.positions).mean(axis=1)
    mean = float(stress @ body.areas / body.areas.sum())
    return (volume / specimen.system.volume) ** (1.0 / 3.0) - 1.0, mean


@case("pressurised_sphere", "Sphere under pressure", "sigma = p R / 2 t, dR / R = p R (1 - nu) / (2 E t)")
def pressurised_sphere() -> tuple[Figure, ...]:
    """Stress and growth of a sphere at a strain of 2e-4, where the linear formulas hold to 1e-3."""
    stress = SPHERE_PA * RADIUS_M / (2.0 * FILM.thickness_m)
    growth = stress * (1.0 - FILM.poisson_ratio) / FILM.young_modulus_Pa
    names = {"dR / R": "1", "mean stress": "Pa"}
    coarse, fine = map(inflated_sphere, RINGS)
    return tuple(Figure.all_refined(names, coarse, fine, (growth, stress)))


def inflated_cylinder(sides: int) -> tuple[float, float, float, float]:
    """Return (dR / R, dL / L, hoop stress, axial stress [Pa]) of a cylinder closed by caps."""
    rows = sides // 4
    positions, triangles = tube(RADIUS_M, LENGTH_M, sides, rows)
    last = rows * sides + np.arange(sides)
    caps = (np.arange(sides)[::-1].copy(), last)
    body = SoftBody.from_arrays(positions, triangles, FILM, caps=caps)
    specimen = Specimen(body, held_on_axis(sides, body.nodes), newton_options.NewtonOptions(tolerance_N=1e-9))
    found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(CYLINDER_PA,)))
    x = found.state.positions
    radius = float(np.hypot(x[:, 0], x[:, 1]).mean())
    hoop, axial = body.principal_stress(x).mean(axis=0)
    length = float(x[last, 2].mean())
    return radius / RADIUS_M - 1.0, length / LENGTH_M - 1.0, float(hoop), float(axial)


@case(
    "pressurised_cylinder",
    "Closed cylinder under pressure",
    "hoop p R / t, axial p R / 2 t; dR/R = (1 - nu/2) p R/E t, dL/L = (1/2 - nu) p R/E t",
)
def pressurised_cylinder() -> tuple[Figure, ...]:
    """Stresses and growth of a cylinder that carries the pressure on its end caps."""
    hoop, nu = CYLINDER_PA * RADIUS_M / FILM.thickness_m, FILM.poisson_ratio
    strain = hoop / FILM.young_modulus_Pa
    exact = (strain * (1.0 - 0.5 * nu), strain * (0.5 - nu), hoop, 0.5 * hoop)
    names = {"dR / R": "1", "dL / L": "1", "hoop stress": "Pa", "axial stress": "Pa"}
    coarse, fine = map(inflated_cylinder, SIDES)
    return tuple(Figure.all_refined(names, coarse, fine, exact))


HENCKY_RADIUS_M = 0.1
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
    shape = quarter_disc(HENCKY_RADIUS_M, rings)
    body = SoftBody.from_arrays(shape.positions, shape.triangles, FILM)
    radius = np.linalg.norm(shape.positions, axis=1)
    clamped = shape.symmetry | (radius > HENCKY_RADIUS_M * (1.0 - 1e-9))[:, None]
    specimen = Specimen(body, clamped, newton_options.NewtonOptions(tolerance_N=1e-9))
    bulge = shape.positions.copy()
    bulge[:, 2] = 0.03 * HENCKY_RADIUS_M * (1.0 - (radius / HENCKY_RADIUS_M) ** 2)
    found = specimen.solve(specimen.drawn(bulge), replace(UNLOADED, pressure_Pa=(PRESSURE_PA,)))
    x = found.state.positions
    volume = 4.0 * specimen.system.volume
    middle = np.flatnonzero((body.triangles == 0).any(axis=1))
    stress = float(body.principal_stress(x)[middle].mean())
    return float(x[0, 2]) / HENCKY_RADIUS_M, stress, volume


@case(
    "hencky_membrane",
    "Clamped circular membrane under pressure",
    "Hencky, Z. Math. Phys. 63 (1915) 311; Foeppl's equations integrated numerically",
)
def hencky_membrane() -> tuple[Figure, ...]:
    """Height, stress and volume; the load is small enough for Hencky's shallow slopes (w0 / a = 0.026).

    The constants are not looked up: the equations are integrated.
    """
    height, stress, volume = coefficients(FILM.poisson_ratio)
    q = (PRESSURE_PA * HENCKY_RADIUS_M / (FILM.young_modulus_Pa * FILM.thickness_m)) ** (1.0 / 3.0)
    exact = (height * q, stress * FILM.young_modulus_Pa * q * q, volume * HENCKY_RADIUS_M**3 * q)
    names = {"w0 / a": "1", "stress at the centre": "Pa", "volume": "m^3"}
    return tuple(Figure.all_refined(names, inflated(COARSE), inflated(FINE), exact, 1e-2))


RUBBER = Film(1.5e6, 0.5, 5e-4, "neo_hookean")
BALLOON_RINGS = 8, 16
STRETCHES = (1.33, 1.38, 1.43)


def limit_pressure(rings: int) -> float:
    """Return the largest pressure [Pa] of a balloon, by gas that is filled in: it passes the limit.

    The gas is isothermal, in a vacuum. A parabola through three fillings has the largest pressure.
    """
    shape, found = octant_sphere(RADIUS_M, rings), []
    body = SoftBody.from_arrays(shape.positions, shape.triangles, RUBBER)
    specimen = Specimen(body, shape.symmetry, newton_options.NewtonOptions(tolerance_N=1e-9))
    specimen.gradient(specimen.solve(specimen.drawn(), UNLOADED))
    drawn_volume = specimen.system.volume
    for stretch in STRETCHES:
        gas = SealedGas(balloon_pressure(stretch), drawn_volume * stretch**3, 1.0, 0.0)
        specimen.solve(specimen.drawn(shape.positions * stretch), replace(UNLOADED, gas=(gas,)))
        found.append((specimen.system.volume ** (1.0 / 3.0), specimen.system.pressure_Pa))
    radius, pressure = np.array(found).T
    middle = radius[1]
    square, slope, level = np.polyfit(radius / middle - 1.0, pressure, 2)
    return float(level - 0.25 * slope**2 / square)


def balloon_pressure(stretch: float) -> float:
    """Return 2 mu t / R (1 / l - 1 / l^7) [Pa], mu a third of Young's modulus."""
    shear = RUBBER.young_modulus_Pa * RUBBER.thickness_m / 3.0
    return 2.0 * shear / RADIUS_M * (1.0 / stretch - stretch**-7.0)


@case(
    "rubber_balloon",
    "Limit pressure of a rubber balloon",
    "neo-Hookean sphere: p = 2 mu t / R (1 / l - 1 / l^7), largest at l = 7^(1/6)",
)
def rubber_balloon() -> tuple[Figure, ...]:
    """Largest pressure of a sphere of incompressible rubber, and the stretch behind it."""
    coarse, fine = map(limit_pressure, BALLOON_RINGS)
    exact = balloon_pressure(7.0 ** (1.0 / 6.0))
    return (Figure.refined("limit pressure", "Pa", coarse, fine, exact),)


GAS_FILM = Film(20e6, 0.3, 1e-4)
GAS_RADIUS_M = 0.04
DENSITY = 1200.0
EXPONENT = 1.4
FILLING = 1.02
"""Absolute pressure over the atmosphere's, in the drawn volume."""
GAS_RINGS = 16


def filled_pressure() -> float:
    """Return the gauge pressure [Pa] at which gas (isothermal) and film agree on the radius.

    With the growth e = dR / R and the filling f, the gas has p = p_a (f / (1 + e)^3 - 1). The film's energy
    is 4 pi R^2 E t g^2 / (1 - nu) with the Green strain g = e + e^2 / 2, and its derivative by the volume
    is p = 2 E t g / ((1 - nu) R (1 + e)).
    """
    stretch = 2.0 * GAS_FILM.young_modulus_Pa * GAS_FILM.thickness_m
    stiffness = stretch / ((1.0 - GAS_FILM.poisson_ratio) * GAS_RADIUS_M)

    def gas(e: float) -> float:
        return STANDARD_ATMOSPHERE_Pa * (FILLING / (1.0 + e) ** 3 - 1.0)

    def film(e: float) -> float:
        return stiffness * (e + 0.5 * e * e) / (1.0 + e)

    return gas(float(brentq(lambda e: gas(e) - film(e), 0.0, 0.1, xtol=1e-15)))


def breathing() -> float:
    """Return omega [rad/s] of the sphere at rest:  2 E / (rho R^2 (1 - nu)) + 3 gamma p_a / (rho t R)."""
    film = 2.0 * GAS_FILM.young_modulus_Pa / (GAS_RADIUS_M**2 * (1.0 - GAS_FILM.poisson_ratio))
    gas = 3.0 * EXPONENT * STANDARD_ATMOSPHERE_Pa / (GAS_FILM.thickness_m * GAS_RADIUS_M)
    return math.sqrt((film + gas) / DENSITY)


@case(
    "sealed_gas",
    "Sphere with a sealed gas: pressure and breathing",
    "p V^gamma = const; omega^2 = 2E / (rho R^2 (1-nu)) + 3 gamma p / (rho t R)",
)
def sealed_gas() -> tuple[Figure, ...]:
    """A filled sphere at rest, and its breathing with the film's and the gas's stiffness.

    The gas takes a good half of the breathing stiffness. The frequency is Rayleigh's quotient of the radial
    motion.
    """
    shape = octant_sphere(GAS_RADIUS_M, GAS_RINGS)
    body = SoftBody.from_arrays(shape.positions, shape.triangles, GAS_FILM)
    specimen = Specimen(body, shape.symmetry, newton_options.NewtonOptions(tolerance_N=1e-9))
    specimen.gradient(specimen.solve(specimen.drawn(), UNLOADED))
    drawn_volume = specimen.system.volume
    rest = SealedGas(STANDARD_ATMOSPHERE_Pa, drawn_volume, EXPONENT)
    filled = SealedGas(FILLING * STANDARD_ATMOSPHERE_Pa, drawn_volume, 1.0)

    specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(filled,)))
    pressure = specimen.system.pressure_Pa

    stiffness = specimen.stiffness(specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(rest,))))
    radial = shape.positions.ravel() / GAS_RADIUS_M
    mass = np.zeros(body.nodes)
    np.add.at(mass, shape.triangles, body.areas[:, None] * DENSITY * GAS_FILM.thickness_m / 3.0)
    omega = math.sqrt(float(radial @ stiffness @ radial) / float(mass.sum()))
    return (
        Figure("gauge pressure of the filled sphere", "Pa", pressure, filled_pressure(), 5e-3),
        Figure("breathing frequency", "rad/s", omega, breathing(), 5e-3),
    )


LOADS = (-0.2, 0.5, 1.0)
"""Weight over p_a A; a negative one pulls."""


PISTON_SIDES = 12
_RADIUS_M, _HEIGHT_M, _MASS_kg = 0.05, 0.2, 2.0
_FILM = Film(10.0, 0.3, 1e-4)
"""So soft that it carries less than 1e-7 of the load: E t / (p_a R)."""


def cylinder() -> tuple[Specimen, float]:
    """Return a closed prism whose film can only move up and down, held at its bottom; its section [m^2]."""
    positions, triangles = tube(_RADIUS_M, _HEIGHT_M, PISTON_SIDES, 1)
    top = PISTON_SIDES + np.arange(PISTON_SIDES)
    body = SoftBody.from_arrays(
        positions, triangles, _FILM, caps=(np.arange(PISTON_SIDES)[::-1].copy(), top), tip=top
    )
    held = np.ones(positions.shape, dtype=bool)
    held[top, 2] = False
    section = 0.5 * PISTON_SIDES * _RADIUS_M**2 * math.sin(2.0 * math.pi / PISTON_SIDES)
    return Specimen(body, held, newton_options.NewtonOptions(tolerance_N=1e-6, iterations_max=200)), section


def on_top(body: SoftBody, weight_N: float) -> Array:
    """Return nodal forces (n, 3) [N] of a weight on the piston."""
    force = np.zeros((body.nodes, 3))
    force[body.tip, 2] = -weight_N / len(body.tip)
    return force


@case(
    "sealed_piston",
    "Piston on sealed gas: height under a weight, and bounce",
    "Boyle 1662: p V = const; Rüchardt 1929: omega^2 = gamma p A^2 / (m V)",
)
def sealed_piston() -> tuple[Figure, ...]:
    """Height of the piston under three weights, isothermal, and its frequency, adiabatic.

    The gas is at the atmosphere's pressure p_a while nothing weighs on it. A weight W on the section A asks
    for p = p_a + W / A, so the height falls as 1 / (1 + W / p_a A). The tolerance leaves the film its share.
    """
    specimen, section = cylinder()
    body = specimen.body
    volume, pressure = section * _HEIGHT_M, STANDARD_ATMOSPHERE_Pa
    slow, fast = (SealedGas(pressure, volume, exponent) for exponent in (1.0, EXPONENT))
    here = specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(slow,), nodal_force=on_top(body, 0.0)))
    figures = []
    for load in LOADS:
        force = on_top(body, load * pressure * section)
        found = specimen.follow(here, replace(UNLOADED, gas=(slow,), nodal_force=force), 4)
        height = float(body.tip_position(found.state.positions)[2]) / _HEIGHT_M
        figures.append(Figure(f"height / h_0, W / p_a A = {load:g}", "1", height, 1.0 / (1.0 + load), 1e-5))
    still = specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(fast,)))
    up = np.zeros((body.nodes, 3))
    up[body.tip, 2] = 1.0
    omega = math.sqrt(float(up.ravel() @ specimen.stiffness(still) @ up.ravel()) / _MASS_kg)
    exact = math.sqrt(EXPONENT * pressure * section**2 / (_MASS_kg * volume))
    return (*figures, Figure("frequency, adiabatic", "rad/s", omega, exact, 1e-5))


MOVED_LOADS = Loads((20e3,), (2.0, 3.0), (0.0, 0.0, 0.0))
STEPS_M = (4e-6, 2e-6)


def chamber(law: FilmLaw = "plain") -> tuple[SoftBody, Array]:
    """Return two hexagonal units with film, hinges, fold barrier, gas and cables, and a deformed shape.

    The shape is the drawn one, drawn out five times and scattered by 1 mm.
    """
    mesh = polygonal_stack.PolygonalStack(6, 2, 0.05, 0.01, 0.002, 0.95).mesh()
    body = SoftBody.from_arrays(
        mesh.positions, mesh.triangles, Film(1.3e9, 0.5 if law == "neo_hookean" else 0.2, 1.1e-4, law),
        wrinkle_panel_m=mesh.face_values["wrinkle_panel_m"],
        hinge_nodes=surface.interior_hinges(mesh.triangles, mesh.seam), hinge_stiffness=1.4e-3,
        fold_barrier_rad=0.02 * math.pi, caps=mesh.caps,
        cables=tuple(Cable(mesh.line(f"corner_{k}"), 0.8) for k in (0, 1)), node_mass=2e-3,
    )  # fmt: skip
    scatter = 1e-3 * np.random.default_rng(0).normal(size=mesh.positions.shape)
    return body, np.ascontiguousarray(mesh.positions * (1.0, 1.0, 5.0) + scatter)


def potential(system: assembly.SoftSystem, x: Array, angles: Array, *, hessian: bool = False) -> float:
    """Return the potential [J] at positions (n, 3) [m]; gradient and Hessian stay in the system."""
    return system.evaluate(x, MOVED_LOADS, system.segment_share(x, MOVED_LOADS), angles, hessian=hessian)


def taylor_remainder(system: assembly.SoftSystem, x: Array, angles: Array, step: float) -> float:
    """Return |F(x + d) - F(x - d) - 2 g . d| [J] for |d| = step along a random direction; it is O(step^3)."""
    direction = np.random.default_rng(1).normal(size=x.shape)
    d = step * direction / np.abs(direction).max()
    ahead, behind = potential(system, x + d, angles), potential(system, x - d, angles)
    potential(system, x, angles)
    return abs(ahead - behind - 2.0 * float((system.gradient * d).sum()))


def hessian_remainder(system: assembly.SoftSystem, x: Array, angles: Array, step: float) -> float:
    """Return max |g(x + d) - g(x - d) - 2 H d| [N]; it is O(step^3)."""
    direction = np.random.default_rng(2).normal(size=x.shape)
    d = step * direction / np.abs(direction).max()
    potential(system, x + d, angles)
    ahead = system.gradient.copy()
    potential(system, x - d, angles)
    behind = system.gradient.copy()
    potential(system, x, angles, hessian=True)
    row, column, blocks = system.pattern.row, system.pattern.column, system.blocks
    product = np.zeros_like(x)
    np.add.at(product, row, np.einsum("brc,bc->br", blocks, d[column]))
    other = row != column
    np.add.at(product, column[other], np.einsum("bcr,bc->br", blocks[other], d[row[other]]))
    return float(np.abs(ahead - behind - 2.0 * product).max())


def change_by_rigid_motion(law: FilmLaw) -> float:
    """Return the relative change of the potential when the chamber is turned and shifted."""
    body, x = chamber(law)
    system, angles = assembly.SoftSystem(body), surface.dihedral_angle(x, body.hinges.nodes)
    rotation = rotation_from_vector(np.array([0.7, -1.1, 0.4]))
    moved = np.ascontiguousarray(x @ rotation.T + np.array([0.3, -0.2, 0.5]))
    return abs(potential(system, moved, angles) / potential(system, x, angles) - 1.0)


@case(
    "rigid_motion",
    "Invariance, balance and exact derivatives of the whole potential",
    "Noether's theorem; Taylor's theorem",
)
def rigid_motion() -> tuple[Figure, ...]:
    """A turned and shifted chamber has the same potential; its inner forces have no resultant.

    Both hold only if every term is written in lengths and angles, if gas is closed in, and if cables pull in
    pairs. The remainders of Taylor's series fall with the cube of the step only if gradient and Hessian are
    exact.
    """
    change = max(change_by_rigid_motion(law) for law in get_args(FilmLaw))
    body, x = chamber()
    system, angles = assembly.SoftSystem(body), surface.dihedral_angle(x, body.hinges.nodes)
    potential(system, x, angles)
    force = system.gradient
    scale = float(np.abs(force).sum())
    resultant = float(np.linalg.norm(force.sum(axis=0))) / scale
    moment = float(np.linalg.norm(np.cross(x - x.mean(axis=0), force).sum(axis=0))) / (scale * 0.05)
    gradients = [taylor_remainder(system, x, angles, step) for step in STEPS_M]
    hessians = [hessian_remainder(system, x, angles, step) for step in STEPS_M]
    return (
        Figure("change of the potential, worst film law", "1", change, 0.0, 1e-11, absolute=True),
        Figure("resultant of all forces / their sum", "1", resultant, 0.0, 1e-12, absolute=True),
        Figure("moment of all forces / (sum x radius)", "1", moment, 0.0, 1e-12, absolute=True),
        Figure(
            "order of the gradient's remainder", "1", observed_order(*gradients), 3.0, 0.15, absolute=True
        ),
        Figure("order of the Hessian's remainder", "1", observed_order(*hessians), 3.0, 0.15, absolute=True),
    )
