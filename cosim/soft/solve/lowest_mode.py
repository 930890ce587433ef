"""The lowest eigenvalue and eigenvector of a body's tangent stiffness: its softest motion.

At a stable equilibrium the tangent is positive definite. If it is not, the potential falls along the
eigenvectors of its negative eigenvalues, on both sides: a branch of equilibria bifurcates or ends there.
"""

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import describe_largest
from cosim.soft.elements.cable import losses_follow
from cosim.soft.film.inertia import Inertia
from cosim.soft.linear.linear_solver import ShiftSearch
from cosim.soft.solve.branching import UNDECIDED, Branching, LowestMode
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import SoftState

_LEAST_SHIFT, _LARGEST_SHIFT = 1e-3, 1e9  # of a weight of 1
_TOLERANCE, _VECTORS = 1e-5, 8  # of the iteration


def lowest_mode(
    solver: NewtonSolver,
    state: SoftState,
    loads: Loads,
    frame: Array,
    weight: Array | None = None,
    count: int = 1,
) -> LowestMode:
    """Return the lowest eigenvalue of the static tangent K, and its mode: K v = e W v.

    Inverse Lanczos iteration on K + s W, with s the shift that makes it positive definite; K includes sealed
    gas and commanded lengths. The stored factorisation is lost.

    Args:
        solver: Newton's method for the body with the present clamp.
        state: of the tangent.
        loads: that act.
        frame: (3, 3), rotation of the flange.
        weight: (n,), of the nodes, above 0; with masses [kg], e is the square of an angular frequency; None
            for 1.
        count: number of lowest eigenvalues to find, at most.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh  # imported here because it takes long to load

    x, shift = state.positions, 0.0
    weights = np.ones(len(x)) if weight is None else weight
    root = np.sqrt(weights)[:, None]

    def definite(by: float) -> bool:
        nonlocal shift
        shift = by
        term = Inertia(by * weights, x) if by else None
        return solver.factorise(x, state.memory, loads, term, frame)

    def inverse(vector: Array) -> Array:
        return np.asarray(root * solver.linear.solve(root * vector.reshape(-1, 3))).ravel()

    least_shift = _LEAST_SHIFT / float(weights.mean())
    ShiftSearch().factor(definite, least_shift, least_shift * _LARGEST_SHIFT / _LEAST_SHIFT)
    start = np.where(solver.free, np.random.default_rng(0).standard_normal(x.shape), 0.0).ravel()
    operator = LinearOperator((x.size, x.size), matvec=inverse, dtype=np.float64)
    count = min(count, int(np.count_nonzero(solver.free)), x.size - 1)
    room = min(_VECTORS + 2 * (count - 1), x.size)
    inverse_values, vectors = eigsh(operator, k=count, which="LA", v0=start, tol=_TOLERANCE, ncv=room)
    solver.set_factor_key(None)
    order = np.argsort(-inverse_values)
    values = (1.0 / inverse_values[order] - shift).tolist()
    shapes = vectors.T[order].reshape(len(order), -1, 3) / root
    mode = shapes[0] / shapes[0].ravel()[np.argmax(np.abs(shapes[0]))]
    place = describe_largest(solver.film.body, x, mode, solver.free)
    return LowestMode(values[0], mode, place, tuple(values), shapes)


def describe_instability(
    solver: NewtonSolver, state: SoftState, loads: Loads, lowest: LowestMode, ways: int
) -> Branching:
    """Return the description of an unstable equilibrium.

    Args:
        solver: Newton's method for the body with the present clamp.
        state: of the body.
        loads: that act.
        lowest: its lowest mode.
        ways: number of independent directions in which the potential falls.
    """
    volumes = solver.film.gas.enclosed_volumes(state.positions[None])[0]
    return Branching(
        1.0, loads.pressures_at(tuple(volumes.tolist())), loads.cable_tension_N, lowest.place,
        lowest.direction, lowest.extent, ways, None, None, UNDECIDED, losses_held=losses_held(solver, loads),
    )  # fmt: skip


def losses_held(solver: NewtonSolver, loads: Loads) -> bool:
    """Return whether loads have no potential, so that stability is assessed with frozen losses."""
    cables = solver.film.body.cables
    rubs = any(cable.friction_coefficient for cable in cables)
    return rubs or not solver.film.conservative or losses_follow(cables, loads.cable_length_m)
