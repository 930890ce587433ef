"""Order of convergence in time of every integrator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, final, get_args

import numpy as np
from scipy.integrate import solve_ivp

from cosim.base.frames import Array, Mask, Pose
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.time_scheme import Integrator
from cosim.soft.solve.time_step import ImplicitStepper
from cosim.verification.support.case import Case, Figure, observed_order
from cosim.verification.support.meshes import grid_triangles
from cosim.verification.support.specimen import NO_CLAMP, exact_steps

THEORY: Mapping[str, float] = {"implicit_euler": 1.0, "bdf2": 2.0}
SPAN_S = 0.1
STEPS = (400, 800)
_LOADS = Loads(gravity=(0.0, 0.0, -9.81))


def swinging_sheet() -> tuple[SoftBody, Mask]:
    """Return a soft sheet of 2 x 2 squares with hinges, and the edge that holds it.

    Its fastest oscillation, near 350 rad/s, is resolved by every step used here.
    """
    line = np.linspace(0.0, 0.1, 3)
    x, y = np.meshgrid(line, line, indexing="ij")
    positions = np.stack([x.ravel(), y.ravel(), np.zeros(9)], axis=1)
    triangles = grid_triangles(2, 2)
    body = SoftBody.from_arrays(
        positions, triangles, Film(1e5, 0.3, 2e-4), hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=1e-4, node_mass=1e-3,
    )  # fmt: skip
    return body, np.abs(positions[:, 0]) < 1e-9


def exact_end(body: SoftBody, clamped: Mask) -> Array:
    """Return positions (n, 3) [m] at SPAN_S by an explicit Runge-Kutta method of order 8."""
    system = SoftSystem(body)
    n = body.nodes

    def rates(_t: float, y: Array) -> Array:
        x = np.ascontiguousarray(y[: 3 * n].reshape(n, 3))
        system.evaluate(x, _LOADS, np.zeros(0), system.memory.copy(), hessian=False)
        acceleration = -system.gradient / body.node_mass[:, None]
        acceleration[clamped] = 0.0
        return np.concatenate([y[3 * n :], acceleration.ravel()])

    start = np.concatenate([body.positions.ravel(), np.zeros(3 * n)])
    end = solve_ivp(rates, (0.0, SPAN_S), start, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return np.asarray(end[: 3 * n].reshape(n, 3))


def stepped_end(body: SoftBody, clamped: Mask, integrator: Integrator, steps: int) -> Array:
    """Return positions (n, 3) [m] at SPAN_S after equal steps, each solved to 1e-10 N."""
    options = exact_steps(integrator, 1e-10)
    # a start that is nearly right is not taken as it is either
    options = replace(options, newton=replace(options.newton, start_tolerance_N=1e-10))
    stepper = ImplicitStepper(NewtonSolver(SoftSystem(body), clamped), NO_CLAMP, options)
    state = SoftState.drawn(body, Pose())
    for _ in range(steps):
        state, _ = stepper.step(state, Pose(), _LOADS, SPAN_S / steps)
    return state.positions


@final
@dataclass(frozen=True)
class TimeOrder(Case):
    """A hinged sheet falls from rest about one edge; its end position against a Runge-Kutta solution."""

    name: ClassVar[str] = "time_order"
    title: ClassVar[str] = "Order of convergence in time of every integrator"
    source: ClassVar[str] = "Hairer and Wanner, Solving ODEs II; reference solution by SciPy's DOP853"

    def run(self) -> tuple[Figure, ...]:
        body, clamped = swinging_sheet()
        exact = exact_end(body, clamped)
        figures = []
        for integrator in get_args(Integrator):
            errors = [
                float(np.abs(stepped_end(body, clamped, integrator, steps) - exact).max()) for steps in STEPS
            ]
            order = observed_order(*errors)
            figures.append(
                Figure(f"order of {integrator}", "1", order, THEORY[integrator], 0.15, absolute=True,
                       observed_order=order)
            )  # fmt: skip
        return tuple(figures)
