"""Planned tip paths for robots' controllers: tables, URScript, and MuJoCo alone driven by them."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from benchmarks.tip_paths import bare_arm
from cosim.build import soft_model
from cosim.cli.main import main
from cosim.errors import InputError
from cosim.results.joint_table import JointTable, sample_times
from tests.small_section import on_a_ur5e, section

PHASES = """
[[phase]]
name = "reach"
duration_s = 1.0
settle_s = 1.0
tip_target = { position_m = [0.42, 0.0, 0.42], direction = [0.1, 0.0, -0.95] }

[[phase]]
name = "follow"
pressure_Pa = 22e3
cable_tension_N = [0.5, 0.0]

[phase.tip_path]
points_m = [[0.42, 0.0, 0.42], [0.43, 0.05, 0.43], [0.42, 0.1, 0.42]]
directions = [[0.1, 0.0, -0.95], [0.05, 0.0, -0.95], [0.0, 0.05, -0.95]]
speed_m_s = 0.05
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the scenario of the small arm; its model is not built again."""
    (tmp_path / "small.toml").write_text(on_a_ur5e(20e3, PHASES), encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(soft_model, "build_model", lambda *_: section().model)
    return tmp_path / "small.toml"


def table(rows: int = 5, joints: int = 6, kind: str = "rad") -> JointTable:
    values = np.random.default_rng(0).normal(size=(rows, joints))
    return JointTable(
        "go-on", tuple(f"j{k}.position_{kind}" for k in range(joints)), 0.008 * np.arange(rows), values
    )


def test_the_export_drives_mujoco_alone_as_the_coupled_run_moves(file: Path, tmp_path: Path) -> None:
    assert main(["export-path", str(file), str(tmp_path / "way.csv"), str(tmp_path / "way.script")]) == 0
    read = JointTable.read(tmp_path / "way.csv")
    result = cosim.run(file)
    np.testing.assert_array_equal(read.joint_names, result.stage.joint_names)
    rows = np.flatnonzero(result.phase == 1)
    # the run takes a whole number of ticks for the path, up to half a one more or less
    np.testing.assert_allclose(read.joints[: len(rows)], result.joint_target[rows], atol=1e-4)
    driven, asked = bare_arm(read)
    assert np.linalg.norm(driven - asked, axis=1).max() < 1e-4
    count = min(len(rows), len(driven) - 1)
    coupled = result.flange_position[rows[0] - 1 : rows[0] + count]
    assert np.linalg.norm(driven[: count + 1] - coupled, axis=1).max() < 1e-4


def test_tensions_and_pressures_go_along(file: Path) -> None:
    found = cosim.plan_path(file, rate_Hz=125.0)
    assert found.time_s[1] == pytest.approx(0.008)
    assert found.columns[6:] == ("right.tension_N", "left.tension_N", "chamber.pressure_Pa")
    np.testing.assert_allclose(found.values[[0, -1], 6:], [[0.0, 0.0, 20e3], [0.5, 0.0, 22e3]])


@pytest.mark.parametrize("phase", ["reach", "none"])
def test_a_phase_without_a_path_is_refused(file: Path, phase: str) -> None:
    with pytest.raises(InputError, match=rf"phase '{phase}' has no tip_path; name one that has: follow"):
        cosim.plan_path(file, phase=phase)


def test_a_csv_file_reads_back_to_the_bit(tmp_path: Path) -> None:
    written = table()
    written.write(tmp_path / "way.csv")
    read = JointTable.read(tmp_path / "way.csv")
    assert read.columns == written.columns
    np.testing.assert_array_equal(read.values, written.values)
    np.testing.assert_array_equal(read.time_s, written.time_s)


def test_urscript_moves_to_the_begin_and_serves_every_row(tmp_path: Path) -> None:
    written = table()
    written.write(tmp_path / "way.script")
    lines = (tmp_path / "way.script").read_text().splitlines()
    assert lines[1] == "def go_on():"
    assert lines[-2:] == ["  stopj(2)", "end"]
    calls = [re.fullmatch(r"  (\w+)\((\[.*?\]), (.*)\)", line) for line in lines[2:-2]]
    found: Any = [(call[1], ast.literal_eval(call[2]), call[3]) for call in calls if call]
    assert len(found) == len(lines) - 4
    assert found[0][0] == "movej"
    np.testing.assert_allclose(found[0][1], written.joints[0], atol=1e-9)
    assert [name for name, _, _ in found[1:]] == ["servoj"] * 5
    np.testing.assert_allclose([q for _, q, _ in found[1:]], written.joints, atol=1e-9)
    # acceleration and speed (not used), time, lookahead (0.03 to 0.2 s), gain (100 to 2000)
    assert ast.literal_eval(found[1][2]) == (0, 0, 0.008, 0.1, 300)


@pytest.mark.parametrize(("joints", "kind"), [(7, "rad"), (6, "m")])
def test_urscript_is_for_six_turning_joints(joints: int, kind: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="6 joints that turn"):
        table(joints=joints, kind=kind).write(tmp_path / "way.script")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "time_s first"),
        ("a,b\n1,2\n3,4\n", "time_s first"),
        ("time_s,j.position_rad\n0,1\n", "two rows at least"),
        ("time_s,j.position_rad\n0,1\n0,1\n", "must increase"),
        ("time_s,j.position_rad\n0,1\n1,nan\n", "finite number"),
        ("time_s,j.position_rad\n0,1\n1\n", "cannot be read"),
        ("time_s,j.position_rad\n0,1\n1,x\n", "cannot be read"),
    ],
)
def test_a_file_that_is_no_table_is_refused(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        JointTable.read(tmp_path / "way.csv")


def test_names_and_rates_that_make_no_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must end in \.csv, or in \.script"):
        table().write(tmp_path / "way.txt")
    with pytest.raises(InputError, match="no step within"):
        sample_times(2.0, 0.1)
    assert sample_times(2.0, 500.0)[-1] == pytest.approx(2.0)
    assert sample_times(2.0001, 500.0)[-1] == pytest.approx(2.002)
