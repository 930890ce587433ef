"""Kernels of Kelvin-Voigt damping of films and hinges in an implicit step.

A material with a loss factor tan delta at the angular frequency omega has the time tau = tan delta / omega,
and resists rates of strain with tau times its stiffness. In a step that ends at strain E,
    dissipation potential = A (E - E') : R (E - E') / 2,   R = tau D / s,   D the tangent of the film's law,
with E' and s of the difference formula of the velocities: E' = E_n, s = h with implicit Euler;
E' = (4 E_n - E_n-1) / 3, s = 2 h / 3 with BDF2. Its gradient is the force of the film's rate of strain,
    force N = R (E - E'),   gradient_a = A F N g_a,   power lost = A (E - E') : R (E - E') / s >= 0.
Green strain does not change in a rigid motion, which is not resisted. D is that of the shape at the start of
the step, so that the potential is a sum of squares, and the loss is never negative. The tangents of convex
laws are positive semidefinite; that of "edge_strain" need not be, and is replaced by the plain one. A
wrinkled film resists with its tangent, almost nothing across its wrinkles, whose strain is hidden by bending;
so unfolding causes no tension. A hinge of spring constant k between films of times tau resists the rate of
its angle with the mean tau,
    dissipation potential = (tau k / s) (theta - theta')^2 / 2,
with theta' of the same difference formula as E'. Only its spring has losses: the barrier of closed folds
represents contact of films.
Source: Kelvin-Voigt material in any text on viscoelasticity, e.g. Lakes, Viscoelastic Materials, chapter 2.
"""

from typing import Final

import numpy as np

from cosim.base.kernel_types import Blocks, IndexTable, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.soft.elements import membrane
from cosim.soft.elements.hinge import ANGLE, ROOM, differentiate
from cosim.soft.elements.hinge import LANES as SIDE_BY_SIDE
from cosim.soft.elements.material import EDGE_STRAIN
from cosim.soft.elements.membrane import ENERGY, FORCE, LANES, SIZE, STRAIN, MembraneRows, deformation
from cosim.soft.geometry.surface import TURN

RATE_ROOM: Final = 9 * LANES
"""Numbers of a group: E' (11, 22, 2 12), then R (00, 11, 22, 01, 02, 12), each lane by lane."""


@kernel
def fill_triangle_rates(
    x: Matrix, earlier_x: Matrix, two_steps: bool, film: MembraneRows, time_over_span: float, rates: Matrix
) -> None:
    """Fill E' and R of all triangles of a film for a step.

    Args:
        x: (n, 3) [m], at the start.
        earlier_x: (n, 3) [m], one step before; not used by one-step schemes.
        two_steps: whether the scheme uses two earlier states.
        film: the triangles.
        time_over_span: tau / s.
        rates: (groups, RATE_ROOM), filled.
    """
    f, n, tangent = small_matrix(2, 3), small_vector(3), small_matrix(3, 3)
    for r in range(3):
        for c in range(3):
            tangent[r, c] = film.stiffness[r, c]
    for e in range(film.triangles.shape[0]):
        row, lane = rates[e // LANES], e % LANES
        strain = deformation(x, film.triangles[e], film.gradients[e], f)
        if film.law != EDGE_STRAIN:
            membrane.film_law(film, e, strain, n, tangent)
        n[0], n[1], n[2] = strain
        if two_steps:
            before = deformation(earlier_x, film.triangles[e], film.gradients[e], f)
            for r in range(3):
                n[r] = (4.0 * n[r] - before[r]) / 3.0
        for r in range(3):
            row[r * LANES + lane] = n[r]
            row[(3 + r) * LANES + lane] = time_over_span * tangent[r, r]
        row[6 * LANES + lane] = time_over_span * tangent[0, 1]
        row[7 * LANES + lane] = time_over_span * tangent[0, 2]
        row[8 * LANES + lane] = time_over_span * tangent[1, 2]


@device_function
def _resist(drawn: Vector, rates: Vector, s: Vector) -> None:
    """Replace forces A N and energies of a group of triangles by those of its rates."""
    for lane in range(LANES):
        area = drawn[4 * LANES + lane]
        d0 = s[STRAIN + lane] - rates[lane]
        d1 = s[STRAIN + LANES + lane] - rates[LANES + lane]
        d2 = s[STRAIN + 2 * LANES + lane] - rates[2 * LANES + lane]
        r01, r02, r12 = rates[6 * LANES + lane], rates[7 * LANES + lane], rates[8 * LANES + lane]
        n0 = area * (rates[3 * LANES + lane] * d0 + r01 * d1 + r02 * d2)
        n1 = area * (r01 * d0 + rates[4 * LANES + lane] * d1 + r12 * d2)
        n2 = area * (r02 * d0 + r12 * d1 + rates[5 * LANES + lane] * d2)
        s[ENERGY + lane] = 0.5 * (d0 * n0 + d1 * n1 + d2 * n2)
        s[FORCE + lane], s[FORCE + LANES + lane], s[FORCE + 2 * LANES + lane] = n0, n1, n2


@kernel
def add_triangle_rates(
    x: Matrix, film: MembraneRows, rates: Matrix, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add the losses of all triangles to gradient and, if slots is not empty, to blocks.

    Returns the dissipation potential [J]: half of the power lost, times s.

    Args:
        x: (n, 3) [m].
        film: the triangles.
        rates: (groups, RATE_ROOM), see `fill_triangle_rates`.
        slots: (m, 6), see `BlockPattern.slots`, or empty.
        gradient: (n, 3) [N].
        blocks: (b, 3, 3) [N/m].
    """
    triangles, potential = film.triangles, 0.0
    if slots.shape[0] == 0:
        s = small_vector(SIZE)
        for first in range(0, triangles.shape[0], LANES):
            group, lanes = film.drawn[first // LANES], min(LANES, triangles.shape[0] - first)
            membrane.stretch(x, film, first, lanes, group, s)
            _resist(group, rates[first // LANES], s)
            potential += membrane.scatter(group, triangles, first, lanes, s, gradient)
        return potential
    f, n, resistance = small_matrix(2, 3), small_vector(3), small_matrix(3, 3)
    for e in range(triangles.shape[0]):
        row, lane, g, area = rates[e // LANES], e % LANES, film.gradients[e], film.areas[e]
        e11, e22, e12 = deformation(x, triangles[e], g, f)
        d0, d1, d2 = e11 - row[lane], e22 - row[LANES + lane], e12 - row[2 * LANES + lane]
        for r in range(3):
            resistance[r, r] = row[(3 + r) * LANES + lane]
        resistance[0, 1] = resistance[1, 0] = row[6 * LANES + lane]
        resistance[0, 2] = resistance[2, 0] = row[7 * LANES + lane]
        resistance[1, 2] = resistance[2, 1] = row[8 * LANES + lane]
        for r in range(3):
            n[r] = resistance[r, 0] * d0 + resistance[r, 1] * d1 + resistance[r, 2] * d2
        potential += 0.5 * area * (d0 * n[0] + d1 * n[1] + d2 * n[2])
        for k in range(3):
            p, q = area * (f[0, k] * n[0] + f[1, k] * n[2]), area * (f[0, k] * n[2] + f[1, k] * n[1])
            for a in range(3):
                gradient[triangles[e, a], k] += p * g[a, 0] + q * g[a, 1]
        membrane.add_hessian(f, resistance, n, (g, area), slots[e], blocks)
    return potential


@kernel
def fill_hinge_rates(
    earlier_x: Matrix, hinges: IndexTable, angles: Vector, two_steps: bool, rate_angles: Vector
) -> None:
    """Fill theta' of all hinges for a step.

    Args:
        earlier_x: (n, 3) [m], one step before; not used by one-step schemes.
        hinges: (h, 4) nodes.
        angles: (h,) [rad], at the start of the step.
        two_steps: whether the scheme uses two earlier states.
        rate_angles: (h,) [rad], filled.
    """
    s, count = small_vector(ROOM), hinges.shape[0]
    for first in range(0, count, SIDE_BY_SIDE):
        lanes = min(SIDE_BY_SIDE, count - first)
        if two_steps:
            differentiate(earlier_x, hinges, first, lanes, s)
        for lane in range(lanes):
            angle = angles[first + lane]
            if two_steps:
                turned = angle - s[ANGLE + lane]
                turned -= TURN * np.floor(turned / TURN + 0.5)
                angle += turned / 3.0
            rate_angles[first + lane] = angle
