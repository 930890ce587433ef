"""Known answers: stacks of film against independent finite elements.

Stacks of film with open end holes, kept upright: the specimens of the finite-element reference.

What independent finite elements of the films found, and how stacks of film are compared with them.

Quadratic membranes with bending, CalculiX S8R and Kratos thin shells on films of 0.11 mm, 1.3 GPa and
Poisson's ratio 0.2: open holes, first hole ring held, the films of a unit joined at the seam without
stiffness against turning, neither weight nor contact. Bands are as judged from meshes, branches and codes.

How stiffly a stack that is inflated resists being tilted.

Three square units under pressure, of triangles that cannot wrinkle and of film that only pulls.

Stacks of film with the wrinkling law on coarse meshes, against finite elements fine enough to wrinkle.

Stacks whose films are joined stiffly at the seam, against finite elements that turn as one there.

A square unit whose film is pinned to a frame of beams, against finite elements of both.

A square unit whose upper hole ring is tilted, against finite elements.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Pose, cross, rotation_from_vector
from cosim.errors import MeshError
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.hinge import shell_stiffness
from cosim.soft.elements.material import Film
from cosim.soft.elements.pressure import add_cap_force
from cosim.soft.geometry import named_mesh, surface
from cosim.soft.geometry.polygonal_stack import PolygonalStack, with_finer_holes
from cosim.soft.solve import assembly, equilibrium, newton, newton_options
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState
from cosim.verification.case import Figure, case

_ON_PLANE_m = 1e-9  # of a plane of symmetry, beyond rounding
_ROUNDS, _SETTLED_m = 20, 1e-6


def film_stack(
    stack: PolygonalStack, level: int, film: Film, *, holes: int = 0, rigid_seam: bool = False
) -> SoftBody:
    """Return a stack whose film bends as a discrete shell.

    Args:
        stack: drawn shape.
        level: how often its triangles are refined.
        film: material.
        holes: how often triangles at the holes are refined, before.
        rigid_seam: whether the films of a unit turn as one at their seam; they turn freely otherwise.
    """
    drawn = stack.mesh()
    mesh = named_mesh.refine(with_finer_holes(drawn, (*drawn.center_rings, drawn.tip_ring), holes), level)
    hinges = surface.interior_hinges(mesh.triangles, () if rigid_seam else mesh.seam)
    return SoftBody.from_arrays(
        mesh.positions, mesh.triangles, film, wrinkle_panel_m=mesh.face_values["wrinkle_panel_m"],
        hinge_nodes=hinges,
        hinge_stiffness=shell_stiffness(mesh.positions, mesh.triangles, hinges, film.flexural_rigidity_Nm),
        caps=mesh.caps, base=mesh.ring(mesh.base_ring), tip=mesh.ring(mesh.tip_ring), rings=mesh.rings,
    )  # fmt: skip


class OpenSpecimen:
    """A closed body whose cap forces are taken off as dead loads until they agree with the shape.

    The inner problem keeps a potential, so that Newton's method can go down it through wrinkling.

    Args:
        body: of film, upright; its caps are the open ends.
    """

    def __init__(self, body: SoftBody) -> None:
        self.body = body
        clamp = guided(body)
        self.newton = newton.NewtonSolver(assembly.SoftSystem(body), clamp.mask(body.nodes))
        options = newton_options.NewtonOptions(tolerance_N=1e-5, iterations_max=600, step_max_m=0.01)
        self.solver = equilibrium.EquilibriumSolver(self.newton, clamp, options)
        self.here: Equilibrium | None = None
        self.iterations = 0

    def loads(self, pressure_Pa: float, positions: Array) -> Loads:
        """Return the loads with the caps' pressure taken off at positions (n, 3) [m]."""
        force = np.zeros_like(positions)
        for ring in self.body.caps:
            add_cap_force(np.ascontiguousarray(positions), ring, -pressure_Pa, force)
        return Loads((pressure_Pa,), (), (0.0, 0.0, 0.0), force)

    def load_along(self, pressures_Pa: Iterable[float]) -> "OpenSpecimen":
        """Follow the equilibrium from pressure to pressure; return itself.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        for pressure in pressures_Pa:
            self.load_to(pressure)
        return self

    def load_to(self, pressure_Pa: float) -> Equilibrium:
        """Follow the equilibrium to a pressure.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        state = SoftState.drawn(self.body, Pose()) if self.here is None else self.here.state
        for _ in range(_ROUNDS):
            found = self.solver.solve(state, Pose(), self.loads(pressure_Pa, state.positions))
            self.iterations += found.iterations
            moved = float(np.abs(found.state.positions - state.positions).max())
            state = found.state
            if moved < _SETTLED_m:
                break
        self.here = found
        return found

    @property
    def extension_m(self) -> float:
        """Mean height of the top ring above where it is drawn [m]."""
        assert self.here is not None
        drawn = self.body.tip_position(self.body.positions)
        return float((self.body.tip_position(self.here.state.positions) - drawn)[2])

    @property
    def volume_m3(self) -> float:
        """Volume that film and open ends enclose."""
        return float(self.newton.system.volume)


def guided(body: SoftBody) -> Clamp:
    """Return the clamp of the base, with the nodes on the planes x = 0 and y = 0 kept in them.

    Both are planes of symmetry of the drawn mesh. A free stack leans over above some pressure; the
    finite-element reference is the straight one. Holes may widen, as they do there.

    Raises:
        MeshError: a plane holds no node of a free hole ring, so nothing would keep the stack straight.
    """
    clamp = Clamp.of_base(body)
    on_plane = np.abs(body.positions) < _ON_PLANE_m
    on_plane[:, 2] = False
    rest = np.ones(body.nodes, dtype=bool)
    rest[body.base] = False
    if not on_plane[rest, :2].any(axis=0).all():
        raise MeshError("no free node lies on the planes x = 0 and y = 0")
    return clamp.holding(on_plane, body.positions, Pose())


FILM: Final = Film(1.3e9, 0.2, 0.11e-3)
FIRST_Pa: Final = (100.0, 250.0, 500.0, 1e3)
"""Pressures on the way to those that are compared."""

MESHES: Final = ("", ", refined", ", refined twice")
"""How figures name the drawn mesh and those refined from it."""


def squares(units: int, hole_side_m: float = 0.004) -> PolygonalStack:
    """Return square units of 60 mm, drawn 2 mm high."""
    to_corner = 1.0 / math.sqrt(2.0)
    return PolygonalStack(
        4, units, 0.06 * to_corner, hole_side_m * to_corner, 0.002, ring_heights=(0.2, 0.5, 0.8)
    )


@final
@dataclass(frozen=True)
class Band:
    """Extension at a pressure, as a band of finite-element values.

    Args:
        pressure_Pa: gauge pressure.
        low_m: its lower edge.
        high_m: its upper edge.
        tolerance: beyond the edges, as a share of the edge.
    """

    pressure_Pa: float
    low_m: float
    high_m: float
    tolerance: float

    def figure(self, extension_m: float, note: str) -> Figure:
        """Return an extension [m] against the value in the band that is nearest."""
        name = f"{1e-3 * self.pressure_Pa:g} kPa{note}"
        if self.high_m > self.low_m:
            name += f", {1e3 * self.low_m:.4g} to {1e3 * self.high_m:.4g} mm"
        nearest = min(max(extension_m, self.low_m), self.high_m)
        return Figure(name, "m", extension_m, nearest, self.tolerance)


def along(sample: OpenSpecimen, bands: Sequence[Band], note: str = "") -> list[Figure]:
    """Return the extensions of a specimen at the pressures of bands, one after the other.

    Raises:
        ConvergenceError: an equilibrium was not found.
    """
    figures = []
    for band in bands:
        sample.load_to(band.pressure_Pa)
        figures.append(band.figure(sample.extension_m, note))
    return figures


ANGLE_RAD: Final = math.radians(1.0)


def tilt_stiffness(sample: OpenSpecimen) -> float:
    """Return the moment over angle [N m/rad] of the upper ring, turned about x at the place it has.

    Raises:
        ConvergenceError: no equilibrium was found.
    """
    body, here = sample.body, sample.here
    assert here is not None
    x = here.state.positions
    clamp = Clamp.of_base(body).extended(body.tip, x, Pose())
    solver = equilibrium.EquilibriumSolver(
        newton.NewtonSolver(assembly.SoftSystem(body), clamp.mask(body.nodes)), clamp, sample.solver.options
    )
    centre, state = x[body.tip].mean(axis=0), here.state
    loads = sample.loads(here.loads.pressures(1)[0], x)
    moments = []
    for angle in (0.0, 0.5 * ANGLE_RAD, ANGLE_RAD):
        turn = rotation_from_vector(np.array([angle, 0.0, 0.0]))
        turned = x.copy()
        turned[body.tip] = centre + (x[body.tip] - centre) @ turn.T
        solver.clamp = Clamp.of_base(body).extended(body.tip, turned, Pose())
        state = solver.solve(state, Pose(), loads).state
        moments.append(_moment(solver.solver.system, body, state.positions, centre))
    return float(moments[-1] - moments[0]) / ANGLE_RAD


def _moment(system: assembly.SoftSystem, body: SoftBody, positions: Array, centre: Array) -> float:
    """Return the moment [N m] about x that holds the upper ring, the caps' pressure taken off."""
    arm = positions[body.tip] - centre
    return float(cross(arm, system.gradient[body.tip])[:, 0].sum())


PAPER_MESH = tuple(
    Band(pressure, extension, extension, 0.02)
    for pressure, extension in ((2e3, 16.06e-3), (10e3, 30.63e-3), (20e3, 39.51e-3))
)
TENSION_FIELD = (
    Band(2e3, 79.4e-3, 80.2e-3, 0.05),
    Band(10e3, 82.6e-3, 83.4e-3, 0.02),
    Band(20e3, 83.5e-3, 84.3e-3, 0.02),
)
_FRACTIONS = (0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4)
"""Compressive stiffness on the way to the tension field; the last one keeps slack triangles open."""


@case(
    "paper_mesh",
    "Extension of three square units of 168 plain triangles",
    "own finite elements, constant strain, the same 168 triangles",
)
def paper_mesh() -> tuple[Figure, ...]:
    """Plain constant-strain triangles on the paper's own mesh: another code's extension.

    The mesh decides, not the film: 30.6 mm at 10 kPa, where converged elements of a film that bends have 71.
    Tolerance 2 %: whether hole rings may widen, as here, makes 1.5 %.
    """
    sample = OpenSpecimen(film_stack(squares(3), 0, FILM))
    return tuple(along(sample.load_along(FIRST_Pa), PAPER_MESH))


@case(
    "stack_tension_field",
    "Extension of three square units, tension field",
    "own finite elements with a tension field, no bending, converged on two meshes",
)
def stack_tension_field() -> tuple[Figure, ...]:
    """Three square units of film that gives way to compression, refined once; converged on two meshes there.

    Tolerance 2 %, and 5 % at 2 kPa, where hardly anything resists the last few millimetres: what is left of
    compressive stiffness, and hinges that bend, count against the gas.
    """
    first, stack = TENSION_FIELD[0].pressure_Pa, squares(3)
    sample = OpenSpecimen(film_stack(stack, 1, FILM)).load_along((*FIRST_Pa, first))
    for fraction in _FRACTIONS:
        here, film = sample.here, replace(FILM, law="tension_field", compressive_fraction=fraction)
        sample = OpenSpecimen(film_stack(stack, 1, film))
        sample.here = here
        sample.load_to(first)
    return tuple(along(sample, TENSION_FIELD))


SNAPPING: Final = 0.15
"""Tolerance at 2 and 5 kPa: films snap there, and what they hold depends on their history."""

FOLDED: Final = 0.07
"""Tolerance from 10 kPa on."""

VOLUME_M3: Final = 42.4e-6
"""Of one square unit at 10 kPa."""


def stack(shape: PolygonalStack, level: int, film: Film = FILM) -> OpenSpecimen:
    """Return a stack of wrinkling film under the last pressure before those that are compared.

    Raises:
        ConvergenceError: an equilibrium was not found.
    """
    return OpenSpecimen(film_stack(shape, level, replace(film, law="wrinkling"))).load_along(FIRST_Pa)


def on_meshes(shape: PolygonalStack, bands: Sequence[Band], levels: int, film: Film = FILM) -> list[Figure]:
    """Return the extensions on the drawn mesh and on those refined from it.

    Raises:
        ConvergenceError: an equilibrium was not found.
    """
    return [
        figure for level in range(levels) for figure in along(stack(shape, level, film), bands, MESHES[level])
    ]


THREE_SQUARES_BANDS: Final[tuple[Band, ...]] = (
    Band(2e3, 34.5e-3, 67.2e-3, SNAPPING),
    Band(5e3, 58e-3, 66e-3, SNAPPING),
    Band(10e3, 68e-3, 74e-3, FOLDED),
    Band(20e3, 74e-3, 77e-3, FOLDED),
    Band(40e3, 79e-3, 81e-3, FOLDED),
)


@case(
    "three_squares",
    "Extension of three square units, wrinkling law",
    "finite elements: CalculiX S8R, Kratos thin shells, own quadratic membranes",
)
def three_squares() -> tuple[Figure, ...]:
    """Three square units; nothing of the law was fitted to them.

    At 2 kPa the band runs from the extension while the film is loaded, 34.5 mm, to three times that of one
    unit while it is unloaded, 67.2 mm: refined meshes fold between 0.5 and 2 kPa, finite elements later.
    """
    return tuple(on_meshes(squares(3), THREE_SQUARES_BANDS, 3))


ONE_SQUARE_BANDS: Final[tuple[Band, ...]] = (
    Band(2e3, 11.2e-3, 22.4e-3, SNAPPING),
    Band(5e3, 22.6e-3, 24.2e-3, SNAPPING),
    Band(10e3, 24.5e-3, 25.5e-3, 0.08),
    Band(20e3, 25.7e-3, 26.5e-3, FOLDED),
    Band(40e3, 26.8e-3, 27.2e-3, FOLDED),
)


@case(
    "one_square",
    "Extension and volume of one square unit, wrinkling law",
    "finite elements: quadratic membranes with bending, energies minimised",
)
def one_square() -> tuple[Figure, ...]:
    """One square unit against finer finite elements, with the volume at 10 kPa.

    The band at 2 kPa runs from loading to unloading. At 10 kPa the tolerance is 8 %: the mesh that is refined
    once is 7.2 % short, the others 4 %. The volume's is 15 % on the drawn mesh, whose chords under-fill the
    bulging film, and 6 % on finer ones.
    """
    figures = on_meshes(squares(1), ONE_SQUARE_BANDS, 3)
    for level, tolerance in enumerate((0.15, 0.06, 0.06)):
        sample = stack(squares(1), level)
        along(sample, ONE_SQUARE_BANDS[:3])
        name = f"volume at {1e-3 * ONE_SQUARE_BANDS[2].pressure_Pa:g} kPa{MESHES[level]}"
        figures.append(Figure(name, "m^3", sample.volume_m3, VOLUME_M3, tolerance))
    return tuple(figures)


STIFF_SQUARE_BANDS: Final[tuple[Band, ...]] = (
    Band(2e3, 9.2e-3, 9.2e-3, SNAPPING),
    Band(5e3, 14.3e-3, 14.3e-3, 0.2),
    Band(10e3, 19.6e-3, 19.6e-3, FOLDED),
)


@case(
    "stiff_square",
    "Extension of one square unit that bends three times as stiffly, wrinkling law",
    "own finite elements: quadratic membranes with bending",
)
def stiff_square() -> tuple[Figure, ...]:
    """One square unit of film that bends three times as stiffly and stretches as before.

    That is sqrt(3) times the thickness and 1 / sqrt(3) of Young's modulus. The finite elements are of one
    mesh (4 mm, 2 mm at the seam). Tolerance at 5 kPa 20 %, just above the snap of the film.
    """
    thick = math.sqrt(3.0)
    film = replace(FILM, young_modulus_Pa=FILM.young_modulus_Pa / thick, thickness_m=FILM.thickness_m * thick)
    return tuple(on_meshes(squares(1), STIFF_SQUARE_BANDS, 3, film))


FIVE_HEXAGONS_BANDS: Final[tuple[Band, ...]] = (
    Band(5e3, 111.7e-3, 111.7e-3, SNAPPING),
    Band(20e3, 143.3e-3, 143.3e-3, FOLDED),
    Band(40e3, 151.2e-3, 153.7e-3, FOLDED),
)


@case(
    "five_hexagons",
    "Extension of five hexagonal units, wrinkling law",
    "own finite elements: quadratic membranes with bending",
)
def five_hexagons() -> tuple[Figure, ...]:
    """Five hexagonal units, each 0.95 as wide as the one below; nothing of the law was fitted to them.

    The finite elements are of one mesh (4 mm, 2 mm at the seam) but at 40 kPa, where there are three. The
    stack is kept upright, as it is there: it leans over by itself.
    """
    return tuple(on_meshes(PolygonalStack(6, 5, 0.05, 0.01, 0.002, 0.95), FIVE_HEXAGONS_BANDS, 2))


TEN_SQUARES_BANDS: Final[tuple[Band, ...]] = (Band(20e3, 235e-3, 244e-3, FOLDED),)


@case(
    "ten_squares",
    "Extension of ten square units, wrinkling law",
    "own finite elements: quadratic membranes with bending",
)
def ten_squares() -> tuple[Figure, ...]:
    """Ten square units with holes of 5 mm; finite elements of such meshes are 2 to 5 % short on one unit."""
    figures = []
    for level in range(2):
        sample = stack(squares(10, 0.005), level).load_along((2e3, 5e3, 10e3))
        figures += along(sample, TEN_SQUARES_BANDS, MESHES[level])
    return tuple(figures)


RIGID_SEAMS_BANDS: Final[tuple[Band, ...]] = (
    Band(2e3, 31e-3, 43e-3, 0.15),
    Band(10e3, 62e-3, 72e-3, 0.07),
    Band(20e3, 72.5e-3, 77.5e-3, 0.07),
)

RIGID_SEAMS_ONE_UNIT: Final[Band] = Band(10e3, 21.35e-3, 21.82e-3, 0.1)


@case(
    "rigid_seams",
    "Extension of square units with rigid seams, wrinkling law",
    "finite elements: CalculiX S8R, Kratos thin shells, own quadratic membranes",
)
def rigid_seams() -> tuple[Figure, ...]:
    """Three square units and one, with hinges along the seams that bend like the film around them.

    Three units: 15 % at 2 kPa, where films snap, 7 % above. One unit at 10 kPa: 10 %, as its finite elements
    are of coarse meshes. Below 1 kPa the film bends within few millimetres of the seam, which these meshes do
    not resolve: at 0.5 kPa one unit comes to 4.6 mm, refined twice, and to 4.02 mm in finite elements.
    """
    film, figures = replace(FILM, law="wrinkling"), []
    for level, note in enumerate(MESHES):
        three, one = (
            OpenSpecimen(film_stack(squares(units), level, film, rigid_seam=True)).load_along(FIRST_Pa)
            for units in (3, 1)
        )
        one.load_along((2e3, 5e3))
        figures += along(three, RIGID_SEAMS_BANDS, f"{note}, three")
        figures += along(one, (RIGID_SEAMS_ONE_UNIT,), f"{note}, one")
    return tuple(figures)


SECTION: Final = RectangularSection(2e-3, 2e-3, 2e9)
_FIRST_Pa = (100.0, 500.0, 1e3)


def framed(level: int) -> OpenSpecimen:
    """Return one square unit with beams along its seam."""
    body = film_stack(squares(1), level, replace(FILM, law="wrinkling"))
    rims = np.stack([ring for name, ring in body.rings.items() if name.endswith(".outer")])
    return OpenSpecimen(body.with_elements(BeamRings.from_shape(body.positions, rims, SECTION)))


FRAMED_SQUARE_BANDS: Final[tuple[Band, ...]] = (
    Band(2e3, 4.47e-3, 4.51e-3, 0.07),
    Band(5e3, 6.72e-3, 6.76e-3, 0.07),
    Band(10e3, 10.0e-3, 10.4e-3, 0.12),
    Band(20e3, 15.0e-3, 15.6e-3, 0.12),
    Band(40e3, 19.4e-3, 19.8e-3, 0.07),
)


@case(
    "framed_square",
    "Extension of one square unit in a frame of beams, wrinkling law",
    "finite elements: quadratic membranes with bending, beams, energies minimised",
)
def framed_square() -> tuple[Figure, ...]:
    """A frame of 2 x 2 mm and 2 GPa keeps the seam from being drawn in: a third of the extension at 2 kPa.

    Nothing of the wrinkling law was fitted to a framed film. Tolerance 7 %, and 12 % at 10 and 20 kPa: the
    sides of the frame, two beams each on the drawn mesh, bow unequally above 7 kPa, which the drawn mesh does
    10 % late; refined meshes are within 6 % there.
    """
    figures = []
    for level, note in enumerate(MESHES):
        figures += along(framed(level).load_along(_FIRST_Pa), FRAMED_SQUARE_BANDS, note)
    return tuple(figures)


PRESSURE_Pa: Final = 10e3
BAND_Nm: Final = (22.0e-3, 27.0e-3)
"""Moment over angle [N m/rad]."""

REFINED: Final = ((0, 1), (0, 2), (1, 1), (1, 2), (2, 0))
"""How often all triangles, and how often those at the holes."""


@case(
    "tilted_unit",
    "Tilt stiffness of one square unit, wrinkling law, refined at the holes",
    "finite elements: quadratic membranes with bending, energies minimised",
)
def tilted_unit() -> tuple[Figure, ...]:
    """Moment over angle of one unit at 10 kPa, its upper ring turned at fixed height and place.

    Tolerance 15 % beyond the band. Holes of four straight edges are too stiff, whatever the film's law: the
    drawn mesh has 132 mN m/rad, five times as much.
    """
    figures = []
    for level, holes in REFINED:
        film = replace(FILM, law="wrinkling")
        sample = OpenSpecimen(film_stack(squares(1), level, film, holes=holes))
        sample.load_along((*FIRST_Pa, 2e3, 5e3, PRESSURE_Pa))
        found = tilt_stiffness(sample)
        nearest = min(max(found, BAND_Nm[0]), BAND_Nm[1])
        name = f"refined {level}, at holes {holes}, 22e-3 to 27e-3"
        figures.append(Figure(name, "N m/rad", found, nearest, 0.15))
    return tuple(figures)
