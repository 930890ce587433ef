"""Candidates of a trade beside ticks: fidelities, switches, statics, and what they are measured against."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.build.simulation import build
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.config.toml.reading import parse_assignment
from cosim.errors import InputError
from cosim.trade.candidates import Candidate, candidates_of, lower_fidelities
from cosim.trade.measuring import measure
from tests.trade.test_trade import small

REFERENCE = "ur5e_hexagon_arm"
PUBLISHED = {"model.published": True}


def test_against_the_refined_mesh_there_is_one_table() -> None:
    scenario = load_scenario(REFERENCE, PUBLISHED)
    both, one = candidates_of(scenario), candidates_of(scenario, truth="refined")
    assert {candidate.name for candidate in both} == {candidate.name for candidate in one}
    references = [candidate.name for candidate in one if candidate.reference]
    assert references == ["wrinkling film, refine +1", "wrinkling film, refine +0", "refined once more"]
    assert one[0].reference
    assert {candidate.group for candidate in one} == {"model"}
    assert one[0].changes["soft_robot.stack.refine"] == 1
    with pytest.raises(InputError, match="no refined mesh"):
        candidates_of(scenario, quick=True, truth="refined")


def test_every_lower_fidelity_is_a_candidate() -> None:
    assert "rigid" in lower_fidelities()
    candidates = candidates_of(load_scenario(REFERENCE, PUBLISHED), quick=True)
    timed = {candidate.changes["fidelity"] for candidate in candidates if candidate.group == "time"}
    assert timed == {*lower_fidelities(), "lumped"}


def test_every_switch_of_what_is_modelled_is_a_candidate() -> None:
    changes = [
        candidate.changes
        for candidate in candidates_of(load_scenario(REFERENCE, PUBLISHED))
        if candidate.group == "model"
    ]
    keys = {key for change in changes for key in change}
    assert keys >= {"contact.enabled", "soft_robot.hinge.stiffness_factor", "mode", "fidelity"}


def test_statics_are_compared_at_phase_ends_only() -> None:
    phases = [
        {"name": "inflate", "duration_s": 0.2, "settle_s": 0.2, "pressure_Pa": 5e3, "increments": 4},
        {"name": "more", "duration_s": 0.2, "settle_s": 0.2, "pressure_Pa": 10e3, "increments": 4},
    ]
    candidates = [
        Candidate("dynamics", "model", {"clock.tick_s": 0.005}, reference=True),
        Candidate("statics", "model", {"mode": "quasistatic"}),
    ]
    slow = small(**{"phase": phases, "solver.damping_per_s": 30.0})
    statics = measure(slow, candidates, build)[1]
    assert not statics.failure
    assert np.isnan(statics.tip_error_m)
    assert not statics.comparable
    assert 0.0 < statics.end_error_m < 1e-4


def test_changes_of_the_command_line_come_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["trade", REFERENCE, "--out", str(tmp_path / "out"), "--set", "clock.tck_s=1"]
    assert main(words) == 2
    assert "clock.tck_s" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_words_that_are_told_change_what_a_candidate_changes() -> None:
    scenario = load_scenario(REFERENCE)
    published = Candidate("", "model", {"model.published": False}).words
    assert load_scenario(REFERENCE, dict([parse_assignment(published.removeprefix("--set "))])) == scenario
