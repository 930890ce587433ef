"""`fidelity = "auto"`: what is chosen meets its requirement by construction; figures are measured once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.state_archive import unpacking
from cosim.build.simulation import build
from cosim.config.loading import load_scenario, scenario_text
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError
from cosim.trade import report
from cosim.trade.candidates import Candidate, short_candidates
from cosim.trade.measuring import Measured, compared, trace
from tests.trade.test_trade import small

WORDS = {"fidelity": "auto", "auto.tolerance_m": 1e-3}


def made_up_measure(calls: list[int]) -> Callable[..., list[Measured]]:
    """Return a measurement in which a coarser tick is faster and worse: error [m] = tick / 10."""

    def measure(
        _scenario: Scenario, candidates: tuple[Candidate, ...], *_others: Any, **_more: Any
    ) -> list[Measured]:
        calls.append(len(candidates))
        results = []
        for candidate in candidates:
            tick = candidate.changes["clock.tick_s"]
            if candidate.changes["fidelity"] == "rigid":
                results.append(Measured(candidate, failure="InputError: no rigid one here"))
                continue
            error = 0.0 if candidate.reference else 0.1 * tick
            results.append(
                Measured(
                    candidate, 1e3 * tick, error, error, error, 10.0 * error, 0.0, 1.0,
                    reference=candidate.reference,
                )
            )  # fmt: skip
        return results

    return measure


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    made: list[int] = []
    monkeypatch.setattr(report, "measure", made_up_measure(made))
    return made


@pytest.mark.parametrize(
    ("requirement", "tick_s"),
    [
        ({"auto.tolerance_m": 1.1e-3}, 0.01),
        ({"auto.tolerance_m": 1.0}, 0.02),
        ({"auto.budget": 4.0}, 0.005),
        ({"auto.budget": 1.0}, 0.002),
        ({"auto.tolerance_m": 1.0, "auto.force_tolerance_N": 6e-3}, 0.005),
        ({"auto.budget": 6.0, "auto.tolerance_m": 1.5e-3}, 0.01),
    ],
)
def test_the_choice_meets_the_requirement(
    requirement: dict[str, float], tick_s: float, calls: list[int], tmp_path: Path
) -> None:
    told: list[str] = []
    chosen = report.chosen_fidelity(small(fidelity="auto", **requirement), build, tmp_path, told.append)
    assert chosen.clock.tick_s == tick_s
    assert chosen.fidelity != "auto"
    assert chosen.auto is not None
    assert chosen.auto.chosen is not None
    assert chosen.auto.chosen in told[-1]
    # the scenario as it ran says what was chosen, and runs again without a measurement
    again = tmp_path / "again.toml"
    again.write_text(scenario_text(chosen), encoding="utf-8")
    assert load_scenario(again) == chosen


def test_figures_are_measured_once_and_serve_every_requirement(calls: list[int], tmp_path: Path) -> None:
    told: list[str] = []
    report.chosen_fidelity(small(**WORDS), build, tmp_path, told.append)
    report.chosen_fidelity(small(fidelity="auto", **{"auto.budget": 1.0}), build, tmp_path, told.append)
    report.chosen_fidelity(small(**WORDS, title="another name for it"), build, tmp_path, told.append)
    assert calls == [len(short_candidates(small()))]
    assert "measured before" in told[-1]
    report.chosen_fidelity(small(**WORDS, **{"solver.damping_per_s": 3.0}), build, tmp_path, told.append)
    assert len(calls) == 2  # another motion, other figures
    for path in tmp_path.glob("trade_*.kept"):
        path.write_text("{", encoding="utf-8")
    with pytest.warns(RuntimeWarning, match="is damaged"):
        report.chosen_fidelity(small(**WORDS), build, tmp_path, told.append)
    assert len(calls) == 3


def test_figures_that_other_code_has_measured_are_not_used(
    calls: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report.chosen_fidelity(small(**WORDS), build, tmp_path, lambda _text: None)
    here = report.code_identity()
    monkeypatch.setattr(report, "code_identity", lambda: {**here, "source": "edited"})  # of the same version
    report.chosen_fidelity(small(**WORDS), build, tmp_path, lambda _text: None)
    assert len(calls) == 2


def test_a_requirement_that_nothing_meets_is_refused_with_the_nearest(
    calls: list[int], tmp_path: Path
) -> None:
    with pytest.raises(
        ScenarioError, match=r"auto: no candidate meets tolerance tip error 1e-06 mm.*BDF2, 2 ms"
    ):
        report.chosen_fidelity(
            small(fidelity="auto", **{"auto.tolerance_m": 1e-9}), build, tmp_path, lambda _t: None
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fidelity": "auto"}, "auto: is missing a requirement"),
        ({"auto.budget": 1.0}, "auto: goes with fidelity = 'auto'; the fidelity is 'lumped'"),
        ({"fidelity": "auto", "auto.budget": 0.0}, "auto.budget: "),
        ({**WORDS, "mode": "quasistatic"}, "fidelity: 'auto' chooses among dynamic runs"),
    ],
)
def test_wrong_requirements_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        small(**changes)


def test_a_scenario_without_the_requirement_stays_as_it_is(tmp_path: Path) -> None:
    scenario = small()
    assert report.chosen_fidelity(scenario, build, tmp_path, lambda _text: None) is scenario
    assert not list(tmp_path.iterdir())


def test_an_unsettled_scenario_is_not_built() -> None:
    with pytest.raises(ScenarioError, match="settled before a run is built"):
        build(small(**WORDS))


def test_a_run_measures_and_keeps_the_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    phases = [{"name": "inflate", "duration_s": 0.02, "pressure_Pa": 1e3}]
    result = cosim.run(small(fidelity="auto", **{"auto.tolerance_m": 1.0}, phase=phases))
    (path,) = (tmp_path / "cosim").glob("trade_*.kept")
    rows = unpacking(list)(path.read_bytes().partition(b"\n")[2])
    assert "chosen by measurement: " in result.stage.report
    able = [row for row in rows if not row.reference and not row.failure]
    fastest = max(able, key=lambda row: float(row.real_time_factor)).candidate
    assert fastest.name in result.stage.report
    assert np.isclose(result.stage.tick_s, fastest.changes["clock.tick_s"])


def test_the_run_that_was_chosen_is_within_the_tolerance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    phases = [{"name": "inflate", "duration_s": 0.1, "pressure_Pa": 20e3}]
    scenario, tolerance_m = small(phase=phases), 3e-3
    lumped = [
        candidate for candidate in short_candidates(scenario) if candidate.changes["fidelity"] == "lumped"
    ]
    monkeypatch.setattr(report, "short_candidates", lambda _scenario: tuple(lumped))
    asking = load_scenario(scenario, {"fidelity": "auto", "auto.tolerance_m": tolerance_m})
    chosen = report.chosen_fidelity(asking, build, tmp_path, lambda _text: None)
    truth, *others = (trace(load_scenario(scenario, candidate.changes), build) for candidate in lumped)
    errors = [compared(lumped[1], curve, truth).tip_error_m for curve in others]
    assert errors[0] < tolerance_m < errors[-1]  # there is something to choose
    run = cosim.run(chosen)
    times = truth.time_s[::20]
    ours = np.stack([np.interp(times, run.time_s, run.tip_position[:, axis]) for axis in range(3)], axis=1)
    assert np.linalg.norm(ours - truth.tip[::20], axis=1).max() <= tolerance_m
