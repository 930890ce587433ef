"""Stability of a body as if it was at rest: instabilities, natural frequencies, and the margin of loads."""

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.solve.branching import DISTURBED, MODES, Branching, LowestMode, StabilityReport
from cosim.soft.solve.lowest_mode import describe_instability, losses_held, lowest_mode
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import SoftState

_GROWTH, _MOVES_m = 1e-3, 1e-5  # relative growth of loads, and largest motion by it, in a finite difference
_PROBE_m = 1e-7  # half of the step of differences
_DRIVEN = 0.5  # fraction of the response to more load in the lowest mode above which the body snaps
_RATE_PROBE_m = 1e-6


def find_instability(solver: NewtonSolver, state: SoftState, loads: Loads, frame: Array) -> Branching | None:
    """Return the instability of a state as if it was at rest; None if it is not known to be unstable.

    With open ends, an indefinite symmetric part does not prove an instability, see `assess_stability`.

    Args:
        solver: Newton's method for the body with the present clamp, for symmetric parts of tangents; its
            factorisation is lost.
        state: of the body.
        loads: that act.
        frame: (3, 3), rotation of the flange.
    """
    if not solver.film.conservative or solver.factorise(state.positions, state.memory, loads, None, frame):
        return None
    negative_pivots = solver.negative_pivots(state.positions, state.memory, loads)
    return (
        describe_instability(solver, state, loads, lowest_mode(solver, state, loads, frame), negative_pivots)
        if negative_pivots
        else None
    )


def assess_stability(solver: NewtonSolver, state: SoftState, loads: Loads, frame: Array) -> StabilityReport:
    """Return the stability of a body as if it was at rest.

    One factorisation, that of the lowest mode, is enough: three solutions give the effect of a disturbance,
    one the response to more load, whose effect on the stiffness follows from differences of gradients.

    Args:
        solver: Newton's method for the body with the present clamp, for symmetric parts of tangents; its
            factorisation is lost.
        state: of the body.
        loads: that act.
        frame: (3, 3), rotation of the flange.
    """
    film, x = solver.film, state.positions
    are_held = losses_held(solver, loads)
    mass = film.body.node_mass
    weight = mass if (mass > 0.0).all() else None
    lowest = lowest_mode(solver, state, loads, frame, weight, MODES)
    if not lowest.value > 0.0:
        if not film.conservative:  # it may still be stable
            return StabilityReport(None, math.inf, math.inf, losses_held=are_held)
        unstable_directions = max(1, solver.negative_pivots(x, state.memory, loads))
        return StabilityReport(
            None,
            math.inf,
            0.0,
            losses_held=are_held,
            unstable=describe_instability(solver, state, loads, lowest, unstable_directions),
        )
    growth = _Growth(solver, state, loads)
    force = growth.force
    disturbance = DISTURBED * np.linalg.norm(force, axis=1)[:, None, None] * np.eye(3)
    responses = solver.linear.solve_all(np.ascontiguousarray(disturbance.swapaxes(0, 1))).swapaxes(0, 1)
    disturbed_tip_m = tip_displacement(film.body.tip, responses)
    margin, snaps = growth.margin(lowest, solver.linear.solve(force), weight)
    modes = () if weight is None else natural_frequencies(lowest.values)
    losses = () if weight is None else material_losses(film, x, lowest.shapes)
    return StabilityReport(
        modes[0] if modes else None,
        disturbed_tip_m,
        margin,
        snaps,
        are_held,
        frequencies_Hz=modes,
        losses_per_s=losses,
    )


def material_losses(film: FilmPotential, positions: Array, shapes: Array) -> tuple[float, ...]:
    """Return v.D v / v.M v [1/s] of each mode: by its materials' losses it decays at half of that rate.

    D is the damping matrix of strain rates at the shape, M the mass matrix.

    Args:
        film: of the body.
        positions: (n, 3) [m].
        shapes: (k, n, 3), v.
    """
    rates, mass = StrainRates.of(film.body), film.body.node_mass
    if rates is None:
        return (0.0,) * len(shapes)
    rates.begin(positions, None, 1.0)
    loss_rates = []
    for shape in shapes:
        step = _RATE_PROBE_m / float(np.abs(shape).max())
        potentials = (
            rates.potential(np.ascontiguousarray(positions + sign * step * shape)) for sign in (1.0, -1.0)
        )
        loss_rates.append(sum(potentials) / step**2 / float(mass @ (shape**2).sum(axis=1)))
    return tuple(loss_rates)


def natural_frequencies(values: Sequence[float]) -> tuple[float, ...]:
    """Return the frequencies [Hz] of eigenvalues above 0, the squares of angular frequencies."""
    return tuple(math.sqrt(value) / (2.0 * math.pi) for value in values)


def tip_displacement(tip: IntArray, responses: Array) -> float:
    """Return the largest motion [m] of the tip by a combination of disturbances; of any node without a tip.

    Args:
        tip: (k,) nodes.
        responses: (n, 3, 3) [m], of each node to each of three disturbances.
    """
    tip_responses = responses[tip].mean(axis=0, keepdims=True) if len(tip) else responses
    return float(np.linalg.norm(tip_responses, ord=2, axis=(1, 2)).max())


def is_driven(product: float, size_of_mode: float, size_of_response: float) -> bool:
    """Return whether the response of a body to more load is mostly in its lowest mode: it is driven to snap.

    Args:
        product: inner product of both, weighted by mass.
        size_of_mode: inner product of the mode with itself.
        size_of_response: inner product of the response with itself.
    """
    return product**2 > _DRIVEN * size_of_mode * size_of_response


def load_margin(stiffness: float, fall: float, *, driven: bool) -> tuple[float, bool]:
    """Return the relative growth of loads, below 1, at which a stiffness is zero, and if the body snaps.

    Args:
        stiffness: at present.
        fall: its decrease per relative growth of the loads.
        driven: whether the loads move the body along the mode. Then it snaps if the stiffness falls as loads
            grow, and the square of the stiffness falls linearly; as loads fall, it returns to its branch.
    """
    linear = stiffness / fall if fall else math.inf
    snaps = driven and linear > 0.0
    margin = 0.5 * linear if snaps else linear
    return (margin, snaps) if abs(margin) < 1.0 else (math.inf, False)


def nodal_loads(film: FilmPotential, positions: Array, memory: Array, loads: Loads) -> Array:
    """Return the forces of loads on nodes (n, 3) [N]: gas, cables of commanded tension, weight, dead loads.

    Args:
        film: of the body.
        positions: (n, 3) [m].
        memory: (values,), internal variables of the elements there.
        loads: that act.
    """
    tensions, gradients = film.losses_at(positions, loads), []
    volumes = tuple(film.gas.enclosed_volumes(positions[None])[0].tolist())
    for growth in (-1.0, 0.0):
        film.evaluate(positions, loads.grown(growth, volumes), tensions, memory.copy(), hessian=False)
        gradients.append(film.gradient.copy())
    return np.asarray(gradients[0] - gradients[1])


@final
class _Growth:
    """The loads of a body, and the change of its lowest stiffness as all loads grow.

    Args:
        solver: Newton's method for the body.
        state: of the body.
        loads: that act.
    """

    def __init__(self, solver: NewtonSolver, state: SoftState, loads: Loads) -> None:
        self._solver, self._state, self._loads = solver, state, loads
        volumes = solver.film.gas.enclosed_volumes(state.positions[None])[0]
        self._volumes = tuple(volumes.tolist())
        forces = nodal_loads(solver.film, state.positions, state.memory, loads)
        self.force = np.where(solver.free, forces, 0.0)

    def margin(self, lowest: LowestMode, response: Array, weight: Array | None) -> tuple[float, bool]:
        """Return the relative growth of loads at which the lowest stiffness is zero, and if the body snaps.

        Args:
            lowest: eigenvalue and mode.
            response: (n, 3) [m], linear response of the body to twice the loads.
            weight: of `lowest_mode`.
        """
        largest_m = float(np.abs(response).max())
        growth = min(_GROWTH, _MOVES_m / largest_m) if largest_m else _GROWTH
        # terms of second order in the motion, such as stretch along a straight mode, cancel
        stiffness_less, stiffness_now, stiffness_more = (
            self._stiffness(lowest.mode, change, change * response) for change in (-growth, 0.0, growth)
        )
        weights = np.ones(len(response)) if weight is None else weight
        driven = is_driven(
            *(
                float(weights @ (a * b).sum(axis=1))
                for a, b in ((lowest.mode, response), (lowest.mode, lowest.mode), (response, response))
            )
        )
        return load_margin(stiffness_now, (stiffness_less - stiffness_more) / (2.0 * growth), driven=driven)

    def _stiffness(self, mode: Array, growth: float, displacement: Array) -> float:
        """Return the stiffness along a mode, of a body that has moved under grown loads."""
        gradients = [self._gradient(growth, displacement + sign * _PROBE_m * mode) for sign in (1.0, -1.0)]
        return float((mode * (gradients[0] - gradients[1])).sum()) / (2.0 * _PROBE_m)

    def _gradient(self, growth: float, displacement: Array | float = 0.0) -> Array:
        film, x = self._solver.film, np.ascontiguousarray(self._state.positions + displacement)
        loads = self._loads.grown(growth, self._volumes)
        losses = film.losses_at(self._state.positions, loads, self._state.memory)
        film.evaluate(x, loads, losses, self._state.memory, hessian=False)
        return np.where(self._solver.free, film.gradient, 0.0)
