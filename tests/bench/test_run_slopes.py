"""Derivatives of 200 dynamic ticks against differences of whole runs."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from tests.derivatives import differences, relative_error

SWING: dict[str, Any] = {
    "name": "swing",
    "duration_s": 0.1,
    "pressure_Pa": 9e3,
    "cable_tension_N": [0.4, 0.8],
}
BEGIN: dict[str, Any] = {
    "mode": "dynamic",
    "robot": "none",
    "model.published": False,
    "contact.enabled": False,
    "contact.self_contact": False,
    "soft_robot.stiffener.rest_on_one_another": False,
    "gravity_m_s2": [0.0, 0.0, 4.0],
    "clock.tick_s": 0.002,
    "solver.residual_tolerance_N": 2e-10,  # rounding; 1e-9 at rest moves differences by 1e-5 of them
    "solver.dynamic_tolerance_N": 1e-12,
    "solver.damping_per_s": 3.0,
    "solver.air_drag_per_s": 1.0,
    "soft_robot.cable.corner_0.capstan_factor": 0.9,
    "soft_robot.film.law": "edge_strain",
    "soft_robot.film.loss_factor": 0.05,
    "soft_robot.mass.node_mass_kg": 1e-3,
    "soft_robot.stack.mesh": "drawn",
    "soft_robot.stack.neck": {"fused_radius_m": 0.005},
    "start.pressure_Pa": 8e3,
    "start.cable_tension_N": [1.0, 0.5],
    "phase": [SWING],
}
DIRECTED = {"soft_robot.cable.corner_0.losses": "directed"}
ASKED = {  # a step within which the motion is smooth, and moves by far more than its rounding
    "soft_robot.film.thickness_m": 3e-4,
    "soft_robot.stack.hole_radius_m": 3e-4,
    "soft_robot.stiffener.height_m": 3e-4,
    "soft_robot.mass.node_mass_kg": 3e-4,
    "soft_robot.cable.corner_0.capstan_factor": 3e-5,
    "pressure_Pa.chamber": 1e-4,
    "cable_tension_N.corner_0": 3e-5,
    "solver.damping_per_s": 2e-2,
    "solver.air_drag_per_s": 2e-2,
    "soft_robot.film.loss_factor": 5e-2,
}
FIRST = ("soft_robot.film.thickness_m", "pressure_Pa.chamber", "soft_robot.cable.corner_0.capstan_factor")
"""A value of the drawn film, of the load, of a law: the others every week."""


@cache
def jacobian() -> cosim.Jacobian:
    return cosim.sensitivity("bending_angle", list(ASKED), ["tip_position_m"], overrides=BEGIN)


def tip(name: str, value: float, shift: float) -> Array:
    """Return the tip at the end of a run; a load is shifted at rest and throughout."""
    changes: dict[str, Any] = {name: value}
    if name == "pressure_Pa.chamber":
        changes = {"start.pressure_Pa": value, "phase": [SWING | {"pressure_Pa": 9e3 + shift}]}
    if name == "cable_tension_N.corner_0":
        swing = SWING | {"cable_tension_N": [0.4 + shift, 0.8]}
        changes = {"start.cable_tension_N": [value, 0.5], "phase": [swing]}
    simulation = cosim.Simulation("bending_angle", overrides=BEGIN | changes)
    return simulation.step(ticks=simulation.ticks_left).tip_position


@pytest.mark.parametrize(
    "name", [name if name in FIRST else pytest.param(name, marks=pytest.mark.long) for name in ASKED]
)
def test_a_column_against_whole_runs(name: str) -> None:
    column = list(ASKED).index(name)
    value = float(jacobian().parameter_values[column])
    found = differences(lambda x: tip(name, x[0], x[0] - value), np.array([value]), ASKED[name] * value)[0]
    assert relative_error(found, jacobian().matrix[:, column]) < 1e-6


def test_shipped_tolerances_leave_the_derivatives_of_tight_ones() -> None:
    smooth: dict[str, Any] = {**BEGIN, "soft_robot.cable.corner_0.capstan_factor": 1.0}
    shipped = {key: value for key, value in smooth.items() if not key.endswith("tolerance_N")}
    names = [name for name in ASKED if "capstan" not in name]
    tight, loose = (
        cosim.sensitivity("bending_angle", names, ["tip_position_m"], overrides=each).matrix
        for each in (smooth, shipped)
    )
    for exact, found in zip(tight.T, loose.T, strict=True):
        assert relative_error(exact, found) < 1e-4


@pytest.mark.parametrize(
    ("changes", "output", "message"),
    [
        ({}, "flange_force_N", "flange_force_N.x: has no derivative in time"),
        (DIRECTED, "length_m", "set friction_coefficient = 0"),
    ],
)
def test_what_has_no_derivative_in_time_is_refused(
    changes: dict[str, Any], output: str, message: str
) -> None:
    with pytest.raises(cosim.InputError, match=message):
        cosim.sensitivity("bending_angle", ["pressure_Pa"], [output], overrides=BEGIN | changes)
    statics = {**BEGIN, "mode": "quasistatic", "phase": [SWING | {"increments": 2}]}
    with pytest.raises(cosim.InputError, match=r"solver.damping_per_s: has an effect only in time"):
        cosim.sensitivity("bending_angle", ["solver.damping_per_s"], ["length_m"], overrides=statics)
