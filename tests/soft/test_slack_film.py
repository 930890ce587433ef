"""Film that is slack in its frames opens without pressure, and is followed up and down in few iterations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.slack_film import is_slack
from cosim.soft.solve.state import Equilibrium, SoftState

WEIGHTLESS = (0.0, 0.0, 0.0)


def solver_of_robot(robot: dict[str, Any] | str, **changes: Any) -> EquilibriumSolver:
    """Return a solver of a robot on a fixed flange."""
    scenario = load_scenario(
        "three_unit_inflation", {"model.published": False, "soft_robot": robot, **changes}
    )
    assert isinstance(scenario.soft_robot, SoftRobotTable)
    body = build_soft_body(scenario.soft_robot, scenario.model)
    clamp = Clamp.of_base(body)
    newton = NewtonSolver(FilmPotential(body), clamp.mask(body.nodes))
    return EquilibriumSolver(newton, clamp, NewtonOptions(reuse_max=8, reuse_below_N=1.0))


def solver_of(ratio: float, refine: int = 0) -> EquilibriumSolver:
    """Return a solver of three square units whose frames rest on one another."""
    sizes = {"soft_robot.stiffener.side_ratio": ratio, "soft_robot.stack.refine": refine}
    return solver_of_robot("square_core", **sizes)


def hung(solver: EquilibriumSolver) -> Equilibrium:
    return solver.hang(SoftState.drawn(solver.body, Pose()), Pose(), WEIGHTLESS)


def length_mm(solver: EquilibriumSolver, found: Equilibrium) -> float:
    return 1e3 * float(solver.body.tip_position(found.state.positions)[2])


@pytest.mark.parametrize("ratio", [0.98, 0.99, 0.995])
def test_without_pressure_each_film_opens_to_a_cone_that_takes_up_the_slack(ratio: float) -> None:
    solver = solver_of(ratio)
    opened = length_mm(solver, hung(solver))
    # 30 mm from the middle to a side, in a frame that is smaller: two films a unit
    cone = np.sqrt(1.0 - ratio**2) * 30.0
    assert opened == pytest.approx(6.0 * cone, rel=0.08)
    assert is_slack(solver.body)
    assert not is_slack(solver_of(1.0).body)


@pytest.mark.parametrize("refine", [0, pytest.param(1, marks=pytest.mark.long)])
def test_slack_film_is_followed_up_to_10_kPa_and_down_to_nothing(refine: int) -> None:
    solver = solver_of(0.99, refine)
    here, lengths = hung(solver), []
    lengths.append(length_mm(solver, here))
    for pressure in (3e3, 10e3, 3e3, 1e3, 0.0):
        here = solver.follow(here, Pose(), Loads((pressure,), (), WEIGHTLESS))
        assert here.iterations < 150
        assert not here.slides
        assert not here.branchings
        lengths.append(length_mm(solver, here))
    assert lengths[2] > 1.15 * lengths[1]
    assert lengths[3] == pytest.approx(lengths[1], rel=2e-3)
    assert lengths[5] == pytest.approx(lengths[0], rel=2e-3)


def test_fitting_film_starts_from_its_drawn_shape() -> None:
    solver = solver_of(1.0)
    drawn = SoftState.drawn(solver.body, Pose())
    assert solver.hang(drawn, Pose(), WEIGHTLESS).iterations > 0
    assert length_mm(solver, hung(solver)) < 9.0  # frames 2.4 mm high and two films rest on one another


def test_the_stiff_frame_s_film_opens_as_well() -> None:
    solver = solver_of_robot({"file": "square_core", "stiffener": {"kind": "stiff", "side_ratio": 0.99}})
    assert is_slack(solver.body)
    assert length_mm(solver, hung(solver)) == pytest.approx(6.0 * np.sqrt(1.0 - 0.99**2) * 30.0, rel=0.08)


@pytest.mark.long
def test_one_identified_unit_is_as_near_to_the_mesh_refined_twice_as_runs_report() -> None:
    found = []
    for stack in ({"mesh": "graded"}, {"mesh": "drawn", "refine": 2}):
        robot = {"file": "square_core_identified", "stack": {"units": 1, **stack}}
        solver = solver_of_robot(robot)
        here, of_mesh = hung(solver), []
        for pressure in (2e3, 40e3):
            here = solver.follow(here, Pose(), Loads((pressure,), (), WEIGHTLESS))
            volume = solver.solver.film.gas.enclosed_volumes(here.state.positions[None])[0, 0]
            of_mesh.append((length_mm(solver, here) - 2.0, volume))
        found.append(of_mesh)
    extension, volume = (np.array(found[0]) / np.array(found[1]) - 1.0).T
    assert 0.005 < extension.min() < extension.max() < 0.045
    assert -0.055 < volume.min() < volume.max() < -0.025
