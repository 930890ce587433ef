"""Searches on the film end at a bound that a key sets, say what they try meanwhile, and what was reached."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest

import cosim
from cosim.cli.main import main
from cosim.errors import ConvergenceError, ScenarioError

SCENARIO = """\
schema = 2
title = "Cables lift the tip of a small arm"
robot = "none"
soft_robot = "hexagon_arm_five"
mode = "quasistatic"
model.published = true
start.flange = { position_m = [0.0, 0.0, 0.5], direction = [0.5, 0.0, -1.0] }

[[phase]]
name = "inflate"
duration_s = 0.5
increments = 2
pressure_Pa = 20e3

[[phase]]
name = "lift"
duration_s = 0.5
increments = 2
tip_target = { height_m = 0.9, reach_with = "cables" }
"""
TARGET = "phase.lift.tip_target"
KEY = "solver.search_iterations_max"
BOUND = re.compile(r"the search for (.+?) reached its bound of (\d+) Newton iterations")
TRIED = re.compile(r"(.+?): looking for (.+): (\d+) s so far(?:, given up after about (\d+) s)?")


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "lifted.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "target",
    [{"height_m": 0.9, "reach_with": "cables"}, {"position_m": [0.3, 0.3, 0.9], "reach_with": "cables"}],
)
def test_a_target_out_of_reach_ends_at_the_bound_with_what_was_reached(
    scenario: Path, target: dict[str, object]
) -> None:
    with pytest.raises(ScenarioError) as refused:
        cosim.run(scenario, overrides={TARGET: target, KEY: 60})
    told = str(refused.value)
    assert refused.value.path == TARGET
    assert re.search(r"the nearest is \d+\.\d\d mm off at \[.*\] N", told)
    assert KEY in told
    (bound,) = set(BOUND.findall(told))
    assert bound == ("cable tensions for a tip target", "60")


def test_a_bound_that_is_raised_as_told_lets_the_search_arrive(scenario: Path) -> None:
    near = {f"{TARGET}.height_m": 0.42}
    with pytest.raises(ScenarioError, match=f"raise {KEY}"):
        cosim.run(scenario, overrides={**near, KEY: 25})
    found = cosim.run(scenario, overrides=near)
    assert found.tip_position[-1, 2] == pytest.approx(0.42, abs=1e-4)  # what a plan's motion is held to


@pytest.mark.parametrize(("at", "bound"), [("at the start: ", 5), ("phase 'inflate', increment 1 of 1", 25)])
def test_equilibria_of_a_run_end_at_the_bound(scenario: Path, at: str, bound: int) -> None:
    # without a target the plan needs no statics
    phase = {"name": "inflate", "duration_s": 0.5, "increments": 1, "pressure_Pa": 30e6}
    with pytest.raises(ConvergenceError) as stopped:
        cosim.run(scenario, overrides={"phase": [phase], KEY: bound})
    assert at in str(stopped.value)
    assert BOUND.search(str(stopped.value))


def test_a_search_that_lasts_says_what_it_tries(
    scenario: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    clock = time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: 1e4 * clock())  # milliseconds last as long as 10 s
    words = ["run", str(scenario), "--no-recording", "--set", f"{KEY}=200"]
    assert main([*words, "--out", str(tmp_path / "told")]) == 2
    told = [found.groups() for line in capsys.readouterr().err.splitlines() if (found := TRIED.match(line))]
    assert {"start", TARGET} <= {place for place, *_ in told}
    tried = [what for place, what, *_ in told if place == TARGET]
    assert any(
        re.match(r"cable tensions for a tip target, cable tensions \[.*\] N, ", what) for what in tried
    )
    spent_s = [
        (int(passed), int(longest)) for place, _, passed, longest in told if place == TARGET and longest
    ]
    assert all(passed <= 1.1 * longest for passed, longest in spent_s)
    assert min(longest for _, longest in spent_s) < 10 * max(passed for passed, _ in spent_s)
    assert main([*words, "--quiet", "--out", str(tmp_path / "quiet")]) == 2
    assert "so far" not in capsys.readouterr().err
