"""Loads under which folds close and eyelets meet: every number of steps reaches them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cosim
from cosim.base.frames import Pose
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.schema.settings import ModelTable
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium, SoftState
from tests.bare_film import bare_film


def inflated(
    scenario: str, pressure_Pa: float, *, closed: bool = True, **overrides: object
) -> tuple[EquilibriumSolver, Equilibrium]:
    """Return a weightless soft robot on a fixed flange under pressure, and what solves it."""
    keys = {f"soft_robot.{name.replace('__', '.')}": value for name, value in overrides.items()}
    robot = load_scenario(scenario, keys).soft_robot
    body = build_soft_body(robot, ModelTable(closed=closed, published=True))
    clamp = Clamp.of_base(body)
    newton = NewtonSolver(FilmPotential(body), clamp.mask(body.nodes))
    solver = EquilibriumSolver(newton, clamp, NewtonOptions(iterations_max=100))
    flat = Loads((0.01 * pressure_Pa,), (0.0,) * len(body.cables), (0.0, 0.0, 0.0))
    here = solver.solve(SoftState.drawn(body, Pose()), Pose(), flat)
    for share in np.linspace(0.01, 1.0, 21)[1:]:
        here = solver.follow(here, Pose(), replace(flat, pressure_Pa=(share * pressure_Pa,)))
    return solver, here


@pytest.mark.parametrize("pressure_Pa", [20e3, 30e3])
def test_a_finger_closes_in_any_number_of_steps(pressure_Pa: float) -> None:
    # at 20 kPa two eyelets of a cable meet at 2.5 N; where they met, no shape was in balance
    solver, open_ = inflated("gripper_finger_closing", pressure_Pa)
    ends = []
    for steps in (1, 5, 20):
        here = open_
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            here = solver.follow(here, Pose(), replace(open_.loads, cable_tension_N=(3.0 * share,) * 2))
        ends.append(here.state.positions)
    # residuals of 1e-6 N over the softest stiffness, 0.2 N/m
    assert ends[1] == pytest.approx(ends[0], abs=1e-5)
    assert ends[2] == pytest.approx(ends[0], abs=1e-5)


@pytest.mark.parametrize("steps", [2, 5])
def test_an_open_arm_bends_in_any_number_of_steps(steps: int) -> None:
    # without end caps there is no potential; five solutions without a halved load ended at 18 N
    solver, here = inflated("hexagon_arm_bending", 40e3, closed=False)
    for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
        here = solver.solve(here.state, Pose(), replace(here.loads, cable_tension_N=(30.0 * share, 0.0, 0.0)))
    assert here.residual_N < 1e-6


@pytest.mark.long
def test_a_thin_refined_stack_bends_by_more_than_right_angles() -> None:
    # six square units of 50 mm, a film of 50 um and 3 GPa; it used to stop at 85 degrees
    cables = [{"name": f"c{k}", "corner": k, "units": [1, 6], "capstan_factor": 1.0} for k in (0, 1)]
    scenario = bare_film(
        "bending_angle",
        "plain",
        {
            "soft_robot.stack.refine": 1,
            "soft_robot.stack.units": 6,
            "soft_robot.stack.corner_radius_m": 0.025 * np.sqrt(2.0),
            "soft_robot.film.thickness_m": 50e-6,
            "soft_robot.film.young_modulus_Pa": 3e9,
            "soft_robot.hinge.rule": "shell",
            "soft_robot.cable": cables,
            "phase.pull.cable_tension_N": [3.0, 3.0],
        },
    )
    result = cosim.run(scenario)
    assert result.status == "completed"
    assert result.summary["phases"][-1]["tip_direction"][2] < 0.0


@pytest.mark.long
def test_an_arm_refined_twice_hangs_without_pressure() -> None:
    # eight of the ten units of the reference arm: none was found at 0 Pa
    robot = load_scenario("ur5e_hexagon_arm", {"soft_robot.stack.refine": 2}).soft_robot
    robot = replace(robot, stack=replace(robot.stack, units=8), cables=())
    body = build_soft_body(robot, ModelTable(published=True))
    clamp, hanging = Clamp.of_base(body), Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    newton = NewtonSolver(FilmPotential(body), clamp.mask(body.nodes))
    # the whole arm needs more than 100 iterations, these units more than 60: the load comes in pieces
    solver = EquilibriumSolver(newton, clamp, NewtonOptions(iterations_max=60))
    slack = Loads((), (), (0.0, 0.0, 0.0))
    weightless = solver.solve(SoftState.drawn(body, hanging), hanging, slack)
    here = solver.follow(weightless, hanging, replace(slack, gravity=(0.0, 0.0, -9.81)))
    assert here.residual_N < 1e-6
    # it carries its own weight and nothing else
    assert -here.wrench.force[2] == pytest.approx(9.81 * body.mass_kg, abs=1e-4)


def test_where_a_branch_ends_the_body_slides_to_the_next() -> None:
    # a shallow roof of two strips that snaps through; three short iterations do not lead there
    half, rise = 0.05, 0.01
    positions = np.array([
        [-half, 0.0, 0.0], [-half, 0.02, 0.0], [0.0, 0.0, rise], [0.0, 0.02, rise],
        [half, 0.0, 0.0], [half, 0.02, 0.0],
    ])  # fmt: skip
    triangles = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]])
    body = SoftBody.from_arrays(positions, triangles, Film(1e6, 0.3, 1e-3))
    clamped = np.isin(np.arange(6), [0, 1, 4, 5])
    nowhere = Clamp(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), dtype=bool))
    options = NewtonOptions(iterations_max=3, step_max_m=1e-3)
    force = np.zeros((6, 3))
    force[2:4, 2] = -0.12

    def pushed(slides_max: int) -> Equilibrium:
        solver = EquilibriumSolver(
            NewtonSolver(FilmPotential(body), clamped), nowhere, options, slides_max=slides_max
        )
        rest = solver.solve(SoftState.drawn(body, Pose()), Pose(), Loads(gravity=(0.0, 0.0, 0.0)))
        return solver.follow(rest, Pose(), replace(rest.loads, nodal_force=force))

    with pytest.raises(ConvergenceError, match=r"the largest at node [23]"):
        pushed(0)
    here = pushed(4)
    assert here.slides == 1
    assert here.residual_N < options.tolerance_N
    assert here.state.positions[2:4, 2].max() < -rise
