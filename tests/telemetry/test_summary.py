"""The summary holds what docs/summary.md documents."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.column import ends_of, figures_of
from cosim.base.columns import TickColumns
from cosim.config.loading import load_scenario
from cosim.soft.solve.branching import StabilityReport
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.longer_tick import longer_tick_s
from cosim.telemetry.summary import SummaryBuilder
from cosim.telemetry.texts.closing_lines import closing_lines, error_line, tip_lines
from cosim.telemetry.texts.summary_markdown import summary_markdown
from tests.ticks import changed

DOCUMENT = Path(__file__).parents[2] / "docs" / "summary.md"
TICK = {"clock.tick_s": 4e-3}


@pytest.fixture
def summary(made_up_build: Callable[..., Any]) -> dict[str, Any]:
    simulation = made_up_build()(load_scenario("ur5e_hexagon_arm", TICK))
    builder = SummaryBuilder(simulation.stage, startup_s=1.5, version="0")
    for batch in simulation.batches():
        builder.observe(batch)
    return builder.finish("completed", None, wall_s=0.01)


def test_the_summary_adds_up(summary: dict[str, Any]) -> None:
    assert summary["ticks"] == 25
    assert summary["newton_iterations"] == 2 * 26
    assert sum(phase["newton_iterations"] for phase in summary["phases"]) == summary["newton_iterations"]
    assert summary["max_equilibrium_residual_N"] == pytest.approx(25e-9)
    assert summary["max_interface_power_error_W"] == pytest.approx(25e-6)
    assert summary["real_time_factor"] == pytest.approx(25 * 0.004 / 0.01)
    assert summary["command_s"] == pytest.approx(1.5 + 0.01)


def test_the_last_line_tells_what_the_user_has_waited_for(summary: dict[str, Any]) -> None:
    (line,) = (line for line in closing_lines(summary, Path("runs/a"), []) if line.startswith("time: "))
    assert line.endswith("completed, 0.10 s in 1.51 s (start 1.5 s, ticks 0.0 s; x0.07 real time)")
    first = summary | {"command_s": 40.0, "startup_s": 39.99, "compiling_s": 38.4}
    (line,) = (line for line in closing_lines(first, Path("runs/a"), []) if line.startswith("time: "))
    assert "(start 40.0 s, ticks 0.0 s, 38 s of it compiling, once per machine; x0.00 real time)" in line


def test_the_first_line_tells_where_the_tip_is_with_its_bar() -> None:
    last = {
        "name": "reach",
        "tip_position_m": [0.45, -1e-9, 0.55],
        "sag_m": 0.0755,
        "length_m": 0.1304,
        "cable_tension_N": [2.5, 0.0],
        "error": {"tip_m": 6.9e-3, "sag_m": 6.7e-3, "length_m": None, "cable_tension_N": 0.45},
    }
    assert tip_lines([{"tip_position_m": [None] * 3}, last]) == [
        "at 0.450, 0.000, 0.550 m +-6.9 mm, sag 75.5 +-6.7 mm, length 130.4 mm, cables up to 2.5 +-0.45 N, "
        "at the end of 'reach'"
    ]
    slack = {"sag_m": None, "length_m": None, "error": None, "cable_tension_N": [0.0, 0.0]}
    assert tip_lines([last | slack]) == ["at 0.450, 0.000, 0.550 m, cables slack, at the end of 'reach'"]
    assert tip_lines([last | {"tip_position_m": [None] * 3}]) == tip_lines([]) == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_power_that_vanishes_counts_like_power_that_appears(
    sign: float, made_up_build: Callable[..., Any]
) -> None:
    simulation = made_up_build()(load_scenario("ur5e_hexagon_arm", TICK))
    builder = SummaryBuilder(simulation.stage, 0.0, "0")
    for snapshot in simulation.steps():
        error_W = sign * 1e-6 * snapshot.tick
        entry = changed(snapshot, soft_power_W=-1.0 + error_W, power_size_W=2.0)
        assert entry.power_error_W == pytest.approx(error_W)
        builder.observe(entry.table)
    summary = builder.finish("completed", None, 0.01)
    assert summary["max_interface_power_error_W"] == pytest.approx(25e-6)
    assert summary["max_interface_power_error"] == pytest.approx(12.5e-6)


def test_a_phase_ends_with_its_last_tick(summary: dict[str, Any]) -> None:
    assert [phase["end_s"] for phase in summary["phases"]] == pytest.approx(
        [0.02, 0.04, 0.06, 0.08, 0.1], rel=1e-12
    )
    assert [phase["pressure_Pa"] for phase in summary["phases"]] == [500.0, 1000.0, 1500.0, 2000.0, 2500.0]
    assert all(phase["complete"] for phase in summary["phases"])


def test_targets_appear_only_where_there_is_one(summary: dict[str, Any]) -> None:
    assert [("tip_error_m" in phase) for phase in summary["phases"]] == [False] * 4 + [True]
    assert summary["phases"][-1]["tip_error_m"] == pytest.approx(0.025, rel=1e-12)


def test_numbers_that_are_not_finite_become_null(made_up_build: Callable[..., Any]) -> None:
    simulation = made_up_build()(load_scenario("ur5e_hexagon_arm", TICK))
    builder = SummaryBuilder(simulation.stage, 0.0, "0")
    first = next(simulation.steps())
    figures = replace(first.table.film.figures, center_line_m=np.array([np.nan]))
    builder.observe(replace(first.table, film=FilmShapes(None, first.table.film.node_position(), figures)))
    figures = builder.finish("failed", "InstabilityError: nan", 0.0)
    assert figures["phases"][0]["sag_m"] is None
    json.dumps(figures, allow_nan=False)
    assert "InstabilityError" in summary_markdown(figures)


def test_every_key_is_documented_and_every_documented_key_exists(summary: dict[str, Any]) -> None:
    documented = set(re.findall(r"^\| `(\w+)` \|", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE))
    reduced = [*figures_of(TickColumns), *ends_of(TickColumns)]  # in tables that are made of them
    documented |= {figure.name for _, figure in reduced}
    keys = set(summary) | {key for phase in summary["phases"] for key in phase}
    absent = {"devices", "tip_path", "tip_angle_error_rad"}  # a made-up run has none of these
    assert documented == keys | set(summary["phases"][0]["flange_wrench"]) | absent


def test_the_markdown_has_a_row_per_phase(summary: dict[str, Any]) -> None:
    text = summary_markdown(summary)
    for phase in summary["phases"]:
        assert f"| {phase['name']} |" in text


def test_the_markdown_has_a_row_for_each_bound_of_the_arm(summary: dict[str, Any]) -> None:
    torque = {
        "unit": "N m",
        "joint": "elbow",
        "value": -31.25,
        "bound": 150.0,
        "time_s": 1.5,
        "phase": "lift",
    }
    text = summary_markdown(summary | {"arm": {"planned": {}, "run": {"torque": torque}}})
    assert "| torque [N m] | run | elbow | -31.25 | 150 | 1.50 | lift |" in text


def test_a_run_warns_of_a_mode_that_ticks_do_not_let_swing(made_up_build: Callable[..., Any]) -> None:
    def warnings(frequency_Hz: float, numerical: float) -> list[str]:
        simulation = made_up_build()(load_scenario("ur5e_hexagon_arm", TICK))
        stage = replace(simulation.stage, decay=lambda _, own: (1.0 + own, numerical))
        builder = SummaryBuilder(stage, 0.0, "0")
        for snapshot in simulation.steps():
            stands = StabilityReport(frequency_Hz, 0.0, 1.0, frequencies_Hz=(frequency_Hz,))
            builder.observe(changed(snapshot, stability=stands).table)
        summary = builder.finish("completed", None, 0.01)
        mode = {"frequency_Hz": frequency_Hz, "declared_decay_per_s": 1.0, "numerical_decay_per_s": numerical}
        assert all(phase["modes"] == [mode] for phase in summary["phases"])
        assert f"{frequency_Hz:.3g} Hz" in summary_markdown(summary)
        return [text for text in summary["warnings"] if "swing" in text]

    assert not warnings(2.0, 4.5), "less than ln 10 in a period"
    (told,) = warnings(2.0, 4.7)
    assert "bdf2" in told
    assert "2 Hz" in told


def test_why_phases_have_no_bar_is_said_for_each_reason() -> None:
    none = dict.fromkeys(("tip_m", "sag_m", "length_m", "volume_m3", "cable_tension_N", "peak_strain"))
    touches = none | {"reason": "it touches something"}
    errors = [none | {"tip_m": 1e-3, "reason": None}, *[touches] * 4, none | {"reason": "it branches in it"}]
    phases = [{"name": name, "error": error} for name, error in zip("abcdef", errors, strict=True)]
    assert error_line({"phases": phases, "error": {"reason": None}}) == (
        "tip 1 mm ('a'); no bar in 'b', 'c', 'd' and 1 more: it touches something; "
        "no bar in 'f': it branches in it"
    )


def test_a_longer_tick_is_named_if_its_error_is_far_below_that_of_the_mesh() -> None:
    def named(
        of_tick_m: float,
        tick_s: float = 2e-3,
        end_s: float = 2.0,
        reason: str | None = None,
        ramp_s: float = 2.0,
    ) -> str:
        parts = {"of_mesh": {"tip_m": 4e-3}, "of_tick": {"tip_m": of_tick_m} if of_tick_m else {}}
        figures = dict.fromkeys(("tip_m", "sag_m", "length_m", "volume_m3", "cable_tension_N", "peak_strain"))
        phases = [
            {"name": "hang", "end_s": 1.0, "error": None},
            {"name": "lift", "end_s": end_s, "error": figures | parts | {"reason": reason}},
        ]
        longer_s = longer_tick_s(phases, tick_s, (2.0, ramp_s))
        return error_line({"phases": phases, "error": {"reason": None, "longer_tick_s": longer_s}})

    assert "tick_s = 0.01 " in named(8e-6), "25 times 8 um are a twentieth of 4 mm"
    assert "tick_s = 0.008 " in named(8.1e-6)
    assert "tick_s = 0.004 " in named(49e-6)
    assert "tick_s = 0.004 " in named(8e-6, end_s=2.012), "phases of 500 and 506 ticks"
    assert "tick_s = 0.004 " in named(8e-6, ramp_s=0.012), "a linear ramp of 6 ticks"
    assert "tick_s" not in named(8e-6, ramp_s=0.011), "of 5.5 ticks, which is rounded as it is"
    assert "tick_s" not in named(51e-6)
    assert "tick_s" not in named(1e-9, tick_s=6e-3), "bars of longer ticks were not compared with errors"
    assert "tick_s" not in named(8e-6, reason="it touches something")
    assert "tick_s" not in named(0.0), "statics have no ticks"
