"""The case in cosim, and the truth that all are measured against: cosim's own with a tick of 0.1 ms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.peers.case import DAMPING_PER_S, GRAVITY_M_S2, Case, LOW_Pa, Run, gravity_at, pressure_at, run
from cosim.base.frames import Pose
from cosim.build.fidelity import fidelity_body
from cosim.config.loading import load_scenario
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.hinge import Hinges
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, SoftState
from cosim.soft.solve.time_scheme import Integrator, StepOptions
from cosim.soft.solve.time_step import ImplicitStepper

_HANGING = Pose(np.diag([1.0, -1.0, -1.0]))


def film_only() -> SoftBody:
    """Return the hexagonal arm hanging down, without hinges and cables."""
    scenario = load_scenario("ur5e_hexagon_arm", {"model.published": True})
    body = fidelity_body(scenario)
    hinges = replace(body.hinges, stiffness=0.0 * body.hinges.stiffness, fold_barrier_rad=0.0)
    bare = body.with_other(Hinges, hinges).with_other(Cable)
    return replace(bare, positions=np.ascontiguousarray(_HANGING.apply(body.positions)))


def make_case() -> tuple[SoftBody, Case]:
    """Return the body and the case with its start, the equilibrium at the low pressure."""
    body = film_only()
    clamp = Clamp.of_base(body)
    newton = NewtonSolver(SoftSystem(body), clamp.mask(body.nodes))
    solver = EquilibriumSolver(newton, clamp, NewtonOptions(tolerance_N=1e-8, start_tolerance_N=1e-8))
    loads = Loads((LOW_Pa,), (), (0.0, 0.0, -GRAVITY_M_S2))
    start = solver.solve(SoftState.drawn(body, Pose()), Pose(), loads).state.positions
    film = body.membranes[0].film
    case = Case(
        body.positions, start, body.triangles, body.caps, np.unique(body.base), body.tip,
        body.node_mass, film.young_modulus_Pa, film.poisson_ratio, film.thickness_m,
    )  # fmt: skip
    return body, case


def simulate(body: SoftBody, case: Case, tick_s: float, integrator: Integrator, iterations: int = 1) -> Run:
    """Return the run of cosim's lumped model."""
    clamp = Clamp.of_base(body)
    newton = NewtonSolver(SoftSystem(body), clamp.mask(body.nodes))
    options = StepOptions(integrator, iterations=iterations, damping_per_s=DAMPING_PER_S)
    if iterations > 1:
        options = replace(options, tolerance_N=1e-6)
    stepper = ImplicitStepper(newton, clamp, options)
    state = SoftState.at_rest(np.array(case.start), SoftState.drawn(body, Pose()).memory)

    def step(time_s: float) -> None:
        nonlocal state
        loads = Loads((pressure_at(time_s),), (), gravity_at(time_s))
        state, _ = stepper.step(state, Pose(), loads, tick_s)

    return run(case, tick_s, step, lambda: state.positions[case.tip].mean(axis=0))
