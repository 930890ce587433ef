"""Kernels for the load on a flange: mass properties of a cloud of nodes, and the payload's parameters."""

from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import kernel, small_matrix, small_vector
from cosim.reduced.sections.figures import CENTER, INERTIA


@kernel
def fill_payload(
    figures: Vector, mass: float, origin: Vector, axes: Matrix, mounted: Vector, out: Vector
) -> None:
    """Fill out (10,) with the `inertial_parameters` of the load on the flange, flange frame.

    Args:
        figures: (FIGURES,) of the soft robot, which include centre and inertia of its mass, world axes.
        mass: of the soft robot [kg].
        origin: (3,) [m], of the flange, world.
        axes: (3, 3), world from flange.
        mounted: (10,), the parameters of a rigid mass that is mounted too.
        out: result.
    """
    center, turned, inertia = small_vector(3), small_matrix(3, 3), small_matrix(3, 3)
    square = 0.0
    for r in range(3):
        center[r] = 0.0
        for i in range(3):
            center[r] += axes[i, r] * (figures[CENTER + i] - origin[i])
        square += center[r] * center[r]
        for c in range(3):
            turned[r, c] = 0.0
            for i in range(3):
                turned[r, c] += figures[INERTIA + 3 * r + i] * axes[i, c]
    for r in range(3):
        for c in range(3):
            total = -mass * center[r] * center[c] + (mass * square if r == c else 0.0)
            for i in range(3):
                total += axes[i, r] * turned[i, c]
            inertia[r, c] = total
    out[0] = mass
    for r in range(3):
        out[1 + r] = mass * center[r]
    out[4], out[5], out[6] = inertia[0, 0], inertia[0, 1], inertia[1, 1]
    out[7], out[8], out[9] = inertia[0, 2], inertia[1, 2], inertia[2, 2]
    for k in range(10):
        out[k] += mounted[k]


@kernel
def fill_mass(mass: Vector, x: Matrix, figures: Vector) -> None:
    """Fill centre of mass [m] and inertia about it [kg m^2], world axes, in a soft robot's figures.

    Args:
        mass: (n,) [kg], of the nodes.
        x: (n, 3) [m], their positions, world.
        figures: (FIGURES,); the entries of the mass are overwritten.
    """
    total, first, second = 0.0, small_vector(3), small_matrix(3, 3)
    for r in range(3):
        first[r] = 0.0
        for c in range(3):
            second[r, c] = 0.0
    for i in range(mass.shape[0]):
        total += mass[i]
        for r in range(3):
            moment = mass[i] * x[i, r]
            first[r] += moment
            for c in range(r, 3):
                second[r, c] += moment * x[i, c]
    for r in range(3):
        figures[CENTER + r] = first[r] / total
    for r in range(3):
        for c in range(r, 3):
            second[r, c] -= first[r] * figures[CENTER + c]
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    for r in range(3):
        for c in range(3):
            about = -second[min(r, c), max(r, c)]
            figures[INERTIA + 3 * r + c] = about + (trace if r == c else 0.0)
