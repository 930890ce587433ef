"""Known answers: inflated tubes and pouches, free, squeezed, welded and bent.

A film that curves about one axis only: a quarter of the section of a long tube or pouch.

A long flat tube of inextensible film under pressure, free or squeezed between two plates.

A pouch motor: two films welded along two edges, which pull together when inflated.

An inflated tube, its measures, the loads of a beam on it and the flexibility of beam theory.

An inflated tube as a beam: stiffness in bending and shear, and where it wrinkles.
"""

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium
from cosim.verification.case import UNLOADED, Figure, Specimen, case, held_on_axis, tube

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
        y = depth a third of the prism, and no film represents it: the film measures two thirds of the
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


GAPS = (0.2, 0.4)
PANELS = 80
_ROUNDS = 60


def squeezed(panels: int, gap: float) -> tuple[float, float]:
    """Return (F / (p W), V / W^2), per length of the tube, between plates at a gap in units of W.

    A quarter of the section, from the middle of the contact to the seam. The contact is a set of nodes held
    at half the gap: nodes beyond the plate join it, nodes that it would have to pull leave it.
    """
    sheet = Sheet(panels)
    height = 0.5 * gap * sheet.flat_width_m
    arc = 0.5 * math.pi * height
    positions = sheet.bent(flat=sheet.length_m - arc, radius=height)
    touching = positions[:, 2] > height * (1.0 - 1e-9)
    for _ in range(_ROUNDS):
        specimen, found = settled(sheet, positions, touching)
        push = np.where(touching, specimen.gradient(found)[:, 2], 0.0)
        x = found.state.positions
        # both nodes of a section touch or leave together
        pulled = np.repeat((push.reshape(-1, 2).sum(axis=1) > 0.0), 2) & touching
        beyond = np.repeat((x[:, 2].reshape(-1, 2).max(axis=1) > height * (1.0 + 1e-9)), 2)
        if not (pulled.any() or (beyond & ~touching).any()):
            break
        touching = (touching & ~pulled) | beyond
        positions = x.copy()
        positions[touching, 2] = height
    else:
        raise ConvergenceError("the contact of the squeezed tube did not settle", math.nan, _ROUNDS)
    width = sheet.flat_width_m
    force = -2.0 * float(push.sum()) / (sheet.depth_m * PRESSURE_PA * width)
    return force, sheet.section_area(specimen.system.volume) / width**2


def settled(sheet: Sheet, positions: np.ndarray, touching: np.ndarray) -> tuple[Specimen, Equilibrium]:
    """Return the equilibrium with the touching nodes held at their height."""
    held = sheet.symmetry()
    held[touching, 2] = True
    specimen = Specimen(sheet.body(), held, sheet.options())
    return specimen, specimen.solve(specimen.drawn(positions), sheet.loads())


@case(
    "squeezed_tube",
    "Flat tube between two plates",
    "half circles of diameter h: F/L = p (W - pi h / 2), V/L = W h - pi h^2 / 4",
)
def squeezed_tube() -> tuple[Figure, ...]:
    """Force and volume of a tube of flat width W between plates at a gap h; radius of the free tube.

    The film is stiff enough (p W / E t = 3e-5) to count as inextensible. The force follows from the contact,
    the volume from the shape; virtual work ties them, F = -p dV/dh.
    """
    figures = []
    for gap in GAPS:
        exact = (1.0 - 0.5 * math.pi * gap, gap - 0.25 * math.pi * gap**2)
        found = squeezed(PANELS, gap)
        figures += [
            Figure(f"{name}, h / W = {gap:g}", "1", value, reference, 5e-3)
            for name, value, reference in zip(("F / (p W L)", "V / (W^2 L)"), found, exact, strict=True)
        ]
    free = squeezed(PANELS, 2.0 / math.pi - 1e-12)
    figures.append(Figure("V / (W^2 L), free", "1", free[1], 1.0 / math.pi, 5e-3))
    return tuple(figures)


ANGLES_DEG = (30.0, 60.0, 80.0)
POUCH_PANELS = 40


def pouch(panels: int, angle: float) -> tuple[float, float]:
    """Return (F / (p L D), V / (D L^2)) of a pouch of length L and depth D.

    A quarter of the section: the seam is held at x = (L / 2) sin(angle) / angle, where the arc has the angle.
    """
    sheet = Sheet(panels)
    length = 2.0 * sheet.length_m
    # first guess: an arc that is a little too flat
    positions = sheet.bent(flat=0.0, radius=sheet.length_m / angle * 1.05)
    seam = np.arange(sheet.nodes - 2, sheet.nodes)
    held = sheet.symmetry()
    held[seam, 0] = True
    positions[seam, 0] = sheet.length_m * math.sin(angle) / angle
    specimen = Specimen(sheet.body(), held, sheet.options())
    found = specimen.solve(specimen.drawn(positions), sheet.loads())
    pull = 2.0 * float(specimen.gradient(found)[seam, 0].sum())
    return (
        pull / (PRESSURE_PA * length * sheet.depth_m),
        sheet.section_area(specimen.system.volume) / length**2,
    )


@case(
    "pouch_motor",
    "Pouch motor: force against contraction",
    "arcs of length L: F = p L D cos(theta)/theta, V = D L^2 (theta - sin cos)/(2 theta^2)",
)
def pouch_motor() -> tuple[Figure, ...]:
    """Force and volume at three contractions; inextensible arcs of half angle theta."""
    figures = []
    for degrees in ANGLES_DEG:
        a = math.radians(degrees)
        exact = (math.cos(a) / a, 0.5 * (a - math.sin(a) * math.cos(a)) / a**2)
        found, note = pouch(POUCH_PANELS, a), f"contraction {1.0 - math.sin(a) / a:.4f}"
        figures += [
            Figure(f"{name}, {note}", "1", value, reference, 5e-3)
            for name, value, reference in zip(("F / (p L D)", "V / (D L^2)"), found, exact, strict=True)
        ]
    return tuple(figures)


FILM = Film(300e6, 0.3, 1e-4)
RADIUS_M, LENGTH_M = 0.04, 0.4
TUBE_PRESSURE_PA = 10e3
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
    def make(cls) -> "InflatedTube":
        """Inflate the tube with its first ring free to grow in its plane."""
        positions, triangles = tube(RADIUS_M, LENGTH_M, SIDES, ROWS)
        caps = (np.arange(SIDES)[::-1].copy(), ROWS * SIDES + np.arange(SIDES))
        body = SoftBody.from_arrays(positions, triangles, FILM, caps=caps)
        specimen = Specimen(body, held_on_axis(SIDES, body.nodes), _OPTIONS)
        found = specimen.solve(specimen.drawn(), replace(UNLOADED, pressure_Pa=(TUBE_PRESSURE_PA,)))
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
        pull, section = TUBE_PRESSURE_PA * math.pi * r**2, 2.0 * math.pi * r * t
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


@case(
    "inflated_cantilever",
    "Inflated tube as a cantilever",
    "Le van and Wielgosz, Thin-Walled Struct. 43 (2005) 1166; Stein and Hedgepeth 1961",
)
def inflated_cantilever() -> tuple[Figure, ...]:
    """Tip deflection and wrinkling moment of a tube clamped at one end.

    The first ring is clamped after inflation, where it then is, so that the clamp does not neck the tube.
    """
    beam = InflatedTube.make()
    held = np.arange(beam.body.nodes) < SIDES
    found, moved = beam.bent(held, beam.shear_force(ROWS, FORCE_N))
    deflection = abs(float(moved[beam.ring(ROWS), 0].mean())) / FORCE_N
    bending, shear = beam.flexibility()
    exact = beam.length**3 / 3.0 * bending + beam.length * shear
    wrinkling = 0.5 * math.pi * TUBE_PRESSURE_PA * beam.radius**3
    return (
        Figure("tip deflection / force", "m/N", deflection, exact, 3e-2),
        Figure("wrinkling moment", "N m", beam.wrinkling_moment(found, FORCE_N), wrinkling, 3e-2),
    )


@case(
    "inflated_three_point",
    "Inflated tube in three-point bending",
    "Le van and Wielgosz, Thin-Walled Struct. 43 (2005) 1166",
)
def inflated_three_point() -> tuple[Figure, ...]:
    """Deflection of a tube on two supports, loaded in the middle: half of it, on its plane of symmetry.

    The support is a ring kept round in its plane, free to move along the tube and to tilt.
    """
    beam = InflatedTube.make()
    held = np.zeros((beam.body.nodes, 3), dtype=bool)
    held[beam.ring(0), 2] = True
    held[beam.ring(ROWS), :2] = True
    _, moved = beam.bent(held, beam.shear_force(0, 0.5 * FORCE_N))
    deflection = abs(float(moved[beam.ring(0), 0].mean())) / FORCE_N
    bending, shear = beam.flexibility()
    span = 2.0 * beam.length
    exact = span**3 / 48.0 * bending + span / 4.0 * shear
    return (Figure("deflection of the middle / force", "m/N", deflection, exact, 3e-2),)
