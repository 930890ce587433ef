"""Jacobians of equilibria against differences of whole solutions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.bench.outputs import Shape, outputs_of, read
from cosim.bench.parameters import LoadParameter, StaticModel, parameters_of, with_values
from cosim.build.soft_model import fidelity_body, static_options
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas
from cosim.soft.solve.implicit import Side
from cosim.soft.solve.state import Equilibrium
from cosim.stepping.parts import film_law
from cosim.stepping.quasistatic import QuasistaticSimulation
from tests.derivatives import differences, relative_error

PULLED: dict[str, Any] = {
    "model.published": False,
    "gravity_m_s2": [0.0, 0.0, 4.0],
    "solver.residual_tolerance_N": 1e-9,
    "soft_robot.cable.corner_0.capstan_factor": 0.9,
    "soft_robot.stack.mesh": "drawn",
    "soft_robot.stack.neck": {"fused_radius_m": 0.005},
    "phase": [
        {"name": "inflate", "duration_s": 1.0, "increments": 2, "pressure_Pa": 8e3},
        {"name": "pull", "duration_s": 1.0, "increments": 2, "cable_tension_N": [1.0, 0.5]},
    ],
}
OUTPUTS = ["tip_position_m", "tip_direction", "length_m", "cable_length_m", "flange_torque_Nm"]
KEYS = (
    "soft_robot.film.young_modulus_Pa", "soft_robot.film.thickness_m", "soft_robot.film.poisson_ratio",
    "soft_robot.hinge.stiffness_factor", "soft_robot.stiffener.height_m", "soft_robot.mass.node_mass_kg",
    "soft_robot.cable.corner_0.capstan_factor",
)  # fmt: skip
REDRAWN = (
    "soft_robot.stack.corner_radius_m", "soft_robot.stack.hole_radius_m", "soft_robot.stack.unit_height_m",
)  # fmt: skip


@cache
def pulled() -> cosim.Simulation:
    simulation = cosim.Simulation("bending_angle", overrides=PULLED)
    simulation.step(ticks=simulation.ticks_left)
    return simulation


def present(simulation: cosim.Simulation) -> tuple[SoftArm, Equilibrium]:
    run = simulation.run
    assert isinstance(run, QuasistaticSimulation)
    assert isinstance(run.soft, SoftArm)
    return run.soft, run.equilibrium


def solved(simulation: cosim.Simulation, name: str, loads: Loads) -> Callable[[float], Array]:
    """Return what solves the equilibrium near the present one at another value, and reads the outputs."""
    _, here = present(simulation)
    options = replace(
        static_options(simulation.scenario), tolerance_N=1e-9, start_tolerance_N=1e-9, reuse_max=0
    )

    def at(value: float) -> Array:
        scenario, given = simulation.scenario, loads
        if name.startswith("soft_robot."):
            scenario = with_values(scenario, {name: value})
        body, law = fidelity_body(scenario), film_law(scenario)
        arm = SoftArm(body, here.world_from_flange, options, present(simulation)[0].dynamics, law)
        solver = arm.equilibrium_solver.solver
        model = StaticModel.of(scenario, solver.system)
        for each in parameters_of([name], model):
            if isinstance(each, LoadParameter):
                given = each.changed(given, value, model)
        found = arm.equilibrium_solver.solve(here.state, here.world_from_flange, given)
        side = Side(0.0, 0.0, 0.0, solver.system, arm.clamp, found.loads)
        shape = Shape(side, found.state.positions, solver.system.gradient, here.world_from_flange)
        return read(outputs_of(OUTPUTS, model), shape)

    return at


def error_of(simulation: cosim.Simulation, name: str, step: float = 3e-4) -> float:
    """Return the relative error of a column; of the tip, the film and the wrench each by itself, the largest."""
    jacobian = cosim.sensitivity(simulation, [name], OUTPUTS)
    value, column = float(jacobian.parameter_values[0]), jacobian.matrix[:, 0]
    at = solved(simulation, name, present(simulation)[1].loads)
    difference = differences(lambda x: at(float(x[0])), np.array([value]), step * value)[0]
    parts = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
    return max(relative_error(difference[part], column[part]) for part in parts)


@pytest.mark.parametrize("name", KEYS)
def test_values_of_the_robot(name: str) -> None:
    assert error_of(pulled(), name) < 1e-6


@pytest.mark.parametrize("name", REDRAWN)
def test_geometry(name: str) -> None:
    assert error_of(pulled(), name) < 1e-5


@pytest.mark.parametrize("name", ["pressure_Pa.chamber", "cable_tension_N.corner_1"])
def test_loads(name: str) -> None:
    assert error_of(pulled(), name) < 1e-6
