"""A soft body that tumbles and pulsates freely: momentum and energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.time_step import ImplicitStepper
from cosim.verification.support.case import Case, Figure, observed_order
from cosim.verification.support.specimen import NO_CLAMP, exact_steps

SPAN_S = 0.2
STEPS = (800, 1600)
_LOADS = Loads(pressure_Pa=(50.0,), cable_tension_N=(0.05,), gravity=(0.0, 0.0, 0.0))


def octahedron() -> SoftBody:
    """Return a closed octahedron of soft film with hinges, gas, a cable through it and unequal masses."""
    positions = 0.05 * np.array(
        [[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.3], [0, 0, -1.0]]
    )
    triangles = np.array(
        [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]]
    )
    return SoftBody.from_arrays(
        positions, triangles, Film(1e5, 0.3, 2e-4), hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=1e-4, cables=(Cable(np.array([0, 2, 4])),),
        node_mass=1e-3 * np.array([1.0, 2.0, 1.5, 1.0, 3.0, 2.0]),
    )  # fmt: skip


def motion(body: SoftBody, state: SoftState, system: SoftSystem) -> tuple[Array, Array, float]:
    """Return momentum (3,) [kg m/s], moment of momentum about the origin (3,) [kg m^2/s], energy [J]."""
    mass, x, v = body.node_mass[:, None], state.positions, state.velocities
    tension = system.segment_share(x, _LOADS)
    potential = system.evaluate(x, _LOADS, tension, state.memory, hessian=False)
    return (mass * v).sum(0), np.cross(x, mass * v).sum(0), potential + 0.5 * float((mass * v * v).sum())


def drifts(steps: int) -> tuple[float, float, float]:
    """Return the relative drift of momentum, moment of momentum and energy over the flight.

    Energy is compared with the kinetic energy at the start.
    """
    body = octahedron()
    system, probe = SoftSystem(body), SoftSystem(body)
    solver = NewtonSolver(system, NO_CLAMP.mask(body.nodes))
    stepper = ImplicitStepper(solver, NO_CLAMP, exact_steps("bdf2", 1e-11))
    state = SoftState.drawn(body, Pose())
    spin, flight = np.array([20.0, 5.0, 30.0]), np.array([0.5, -0.2, 0.3])
    state = SoftState(state.positions, np.cross(spin, state.positions) + flight, state.memory)
    begin = motion(body, state, probe)
    kinetic = 0.5 * float((body.node_mass[:, None] * state.velocities**2).sum())
    for _ in range(steps):
        state, _ = stepper.step(state, Pose(), _LOADS, SPAN_S / steps)
    end = motion(body, state, probe)
    linear, angular = (float(np.linalg.norm(end[k] - begin[k]) / np.linalg.norm(begin[k])) for k in (0, 1))
    return linear, angular, abs(end[2] - begin[2]) / kinetic


@final
@dataclass(frozen=True)
class FreeFlight(Case):
    """Momentum is kept to the solver's tolerance, moment of momentum and energy to the order of BDF2."""

    name: ClassVar[str] = "free_flight"
    title: ClassVar[str] = "Momentum and energy of a free, tumbling body (BDF2)"
    source: ClassVar[str] = "Newton's laws: no outer force, conservative inner ones"

    def run(self) -> tuple[Figure, ...]:
        coarse, fine = drifts(STEPS[0]), drifts(STEPS[1])
        angular, energy = (observed_order(coarse[k], fine[k]) for k in (1, 2))
        return (
            Figure("drift of momentum", "1", fine[0], 0.0, 1e-7, absolute=True),
            Figure(
                "drift of the moment of momentum",
                "1",
                fine[1],
                0.0,
                1e-3,
                absolute=True,
                observed_order=angular,
            ),
            Figure("drift of energy", "1", fine[2], 0.0, 5e-3, absolute=True, observed_order=energy),
        )
