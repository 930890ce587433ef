"""Tip targets from their benchmark, two of them: met statically, held in the coupled dynamic run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from benchmarks import tip_targets
from benchmarks.tip_targets import BOUNDS, measure, summary
from cosim.base.kept_parts import KeptParts
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.soft.solve.state import Equilibrium
from cosim.telemetry.texts.closing_lines import closing_lines
from tests.small_section import on_a_ur5e


def test_two_targets_are_met_and_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tip_targets, "SETTLE_S", 2.5)
    found = measure(2, seed=3)
    for entry in found:
        assert 1 <= entry.iterations <= BOUNDS["iterations"]
        assert entry.tip_mm < BOUNDS["tip_mm"]
        assert entry.tip_degrees < BOUNDS["tip_degrees"]
        assert entry.dynamic_tip_mm is not None
        assert entry.dynamic_tip_mm < BOUNDS["dynamic_tip_mm"]
    assert max(entry.rigid_guess_mm for entry in found) > 5.0  # there is something to compensate
    totals = summary(found, 1.0)
    assert totals["targets"] == 2
    assert totals["tip_mm"]["within_bound"] == 2
    assert totals["tip_mm"]["max"] == max(entry.tip_mm for entry in found)


TARGETS = """
[[phase]]
name = "free"
duration_s = 0.6
tip_target = { position_m = [0.42, 0.02, 0.35] }

[[phase]]
name = "turned"
duration_s = 0.6
tip_target = { position_m = [0.42, 0.02, 0.35], direction = [0.3, 0.0, -2.0] }
"""


def test_how_far_the_direction_is_off_is_in_the_summary(tmp_path: Path) -> None:
    file = tmp_path / "turned.toml"
    file.write_text(on_a_ur5e(10e3, TARGETS, robot='"square_core"', published=False), encoding="utf-8")
    changes = {"fidelity": "rigid", "contact.enabled": False}
    run = cosim.run(file, overrides=changes, error=False)
    free, turned = run.summary["phases"]
    assert "tip_angle_error_rad" not in free
    wanted = np.array([0.3, 0.0, -2.0]) / np.linalg.norm([0.3, 0.0, -2.0])
    off = float(np.arccos(run.tip_direction[-1] @ wanted))
    assert turned["tip_angle_error_rad"] == pytest.approx(off, abs=1e-7)
    assert turned["tip_angle_error_rad"] > 0.0
    (line,) = [line for line in closing_lines(run.summary, tmp_path, []) if line.startswith("target: ")]
    assert line.endswith(f" and {np.degrees(off):.3g} degrees (phase 'turned')")


ACROSS = """
[[phase]]                       # horizontal: units press on one another where the arm sags
name = "across"
duration_s = 1.6
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -1.4 }

[[phase]]
name = "reach"
duration_s = 0.6
tip_target = { position_m = [0.5, 0.02, 0.5] }
"""


def test_a_search_begins_with_the_films_that_press(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begins: list[Equilibrium] = []
    find = FilmRobot.find_flange_pose

    def noting(soft: FilmRobot, begin: Equilibrium, *wanted: Any) -> Equilibrium:
        begins.append(begin)
        return find(soft, begin, *wanted)

    monkeypatch.setattr(FilmRobot, "find_flange_pose", noting)
    file = tmp_path / "across.toml"
    file.write_text(on_a_ur5e(15e3, ACROSS, robot='"square_core"', published=False), encoding="utf-8")
    cosim.Simulation(file, overrides={"fidelity": "lumped"}, kept=KeptParts())  # none from disk
    (begin,) = begins
    assert begin.state.touching is not None
    assert begin.loads.self_contact is not None  # without it, an arm folded on itself is not stable
