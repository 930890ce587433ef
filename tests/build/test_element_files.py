"""A kind of elements that the package does not have reaches scenario files by one file and one line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.app.preparation import build_simulation
from cosim.base.kept_parts import KeptParts
from cosim.build.soft_body import build_soft_body
from cosim.build.soft_model import SoftModel
from cosim.config.json_schema import json_schema
from cosim.config.loading import load_scenario, scenario_text
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import ElementTable
from cosim.config.toml.tables import adapter_of
from cosim.errors import InputError, ScenarioError
from cosim.stepping.dynamic import DynamicSimulation
from tests.pages import page
from tests.soft import dashpot
from tests.soft.dashpot import Dashpots, DashpotTable

SCENARIO = """
schema = 2
title = "an arm with dashpots"
robot = "none"

[soft_robot]
file = "hexagon_arm"
{elements}
[start]
pressure_Pa = 20e3
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [0.0, 0.0, -1.0]

[[phase]]
name = "inflate"
duration_s = 0.04
settle_s = 0.0
pressure_Pa = 40e3
"""
DASHPOT = """
[[soft_robot.element]]
kind = "dashpot"
ends = [["unit_1.outer", 0], ["unit_2.outer", 0]]
damping_Ns_m = {damping}
"""


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(ElementTable, "kinds", {})
    cosim.register_kind(DashpotTable)
    yield
    adapter_of.cache_clear()


def scenario(folder: Path, *entries: str) -> Scenario:
    file = folder / "damped.toml"
    file.write_text(SCENARIO.format(elements="".join(entries)), encoding="utf-8")
    return load_scenario(file)


def simulation(described: Scenario) -> DynamicSimulation:
    made = build_simulation(described)
    assert isinstance(made, DynamicSimulation)
    return made


@pytest.mark.usefixtures("known")
def test_its_plan_is_not_kept_on_disk(tmp_path: Path) -> None:
    with_own = scenario(tmp_path, DASHPOT.format(damping=200.0))
    assert not SoftModel(with_own, KeptParts()).lasting  # its code may change without a change of its name
    assert SoftModel(load_scenario("three_unit_inflation"), KeptParts()).lasting


@pytest.mark.usefixtures("known")
def test_a_scenario_has_it(tmp_path: Path) -> None:
    damped = scenario(tmp_path, DASHPOT.format(damping=200.0), DASHPOT.format(damping=1.0))
    body = build_soft_body(damped.soft_robot, damped.model)
    first, second = body.of_kind(Dashpots)
    np.testing.assert_array_equal(
        first.nodes, [[body.rings["unit_1.outer"][0], body.rings["unit_2.outer"][0]]]
    )
    assert (first.damping_Ns_m[0], second.damping_Ns_m[0]) == (200.0, 1.0)
    again = tmp_path / "again.toml"
    again.write_text(scenario_text(damped), encoding="utf-8")
    assert load_scenario(again) == damped


@pytest.mark.usefixtures("known")
def test_a_run_feels_it_and_goes_on_from_a_saved_state_bit_for_bit(tmp_path: Path) -> None:
    plain = [snapshot.node_position for snapshot in simulation(scenario(tmp_path)).steps()]
    damped = scenario(tmp_path, DASHPOT.format(damping=200.0))
    run = simulation(damped)
    shapes = [snapshot.node_position for snapshot in run.steps(10)]
    saved = run.save_state()
    after = [snapshot.node_position for snapshot in run.steps()]
    body = build_soft_body(damped.soft_robot, damped.model)
    element = body.of_kind(Dashpots)[0]
    lengths = [[element.first_memory(x)[0] for x in entry] for entry in (plain, [*shapes, *after])]
    assert np.ptp(lengths[1]) < 0.5 * np.ptp(lengths[0])
    assert len(after) > 5
    run.restore_state(saved)
    repeated = [snapshot.node_position for snapshot in run.steps()]
    np.testing.assert_array_equal(repeated, after)


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (("200.0", "-1.0"), r"soft_robot\.element\.1\.damping_Ns_m: -1 is out of bounds"),
        (("damping_Ns_m", "damping"), r"soft_robot\.element\.1\.damping: .*damping_Ns_m"),
        (('"dashpot"', '"spring"'), r"soft_robot\.element\.1: kind is the text 'spring'; allowed: 'dashpot'"),
        (('kind = "dashpot"\n', ""), r"soft_robot\.element\.1: kind is missing; allowed: 'dashpot'"),
    ],
)
def test_wrong_values_are_told_with_their_place(tmp_path: Path, wrong: tuple[str, str], text: str) -> None:
    with pytest.raises(ScenarioError, match=text):
        scenario(tmp_path, DASHPOT.format(damping=200.0).replace(*wrong))


@pytest.mark.usefixtures("known")
def test_nodes_that_are_not_there_are_refused(tmp_path: Path) -> None:
    away = scenario(tmp_path, DASHPOT.format(damping=1.0).replace("unit_2.outer", "unit_99.outer"))
    with pytest.raises(InputError, match=r"ring 'unit_99\.outer' has no node 0"):
        build_soft_body(away.soft_robot, away.model)


def test_a_kind_that_is_not_registered_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="kind 'dashpot' is not known"):
        scenario(tmp_path, '[[soft_robot.element]]\nkind = "dashpot"\n')


@pytest.mark.usefixtures("known")
def test_editors_are_told_of_it() -> None:
    for kind in ("robot", "scenario"):
        table = json_schema(kind)["$defs"]["DashpotTable"]  # type: ignore[arg-type]
        assert table["properties"]["damping_Ns_m"]["x-unit"] == "N s/m"
        assert set(table["required"]) == {"ends", "damping_Ns_m"}


def test_the_page_on_extending_shows_the_file() -> None:
    file = Path(dashpot.__file__ or "").read_text(encoding="utf-8")
    shown = page("extending")
    assert f"```python\n{file}```" in shown
    assert DASHPOT.format(damping=200.0).strip() in shown
