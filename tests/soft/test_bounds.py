"""Numbers that no soft body can have are refused by name where they come in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import InputError, MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from tests.soft.bodies import HANGING, hexagon_arm, no_load


@pytest.mark.parametrize("name", ["young_modulus_Pa", "thickness_m"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_a_film_has_a_modulus_and_a_thickness(name: str, value: float) -> None:
    given: dict[str, Any] = {"young_modulus_Pa": 1e9, "poisson_ratio": 0.3, "thickness_m": 1e-4, name: value}
    with pytest.raises(InputError, match=name):
        Film(**given)


@pytest.mark.parametrize("value", [-1.0, 1.0, np.nan])
def test_a_films_poisson_ratio_is_bounded(value: float) -> None:
    with pytest.raises(InputError, match="poisson_ratio"):
        Film(1e9, value, 1e-4)


@pytest.mark.parametrize("value", [-1e-9, np.inf, np.nan])
def test_node_masses_are_finite_and_not_negative(value: float) -> None:
    with pytest.raises(MeshError, match="node masses"):
        hexagon_arm(1, node_mass=value)


@pytest.mark.parametrize("value", [-1e-9, np.nan])
def test_a_cable_cannot_push(value: float) -> None:
    with pytest.raises(InputError, match="cannot push"):
        Loads(cable_tension_N=(1.0, value))


@pytest.mark.parametrize("value", [0.0, -1e-3, np.inf, np.nan])
def test_a_step_has_a_length(value: float) -> None:
    arm = FilmRobot(hexagon_arm(1), HANGING, NewtonOptions(), StepOptions())
    before = arm.state
    with pytest.raises(InputError, match="step"):
        arm.advance(HANGING, no_load(arm.body), value)
    assert arm.state is before


def test_a_body_from_arrays_refuses_what_it_does_not_know() -> None:
    unknown: dict[str, Any] = {"cap": ()}
    with pytest.raises(TypeError, match="'cap'"):
        SoftBody.from_arrays(np.eye(3), np.array([[0, 1, 2]]), Film(1e9, 0.3, 1e-4), **unknown)
