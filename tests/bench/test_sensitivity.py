"""Jacobians of equilibria against differences of whole solutions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import cosim
from cosim.app.simulation import stepped_run
from cosim.base.frames import Array
from cosim.bench.outputs import OutputShape, Slopes, outputs_of, read
from cosim.bench.parameters import LoadParameter, StaticModel, parameters_of, value_at, with_values
from cosim.build.options import fidelity_body, static_options
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.parameter_derivatives import EquilibriumDerivatives, ParameterChange, PerturbedModel
from cosim.soft.solve.state import Equilibrium
from cosim.stepping.quasistatic import QuasistaticSimulation
from tests.derivatives import differences, relative_error

PULLED: dict[str, Any] = {
    "model.published": False,
    "gravity_m_s2": [0.0, 0.0, 4.0],
    "solver.residual_tolerance_N": 1e-10,
    "contact.self_contact": False,
    "soft_robot.cable.corner_0.capstan_factor": 0.9,
    "soft_robot.stack.mesh": "drawn",
    "soft_robot.stack.neck": {"fused_radius_m": 0.005},
    "phase": [
        {"name": "inflate", "duration_s": 1.0, "increments": 2, "pressure_Pa": 8e3},
        {"name": "pull", "duration_s": 1.0, "increments": 2, "cable_tension_N": [1.0, 0.5]},
    ],
}
OUTPUTS = [
    "frame_strain",
    "mass_kg",
    "tip_position_m",
    "tip_direction",
    "length_m",
    "cable_length_m",
    "flange_torque_Nm",
]


@cache
def pulled() -> cosim.Simulation:
    simulation = cosim.Simulation("bending_angle", overrides=PULLED)
    simulation.step(ticks=simulation.ticks_left)
    return simulation


def present(simulation: cosim.Simulation) -> tuple[FilmRobot, Equilibrium]:
    run = stepped_run(simulation)
    assert isinstance(run, QuasistaticSimulation)
    assert isinstance(run.soft, FilmRobot)
    return run.soft, run.equilibrium


def solved(simulation: cosim.Simulation, name: str, loads: Loads) -> Callable[[float], Array]:
    """Return what solves the equilibrium near the present one at another value, and reads the outputs."""

    def at(value: float) -> Array:
        scenario, given = simulation.scenario, loads
        if name.startswith("soft_robot."):
            scenario = with_values(scenario, {name: value})
        else:
            model = StaticModel.of(scenario, present(simulation)[0].equilibrium_solver.solver.film)
            parameter = parameters_of([name], model)[0]
            assert isinstance(parameter, LoadParameter)
            given = parameter.changed(given, value, model)
        there = solution(simulation, given, scenario)
        system = there.solver.film
        side = PerturbedModel(0.0, 0.0, 0.0, system, there.clamp, there.here.loads)
        shape = OutputShape(side, there.here.state.positions, system.gradient, there.here.world_from_flange)
        return read(outputs_of(OUTPUTS, StaticModel.of(scenario, system)), shape)

    return at


class Solution(NamedTuple):
    """An equilibrium and what has found it."""

    here: Equilibrium
    body: SoftBody
    solver: NewtonSolver
    clamp: Clamp


def solution(simulation: cosim.Simulation, loads: Loads, scenario: Scenario) -> Solution:
    """Return the equilibrium of a scenario's body near the present one, under some loads."""
    arm, here = present(simulation)
    options = replace(static_options(scenario), tolerance_N=2e-10, start_tolerance_N=2e-10, reuse_max=0)
    body = fidelity_body(scenario)
    other = FilmRobot(body, here.world_from_flange, options, arm.dynamics)
    found = other.equilibrium_solver.follow(
        replace(here, loads=replace(loads, cable_length_m=here.loads.cable_length_m)),
        here.world_from_flange,
        loads,
    )
    return Solution(found, body, other.equilibrium_solver.solver, other.clamp)


def column_error(found: Array, at: Callable[[float], Array], value: float, step: float) -> float:
    """Return the relative error of a column: the largest of those of tip, direction, lengths and wrench.

    A wrench is a sum of much larger forces of nodes, so that a tenth of its error counts.
    """
    difference = differences(lambda x: at(float(x[0])), np.array([value]), step * value)[0]
    parts = (slice(0, 3), 1.0), (slice(3, 6), 1.0), (slice(6, 9), 1.0), (slice(9, 12), 0.1)
    return max(share * relative_error(difference[part], found[part]) for part, share in parts)


def error_of(simulation: cosim.Simulation, name: str, step: float) -> float:
    jacobian = cosim.sensitivity(simulation, [name], OUTPUTS)
    at = solved(simulation, name, present(simulation)[1].loads)
    return column_error(jacobian.matrix[:, 0], at, float(jacobian.parameter_values[0]), step)


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("soft_robot.film.thickness_m", 3e-4),
        ("soft_robot.film.young_modulus_Pa", 3e-4),
        ("soft_robot.stiffener.height_m", 3e-4),
        ("soft_robot.stiffener.side_ratio", 1e-5),
        ("soft_robot.mass.node_mass_kg", 3e-4),
        ("soft_robot.cable.corner_0.capstan_factor", 3e-4),
        ("soft_robot.stack.hole_radius_m", 3e-4),
        ("pressure_Pa.chamber", 3e-4),
        ("cable_tension_N.corner_1", 3e-4),
    ],
)
def test_a_column_against_whole_solutions(name: str, step: float) -> None:
    assert error_of(pulled(), name, step) < 1e-6


def test_a_derivative_is_read_by_its_names_and_has_a_unit() -> None:
    jacobian = cosim.Jacobian(
        ("tip_position_m.z", "length_m"), ("m", "m"), np.array([0.5, 0.3]),
        ("pressure_Pa.chamber", "thickness_m"), ("Pa", "m"), np.array([8e3, 1e-4]),
        np.array([[1.0, 2.0], [3.0, 4.0]]),
    )  # fmt: skip
    assert jacobian.of("length_m", "pressure_Pa.chamber") == 3.0
    assert jacobian.of("tip_position_m.z", "thickness_m") == 2.0
    assert jacobian.unit("length_m", "pressure_Pa.chamber") == "m per Pa"
    for output, parameter, text in (
        ("length", "thickness_m", "no 'length' in the Jacobian; there are tip_position_m.z, length_m"),
        (
            "length_m",
            "thickness",
            "no 'thickness' in the Jacobian; there are pressure_Pa.chamber, thickness_m",
        ),
    ):
        with pytest.raises(cosim.InputError, match=text):
            jacobian.of(output, parameter)


@pytest.mark.parametrize(("name", "step"), [("cable_length_m.corner_0", 1e-3), ("gas_mass_kg.chamber", 1e-4)])
def test_lengths_and_sealed_gas(name: str, step: float) -> None:
    simulation = pulled()
    arm, here = present(simulation)
    volume, length = arm.volumes_m3[0], arm.body.cables[0].length(here.state.positions)
    gas = SealedGas(101325.0 + 8e3, volume)
    loads = replace(here.loads, gas=(gas,), cable_length_m=(0.98 * length, None))
    there = solution(simulation, loads, simulation.scenario)
    model = StaticModel.of(simulation.scenario, there.solver.film)
    parameter = parameters_of([name], model)[0]
    assert isinstance(parameter, LoadParameter)
    slopes = Slopes([parameter], outputs_of(OUTPUTS, model), model)
    _, jacobian = slopes.at(there.solver, there.clamp, there.here)
    value = parameter.value_in(loads, 1)
    assert column_error(jacobian[:, 0], solved(simulation, name, loads), value, step) < 1e-6


def test_forces_are_linear_in_what_needs_one_assembly() -> None:
    simulation = pulled()
    arm, here = present(simulation)
    solver = arm.equilibrium_solver.solver
    model = StaticModel.of(simulation.scenario, solver.film)
    names = [
        "film.young_modulus_Pa", "stiffener.young_modulus_Pa", "hinge.stiffness_factor", "mass.node_mass_kg",
    ]  # fmt: skip
    wanted = parameters_of([*(f"soft_robot.{n}" for n in names), "pressure_Pa", "cable_tension_N"], model)
    moved = [each.moves(model)(here, arm.clamp) for each in wanted]
    assert all(each.straight for each in moved)
    slopes = EquilibriumDerivatives(solver, arm.clamp, here)
    two_sided = slopes.by([each._replace(straight=False) for each in moved])
    for one, other in zip(slopes.by(moved), two_sided, strict=True):
        assert relative_error(other.motion, one.motion) < 1e-7


def test_products_move_as_one_and_units_are_said() -> None:
    names = tuple(f"soft_robot.cable.corner_{k}.stiffness_N_m" for k in (0, 1))
    found = cosim.sensitivity(pulled(), [names, "pressure_Pa"], ["tip_position_m.z", "volume_m3"])
    assert found.matrix[0, 0] == 0.0  # stiffness acts where a length is commanded
    assert found.unit("volume_m3.chamber", "pressure_Pa.chamber") == "m^3 per Pa"
    assert "pressure_Pa.chamber = 8000 Pa" in repr(found)


def test_a_kink_is_refused() -> None:
    simulation = pulled()
    arm, here = present(simulation)
    solver = arm.equilibrium_solver.solver
    sides = tuple(
        PerturbedModel(
            offset, 0.5 * offset, 1.0, solver.film, arm.clamp, replace(here.loads, pressure_Pa=(pressure,))
        )
        for offset, pressure in ((-1.0, 7990.0), (1.0, 8000.0))  # nothing happens above 8 kPa
    )
    with pytest.raises(cosim.SensitivityError, match=r"no derivative by pressure: the forces at node \d+ "):
        EquilibriumDerivatives(solver, arm.clamp, here).by([ParameterChange("pressure", sides)])


def test_a_cable_that_is_about_to_pull_is_refused() -> None:
    simulation = pulled()
    loads = present(simulation)[1].loads
    slack = solution(simulation, replace(loads, cable_tension_N=(0.0, 0.5)), simulation.scenario)
    length = slack.body.cables[0].length(slack.here.state.positions)
    # it gets taut over 20 um
    loads = replace(slack.here.loads, cable_length_m=(length + 1e-5, None))
    there = solution(simulation, loads, simulation.scenario)
    model = StaticModel.of(simulation.scenario, there.solver.film)
    slopes = Slopes(parameters_of(["soft_robot.film.thickness_m"], model), outputs_of(OUTPUTS, model), model)
    with pytest.raises(cosim.SensitivityError, match=r"no derivative by soft_robot.film.thickness_m"):
        slopes.at(there.solver, there.clamp, there.here)


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("soft_robot.film.thicknes_m", "soft_robot.film.thicknes_m: is not set"),
        ("soft_robot.stack.units", "no value near it is allowed"),
        ("gas_mass_kg", "ask for pressure_Pa"),
        ("cable_tension_N.corner_9", "no cable 'corner_9'"),
        ("clock.tick_s", "no parameter 'clock.tick_s'"),
    ],
)
def test_wrong_parameters_are_named(parameter: str, message: str) -> None:
    with pytest.raises(cosim.InputError, match=message):
        cosim.sensitivity(pulled(), [parameter], ["length_m"])


def test_an_entry_of_a_list_is_found_by_its_name() -> None:
    scenario = load_scenario("ur5e_hexagon_arm", {"phase.turn.duration_s": 7.0})
    assert value_at(scenario, "phase.turn.duration_s") == value_at(scenario, "phase.3.duration_s") == 7.0
