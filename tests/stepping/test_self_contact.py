"""Scenarios whose soft robot touches itself: figures, switch, both modes, a state that is saved."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import pytest

import cosim
from cosim.build.options import fidelity_body
from cosim.config.loading import load_scenario
from tests.app.test_saved_runs import same, simulation, through_a_file
from tests.soft.interpenetration import deepest_m

SCENARIO = "gripper_closes_on_itself"
SHORT: dict[str, Any] = {"model.published": True, "phase.inflate.increments": 6, "phase.close.increments": 10}
QUICK: dict[str, Any] = {
    "mode": "dynamic",
    "clock.tick_s": 0.004,
    "solver.damping_per_s": 10.0,
    "phase.inflate.duration_s": 0.3,
    "phase.close.duration_s": 0.4,
    "phase.close.settle_s": 0.0,
}


def closed(**overrides: Any) -> tuple[cosim.RunResult, float]:
    """Return the run of three fingers that close on nothing, and how deep they are in one another [m]."""
    given = {**SHORT, **overrides}
    result = cosim.run(SCENARIO, overrides=given)
    assert result.summary["status"] == "completed"
    body = fidelity_body(load_scenario(SCENARIO, given))
    return result, deepest_m(body, result.node_position[-1])


FLAT = """
schema = 2
title = "a flat arm is held sideways"
robot = "none"
mode = "quasistatic"
soft_robot = "hexagon_arm_five"
fidelity = "lumped"

[start]
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [1.0, 0.0, 0.0]

[[phase]]
name = "inflate"
duration_s = 1.0
increments = 2
pressure_Pa = 100.0
"""


@pytest.mark.parametrize("asked", ["auto", True])
def test_units_of_a_flat_arm_hold_each_other_apart(asked: str | bool, tmp_path: Path) -> None:
    """They do not turn inside out, as when one saw another through those between them."""
    scenario = tmp_path / "flat.toml"
    scenario.write_text(FLAT, encoding="utf-8")
    result, through = (
        cosim.run(scenario, overrides={"contact.self_contact": each}, error=False) for each in (asked, False)
    )
    assert result.summary["max_self_contact_force_N"] > 0.1
    assert result.tip_position[-1, 0] > through.tip_position[-1, 0]  # 18 and 17 mm; -0.4 mm inside out


def test_fingers_meet_and_press_in_statics() -> None:
    result, depth = closed()
    summary = result.summary
    assert 0.0 < result.self_contact_force_N[0] < 5.0  # without gas fingers lie on their own films
    assert result.self_contact_force_N[-1] > 10.0
    assert summary["max_self_contact_force_N"] == result.self_contact_force_N.max()
    assert summary["max_self_contact_depth_m"] == result.self_contact_depth_m.max()
    assert summary["max_contact_force_N"] == 0.0  # that is of contact with the scene
    assert depth < 3e-4
    assert "between 24 units" in result.stage.report
    through, deep = closed(**{"contact.self_contact": False})
    assert deep > 2e-3
    assert through.summary["max_self_contact_force_N"] == 0.0
    assert summary["overlaps"] == []
    (found,) = through.summary["overlaps"]
    assert found["phase"] == "close"
    # by winding numbers, independent of the search: other points of the film, so only nearly as deep
    assert found["depth_m"] == pytest.approx(deep, rel=0.3)
    assert found["since_s"] <= found["time_s"] <= through.time_s[-1]
    assert "pass through one another" in str(through._repr_html_())
    assert "Self contact**: not modelled" in through.stage.report


def test_a_dynamic_run_with_rubbing_films_continues_bit_identically(tmp_path: Path) -> None:
    whole = simulation(SCENARIO, **QUICK)
    steps = whole.steps()
    for snapshot in steps:
        if snapshot.self_contact_force_N > 5.0:
            break
    state = through_a_file(whole.save_state(), tmp_path)
    expected = list(islice(steps, 8))
    assert expected[-1].self_contact_force_N > 5.0
    other = simulation(SCENARIO, **QUICK)
    other.restore_state(state)
    assert same(list(islice(other.steps(), 8)), expected)


def test_a_static_run_with_pressing_films_continues_bit_identically(tmp_path: Path) -> None:
    whole, other = simulation(SCENARIO, **SHORT), simulation(SCENARIO, **SHORT)
    steps = whole.steps()
    for snapshot in steps:
        if snapshot.self_contact_force_N > 5.0:
            break
    state = whole.save_state()
    expected = list(islice(steps, 3))
    assert expected[-1].self_contact_force_N > 5.0
    other.restore_state(through_a_file(state, tmp_path))
    assert same(list(islice(other.steps(), 3)), expected)
    whole.restore_state(state)
    assert same(list(islice(whole.steps(), 3)), expected)


def test_negative_friction_is_refused() -> None:
    with pytest.raises(cosim.ScenarioError, match=r"contact\.self_friction"):
        load_scenario(SCENARIO, {"contact.self_friction": -0.5})


BENT = """
schema = 2
title = "a soft arm is bent until it touches itself"
robot = "none"
mode = "quasistatic"
fidelity = "lumped"

[soft_robot]
file = "hexagon_arm_five"
cable = [{cables}]

[start]
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [0.0, 0.0, {up}]

[[phase]]
name = "inflate"
duration_s = 1.0
increments = 10
pressure_Pa = {pressure_Pa}

[[phase]]
name = "bend"
duration_s = 1.0
increments = 20
{load}
"""
CABLE = '{{ name = "{}", corner = {}, units = [{}, {}], capstan_factor = 1.0 }}'
PULLED = "cable_tension_N = [{}]"
PUSHED_OVER = """
[[phase.force]]
rings = ["unit_5.outer"]
total_N = [1.5, 0.0, -3.0]
"""
CURLED = {"cables": [(1, 1, 5)], "up": -1.0, "pressure_Pa": 20e3, "load": PULLED.format("12.0")}
S_SHAPED = CURLED | {"cables": [(1, 1, 3), (4, 3, 5)], "load": PULLED.format("12.0, 12.0")}
FOLDED = {"cables": [(1, 1, 5)], "up": 1.0, "pressure_Pa": 10e3, "load": PUSHED_OVER}


@pytest.mark.parametrize(
    "bent",
    [
        pytest.param(CURLED, id="curled"),
        pytest.param(S_SHAPED, id="s_shaped", marks=pytest.mark.long),
        pytest.param(FOLDED, id="folded", marks=pytest.mark.long),
    ],
)
def test_no_way_of_bending_lets_films_pass_through_one_another(bent: dict[str, Any], tmp_path: Path) -> None:
    cables = ", ".join(CABLE.format(f"c{k}", *each) for k, each in enumerate(bent["cables"]))
    scenario = tmp_path / "bent.toml"
    scenario.write_text(BENT.format(**{**bent, "cables": cables}), encoding="utf-8")
    body = fidelity_body(load_scenario(scenario))
    auto, throughout, through = (
        cosim.run(scenario, overrides={"contact.self_contact": each}, error=False)
        for each in ("auto", True, False)
    )
    deep, crossed = (deepest_m(body, run.node_position[-1]) for run in (auto, through))
    assert deep < 4e-4  # the law's own softness
    assert crossed > 2.5e-3
    assert abs(auto.tip_position[-1] - throughout.tip_position[-1]).max() < 1e-4
    assert auto.summary["self_contact_since_s"] is not None
    assert auto.summary["overlaps"] == []
    assert [each["phase"] for each in through.summary["overlaps"]][-1] == "bend"


FOREARM = """
schema = 2
title = "a soft arm is bent back onto the forearm that carries it"
robot = "ur5e"
soft_robot = "hexagon_arm"
mode = "quasistatic"

[start]
flange = { position_m = [0.3, 0.0, 0.6], direction = [-0.95, 0.0, 0.3], roll_rad = 1.5708 }

[[phase]]
name = "inflate"
duration_s = 1.0
increments = 10
pressure_Pa = 30e3

[[phase]]
name = "pull"
duration_s = 1.0
increments = 5
cable_tension_N = [0.0, 6.0]
"""


@pytest.mark.long
def test_a_run_names_the_link_of_the_arm_that_its_film_is_in(tmp_path: Path) -> None:
    scenario = tmp_path / "forearm.toml"
    scenario.write_text(FOREARM, encoding="utf-8")
    result = cosim.run(scenario, error=False)
    assert {found["link"] for found in result.summary["overlaps"]} == {"forearm_link"}
    found = result.summary["overlaps"][-1]
    assert found["phase"] == "pull"
    # a corner of a unit, no deeper than to the middle of the link
    assert 1e-3 < found["depth_m"] < 0.03
    assert found["since_s"] <= found["time_s"] <= 2.0
    assert found["place"].startswith("node ")
