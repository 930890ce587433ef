"""Known answers: strips and rings that bend and buckle, panels joined by rotational springs.

A narrow strip as an elastica: flat panels joined by rotational springs.

A cantilever strip under a dead load at its tip: large deflections.

A cantilever strip that bends under its own weight.

A strip rolled up by a moment at its end.

A clamped-free strip under an axial load: where it buckles, and its shape beyond.

An upright strip that buckles under its own weight.

A long thin-walled tube under outer pressure: where its section buckles.
"""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import final

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc, jv

from cosim.base.frames import Array, IntArray, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, Equilibrium
from cosim.verification.case import UNLOADED, Figure, Specimen, case

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

    The clamped panel lies at x < 0. The fold at the clamp represents half a panel only, so its stiffness is
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
        triangles = np.stack([a, a + 2, a + 1, a + 1, a + 2, a + 3], 1).reshape(-1, 3)
        hinges = interior_hinges(triangles)
        across = hinges[:, 1] // 2 == hinges[:, 2] // 2
        between = self.bending_stiffness / self.panel_m
        stiffness = np.where(across, between, PANEL_FACTOR * between)
        stiffness[across & (hinges[:, 1] == 2)] *= 2.0
        hinged = (hinges, stiffness) if self.hinged else (None, 0.0)
        return SoftBody.from_arrays(
            positions, triangles, self.film, hinge_nodes=hinged[0], hinge_stiffness=hinged[1],
            node_mass=self.node_mass(),
        )  # fmt: skip

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

    def clamp(self) -> Clamp:
        """Return the clamp that holds that panel to a flange."""
        held = np.flatnonzero(self.clamped())
        return Clamp(held, self.body().positions[held], np.ones((len(held), 3), dtype=bool))

    def sideways(self, stiffness: Array, modes: int) -> tuple[Array, Array]:
        """Return the lowest squared frequencies (modes,) and heights (panels + 2, modes) of plane bending.

        In the straight strip bending decouples: both nodes of a section move along z together.

        Args:
            stiffness: (3 n, 3 n) [N/m], of all components.
            modes: how many.
        """
        z = stiffness[2::3, 2::3].reshape(self.panels + 2, 2, self.panels + 2, 2).sum(axis=(1, 3))[2:, 2:]
        mass = self.node_mass().reshape(-1, 2).sum(axis=1)[2:]
        squares, shapes = eigh(z, np.diag(mass), subset_by_index=[0, modes - 1])
        return squares, np.concatenate([np.zeros((2, modes)), shapes])

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


LOADS = (0.5, 1.0, 2.0, 5.0, 10.0)
COARSE, FINE = 12, 24


def exact_tip(alpha: float) -> tuple[float, float]:
    """Return (drop / L, x / L) of the tip under P = alpha EI / L^2.

    With k^2 = (1 + sin phi) / 2 and sin theta = 1 / (k sqrt 2):  sqrt alpha = K(k) - F(k, theta),
    drop / L = 1 - 2 (E(k) - E(k, theta)) / sqrt alpha,  x / L = sqrt(2 sin phi / alpha).
    """

    def parts(phi: float) -> tuple[float, float]:
        m = 0.5 * (1.0 + math.sin(phi))
        return m, math.asin(1.0 / math.sqrt(2.0 * m))

    def length(phi: float) -> float:
        m, theta = parts(phi)
        return float(ellipk(m) - ellipkinc(theta, m)) - math.sqrt(alpha)

    phi = float(brentq(length, 1e-9, 0.5 * math.pi - 1e-9, xtol=1e-14))
    m, theta = parts(phi)
    drop = 1.0 - 2.0 * float(ellipe(m) - ellipeinc(theta, m)) / math.sqrt(alpha)
    return drop, math.sqrt(2.0 * math.sin(phi) / alpha)


def computed_tips(panels: int) -> list[tuple[float, float]]:
    """Return (drop / L, x / L) of the tip for each of LOADS."""
    strip = Strip(panels)
    specimen = strip.specimen()
    here = specimen.solve(specimen.drawn(), UNLOADED)
    tips = []
    for alpha in LOADS:
        force = (0.0, 0.0, -alpha * strip.bending_stiffness / strip.length_m**2)
        here = specimen.follow(here, replace(UNLOADED, nodal_force=strip.tip_force(force)), 2)
        x, z, _ = strip.deflection(here.state.positions)
        tips.append((-z / strip.length_m, x / strip.length_m))
    return tips


@case(
    "tip_loaded_cantilever",
    "Cantilever strip under a tip load, large deflection",
    "Bisshopp and Drucker, Q. Appl. Math. 3 (1945) 272",
)
def tip_loaded_cantilever() -> tuple[Figure, ...]:
    """Bisshopp and Drucker's cantilever for five loads, to 0.5 % in both coordinates of the tip."""
    figures = []
    for alpha, coarse, fine in zip(LOADS, computed_tips(COARSE), computed_tips(FINE), strict=True):
        names = {f"tip {name} / L, P L^2/EI = {alpha:g}": "1" for name in ("drop", "reach")}
        figures += Figure.all_refined(names, coarse, fine, exact_tip(alpha))
    return tuple(figures)


WEIGHTS = (1.0, 5.0, 20.0)
HEAVY_COARSE, HEAVY_FINE = 16, 32


def exact_heavy_tip(weight: float) -> tuple[float, float]:
    """Return (drop / L, slope) of the tip for weight = w L^3 / EI.

    From the tip, at the arc length u = s / L:  theta'' = -weight u cos theta, theta'(0) = 0, theta(1) = 0.
    """

    def shape(tip_slope: float) -> tuple[float, float]:
        def rates(u: float, y: np.ndarray) -> list[float]:
            return [y[1], -weight * u * math.cos(y[0]), math.sin(y[0])]

        end = solve_ivp(rates, (0.0, 1.0), [tip_slope, 0.0, 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
        return float(end[0]), float(end[2])

    slope = float(brentq(lambda angle: shape(angle)[0], 0.0, 0.5 * math.pi, xtol=1e-13))
    return shape(slope)[1], slope


def computed_heavy_tips(panels: int) -> list[tuple[float, float]]:
    """Return (drop / L, slope) of the tip for each of WEIGHTS; the slope is that of the last panel."""
    strip = Strip(panels, density=1.0)
    specimen = strip.specimen()
    here = specimen.solve(specimen.drawn(), UNLOADED)
    tips = []
    for weight in WEIGHTS:
        gravity = weight * strip.bending_stiffness / (strip.length_m**3 * strip.width_m * strip.density)
        here = specimen.follow(here, replace(UNLOADED, gravity=(0.0, 0.0, -gravity)), 4)
        _, z, slope = strip.deflection(here.state.positions)
        tips.append((-z / strip.length_m, -slope))
    return tips


@case(
    "heavy_cantilever",
    "Cantilever strip under its own weight, large deflection",
    "EI theta'' = -w (L - s) cos theta, integrated numerically by shooting",
)
def heavy_cantilever() -> tuple[Figure, ...]:
    """Drop and slope of the tip under the strip's weight."""
    figures = []
    found = computed_heavy_tips(HEAVY_COARSE), computed_heavy_tips(HEAVY_FINE)
    for weight, coarse, fine in zip(WEIGHTS, *found, strict=True):
        names = {f"tip drop / L, w L^3/EI = {weight:g}": "1", f"tip slope, w L^3/EI = {weight:g}": "rad"}
        figures += Figure.all_refined(names, coarse, fine, exact_heavy_tip(weight))
    return tuple(figures)


PANELS = 40
STEPS = 16
_ROUNDS = 12


def couple(strip: Strip, positions: Array, moment: float) -> Array:
    """Return the forces (n, 3) [N] of a moment about -y [N m] on the last panel, normal to it."""
    run = (positions[strip.tip] - positions[strip.tip - 2]).mean(axis=0)
    length = float(np.linalg.norm(run))
    normal = np.array([-run[2], 0.0, run[0]]) / length
    forces = np.zeros_like(positions)
    forces[strip.tip] = 0.5 * moment / length * normal
    forces[strip.tip - 2] = -0.5 * moment / length * normal
    return forces


def turned(strip: Strip, specimen: Specimen, begin: Equilibrium, moment: float) -> Equilibrium:
    """Return the equilibrium under a moment that follows the panel.

    The couple's forces are dead loads, turned with the panel until they no longer change. Where they are
    normal to the panel their moment is stationary in its slope, so this converges quadratically.
    """
    here = begin
    for _ in range(_ROUNDS):
        forces = couple(strip, here.state.positions, moment)
        if here.loads.nodal_force is not None:
            change = float(np.abs(forces - here.loads.nodal_force).max())
            if change < 1e-8 * moment / strip.panel_m:
                break
        here = specimen.follow(here, replace(UNLOADED, nodal_force=forces))
    return here


@case(
    "roll_up",
    "Strip rolled up to a circle by an end moment",
    "constant curvature M / EI; in every text on large rotations",
)
def roll_up() -> tuple[Figure, ...]:
    """M = pi EI / L bends the strip to a half circle, 2 pi EI / L closes the circle.

    Under a constant moment the panels form a regular polygon: it closes exactly, and the half polygon is
    within O(1 / panels^2) of the half circle.
    """
    strip = Strip(PANELS)
    specimen = strip.specimen()
    here = specimen.solve(specimen.drawn(), UNLOADED)
    way = []
    for k in range(1, STEPS + 1):
        here = turned(strip, specimen, here, 2.0 * math.pi * strip.bending_stiffness * k / STEPS)
        way.append(strip.deflection(here.state.positions))
    (x, z, _), (_, height, _) = way[-1], way[STEPS // 2 - 1]
    hinge_turn = np.abs(here.state.memory - math.pi)
    return (
        Figure("height of the half circle / L", "1", height, 2.0 / math.pi, 5e-3),
        Figure("gap of the closed circle / L", "1", math.hypot(x, z), 0.0, 1e-3, absolute=True),
        Figure("turn per panel", "rad", float(hinge_turn.max()), 2.0 * math.pi / PANELS, 1e-3),
    )


EULER_COARSE, EULER_FINE = 8, 16
ELASTICA_PANELS = 40
TIP_ANGLES_DEG = (40.0, 80.0, 120.0)
_NUDGE = 0.02
"""Lateral force in units of the critical load that decides the side; removed before anything is read."""


def euler_load(strip: Strip) -> float:
    """Return pi^2 EI / (4 L^2) [N]."""
    return math.pi**2 * strip.bending_stiffness / (4.0 * strip.length_m**2)


def axial(strip: Strip, load: float, lateral: float = 0.0) -> Loads:
    """Return the loads of an axial compression and a lateral force [N] at the tip."""
    return replace(UNLOADED, nodal_force=strip.tip_force((-load, 0.0, lateral)))


def critical_load(panels: int) -> float:
    """Return the load [N] at which the straight strip's tangent stiffness ceases to be positive definite."""
    strip = Strip(panels)
    euler = euler_load(strip)
    return strip.specimen().critical(0.5 * euler, 2.0 * euler, partial(axial, strip))


def elastica(tip_angle: float) -> tuple[float, float, float]:
    """Return (P / P_cr, x / L, z / L) of the tip; k = sin(angle / 2), moduli K and E.

    P / P_cr = (2 K / pi)^2,  x / L = 2 E / K - 1,  z / L = 2 k / K.
    """
    k = math.sin(0.5 * tip_angle)
    first, second = float(ellipk(k * k)), float(ellipe(k * k))
    return (2.0 * first / math.pi) ** 2, 2.0 * second / first - 1.0, 2.0 * k / first


@case(
    "euler_buckling",
    "Buckling load of a strip, from the tangent stiffness",
    "Euler 1744: P = pi^2 EI / (4 L^2)",
)
def euler_buckling() -> tuple[Figure, ...]:
    """The load at which the tangent stiffness becomes singular is Euler's."""
    exact = euler_load(Strip(EULER_FINE))
    return (
        Figure.refined("critical load", "N", critical_load(EULER_COARSE), critical_load(EULER_FINE), exact),
    )


@case(
    "post_buckling",
    "Shape of the buckled strip",
    "elastica; Timoshenko and Gere, Theory of Elastic Stability, section 2.7",
)
def post_buckling() -> tuple[Figure, ...]:
    """The tip of the buckled strip lies on the elastica."""
    strip = Strip(ELASTICA_PANELS)
    specimen, euler = strip.specimen(), euler_load(strip)
    here = specimen.solve(specimen.drawn(), UNLOADED)
    here = specimen.follow(here, axial(strip, 0.0, _NUDGE * euler), 1)
    figures = []
    for degrees in TIP_ANGLES_DEG:
        ratio, x, z = elastica(math.radians(degrees))
        if degrees == TIP_ANGLES_DEG[0]:
            here = specimen.follow(here, axial(strip, ratio * euler, _NUDGE * euler), 4)
        here = specimen.follow(here, axial(strip, ratio * euler), 4)
        found_x, found_z, _ = strip.deflection(here.state.positions)
        note = f"P / P_cr = {ratio:.4f}"
        figures += [
            Figure(f"tip x / L, {note}", "1", found_x / strip.length_m, x, 5e-3, absolute=True),
            Figure(f"tip z / L, {note}", "1", found_z / strip.length_m, z, 5e-3),
        ]
    return tuple(figures)


def critical_weight() -> float:
    """Return w L^3 / EI at which an upright clamped column buckles, w its weight per length.

    The slope obeys EI theta'' = -w s theta, s from the top, which Bessel's functions of order 1/3 solve;
    free at the top and clamped at the bottom ask for J_{-1/3}((2 / 3) sqrt(w L^3 / EI)) = 0.
    """
    root = float(brentq(lambda z: float(jv(-1.0 / 3.0, z)), 1.0, 2.5, xtol=1e-14))
    return 2.25 * root**2


def found_weight(panels: int) -> float:
    """Return w L^3 / EI at which the upright strip's tangent stiffness ceases to be positive definite."""
    strip = Strip(panels, density=1.0)
    unit = strip.bending_stiffness / (strip.length_m**3 * strip.width_m * strip.density)

    def upright(weight: float) -> Loads:  # the strip lies along x: this presses it against its clamp
        return replace(UNLOADED, gravity=(-weight * unit, 0.0, 0.0))

    return strip.specimen().critical(0.5 * critical_weight(), 2.0 * critical_weight(), upright)


@case(
    "self_buckling",
    "Upright strip under its own weight: where it buckles",
    "Greenhill, Proc. Camb. Phil. Soc. 4 (1881) 65: J_{-1/3}((2/3) sqrt(w L^3/EI)) = 0",
)
def self_buckling() -> tuple[Figure, ...]:
    """The weight at which the tangent stiffness becomes singular is Greenhill's, 7.837 EI / L^3.

    Weight is compression that grows along the strip: the load's distribution is tested besides the hinges.
    The error falls with the square of the panels' length; 24 panels leave 0.1 %.
    """
    coarse, fine = found_weight(COARSE), found_weight(FINE)
    return (Figure.refined("critical w L^3 / EI", "1", coarse, fine, critical_weight()),)


RING_COARSE, RING_FINE = 48, 96
RADIUS_M, DEPTH_M = 0.1, 0.02
FILM = Film(1e9, 0.0, 1e-3)


def critical_pressure() -> float:
    """Return 3 D / R^3 [Pa], D = E t^3 / 12 the bending stiffness per width."""
    return 3.0 * FILM.bending_stiffness_Nm / RADIUS_M**3


def ring(panels: int) -> tuple[Array, IntArray]:
    """Return positions (n, 3) [m] and outward triangles; nodes 2 s and 2 s + 1 are line s, the axis is y.

    The polygon has the circle's circumference.
    """
    angle = 2.0 * math.pi * np.arange(panels) / panels
    radius = math.pi * RADIUS_M / (panels * math.sin(math.pi / panels))
    positions = np.zeros((2 * panels, 3))
    positions[:, 0], positions[:, 2] = np.repeat(radius * np.array([np.cos(angle), np.sin(angle)]), 2, axis=1)
    positions[1::2, 1] = DEPTH_M
    a = 2 * np.arange(panels)
    b = (a + 2) % (2 * panels)
    return positions, np.stack([a, a + 1, b, a + 1, b + 1, b], 1).reshape(-1, 3)


def pressed(panels: int) -> Specimen:
    """Return the ring, its lines kept at their depth and three components held against rigid motion."""
    positions, triangles = ring(panels)
    hinges = interior_hinges(triangles)
    across = hinges[:, 1] // 2 == hinges[:, 2] // 2
    between = FILM.bending_stiffness_Nm * DEPTH_M * panels / (2.0 * math.pi * RADIUS_M)
    body = SoftBody.from_arrays(
        positions, triangles, FILM, hinge_nodes=hinges,
        hinge_stiffness=np.where(across, between, PANEL_FACTOR * between),
    )  # fmt: skip
    held = np.zeros(positions.shape, dtype=bool)
    held[:, 1] = True
    held[0, [0, 2]] = True
    held[panels, 2] = True  # opposite: no turn about the axis
    return Specimen(body, held, NewtonOptions(tolerance_N=1e-7, iterations_max=100))


def outer(pressure_Pa: float) -> Loads:
    """Return the loads of a pressure from outside.

    No film represents the ends, so the model measures two thirds of the volume, see `Sheet.loads`.
    """
    return replace(UNLOADED, pressure_Pa=(-1.5 * pressure_Pa,))


def found_pressure(panels: int) -> float:
    """Return the pressure [Pa] at which the round ring's tangent stiffness ceases to be positive definite."""
    return pressed(panels).critical(0.5 * critical_pressure(), 1.5 * critical_pressure(), outer)


@case(
    "pressed_ring",
    "Long tube under outer pressure: where its section buckles",
    "Lévy 1884; Timoshenko and Gere, Theory of Elastic Stability, 7.3: p = 3 EI / R^3",
)
def pressed_ring() -> tuple[Figure, ...]:
    """The pressure at which the tangent stiffness becomes singular is 3 EI / R^3.

    That number belongs to a pressure that stays normal to the wall; a load that kept its direction would
    give 4 EI / R^3, one towards the centre 4.5 EI / R^3. So the tangent of the pressure is tested, which is
    as large as that of the hinges. The error falls with the square of the panels' length.
    """
    coarse, fine = found_pressure(RING_COARSE), found_pressure(RING_FINE)
    return (Figure.refined("critical pressure", "Pa", coarse, fine, critical_pressure()),)
