"""Gas chambers in scenarios: values for all, by list or by name; orifices; rings of copies by pattern."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build.simulation import build
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario, to_table
from cosim.config.schema.settings import GasTable, ModelTable
from cosim.errors import ScenarioError
from cosim.results.result import RunResult

TRIPLE: dict[str, Any] = {"soft_robot.copies": {"count": 3, "radius_m": 0.08}, "solver.damping_per_s": 20.0}


def phase(name: str, **keys: Any) -> dict[str, Any]:
    return {"name": name, "duration_s": 0.5, "increments": 10, **keys}


def run(*phases: dict[str, Any], **overrides: Any) -> RunResult:
    return cosim.run("three_unit_inflation", overrides={**TRIPLE, "phase": list(phases), **overrides})


def test_each_copy_has_a_pressure_and_what_is_left_out_stays() -> None:
    result = run(
        phase("all", pressure_Pa=2e3),
        phase("some", pressure_Pa={"copy_2": 4e3}),
        phase("list", pressure_Pa=[1e3, 4e3, 6e3]),
    )
    ends = [np.flatnonzero(result.phase == k)[-1] for k in range(3)]
    expected = [[2e3, 2e3, 2e3], [2e3, 4e3, 2e3], [1e3, 4e3, 6e3]]
    np.testing.assert_allclose(result.chamber_pressure_Pa[ends], expected, rtol=1e-12)
    last = result.chamber_volume_m3[-1]
    assert last[0] < last[1] < last[2]
    figures = result.summary["phases"][-1]
    assert figures["chambers"]["copy_3"] == {"pressure_Pa": 6e3, "volume_m3": last[2]}
    assert figures["pressure_Pa"] == 1e3
    assert figures["volume_m3"] == pytest.approx(last.sum(), rel=1e-12)
    assert result.stage.chamber_names == ("copy_1", "copy_2", "copy_3")


@pytest.mark.parametrize("mode", ["quasistatic", "dynamic"])
def test_some_chambers_are_sealed_while_others_follow_the_plan(mode: str) -> None:
    push = [{"rings": ["copy_*/tip"], "total_N": [0.0, 0.0, -6.0]}]
    result = run(
        phase("inflate", pressure_Pa=5e3),
        phase("push", gas={"copy_1": "sealed"}, pressure_Pa={"copy_3": 6e3}, force=push),
        mode=mode,
    )
    sealed = np.flatnonzero(result.phase == 1)
    absolute = result.chamber_pressure_Pa[:, 0] + GasTable().ambient_Pa
    constant = (absolute * result.chamber_volume_m3[:, 0] ** GasTable().exponent)[sealed]
    assert constant == pytest.approx(constant[0], rel=1e-9)
    assert result.chamber_pressure_Pa[-1, 0] > 5.2e3
    np.testing.assert_allclose(result.chamber_pressure_Pa[-1, 1:], [5e3, 6e3], rtol=1e-12)


def test_gas_flows_through_an_orifice_until_pressures_agree() -> None:
    orifice = [{"chambers": ["copy_1", "copy_3"], "conductance_kg_s_Pa": 2e-9}]
    result = run(
        phase("inflate", pressure_Pa=[2e3, 5e3, 8e3]),
        phase("wait", gas="sealed", increments=80),
        **{"gas.orifice": orifice, "gas.exponent": 1.0, "gas.temperature_K": 300.0},
    )
    first, second, third = result.chamber_pressure_Pa[-1]
    assert 2.3e3 < first < third < 7.7e3
    assert second == pytest.approx(5e3, rel=1e-9)
    here = np.concatenate([np.flatnonzero(result.phase == 0)[-1:], np.flatnonzero(result.phase == 1)])
    mass = (result.chamber_pressure_Pa + GasTable().ambient_Pa) * result.chamber_volume_m3 / (287.05 * 300.0)
    # what one loses the other gains, by the difference of pressures over time
    assert mass[here, 0] + mass[here, 2] == pytest.approx(mass[here[0], 0] + mass[here[0], 2], rel=1e-9)
    difference = (result.chamber_pressure_Pa[:, 2] - result.chamber_pressure_Pa[:, 0])[here]
    moved = 2e-9 * 0.5 / 80 * (0.5 * (difference[1:] + difference[:-1])).sum()
    assert mass[here[-1], 0] - mass[here[0], 0] == pytest.approx(moved, rel=0.04)  # first order in the step
    assert "1 orifice" in result.stage.report


def test_a_chamber_table_is_written_back_as_it_was() -> None:
    given = {"phase": [phase("all", pressure_Pa={"copy_*": 2e3}, gas={"copy_1": "sealed"})]}
    with pytest.raises(ScenarioError, match="cannot be combined with a sealed gas"):
        load_scenario("three_unit_inflation", {**TRIPLE, **given})
    given = {"phase": [phase("all", pressure_Pa={"copy_*": 2e3})]}
    scenario = load_scenario("three_unit_inflation", {**TRIPLE, **given})
    assert to_table(scenario)["phase"][0]["pressure_Pa"] == {"copy_*": 2e3}


REFUSED: dict[str, tuple[dict[str, Any], str, str]] = {
    "unknown chamber": ({"pressure_Pa": {"copy_4": 1e3}}, "phase.all.pressure_Pa.copy_4", "no chamber"),
    "too many": ({"pressure_Pa": [1.0, 2.0]}, "phase.all.pressure_Pa", "3 chambers: copy_1"),
    "below vacuum": ({"pressure_Pa": {"copy_1": -2e5}}, "phase.all.pressure_Pa.copy_1", "at least"),
    "text": ({"pressure_Pa": [1.0, "2", 3.0]}, "phase.all.pressure_Pa.2", "expected a number"),
    "leak of an open one": (
        {"gas": {"copy_1": "sealed"}, "leak_kg_s_Pa": {"copy_2": 1e-9}}, "phase.all.leak_kg_s_Pa", "copy_2"
    ),
    "kind": ({"gas": {"copy_1": "open"}}, "phase.all.gas.copy_1", "'sealed'"),
    "ring pattern": ({"clamp": ["copy_*/unit_9.outer"]}, "phase.all.clamp", "copy_*/unit_9.outer"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_values_of_chambers_are_refused(case: str) -> None:
    changes, path, word = REFUSED[case]
    with pytest.raises(ScenarioError) as caught:
        load_scenario("three_unit_inflation", {**TRIPLE, "phase": [phase("all", **changes)]})
    assert caught.value.path == path
    assert word in str(caught.value)


@pytest.mark.parametrize(
    ("chambers", "word"), [(["copy_1", "copy_9"], "no chamber 'copy_9'"), (["copy_1", "copy_1"], "itself")]
)
def test_wrong_orifices_are_refused(chambers: list[str], word: str) -> None:
    orifice = [{"chambers": chambers, "conductance_kg_s_Pa": 1e-8}]
    with pytest.raises(ScenarioError, match=word):
        load_scenario("three_unit_inflation", {**TRIPLE, "gas.orifice": orifice})


def test_names_in_the_schema_are_those_of_the_body() -> None:
    robot = load_scenario("three_unit_inflation", TRIPLE).soft_robot
    body = build_soft_body(robot, ModelTable(published=True))
    assert tuple(part.name for part in body.chambers) == robot.chamber_names()
    assert set(body.rings) == set(robot.ring_names())


def test_a_pattern_clamps_the_rings_of_all_copies() -> None:
    given = [phase("hold", duration_s=0.01, clamp=["copy_*/unit_1.outer"])]
    scenario = load_scenario("three_unit_inflation", {**TRIPLE, "mode": "dynamic", "phase": given})
    simulation = build(scenario)
    list(simulation.steps())
    body = simulation._parts.soft.body
    outer = np.concatenate([body.rings[f"copy_{k}/unit_1.outer"] for k in (1, 2, 3)])
    assert set(outer) <= set(simulation._parts.soft.clamp.nodes)
    assert len(set(outer)) == 24
