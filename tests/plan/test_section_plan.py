"""A motion that takes a section arm out of its model's range is named before it runs."""

from __future__ import annotations

import re
from io import StringIO
from pathlib import Path

import pytest

from cosim.app.driver import build_simulation
from cosim.app.first_run import with_fidelity_chosen
from cosim.build import section_cache as section_model
from cosim.cli.progress import PlanWarnings
from cosim.config.loading import load_scenario
from cosim.plan.decision import SECTION_RANGE
from tests.small_section import on_a_ur5e, section


@pytest.mark.parametrize(("duration_s", "included"), [(0.1, False), (2.0, True)])
def test_a_plan_too_fast_for_the_section_model_is_named_before_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, duration_s: float, included: bool
) -> None:
    rush = {"name": "rush", "duration_s": duration_s, "flange_shift_m": [0.0, 0.25, 0.0]}
    (tmp_path / "rush.toml").write_text(on_a_ur5e(20e3, ""), encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_model, "build_model", lambda *_: section().model)
    scenario = with_fidelity_chosen(load_scenario(tmp_path / "rush.toml", {"phase": [rush]}), lambda _: None)
    stage = build_simulation(scenario).stage
    said = StringIO()
    PlanWarnings(said).open(stage)
    (found,) = (decision for decision in stage.modelled if decision.what == SECTION_RANGE)
    assert found.included is included
    if not included:
        assert re.search(r"phase 'rush' .* up to \d+ m/s\^2; .* section \d of 4 \(.*\) is ", found.reason)
        assert found.switch == "phase.rush.duration_s"
        assert f"warning: {found.line}\n" in said.getvalue()
