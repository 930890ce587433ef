"""The cases in cosim."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.peers.case import GRAVITY_M_S2, SAMPLE_S, Bar, Case, Course, Run, run
from cosim.base.arm_file import ArmFile
from cosim.base.frames import Pose, Wrench
from cosim.build.options import fidelity_body
from cosim.config.loading import load_scenario
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.ticks import ServoCommands
from cosim.rigid.build.description import SceneDescription, SceneObject, ServoGains
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.hinge import Hinges
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import Integrator, StepOptions

_HANGING = Pose(np.diag([1.0, -1.0, -1.0]))
_INFLATION_Pa = 10e3  # of an increment, to the start
_STAND_KG = 1e9  # the film's reaction moves it by some nanometres
_STAND = """<robot name="stand"><link name="ground"/><link name="top"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="ground"/><child link="top"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
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
    newton = NewtonSolver(FilmPotential(body), clamp.mask(body.nodes))
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


class Stand:
    """The arm on a stand that nothing moves, beside the bar, stepped as runs of scenarios are: ticks in rows.

    Args:
        course: what is done to the arm.
        body: the arm.
        start: (n, 3) [m], its nodes at rest.
        tick_s: length of a tick.
        options: of the soft steps.
    """

    def __init__(
        self, course: Course, body: SoftBody, start: np.ndarray, tick_s: float, options: StepOptions
    ) -> None:
        self._course, self._tick_s, self._done = course, tick_s, 0
        stand = ArmFile("stand", Path("stand.urdf"), _STAND, "top", ("slide",), np.zeros(1))
        scene = RigidScene(
            SceneDescription(
                stand, tick_s, gravity=(0.0, 0.0, 0.0),
                objects=() if course.bar is None else (_solid(course.bar),),
                floor_height_m=None, armature=_STAND_KG, gains=ServoGains(np.zeros(1), np.zeros(1)),
            )
        )  # fmt: skip
        soft = FilmRobot(body, scene.flange_pose, NewtonOptions(), options)
        soft.state = SoftState.at_rest(start, SoftState.drawn(body, Pose()).memory)
        contact = None
        if course.bar is not None:
            contact = ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface(), _LAW)
        self._coupling, self._soft = StaggeredCoupling(Interface(scene, soft, Wrench(), contact)), soft

    @property
    def positions(self) -> np.ndarray:
        """(n, 3) [m]."""
        return self._soft.state.positions

    def advance(self, time_s: float) -> None:
        """Take all ticks until a time [s]."""
        course, ticks = self._course, range(self._done + 1, round(time_s / self._tick_s) + 1)
        loads = [
            Loads((course.pressure_at(k * self._tick_s),), (), course.gravity_at(k * self._tick_s))
            for k in ticks
        ]
        while loads:
            still = np.zeros((len(loads), 1))
            servos = ServoCommands.without_payload(still, still, still)
            loads = loads[self._coupling.advance(servos, loads).done :]
        self._done = ticks.stop - 1


def _solid(bar: Bar) -> SceneObject:
    place, half_turn = (bar.x_m, 0.0, bar.z_m), math.sqrt(0.5)
    size, lying = (bar.radius_m, 2.0 * bar.HALF_LENGTH_M), (half_turn, half_turn, 0.0, 0.0)
    return SceneObject("bar", "capsule", size, place, lying, friction=bar.friction)


def simulate(
    course: Course, body: SoftBody, case: Case, tick_s: float, options: StepOptions | Integrator
) -> Run:
    """Return the run of cosim's lumped model, by its usual options or others."""
    if isinstance(options, str):
        options = StepOptions(options)
    options = replace(options, damping_per_s=course.damping_per_s)
    stand = Stand(course, body, np.array(case.start), tick_s, options)
    return run(course, case, SAMPLE_S, stand.advance, lambda: stand.positions)
