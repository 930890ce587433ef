"""Ticks of a lumped film: a restored run continues as before, and films touch from where they press."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.app.preparation import build_simulation
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from tests.stepping.snapshots import assert_close

TICKS = 120
SCENARIO = """
schema = 2
title = "Two units with printed frames on a UR5e, above a block"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2, mesh = "drawn" }, cable = [
  { name = "right", corner = 0, units = [1, 2], capstan_factor = 0.8 }] }
fidelity = "lumped"
clock = { tick_s = 0.002 }
solver = { damping_per_s = 5.0 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 2e3

[[object]]
name = "block"
shape = "box"
size_m = [0.3, 0.3, 0.1]
position_m = [0.4, 0.0, 0.4175]

[[phase]]
name = "turn"
duration_s = 0.1
settle_s = 0.02
pressure_Pa = 2.5e3
cable_tension_N = [0.5]
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.02 }

[[phase]]
name = "lower"
duration_s = 0.1
settle_s = 0.02
flange_shift_m = [0.0, 0.0, -0.02]
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("ticks") / "two_units.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    return file


def scenario(path: Path, **changes: Any) -> Scenario:
    overrides = {name.replace("__", "."): value for name, value in changes.items()}
    return load_scenario(path, overrides)


LOSSY: dict[str, Any] = {"soft_robot__film__loss_factor": 0.05, "solver__integrator": "bdf2"}


@pytest.mark.parametrize(("most", "changes"), [(38, {}), (70, {}), (83, {}), (70, LOSSY)])
def test_a_restored_run_continues_as_the_original(path: Path, most: int, changes: dict[str, Any]) -> None:
    run: Any = build_simulation(scenario(path, **changes))
    list(run.batches(most=most))
    saved = run.save_state()
    first = [snapshot for batch in run.batches(7) for snapshot in batch]
    again: Any = build_simulation(scenario(path, **changes))
    again.restore_state(saved)
    assert_close([snapshot for batch in again.batches(64) for snapshot in batch], first, 0.0)


CURL: dict[str, Any] = {
    "contact__self_contact": True,
    "soft_robot__stack__units": 3,
    "soft_robot__stiffener__width_m": 3e-3,  # films of softer frames are lost and found in most ticks
    "soft_robot__stiffener__height_m": 3e-3,
    "soft_robot__stiffener__young_modulus_Pa": 2e9,
    "soft_robot__cable": [{"name": "right", "corner": 0, "units": [1, 3], "capstan_factor": 1.0}],
    "phase__turn__cable_tension_N": [20.0],
    "phase__turn__pressure_Pa": 3e3,
    "phase__lower__flange_shift_m": [0.0, 0.0, 0.0],
}


def test_contact_is_modelled_from_where_films_come_to_press(path: Path) -> None:
    """Until then a run is that without contact, to the last bit; then that with contact throughout."""
    auto, never, always = (
        list(build_simulation(scenario(path, **{**CURL, "contact__self_contact": asked})).steps())
        for asked in ("auto", False, True)
    )
    first = next(k for k, snapshot in enumerate(auto) if snapshot.self_contacts)
    assert first > 10
    assert_close(auto[:first], never[:first], 0.0)
    assert not np.array_equal(auto[first].node_position, never[first].node_position)
    for one, other in zip(auto, always, strict=True):
        np.testing.assert_allclose(one.tip_position, other.tip_position, rtol=0.0, atol=1e-4)
    assert np.abs(auto[-1].tip_position - never[-1].tip_position).max() > 1e-4


def test_ticks_that_are_solved_closely_take_few_iterations(path: Path) -> None:
    """Rings of beams that end their search as in ordinary ticks leave 2e-6 N, which no iteration removes."""
    changes = {"solver__dynamic_tolerance_N": 1e-7, "solver__dynamic_newton_iterations": 50}
    iterations = [s.newton_iterations for s in build_simulation(scenario(path, **changes)).steps()]
    assert max(iterations) < 20  # 50 and more where they are at the bound
    assert float(np.mean(iterations)) < 6.0
