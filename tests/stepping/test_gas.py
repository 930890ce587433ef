"""Gas in scenarios: sealed from a phase's start on, leaking, opened again; what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.config.schema.settings import GasTable
from cosim.errors import ScenarioError
from cosim.results.result import RunResult

AMBIENT_Pa = GasTable().ambient_Pa
INFLATE: dict[str, Any] = {"name": "inflate", "duration_s": 0.5, "increments": 20, "pressure_Pa": 5e3}
PUSH = [{"rings": ["tip"], "total_N": [0.0, 0.0, -2.0]}]  # the specimen stands on its base


def run(*phases: dict[str, Any], **overrides: Any) -> RunResult:
    changes = {"phase": [INFLATE, *phases], "solver.damping_per_s": 20.0, **overrides}
    return cosim.run("three_unit_inflation", overrides=changes)


def phase(name: str, **keys: Any) -> dict[str, Any]:
    return {"name": name, "duration_s": 0.5, "increments": 10, **keys}


def rows(result: RunResult, name: str) -> Array:
    return np.flatnonzero(result.phase == result.stage.phase_names.index(name))


def leaning(result: RunResult) -> tuple[float, float]:
    """Return how far the tip is off the axis and how high it is [m], at the end."""
    x, y, z = result.tip_position[-1]
    return float(np.hypot(x, y)), float(z)


@pytest.mark.parametrize("mode", ["quasistatic", "dynamic"])
@pytest.mark.parametrize("exponent", [1.0, 1.4])
def test_a_sealed_chamber_keeps_its_gas(mode: str, exponent: float) -> None:
    result = run(
        phase("push", gas="sealed", force=PUSH), phase("wait"), mode=mode, **{"gas.exponent": exponent}
    )
    sealed = np.concatenate([rows(result, "inflate")[-1:], rows(result, "push"), rows(result, "wait")])
    constant = (result.pressure_Pa[sealed] + AMBIENT_Pa) * result.volume_m3[sealed] ** exponent
    assert constant == pytest.approx(constant[0], rel=1e-9)
    assert result.volume_m3[-1] < 0.995 * result.volume_m3[sealed[0]]
    assert result.pressure_Pa[-1] > 6e3
    assert result.summary["phases"][-1]["pressure_Pa"] == result.pressure_Pa[-1]
    assert result.summary["phases"][-1]["volume_m3"] == result.volume_m3[-1]
    assert "sealed in push, wait" in result.stage.report


def test_sealing_alone_changes_nothing() -> None:
    result = run(phase("wait", gas="sealed"))
    last = rows(result, "inflate")[-1]
    assert result.pressure_Pa[last:] == pytest.approx(5e3, rel=1e-9)
    assert result.tip_position[-1] == pytest.approx(result.tip_position[last], abs=1e-9)


def test_sealed_and_prescribed_pressure_agree_at_the_pressure_reached() -> None:
    closely: dict[str, Any] = {"solver.residual_tolerance_N": 1e-9}  # leaning is soft
    sealed = run(phase("push", gas="sealed", force=PUSH), **closely)
    pressure_Pa = float(sealed.pressure_Pa[-1])
    given = run(phase("push", pressure_Pa=pressure_Pa, force=PUSH), **closely)
    assert given.volume_m3[-1] == pytest.approx(sealed.volume_m3[-1], rel=1e-8)
    # the pushed stack leans over; to which of its equivalent sides, rounding decides
    assert leaning(given) == pytest.approx(leaning(sealed), abs=1e-8)


@pytest.mark.parametrize("mode", ["quasistatic", "dynamic"])
def test_a_leak_takes_the_mass_that_its_law_says(mode: str) -> None:
    leak_kg_s_Pa, increments = 2e-9, 200
    settings = {"mode": mode, "gas.exponent": 1.0, "gas.temperature_K": 300.0}
    wait = phase("wait", gas="sealed", leak_kg_s_Pa=leak_kg_s_Pa, increments=increments)
    result = run(wait, phase("more", increments=increments), **settings)
    here = np.concatenate([rows(result, "inflate")[-1:], rows(result, "wait"), rows(result, "more")])
    pressure, volume = result.pressure_Pa[here], result.volume_m3[here]
    # isothermal, so m = p V / (R T) at any time
    mass = (pressure + AMBIENT_Pa) * volume / (287.05 * 300.0)
    step = result.time_s[here[1]] - result.time_s[here[0]]
    lost = leak_kg_s_Pa * step * np.concatenate([[0.0], np.cumsum(0.5 * (pressure[1:] + pressure[:-1]))])
    assert lost[-1] > 0.03 * mass[0]
    # leak and balance take turns: first order in the step
    assert mass[0] - mass == pytest.approx(lost, abs=0.01 * lost[-1])


def test_an_opened_chamber_goes_from_the_pressure_it_has() -> None:
    result = run(
        phase("push", gas="sealed", force=PUSH),
        phase("open", gas="prescribed", pressure_Pa=5e3, increments=10),
        phase("seal", gas="sealed"),
    )
    reached = float(result.pressure_Pa[rows(result, "push")[-1]])
    assert reached > 6e3
    opened = result.pressure_Pa[rows(result, "open")]
    assert opened == pytest.approx(np.linspace(reached, 5e3, 11)[1:], rel=1e-12)
    assert result.pressure_Pa[-1] == pytest.approx(5e3, rel=1e-9)


TARGET = {"height_m": 0.066, "reach_with": "cables"}


def test_targets_are_planned_with_the_gas_that_is_sealed() -> None:
    # hexagonal arm upright; the cables pull the tip down against a gas that resists
    plan = [
        {"name": "inflate", "duration_s": 1.0, "increments": 40, "pressure_Pa": 20e3},
        phase("reach", gas="sealed", increments=40, tip_target=TARGET),
        phase("vent", gas="prescribed", pressure_Pa=18e3, cable_tension_N=[0.0, 0.0, 0.0]),
        phase("again", gas="sealed", leak_kg_s_Pa=1e-9),
        phase("back", leak_kg_s_Pa=0.0, increments=40, tip_target={**TARGET, "height_m": 0.06}),
    ]
    result = cosim.run("hexagon_arm_bending", overrides={"phase": plan})
    errors = {entry["name"]: entry.get("tip_error_m") for entry in result.summary["phases"]}
    assert errors["reach"] < 2e-5  # the search's own bound is 1e-5
    assert errors["back"] < 2e-4  # the plan follows the leak in coarser pieces than the run
    pressure = {entry["name"]: entry["pressure_Pa"] for entry in result.summary["phases"]}
    assert pressure["reach"] > 20.5e3
    assert pressure["again"] < 17.5e3


FEWER = {
    f"phase.{name}.increments": count
    for name, count in {"inflate": 12, "turn": 12, "pull": 24, "leak": 12}.items()
}


@pytest.mark.long
def test_the_sealed_arm_answers_its_question() -> None:
    result = cosim.run("sealed_arm", overrides=FEWER, error=False)
    rise = {entry["name"]: entry["pressure_Pa"] - 30e3 for entry in result.summary["phases"]}
    assert 200.0 < rise["turn"] < 600.0
    assert 4e3 < rise["pull"] < 7e3
    assert rise["leak"] < -1e4


REFUSED: dict[str, tuple[dict[str, Any], str, str]] = {
    "ramp of a sealed gas": ({"push": {"gas": "sealed", "pressure_Pa": 1e3}}, "push.pressure_Pa", "volume"),
    "ramp while sealed": (
        {"push": {"gas": "sealed"}, "wait": {"pressure_Pa": 1e3}}, "wait.pressure_Pa", "'prescribed'"
    ),
    "leak of a given pressure": ({"push": {"leak_kg_s_Pa": 1e-9}}, "push.leak_kg_s_Pa", "needs gas"),
    "leak of an opened chamber": (
        {"push": {"gas": "sealed"}, "wait": {"gas": "prescribed", "leak_kg_s_Pa": 0.0, "pressure_Pa": 0.0}},
        "wait.leak_kg_s_Pa", "needs gas",
    ),
    "opened to nothing": (
        {"push": {"gas": "sealed"}, "wait": {"gas": "prescribed"}}, "wait.pressure_Pa", "is missing"
    ),
    "target while leaking": (
        {"push": {"gas": "sealed", "leak_kg_s_Pa": 1e-9}, "wait": {"tip_target": TARGET}},
        "wait.tip_target", "leak",
    ),
    "unknown kind": ({"push": {"gas": "closed"}}, "push.gas", "'sealed'"),
    "negative leak": ({"push": {"gas": "sealed", "leak_kg_s_Pa": -1.0}}, "push.leak_kg_s_Pa", "at least 0"),
    "other unit": ({"push": {"leak_g_s": 1.0}}, "push.leak_g_s", "did you mean leak_kg_s_Pa"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_gases_are_refused_by_the_key(case: str) -> None:
    changes, path, word = REFUSED[case]
    plan = [INFLATE, *(phase(name, **changes.get(name, {})) for name in ("push", "wait"))]
    with pytest.raises(ScenarioError) as caught:
        load_scenario("hexagon_arm_bending", {"phase": plan})
    assert caught.value.path == f"phase.{path}"
    assert word in str(caught.value)


@pytest.mark.parametrize(
    ("setting", "value", "path", "word"),
    [
        ("model.closed", False, "phase.push.gas", "model.closed = true"),
        ("gas.ambient_Pa", 0.0, "phase.push.gas", "absolute pressure"),
        ("gas.exponent", 0.9, "gas.exponent", "at least 1"),
        ("gas.temperature_C", 20.0, "gas.temperature_C", "temperature_K"),
    ],
)
def test_wrong_settings_of_the_gas_are_refused(setting: str, value: Any, path: str, word: str) -> None:
    plan = [{**INFLATE, "pressure_Pa": 0.0}, phase("push", gas="sealed")]
    with pytest.raises(ScenarioError) as caught:
        load_scenario("three_unit_inflation", {"phase": plan, setting: value})
    assert caught.value.path == path
    assert word in str(caught.value)


def test_a_run_at_a_prescribed_pressure_reports_it() -> None:
    assert "**Gas**: at a given pressure" in build(load_scenario("three_unit_inflation")).stage.report
