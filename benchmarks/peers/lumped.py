"""The cases in cosim."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from benchmarks.peers.case import GRAVITY_M_S2, Bar, Case, Course, Run, run
from cosim.base.frames import Pose
from cosim.build.fidelity import fidelity_body
from cosim.config.loading import load_scenario
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene.bodies import Bodies
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
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
_INFLATION_Pa = 10e3  # of an increment, to the start
_LAW = ContactLaw(stiffness_N_m3=1e8, smoothing_m=3e-4, stick_m=3e-4)  # as in the grasps


def film_only() -> SoftBody:
    """Return the hexagonal arm hanging down, without hinges and cables."""
    scenario = load_scenario("ur5e_hexagon_arm", {"model.published": True})
    body = fidelity_body(scenario)
    hinges = replace(body.hinges, stiffness=0.0 * body.hinges.stiffness, fold_barrier_rad=0.0)
    bare = body.with_other(Hinges, hinges).with_other(Cable)
    return replace(bare, positions=np.ascontiguousarray(_HANGING.apply(body.positions)))


def make_case(course: Course) -> tuple[SoftBody, Case]:
    """Return the body and the case with its start, the equilibrium at the course's low pressure."""
    body = film_only()
    clamp = Clamp.of_base(body)
    newton = NewtonSolver(SoftSystem(body), clamp.mask(body.nodes))
    solver = EquilibriumSolver(newton, clamp, NewtonOptions(tolerance_N=1e-8, start_tolerance_N=1e-8))
    state = SoftState.drawn(body, Pose())
    for pressure_Pa in np.arange(_INFLATION_Pa, course.low_Pa + 1.0, _INFLATION_Pa).tolist():
        state = solver.solve(state, Pose(), Loads((pressure_Pa,), (), (0.0, 0.0, -GRAVITY_M_S2))).state
    film = body.membranes[0].film
    case = Case(
        body.positions, state.positions, body.triangles, body.caps, np.unique(body.base), body.tip,
        body.node_mass, film.young_modulus_Pa, film.poisson_ratio, film.thickness_m,
    )  # fmt: skip
    return body, case


def contact_with(bar: Bar, body: SoftBody, system: SoftSystem) -> ContactExchange:
    """Return the film's contact with a bar."""
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bar.mjcf()}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bodies = Bodies(model, data, slice(0, 0), np.zeros(model.nbody, dtype=bool))
    surface = ContactSurface.of(body, system.pattern)
    return ContactExchange(ContactQuery(model, data, [0]), bodies, surface, _LAW)


def simulate(
    course: Course, body: SoftBody, case: Case, tick_s: float, options: StepOptions | Integrator
) -> Run:
    """Return the run of cosim's lumped model, by its usual options or others."""
    if isinstance(options, str):
        options = StepOptions(options)
    clamp = Clamp.of_base(body)
    system = SoftSystem(body)
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    stepper = ImplicitStepper(newton, clamp, replace(options, damping_per_s=course.damping_per_s))
    state = SoftState.at_rest(np.array(case.start), SoftState.drawn(body, Pose()).memory)
    contact = None if course.bar is None else contact_with(course.bar, body, system)

    def step(time_s: float) -> None:
        nonlocal state
        planes = None if contact is None else contact.find(state, tick_s)
        loads = Loads((course.pressure_at(time_s),), (), course.gravity_at(time_s), contact=planes)
        state, _ = stepper.step(state, Pose(), loads, tick_s)
        if contact is not None:
            contact.settle(state.positions)

    return run(course, case, tick_s, step, lambda: state.positions)
