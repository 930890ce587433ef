"""A run warns if phases do not last whole ticks, and every remedy that it names ends the warning."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import cosim
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.config.several_arms import has_arms, load_arms
from cosim.plan.whole_ticks import are_whole, lengths_s, rounding_warnings

SCENARIOS = sorted(path for path in Path("scenarios").rglob("*.toml"))
SMALL: dict[str, Any] = {"mode": "dynamic", "phase.start.duration_s": 0.1, "phase.inflate.duration_s": 0.05}
"""Changes to three_unit_inflation."""


def remedies(text: str) -> list[dict[str, float]]:
    """Return the sets of values that a warning proposes."""
    return [
        {key: float(value) for key, value in re.findall(r"([a-z_A-Z.]+) = ([0-9.e-]+[0-9])", part)}
        for part in text.partition(" Set ")[2].split(", or ")
    ]


@pytest.mark.parametrize("tick_s", [0.008, 0.003, 0.0007])
@pytest.mark.parametrize("ramp", ["smooth", "linear"])
def test_every_remedy_ends_the_warning(tick_s: float, ramp: str) -> None:
    changes = SMALL | {"clock.tick_s": tick_s, "phase.inflate.ramp": ramp, "phase.inflate.settle_s": 0.024}
    (text,) = rounding_warnings(load_scenario("three_unit_inflation", changes))
    found = remedies(text)
    assert len(found) == 2, text
    for values in found:
        assert values
        assert not rounding_warnings(load_scenario("three_unit_inflation", changes | values)), values
    ticks = [load_scenario("three_unit_inflation", changes | values) for values in ({}, found[-1])]
    assert len({tuple(map(one.ticks, one.phases)) for one in ticks}) == 1, "the times that run anyway"


def test_the_shift_of_a_phase_adds_to_those_before_it() -> None:
    def told(**changes: Any) -> str:
        given = {"mode": "dynamic", "clock.tick_s": 0.008} | {
            f"phase.{key.replace('__', '.')}": value for key, value in changes.items()
        }
        return "".join(rounding_warnings(load_scenario("three_unit_inflation", given)))

    one = told(start__duration_s=0.5, inflate__duration_s=0.8, inflate__settle_s=0.0)
    assert "'start' 0.5 s becomes 0.496 s" in one
    assert "'inflate'" not in one
    assert "up to 4 ms" in one
    two = told(start__duration_s=0.501, inflate__duration_s=0.501, inflate__settle_s=0.0)
    assert "up to 6 ms" in two, "3 ms each"
    assert not told(start__duration_s=0.2, inflate__duration_s=0.8, inflate__settle_s=0.0)


def test_only_a_linear_ramp_must_last_whole_ticks() -> None:
    changes = SMALL | {"phase.inflate.duration_s": 0.003, "phase.inflate.settle_s": 0.003}
    smooth = changes | {"phase.inflate.ramp": "smooth"}
    assert not rounding_warnings(load_scenario("three_unit_inflation", smooth))
    (text,) = rounding_warnings(
        load_scenario("three_unit_inflation", changes | {"phase.inflate.ramp": "linear"})
    )
    assert "'inflate' (linear ramp) 0.003 s becomes 0.004 s" in text
    assert "up to 1 ms" in text


def test_no_tick_is_proposed_if_none_is_near() -> None:
    changes = SMALL | {"phase.inflate.duration_s": 0.10007, "clock.tick_s": 0.008}
    (text,) = rounding_warnings(load_scenario("three_unit_inflation", changes))
    assert "clock.tick_s =" not in text
    assert "phase.inflate.duration_s = 0.104" in text or "phase.inflate.duration_s = 0.096" in text


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_no_shipped_scenario_warns(path: Path) -> None:
    scenarios = load_arms(path).arms.values() if has_arms(path) else [load_scenario(path)]
    assert not [text for scenario in scenarios for text in rounding_warnings(scenario)]


def test_durations_of_statics_are_not_rounded() -> None:
    assert not lengths_s(load_scenario("three_unit_inflation", SMALL | {"mode": "quasistatic"}))
    assert are_whole((0.3, 0.1 + 0.2), 0.1), "but for rounding"
    assert not are_whole((0.3, 0.25), 0.1)


def test_run_and_check_warn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changes = SMALL | {"clock.tick_s": 0.008, "phase.inflate.settle_s": 0.0}
    result = cosim.run("three_unit_inflation", overrides=changes, error=False)
    (text,) = (line for line in result.summary["warnings"] if "rounded" in line)
    assert text.startswith(
        "planned: phases are rounded to whole ticks of 0.008 s: 'start' 0.1 s becomes 0.096 s"
    )
    assert result.time_s[-1] == pytest.approx(0.144)
    words = [part for key, value in changes.items() for part in ("--set", f"{key}={value}")]
    assert (
        main(
            ["run", "three_unit_inflation", *words, "--no-recording", "--no-error", "--out", f"{tmp_path}/r"]
        )
        == 0
    )
    assert "warning: planned: phases are rounded" in capsys.readouterr().err
    assert main(["check", f"{tmp_path}/r/scenario.toml"]) == 0
    assert "fine; warning: phases are rounded to whole ticks of 0.008 s" in capsys.readouterr().out
