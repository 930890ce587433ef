"""Paths of the tip in scenario files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim.config.loading import load_scenario, scenario_text
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError

POINTS = [[0.3, 0.0, 0.5], [0.3, 0.1, 0.52], [0.3, 0.2, 0.5]]
FOLLOW = {
    "name": "follow",
    "tip_path": {"points_m": POINTS, "directions": [[0.0, 0.0, -1.0]], "speed_m_s": 0.02},
}
HEADER = "x_m,y_m,z_m,direction_x,direction_y,direction_z"


def loaded(phase: dict[str, Any], **others: Any) -> Scenario:
    return load_scenario("ur5e_hexagon_arm", {"phase": [phase], **others})


def with_path(**changes: Any) -> dict[str, Any]:
    return {**FOLLOW, "tip_path": {**FOLLOW["tip_path"], **changes}}


def test_the_duration_follows_from_length_and_speed() -> None:
    (phase,) = loaded(FOLLOW).phases
    assert phase.ramp == "linear"
    # two chords of 0.102 m, a little more along the spline
    assert 0.204 / 0.02 + 0.5 < phase.duration_s < 1.01 * 0.204 / 0.02 + 0.5


def test_a_file_says_the_same_as_a_list(tmp_path: Path) -> None:
    rows = [",".join(map(str, [*point, 0.0, 0.0, -1.0])) for point in POINTS]
    text = scenario_text(load_scenario("ur5e_hexagon_arm"))
    (tmp_path / "mine.toml").write_text(text.partition("[[phase]]")[0] + '[[phase]]\nname = "follow"\n'
        'tip_path = { file = "way.csv", speed_m_s = 0.02 }\n')  # fmt: skip
    (tmp_path / "way.csv").write_text("\n".join(["# by hand", HEADER, *rows]) + "\n")
    found = load_scenario(tmp_path / "mine.toml").phases[0]
    given = loaded(with_path(directions=[[0.0, 0.0, -1.0]] * 3)).phases[0]
    assert found == given


def test_a_run_has_its_path_spelled_out(tmp_path: Path) -> None:
    scenario = loaded(FOLLOW)
    (tmp_path / "scenario.toml").write_text(scenario_text(scenario))
    assert load_scenario(tmp_path / "scenario.toml") == scenario


@pytest.mark.parametrize(
    ("phase", "key", "says"),
    [
        ({**FOLLOW, "duration_s": 3.0}, "phase.follow.duration_s", "takes 10."),
        ({**FOLLOW, "ramp": "smooth"}, "phase.follow.ramp", "has its own ramps"),
        ({**FOLLOW, "flange_shift_m": [0, 0, 0.1]}, "phase.follow.flange_shift_m", "combined with tip_path"),
        ({**FOLLOW, "tip_target": {"position_m": [0, 0, 1]}}, "phase.follow.tip_target", "with tip_path"),
        (with_path(speed_m_s=0.0), "phase.follow.tip_path.speed_m_s", "above 0"),
        (with_path(speed_m_s=0.5), "phase.follow.tip_path", "too short to reach 0.5 m/s"),
        (with_path(points_m=POINTS[:1]), "phase.follow.tip_path", "two points at least"),
        (with_path(directions=[[0, 0, 0]]), "phase.follow.tip_path.directions.1", "must not be zero"),
        (with_path(file="x.csv"), "phase.follow.tip_path.points_m", "cannot be combined with file"),
        ({"name": "follow", "tip_path": {"points_m": POINTS}}, "phase.follow.tip_path.speed_m_s", "missing"),
        ({"name": "follow"}, "phase.follow.duration_s", "missing"),
    ],
)
def test_a_wrong_path_is_refused_by_its_key(phase: dict[str, Any], key: str, says: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        loaded(phase)
    assert [path for path, _ in caught.value.faults] == [key]
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "lacks the column x_m"),
        ("x_m,y_m\n1,2\n", "lacks the column z_m"),
        ("x_m,y_m,z_m,direction_x\n1,2,3,4\n", "lacks the column direction_y"),
        ("x_m,y_m,z_m,speed\n1,2,3,4\n", "has the column 'speed'"),
        ("x_m,y_m,z_m\n1,2,3\n1,2,up\n", "line 3: could not convert"),
        ("x_m,y_m,z_m\n1,2,3\n1,2\n", "line 3: '1, 2' must be 3 finite numbers"),
        ("x_m,y_m,z_m\n1,2,nan\n", "must be 3 finite numbers"),
        ("x_m,y_m,z_m\n1,2," + 140_000 * "3", "way.csv: field larger than"),
        (None, "cannot be read"),
    ],
)
def test_a_file_without_points_is_refused(text: str | None, says: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "way.csv").write_text(text)
    phase = {"name": "follow", "tip_path": {"file": str(tmp_path / "way.csv"), "speed_m_s": 0.02}}
    with pytest.raises(ScenarioError, match=r"^phase\.follow\.tip_path\.file: ") as caught:
        loaded(phase)
    assert says in str(caught.value)
    assert len(caught.value.faults) == 1


def test_without_an_arm_nothing_moves_the_flange() -> None:
    with pytest.raises(ScenarioError, match=r"phase\.follow\.tip_path: needs an arm"):
        loaded(FOLLOW, robot="none")
