"""Verification cases: short problems with known answers, and the specimens for them. Each case is a function
that returns its figures, and whose docstring has the formula and the source.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final, final

import numpy as np
from scipy.optimize import brentq, root
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.schemes import iterated, staggered
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.ticks import ServoCommands
from cosim.rigid.build.description import SceneDescription, ServoGains
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.fabric import Fabric
from cosim.soft.elements.gas import SealedGas, STANDARD_ATMOSPHERE_Pa
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.soft.solve.step_scheme import Integrator, StepOptions
from cosim.soft.solve.time_step import Stepper

UNLOADED: Final = Loads(gravity=(0.0, 0.0, 0.0))
"""No pressure, no weight, no forces."""

NO_CLAMP: Final = Clamp(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), dtype=bool))
"""Nothing follows a flange: held nodes stay where they start."""
SLIDE: Final = """<robot name="slide"><link name="rail"/><link name="carriage"><inertial>
<mass value="{mass}"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="along" type="prismatic"><parent link="rail"/><child link="carriage"/><axis xyz="0 0 1"/>
<limit lower="-10" upper="10" effort="1000" velocity="100"/></joint></robot>"""


@final
@dataclass(frozen=True)
class Figure:
    """One number and its known value.

    Args:
        quantity: what it is, with its unit.
        found: as computed.
        expected: the known value.
        tolerance: largest error that passes, relative to the expected value.
    """

    quantity: str
    found: float
    expected: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; a number that is not finite never is."""
        return bool(abs(self.found - self.expected) <= self.tolerance * abs(self.expected))


CASES: Final[dict[str, Callable[[], list[Figure]]]] = {}
"""The cases by name."""


def known_answer(run: Callable[[], list[Figure]]) -> Callable[[], list[Figure]]:
    """Register a function as a case."""
    CASES[run.__name__] = run
    return run


@final
class Specimen:
    """A body whose clamped components stay where they start.

    Args:
        body: the soft body.
        clamped: (n,) or (n, 3) bool.
        options: bounds of Newton's method; steps may be as long as the body.
    """

    def __init__(self, body: SoftBody, clamped: Mask, options: NewtonOptions) -> None:
        self.body, self.film = body, FilmPotential(body)
        self.newton = NewtonSolver(self.film, clamped)
        self.equilibria = EquilibriumSolver(self.newton, NO_CLAMP, options)

    def drawn(self, positions: Array | None = None) -> SoftState:
        """Return the drawn shape at rest, with other positions (n, 3) [m] if given."""
        state = SoftState.drawn(self.body, Pose())
        return state if positions is None else replace(state, positions=np.ascontiguousarray(positions))

    def solve(self, state: SoftState, loads: Loads) -> Equilibrium:
        """Return the equilibrium near a state."""
        return self.equilibria.solve(state, Pose(), loads)

    def follow(self, begin: Equilibrium, loads: Loads, steps: int = 1) -> Equilibrium:
        """Return the equilibrium under other loads, reached in at least `steps` equal steps."""
        here = begin
        for k in range(1, steps + 1):
            here = self.equilibria.follow(here, Pose(), begin.loads.interpolated(loads, k / steps))
        return here

    def gradient(self, here: Equilibrium, *, hessian: bool = False) -> Array:
        """Return the gradient of the potential (n, 3) [N]: what the supports supply."""
        x, loads, memory = here.state.positions, here.loads, here.state.memory
        self.film.evaluate(x, loads, self.film.losses_at(x, loads, memory), memory, hessian=hessian)
        return self.film.gradient.copy()

    def critical(self, expected: float, loads: Callable[[float], Loads]) -> float:
        """Return the factor at which the drawn shape ceases to be stable, by bisection to 1e-7.

        Args:
            expected: it is sought between 0.5 and 1.5 times this.
            loads: at a factor.
        """
        low, high = 0.5 * expected, 1.5 * expected
        while high - low > 1e-7 * high:
            middle = 0.5 * (low + high)
            self.gradient(self.solve(self.drawn(), loads(middle)), hessian=True)
            stable = self.newton.linear.factor(self.film.blocks, low_rank=self.film.tangent.low_rank)
            low, high = (middle, high) if stable else (low, middle)
        return 0.5 * (low + high)


def exact_steps(integrator: Integrator, tolerance_N: float) -> StepOptions:
    """Return options under which every time step is solved to a tolerance [N]."""
    return StepOptions(
        integrator, tolerance_N=tolerance_N, iterations=20, residual_bound_N=tolerance_N,
        newton=NewtonOptions(tolerance_N=tolerance_N),
    )  # fmt: skip


@final
@dataclass(frozen=True)
class Strip:
    """A strip along x of flat panels on hinges, width along y, clamped at x = 0: an elastica.

    Between panels acts k = E b t^3 / (12 D), D the length of a panel. The fold along a panel's diagonal is
    10,000 times as stiff: a soft one would let panels twist. The clamped panel lies at x < 0; the hinge at
    the clamp represents half a panel, so its stiffness is doubled, and the error falls with D^2.

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
    def tip(self) -> IntArray:
        """(2,) nodes at the end."""
        return np.array([2 * self.panels + 2, 2 * self.panels + 3])

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return 2 * (self.panels + 2)

    def body(self) -> SoftBody:
        """Return the strip, stress free when straight; its nodes 2 s and 2 s + 1 are section s."""
        panel_m = self.length_m / self.panels
        positions = np.zeros((self.nodes, 3))
        positions[:, 0] = np.repeat(panel_m * np.arange(-1, self.panels + 1), 2)
        positions[1::2, 1] = self.width_m
        a = 2 * np.arange(self.panels + 1)
        triangles = np.stack([a, a + 2, a + 1, a + 1, a + 2, a + 3], 1).reshape(-1, 3)
        hinges = interior_hinges(triangles)
        across = hinges[:, 1] // 2 == hinges[:, 2] // 2
        stiffness = np.where(across, 1.0, 1e4) * self.bending_stiffness / panel_m
        stiffness[across & (hinges[:, 1] == 2)] *= 2.0
        mass = np.full(self.nodes, 0.5 * self.density * self.width_m * panel_m)
        mass[[0, 1, 2, 3, -2, -1]] *= 0.5
        hinged = (hinges, stiffness) if self.hinged else (None, 0.0)
        return SoftBody.from_arrays(
            positions, triangles, self.film, hinge_nodes=hinged[0], hinge_stiffness=hinged[1], node_mass=mass
        )

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


def tube(radius_m: float, length_m: float, sides: int, rows: int) -> tuple[Array, IntArray]:
    """Return positions (n, 3) and outward triangles of an open tube along z from z = 0.

    Node k of ring r is r * sides + k, at the angle 2 pi k / sides. All diagonals run the same way, so that
    every node carries the pressure of the same area: alternating ones dent a film without bending stiffness.
    """
    angle = 2.0 * math.pi * np.arange(sides) / sides
    ring = radius_m * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    height = np.linspace(0.0, length_m, rows + 1)
    positions = (ring[None, :, :] + height[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
    r, k = (axis.ravel() for axis in np.meshgrid(np.arange(rows), np.arange(sides), indexing="ij"))
    a, b = r * sides + k, r * sides + (k + 1) % sides
    triangles = np.stack([a, b, b + sides, a, b + sides, a + sides], axis=1)
    return positions, triangles.reshape(-1, 3).astype(np.int64)


def closed_tube(radius_m: float, length_m: float, sides: int, rows: int, film: Film) -> Specimen:
    """Return a tube of so many sides and rows, closed by caps; its tip is the last ring.

    Ring 0 stays in its plane, three more components stop rigid motion.
    """
    positions, triangles = tube(radius_m, length_m, sides, rows)
    tip = rows * sides + np.arange(sides)
    body = SoftBody.from_arrays(
        positions, triangles, film, caps=(np.arange(sides)[::-1].copy(), tip), tip=tip
    )
    held = np.zeros(positions.shape, dtype=bool)
    held[:sides, 2] = held[[0, sides // 2], 1] = held[sides // 4, 0] = True
    return Specimen(body, held, NewtonOptions(tolerance_N=1e-9))


@known_answer
def tip_loaded_cantilever() -> list[Figure]:
    """Strip under a dead load P at its tip (Bisshopp and Drucker, Q. Appl. Math. 3 (1945) 272).

    With k^2 = (1 + sin phi) / 2, sin theta = 1 / (k sqrt 2) and alpha = P L^2 / EI:  sqrt alpha =
    K(k) - F(k, theta), drop / L = 1 - 2 (E(k) - E(k, theta)) / sqrt alpha,
    reach / L = sqrt(2 sin phi / alpha). Tolerance: 24 panels leave 0.1 %, falling with their square.
    """
    strip, figures = Strip(24), []
    specimen = strip.specimen()
    here = specimen.solve(specimen.drawn(), UNLOADED)

    def parts(phi: float) -> tuple[float, float]:
        m = 0.5 * (1.0 + math.sin(phi))
        return m, math.asin(1.0 / math.sqrt(2.0 * m))

    def off(phi: float, alpha: float) -> float:
        m, theta = parts(phi)
        return float(ellipk(m) - ellipkinc(theta, m)) - math.sqrt(alpha)

    for alpha in (1.0, 10.0):
        force = strip.tip_force((0.0, 0.0, -alpha * strip.bending_stiffness))
        here = specimen.follow(here, replace(UNLOADED, nodal_force=force), 4)
        x, _, z = here.state.positions[strip.tip].mean(axis=0).tolist()
        phi = float(brentq(off, 1e-9, 0.5 * math.pi - 1e-9, args=(alpha,), xtol=1e-14))
        m, theta = parts(phi)
        drop = 1.0 - 2.0 * float(ellipe(m) - ellipeinc(theta, m)) / math.sqrt(alpha)
        reach = math.sqrt(2.0 * math.sin(phi) / alpha)
        figures += [
            Figure(f"drop / L, P L^2 / EI = {alpha:g}", -z, drop, 5e-3),
            Figure(f"reach / L, P L^2 / EI = {alpha:g}", x, reach, 5e-3),
        ]
    return figures


@known_answer
def euler_buckling() -> list[Figure]:
    """Load at which the tangent of a clamped-free strip becomes singular: pi^2 EI / (4 L^2) (Euler 1744).

    Tolerance: 16 panels leave 0.1 %, falling with their square.
    """
    strip = Strip(16)
    euler = math.pi**2 * strip.bending_stiffness / (4.0 * strip.length_m**2)
    found = strip.specimen().critical(
        euler, lambda load: replace(UNLOADED, nodal_force=strip.tip_force((-load, 0.0, 0.0)))
    )
    return [Figure("critical load [N]", found, euler, 5e-3)]


@known_answer
def self_buckling() -> list[Figure]:
    """Weight w per length at which an upright strip buckles (Greenhill, Proc. Camb. Phil. Soc. 4 (1881) 65).

    J_{-1/3}((2 / 3) sqrt(w L^3 / EI)) = 0: w L^3 / EI = 7.83735. The strip lies along x, and so does gravity.
    Tolerance: 16 panels leave 0.2 %, falling with their square.
    """
    strip = Strip(16, density=1.0)
    unit = strip.bending_stiffness / (strip.length_m**3 * strip.width_m * strip.density)
    found = strip.specimen().critical(
        7.83735, lambda weight: replace(UNLOADED, gravity=(-weight * unit, 0.0, 0.0))
    )
    return [Figure("critical w L^3 / EI", found, 7.83735, 5e-3)]


@known_answer
def pendulum() -> list[Figure]:
    """Period of one stiff panel on a hinge without stiffness, released at 90 degrees, by BDF2.

    T = 4 sqrt(L / g) K(sin(amplitude / 2)), Legendre's complete elliptic integral. It hangs along x, which is
    down. Tolerance: (omega h)^2 of 400 steps to a period.
    """
    strip, amplitude, gravity = Strip(1, density=1.0, hinged=False), 0.5 * math.pi, 9.81
    exact = 4.0 * math.sqrt(strip.length_m / gravity) * float(ellipk(math.sin(0.5 * amplitude) ** 2))
    specimen, start, step = strip.specimen(), strip.body().positions, exact / 400.0
    start[strip.tip, 0], start[strip.tip, 2] = math.cos(amplitude), math.sin(amplitude)
    stepper = Stepper(specimen.newton, NO_CLAMP, exact_steps("bdf2", 1e-9))
    state, heights = specimen.drawn(start), [1.0]
    for _ in range(360):
        state, _ = stepper.step(state, Pose(), replace(UNLOADED, gravity=(gravity, 0.0, 0.0)), step)
        heights.append(float(state.positions[strip.tip, 2].mean()))
    h = np.array(heights)
    before = np.flatnonzero(h[:-1] * h[1:] < 0.0)
    passages = before + h[before] / (h[before] - h[before + 1])
    return [Figure("period [s]", 2.0 * step * float(passages[1] - passages[0]), exact, 2e-3)]


@known_answer
def capstan() -> list[Figure]:
    """Cable with friction laid half a turn around a post: T_1 / T_2 = exp(mu phi).

    Source: Euler 1769, Eytelwein 1808. Eyelets circumscribe the post, so the cable turns by exactly pi. The
    last one feels T_2; those of the post together T_1 + T_2 downwards, and about its axis (T_1 - T_2) R.
    Tolerance: rounding.
    """
    radius, count, friction, pull = 0.05, 24, 0.2, 10.0
    angle = math.pi * (np.arange(count) + 0.5) / count
    path = np.array([[radius, -0.1, 0.0], *np.zeros((count, 3)), [-radius, -0.1, 0.0]])
    path[1:-1, :2] = radius / math.cos(0.5 * math.pi / count) * np.stack([np.cos(angle), np.sin(angle)], 1)
    cable = Cable(np.arange(len(path)), friction_coefficient=friction)
    body = SoftBody.from_arrays(path, np.array([[0, 1, 2]]), Film(1e6, 0.3, 1e-3), cables=(cable,))
    film, loads = FilmPotential(body), replace(UNLOADED, cable_tension_N=(pull,))
    film.evaluate(path, loads, film.losses_at(path, loads), film.memory, hessian=False)
    force, exact = -film.gradient, pull * math.exp(-friction * math.pi)
    moment = abs(float(np.cross(path[1:-1], force[1:-1])[:, 2].sum()))
    return [
        Figure("T_2 [N]", float(np.linalg.norm(force[-1])), exact, 1e-9),
        Figure("force on the post [N]", -float(force[1:-1, 1].sum()), pull + exact, 1e-9),
        Figure("moment on the post [N m]", moment, (pull - exact) * radius, 1e-9),
    ]


def inflated(film: Film, tensions: Callable[[Array], Array], pressure_Pa: float) -> list[Figure]:
    """Return how a closed tube grows under a pressure.

    A tube of flat facets at the distance a from its axis bears pressure as a cylinder of radius a:
    N_z l_z = p a l_t^2 / 2, N_t = p a l_z, with stretches l along and around, and second Piola-Kirchhoff
    forces N. Every triangle is strained alike. Tolerance: facets twist a little, as their diagonals run one
    way; that makes 1e-5 in rubber, and falls with the fourth power of the sides.

    Args:
        film: material, its warp along the tube.
        tensions: returns N (2,) [N/m] of stretches (2,), by the law as it is stated.
        pressure_Pa: of the gas.
    """
    radius, length, sides = 0.04, 0.08, 48
    specimen, a = closed_tube(radius, length, sides, 12, film), radius * math.cos(math.pi / sides)

    def unbalanced(stretch: Array) -> Array:
        n, (lz, lt) = tensions(stretch), stretch
        return np.array([n[0] * lz - 0.5 * pressure_Pa * a * lt**2, n[1] - pressure_Pa * a * lz])

    lz, lt = root(unbalanced, [1.001, 1.002], tol=1e-14).x.tolist()
    x = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(pressure_Pa,))).state.positions
    found = float(np.hypot(x[:, 0], x[:, 1]).mean()) / radius, float(x[specimen.body.tip, 2].mean()) / length
    return [
        Figure("growth of the radius", found[0] - 1.0, lt - 1.0, 1e-4),
        Figure("growth of the length", found[1] - 1.0, lz - 1.0, 1e-4),
    ]


@known_answer
def pressurised_cylinder() -> list[Figure]:
    """Closed tube of isotropic film under pressure: plane stress of the Green strain, see `inflated`."""
    film = Film(300e6, 0.3, 1e-4)
    law = 300e6 * 1e-4 / (1.0 - 0.3**2) * np.array([[1.0, 0.3], [0.3, 1.0]])
    return inflated(film, lambda stretch: np.asarray(law @ (0.5 * (stretch**2 - 1.0))), 2e3)


@known_answer
def woven_cylinder() -> list[Figure]:
    """Closed tube of fabric under pressure, one of whose yarns straightens: orthotropic plane stress.

    A yarn's modulus goes from E to H in proportion to its strain up to e_s: (H - E) e^2 / (2 e_s) is added to
    the stress, beyond (H - E) (e - e_s / 2). Growth as in `inflated`.
    """
    moduli, straight, full, nu = np.array([0.4e9, 0.7e9]), np.array([1.5e9, 0.9e9]), (0.004, 0.0008), 0.2
    fabric = Fabric(0.7e9, 0.1e9, (0.0, 0.0, 1.0), (1.5e9, 0.9e9), full)
    ratio = moduli[1] / moduli[0]
    law = moduli[0] / (1.0 - nu**2 * ratio) * np.array([[1.0, nu * ratio], [nu * ratio, ratio]])

    def tensions(stretch: Array) -> Array:
        e = 0.5 * (stretch**2 - 1.0)
        grown = np.where(e < full, 0.5 * e**2 / full, e - 0.5 * np.array(full))
        return np.asarray(2e-4 * (law @ e + (straight - moduli) * grown))

    return inflated(Film(0.4e9, nu, 2e-4, "tension_field", fabric=fabric), tensions, 5e3)


@known_answer
def rubber_cylinder() -> list[Figure]:
    """Closed tube of neo-Hookean film: N_i = mu t (1 - 1 / (l_i l_z l_t)^2), see `inflated`."""
    film = Film(1.5e6, 0.5, 5e-4, "neo_hookean")
    shear = 1.5e6 * 5e-4 / 3.0
    return inflated(film, lambda x: np.asarray(shear * (1.0 - (x * x[0] * x[1]) ** -2.0)), 3e3)


@known_answer
def sealed_piston() -> list[Figure]:
    """Piston on sealed gas: height under a weight, slowly, and frequency, fast.

    p V = const (Boyle 1662), from the atmosphere's pressure p_a: the height falls as 1 / (1 + W / p_a A).
    omega^2 = gamma p A^2 / (m V) (Ruechardt 1929). The film moves along z only. Tolerance: its stiffness,
    1e-7 of the gas's.
    """
    radius, height, sides, mass, p = 0.05, 0.2, 12, 2.0, STANDARD_ATMOSPHERE_Pa
    body = closed_tube(radius, height, sides, 1, Film(10.0, 0.3, 1e-4)).body
    held = np.ones(body.positions.shape, dtype=bool)
    held[body.tip, 2] = False
    specimen = Specimen(body, held, NewtonOptions(tolerance_N=1e-6, iterations_max=200))
    section = 0.5 * sides * radius**2 * math.sin(2.0 * math.pi / sides)
    slow, fast = (SealedGas(p, section * height, exponent) for exponent in (1.0, 1.4))
    up = np.zeros(body.positions.shape)
    up[body.tip, 2] = 1.0
    begin = specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(slow,), nodal_force=0.0 * up))
    figures = []
    for load in (-0.2, 1.0):
        weight = replace(UNLOADED, gas=(slow,), nodal_force=-load * p * section / sides * up)
        x = specimen.follow(begin, weight, 4).state.positions
        found = float(body.tip_position(x)[2]) / height
        figures.append(Figure(f"height / h_0, W / p_a A = {load:g}", found, 1.0 / (1.0 + load), 1e-5))
    still, force = specimen.solve(specimen.drawn(), replace(UNLOADED, gas=(fast,))), []
    for shift in (1e-6, -1e-6):
        moved = replace(still, state=replace(still.state, positions=still.state.positions + shift * up))
        force.append(float((specimen.gradient(moved) * up).sum()) / 2e-6)
    exact = math.sqrt(1.4 * p * section / (mass * height))
    return [*figures, Figure("frequency [rad/s]", math.sqrt((force[0] - force[1]) / mass), exact, 1e-5)]


def pushed(carriage_kg: float, scheme: Callable[[Interface], Coupling], ticks: int) -> float:
    """Return how far the centre of mass of carriage and strip has risen in 0.1 s under a push of 1 N [m]."""
    levels, strip_kg, still = 8, 0.17, np.zeros((64, 1))
    z = -0.02 * np.arange(1, levels + 1)
    rows = np.stack([np.tile([-0.01, 0.01], levels), np.zeros(2 * levels), np.repeat(z, 2)], axis=1)
    triangles = [(0, 1, 2)]
    for a, c in pairwise(range(1, 2 * levels, 2)):
        triangles += [(a, c, a + 1), (a + 1, c, c + 1)]
    body = SoftBody.from_arrays(
        np.concatenate([np.zeros((1, 3)), rows]), np.array(triangles), Film(1e7, 0.0, 1e-4),
        node_mass=strip_kg / (1 + 2 * levels), base=np.array([0]), tip=np.array([2 * levels - 1, 2 * levels]),
    )  # fmt: skip
    urdf = SLIDE.format(mass=carriage_kg)
    slide = ArmFile("slide", Path("slide.urdf"), urdf, "carriage", ("along",), np.zeros(1))
    scene = RigidScene(
        SceneDescription(
            slide, tick_s=0.1 / ticks, gravity=(0.0, 0.0, 0.0), floor_height_m=None, armature=0.0,
            gains=ServoGains(np.zeros(1), np.zeros(1)),
        )
    )  # fmt: skip
    pose = scene.flange_pose
    soft = FilmRobot(body, pose, NewtonOptions(tolerance_N=1e-9), exact_steps("implicit_euler", 1e-10))
    soft.hold_components(np.tile([True, True, False], (body.nodes, 1)), pose)
    begin = soft.solve(soft.state, pose, UNLOADED)
    soft.commit(begin)
    coupling, done = scheme(Interface(scene, soft, begin.wrench)), 0
    servos = ServoCommands.without_payload(still, still, still + 1.0)
    while done < ticks:
        done += coupling.advance(servos, [UNLOADED] * min(len(still), ticks - done)).done
    rise = float((soft.state.positions - begin.state.positions)[:, 2].mean())
    return (carriage_kg * float(scene.joint_position[0]) + strip_kg * rise) / (carriage_kg + strip_kg)


@known_answer
def coupled_tick() -> list[Figure]:
    """Centre of mass of a carriage (MuJoCo) and the strip of film that it carries, pushed: F t^2 / (2 m).

    Newton's second law, of both exchanges, with a strip that is lighter and one that is heavier than the
    carriage. Tolerance: steps of first order and an exchange that is a tick late, 400 ticks.
    """
    figures = []
    schemes: tuple[Callable[[Interface], Coupling], ...] = (
        staggered.StaggeredCoupling,
        iterated.IteratedCoupling,
    )
    for name, scheme in zip(("staggered", "iterated"), schemes, strict=True):
        for ratio in (0.4, 2.0):
            carriage = 0.17 / ratio
            found = pushed(carriage, scheme, 400)
            exact = 0.5 * 0.1**2 / (carriage + 0.17)
            figures.append(Figure(f"rise [m], {name}, strip / carriage = {ratio:g}", found, exact, 1e-2))
    return figures
