"""What a verification case is and finds; meshes and held specimens that cases are made of.

Meshes of simple shapes, with the components that their planes of symmetry hold.

A soft body held at given components, and its equilibria: what every static case needs.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve import assembly, newton_options
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Clamp, Equilibrium, Integrator, SoftState, StepOptions


@final
@dataclass(frozen=True)
class Figure:
    """One number against its known value.

    Args:
        quantity: what it is.
        unit: SI unit, "1" for a pure number.
        value: as computed by the soft model.
        reference: the known value.
        tolerance: largest error that passes.
        absolute: whether error and tolerance are |value - reference| in `unit`; otherwise they are
            |value - reference| / |reference|.
        observed_order: exponent with which the error falls under refinement, where it was measured.
    """

    quantity: str
    unit: str
    value: float
    reference: float
    tolerance: float
    absolute: bool = False
    observed_order: float | None = None

    @classmethod
    def refined(
        cls, quantity: str, unit: str, coarse: float, fine: float, reference: float, tolerance: float = 5e-3
    ) -> "Figure":
        """Return the figure of a mesh, with the order of convergence from one half as fine."""
        order = observed_order(coarse - reference, fine - reference)
        return cls(quantity, unit, fine, reference, tolerance, observed_order=order)

    @classmethod
    def all_refined(
        cls,
        quantities: Mapping[str, str],
        coarse: Iterable[float],
        fine: Iterable[float],
        reference: Iterable[float],
        tolerance: float = 5e-3,
    ) -> "list[Figure]":
        """Return what `refined` does, of several quantities and their units."""
        rows = zip(quantities.items(), coarse, fine, reference, strict=True)
        return [cls.refined(*named, c, f, r, tolerance) for named, c, f, r in rows]

    @property
    def error(self) -> float:
        """The error, relative to the reference unless the tolerance is absolute."""
        difference = float(abs(self.value - self.reference))
        if self.absolute:
            return difference
        return difference / float(abs(self.reference)) if self.reference else math.inf

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; a number that is not finite never is."""
        return bool(self.error <= self.tolerance)


@final
@dataclass(frozen=True)
class Case:
    """A problem whose answer is known.

    Args:
        name: as typed on the command line.
        title: one line.
        source: of the answer.
        run: solves the problem and returns its figures; a SolverError says that it could not be solved.
    """

    name: str
    title: str
    source: str
    run: Callable[[], tuple[Figure, ...]]


def case(name: str, title: str, source: str) -> Callable[[Callable[[], tuple[Figure, ...]]], Case]:
    """Return a decorator that makes a case of the function that solves it.

    Args:
        name: as typed on the command line.
        title: one line.
        source: of the answer.
    """
    return partial(Case, name, title, source)


def observed_order(coarse_error: float, fine_error: float, ratio: float = 2.0) -> float:
    """Return log(coarse error / fine error) / log(ratio), the order of convergence.

    Args:
        coarse_error: signed or absolute error on the coarse mesh or long step.
        fine_error: the same on a mesh or step finer by `ratio`.
        ratio: of refinement.
    """
    if coarse_error == 0.0 or fine_error == 0.0:
        return math.nan
    return math.log(abs(coarse_error / fine_error)) / math.log(ratio)


@final
@dataclass(frozen=True)
class Shape:
    """A triangulated shape.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3), outward.
        symmetry: (n, 3) bool, components held by planes of symmetry through the origin.
    """

    positions: Array
    triangles: IntArray
    symmetry: Mask


def on_symmetry_planes(positions: Array, axes: tuple[int, ...]) -> Mask:
    """Return (n, 3) bool: component a of the nodes on the plane where coordinate a is zero.

    Args:
        positions: (n, 3) [m].
        axes: coordinates a whose planes are planes of symmetry.
    """
    size = float(np.abs(positions).max())
    held = np.zeros(positions.shape, dtype=bool)
    for axis in axes:
        held[:, axis] = np.abs(positions[:, axis]) < 1e-9 * size
    return held


def sector_lattice(rings: int, sectors: int) -> tuple[IntArray, Array, IntArray]:
    """Return a triangular lattice of a quarter of a disc.

    Ring i = 0 .. rings holds `sectors` * i + 1 nodes over the quarter turn.

    Args:
        rings: around the centre.
        sectors: of the quarter.

    Returns:
        ring of each node (n,), share of the quarter turn (n,) in [0, 1], triangles (m, 3), counterclockwise.
    """
    ring = np.concatenate([np.full(sectors * i + 1, i) for i in range(rings + 1)])
    fraction = np.concatenate([np.arange(sectors * i + 1) / max(sectors * i, 1) for i in range(rings + 1)])
    first = np.concatenate([[0], np.cumsum(sectors * np.arange(rings + 1) + 1)])
    triangles = []
    for i in range(rings):
        for s in range(sectors):
            inner, outer = first[i] + s * i, first[i + 1] + s * (i + 1)
            triangles += [(inner + q, outer + q, outer + q + 1) for q in range(i + 1)]
            triangles += [(inner + q, outer + q + 1, inner + q + 1) for q in range(i)]
    return ring, fraction, np.array(triangles, dtype=np.int64)


def quarter_disc(radius_m: float, rings: int) -> Shape:
    """Return a quarter of a flat disc in the plane z = 0, normal +z."""
    ring, fraction, triangles = sector_lattice(rings, 2)
    angle = 0.5 * math.pi * fraction
    r = radius_m * ring / rings
    positions = np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros_like(r)], axis=1)
    return Shape(positions, triangles, on_symmetry_planes(positions, (0, 1)))


def octant_sphere(radius_m: float, rings: int) -> Shape:
    """Return an eighth of a sphere about the origin; its nodes lie on the sphere."""
    ring, fraction, triangles = sector_lattice(rings, 1)
    azimuth, polar = 0.5 * math.pi * fraction, 0.5 * math.pi * ring / rings
    positions = radius_m * np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    return Shape(positions, triangles, on_symmetry_planes(positions, (0, 1, 2)))


def quarter_square(side_m: float, columns: int) -> Shape:
    """Return the quarter 0 <= x, y <= side / 2 of a flat square, normal +z, in columns x columns squares.

    Each square is cut along the diagonal towards the corner, alternately turned, so that no direction is
    preferred.
    """
    positions, triangles = panel(0.5 * side_m, 0.5 * side_m, columns, columns)
    return Shape(positions, triangles, on_symmetry_planes(positions, (0, 1)))


def panel(length_m: float, height_m: float, columns: int, rows: int) -> tuple[Array, IntArray]:
    """Return positions (n, 3) [m] and triangles of a flat rectangle along x and y, normal +z.

    Node (i, j) is i (rows + 1) + j.
    """
    x, y = np.meshgrid(
        np.linspace(0.0, length_m, columns + 1), np.linspace(0.0, height_m, rows + 1), indexing="ij"
    )
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), grid_triangles(columns, rows)


def grid_triangles(columns: int, rows: int) -> IntArray:
    """Return the triangles of a grid whose node (i, j) is i (rows + 1) + j, with alternating diagonals."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    a = i * (rows + 1) + j
    b, c, d = a + rows + 1, a + rows + 2, a + 1
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int64)


def tube(radius_m: float, length_m: float, sides: int, rows: int) -> tuple[Array, IntArray]:
    """Return positions (n, 3) and outward triangles of an open tube along z from z = 0.

    Node k of ring r is r * sides + k, at the angle 2 pi k / sides. All diagonals run the same way, so that
    every node carries the pressure of the same area: with alternating ones a film without bending stiffness
    is dented at every other node.
    """
    angle = 2.0 * math.pi * np.arange(sides) / sides
    ring = radius_m * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    height = np.linspace(0.0, length_m, rows + 1)
    positions = (ring[None, :, :] + height[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
    r, k = (axis.ravel() for axis in np.meshgrid(np.arange(rows), np.arange(sides), indexing="ij"))
    a, b = r * sides + k, r * sides + (k + 1) % sides
    c, d = b + sides, a + sides
    first, second = np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)
    return positions, np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int64)


def held_on_axis(sides: int, nodes: int) -> Mask:
    """Return (n, 3) bool for a tube: ring 0 stays in its plane, three components stop rigid motion."""
    held = np.zeros((nodes, 3), dtype=bool)
    held[:sides, 2] = True
    held[[0, sides // 2], 1] = True
    held[sides // 4, 0] = True
    return held


UNLOADED = Loads(gravity=(0.0, 0.0, 0.0))
"""No pressure, no weight, no forces."""

NO_CLAMP = Clamp(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), dtype=bool))
"""Nothing follows a flange: what is held stays where it starts."""


def exact_steps(integrator: Integrator, tolerance_N: float) -> StepOptions:
    """Return options under which every time step is solved to a tolerance [N]."""
    newton = newton_options.NewtonOptions(tolerance_N=tolerance_N)
    return StepOptions(
        integrator, tolerance_N=tolerance_N, iterations=20, residual_bound_N=tolerance_N, newton=newton
    )


@final
class Specimen:
    """A body whose clamped components stay where they start.

    Args:
        body: the soft body.
        clamped: (n,) or (n, 3) bool.
        options: bounds of Newton's method; steps may be as long as the body.
    """

    def __init__(self, body: SoftBody, clamped: Mask, options: newton_options.NewtonOptions) -> None:
        self.body = body
        self.system = assembly.SoftSystem(body)
        self.newton = NewtonSolver(self.system, clamped)
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

    def gradient(self, equilibrium: Equilibrium) -> Array:
        """Return the gradient of the potential (n, 3) [N]: what the supports supply."""
        x, loads = equilibrium.state.positions, equilibrium.loads
        memory = equilibrium.state.memory
        tension = self.system.segment_share(x, loads, memory)
        self.system.evaluate(x, loads, tension, memory, hessian=False)
        return self.system.gradient.copy()

    def stable(self, equilibrium: Equilibrium) -> bool:
        """Return whether the tangent stiffness is positive definite there."""
        x, loads, memory = equilibrium.state.positions, equilibrium.loads, equilibrium.state.memory
        self.system.evaluate(x, loads, self.system.segment_share(x, loads, memory), memory)
        return self.newton.linear.factor(self.system.blocks, low_rank=self.system.low_rank)

    def critical(self, low: float, high: float, loads: Callable[[float], Loads]) -> float:
        """Return up to where between two factors the drawn shape is stable, by bisection to 1e-7.

        Args:
            low: factor at which it is.
            high: factor at which it is not.
            loads: at a factor.
        """
        while high - low > 1e-7 * high:
            middle = 0.5 * (low + high)
            stable = self.stable(self.solve(self.drawn(), loads(middle)))
            low, high = (middle, high) if stable else (low, middle)
        return 0.5 * (low + high)

    def stiffness(self, equilibrium: Equilibrium) -> Array:
        """Return the dense tangent stiffness (3 n, 3 n) [N/m] of all components, free or not."""
        x, loads, memory = equilibrium.state.positions, equilibrium.loads, equilibrium.state.memory
        pattern = self.system.pattern
        self.system.evaluate(x, loads, self.system.segment_share(x, loads, memory), memory)
        dense = np.zeros((pattern.nodes, 3, pattern.nodes, 3))
        dense[pattern.row, :, pattern.column] = self.system.blocks
        dense[pattern.column, :, pattern.row] = self.system.blocks.transpose(0, 2, 1)
        matrix = dense.reshape(3 * pattern.nodes, 3 * pattern.nodes)
        if self.system.low_rank is not None:
            matrix += self.system.low_rank.matrix()
        return matrix
