"""Planned tip paths for robots' controllers: tables, URScript, and MuJoCo alone driven by them."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from benchmarks.tip_paths import bare_arm
from cosim.app.payload import payload_rows
from cosim.base.frames import rotations_from_quaternions
from cosim.build import section_models
from cosim.cli.main import main
from cosim.errors import InputError
from cosim.results.joint_table import PAYLOAD, JointTable, sample_times
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
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)
    return tmp_path / "small.toml"


def table(rows: int = 5, joints: int = 6, kind: str = "rad") -> JointTable:
    values = np.random.default_rng(0).normal(size=(rows, joints))
    return JointTable(
        "go-on", tuple(f"j{k}.position_{kind}" for k in range(joints)), 0.008 * np.arange(rows), values
    )


def test_the_export_drives_mujoco_alone_as_the_coupled_run_moves(file: Path, tmp_path: Path) -> None:
    assert main(["export-path", str(file), str(tmp_path / "way.csv"), str(tmp_path / "way.script")]) == 0
    read = JointTable.read(tmp_path / "way.csv")
    result = cosim.run(file, error=False)
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


def test_the_whole_plan_is_its_phases_one_after_the_other(file: Path) -> None:
    whole, path = cosim.plan_path(file, whole=True, rate_Hz=125.0), cosim.plan_path(file, rate_Hz=125.0)
    first = cosim.plan_path(file, phase="reach", rate_Hz=125.0)
    begin = round(125.0 * 2.0)  # a second of motion, one to settle
    np.testing.assert_array_equal(whole.values[: len(first.values)], first.values)
    still = whole.joints[len(first.values) - 1 : begin + 1]
    np.testing.assert_allclose(still, np.broadcast_to(first.joints[-1], still.shape), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(whole.values[begin : begin + 100], path.values[:100], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("wanted", "says"),
    [({"phase": "none"}, "it has reach, follow"), ({"phase": "reach", "whole": True}, "not both")],
)
def test_what_is_no_phase_is_refused(file: Path, wanted: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        cosim.plan_path(file, **wanted)


def test_the_motion_of_a_run_holds_what_was_asked_for_and_the_payload(file: Path, tmp_path: Path) -> None:
    result = cosim.run(file, out=tmp_path / "run")
    assert main(["export-path", str(tmp_path / "run"), str(tmp_path / "all.csv"), "--rate", "500"]) == 0
    every = JointTable.read(tmp_path / "all.csv")  # at ticks of 2 ms
    n = len(result.tick)
    np.testing.assert_allclose(every.time_s[:n], result.time_s, atol=1e-9)
    # the target of a tick is that of its begin, so that run and plan ask for the same at the same time
    np.testing.assert_allclose(every.joints[: n - 1], result.joint_target[1:], atol=1e-12)
    planned = cosim.plan_path(file, whole=True, rate_Hz=500.0)
    np.testing.assert_allclose(every.joints[:n], planned.joints[:n], atol=1e-5)
    columns = every.columns.index("right.tension_N"), every.columns.index("chamber.pressure_Pa")
    had = np.stack([result.cable_tension_N[:, 0], result.chamber_pressure_Pa[:, 0]], axis=1)
    np.testing.assert_allclose(every.values[:n][:, columns], had, rtol=1e-9, atol=1e-9)
    assert every.payload is not None
    turn = rotations_from_quaternions(result.flange_quaternion)
    center = result.flange_position + np.einsum("nij,nj->ni", turn, every.payload[:n, 1:4])
    np.testing.assert_allclose(center, result.soft_center, atol=1e-9)
    along = cosim.run_path(result, phase="follow", rate_Hz=500.0)
    first = int(np.flatnonzero(result.phase == 1)[0]) - 1
    np.testing.assert_allclose(along.joints[: n - first - 1], result.joint_target[first + 1 :], atol=1e-12)


def test_a_rigid_soft_robot_is_a_constant_payload(file: Path, tmp_path: Path) -> None:
    rigid = cosim.run(file, overrides={"fidelity": "rigid", "phase.reach.settle_s": 0.1}, out=tmp_path / "r")
    found = cosim.payload_torque(tmp_path / "r")
    weight = 9.81 * rigid.stage.soft_mass_kg * 0.4  # [N m], 0.4 m from the shoulder
    assert weight > 0.1
    # what is left comes from the speeds, which MuJoCo has of the middle of a tick
    assert np.abs(found.by_fixed[1:]).max() < 0.02 * weight
    assert np.abs(found.by_schedule[1:]).max() < 0.02 * weight
    rows = payload_rows(rigid)
    np.testing.assert_allclose(rows, np.broadcast_to(rows[0], rows.shape), rtol=1e-6, atol=1e-9)
    assert "updated every 0.5 s: wrong by up to" in repr(found)


def test_a_plate_on_the_flange_belongs_to_the_payload(file: Path) -> None:
    result = cosim.run(file, overrides={"fidelity": "rigid", "phase.reach.settle_s": 0.1})
    alone = payload_rows(result)[0]
    plate = (0.3, 0.01, 0.0, 0.02, 1e-3, 2e-3, 3e-3, 0.0, 0.0, 0.0)
    both = payload_rows(replace(result, stage=replace(result.stage, mounted=plate)))[0]
    # Steiner: about the common centre, the reduced mass at the distance of both centres
    mass, apart = alone[0] + 0.3, alone[1:4] - np.array(plate[1:4])
    reduced = alone[0] * 0.3 / mass
    np.testing.assert_allclose(both[0], mass)
    np.testing.assert_allclose(both[1:4], (alone[0] * alone[1:4] + 0.3 * np.array(plate[1:4])) / mass)
    x, y, z = apart
    steiner = reduced * np.array([y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z])
    np.testing.assert_allclose(both[4:], alone[4:] + np.array(plate[4:]) + steiner, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("overrides", "wanted", "says"),
    [
        ({"mode": "quasistatic", "phase.reach.increments": 5}, {}, "no time"),
        ({"phase.reach.settle_s": 0.1}, {"phase": "none"}, "it has reach"),
    ],
)
def test_a_run_without_such_a_motion_is_refused(
    file: Path, overrides: dict[str, Any], wanted: dict[str, Any], says: str
) -> None:
    text = file.read_text(encoding="utf-8")
    file.write_text(text[: text.index('[[phase]]\nname = "follow"')], encoding="utf-8")
    result = cosim.run(file, overrides={"fidelity": "rigid", **overrides})
    with pytest.raises(InputError, match=says):
        cosim.run_path(result, **wanted)


def test_a_csv_file_reads_back_to_the_bit(tmp_path: Path) -> None:
    written = table()
    written.write(tmp_path / "way.csv")
    read = JointTable.read(tmp_path / "way.csv")
    assert read.columns == written.columns
    np.testing.assert_array_equal(read.values, written.values)
    np.testing.assert_array_equal(read.time_s, written.time_s)


def test_urscript_moves_to_the_start_and_has_a_servoj_for_every_row(tmp_path: Path) -> None:
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


def test_columns_are_found_by_their_heads(tmp_path: Path) -> None:
    bare, load = table(), np.random.default_rng(1).normal(size=(5, 10))
    heads, values = [*bare.columns, *PAYLOAD, "c.tension_N"], np.hstack([bare.values, load, np.ones((5, 1))])
    order = [16, *range(15, 5, -1), *range(6)]  # tension, payload backwards, joints
    mixed = JointTable("1. try", tuple(heads[k] for k in order), bare.time_s, values[:, order])
    mixed.write(tmp_path / "1. try.csv")
    read = JointTable.read(tmp_path / "1. try.csv")
    assert read.joint_names == bare.joint_names
    np.testing.assert_array_equal(read.joints, bare.joints)
    np.testing.assert_array_equal(read.payload, load)
    assert read.urscript_text().splitlines()[1] == "def p_1__try():"


def test_urscript_needs_evenly_spaced_rows() -> None:
    times = np.array([0.0, 0.008, 0.016, 0.03, 0.038])
    with pytest.raises(InputError, match=r"0\.008 to 0\.014 s apart"):
        replace(table(), time_s=times).urscript_text()


def test_urscript_sets_the_payload_ahead(tmp_path: Path) -> None:
    rows = 201  # 0.8 s at 250 Hz
    bare = table(rows)
    load = np.linspace(0.0, 1.0, rows)[:, None] + np.arange(10.0)
    columns = (*bare.columns, *PAYLOAD)
    known = JointTable("go-on", columns, 0.004 * np.arange(rows), np.hstack([bare.values, load]))
    lines = known.urscript_text().splitlines()
    calls = {k: line.strip() for k, line in enumerate(lines) if "payload" in line}
    found = {k: ast.literal_eval(line.removeprefix("set_target_payload")) for k, line in calls.items()}
    assert list(found) == [2, 4, 130]  # before the move, at 0 s and at 0.5 s
    assert found[2] == (0.0, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0, 7.0, 8.0, 9.0], 0)
    assert found[4][0] == pytest.approx(0.5 / 0.8)
    assert found[130][0] == pytest.approx(1.0)
    assert [call[3] for call in found.values()] == [0, 0.5, 0.5]


def test_a_trajectory_of_ros_reads_back(tmp_path: Path) -> None:
    from rosbags.typesys import Stores, get_typestore
    from ruamel.yaml import YAML

    written = table(400)
    written.write(tmp_path / "way.yaml")
    read = YAML(typ="safe").load(tmp_path / "way.yaml")
    types = get_typestore(Stores.ROS2_HUMBLE).types
    fields = types["trajectory_msgs/msg/JointTrajectory"].__dataclass_fields__
    assert set(read) == set(fields) - {"__msgtype__"}
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"].__dataclass_fields__
    assert set(read["points"][0]) == set(point) - {"__msgtype__"}
    assert tuple(read["joint_names"]) == written.joint_names
    np.testing.assert_array_equal([entry["positions"] for entry in read["points"]], written.joints)
    since = [entry["time_from_start"] for entry in read["points"]]
    assert [t["sec"] + 1e-9 * t["nanosec"] for t in since] == pytest.approx(written.time_s.tolist(), abs=1e-9)
    speeds = np.array([entry["velocities"] for entry in read["points"]])
    np.testing.assert_array_equal(speeds, written.joint_speeds)


@pytest.mark.parametrize(("joints", "kind"), [(7, "rad"), (6, "m")])
def test_urscript_is_for_six_turning_joints(joints: int, kind: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="6 joints that turn"):
        table(joints=joints, kind=kind).write(tmp_path / "way.script")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "time_s first"),
        ("a,b\n1,2\n3,4\n", "time_s first"),
        ("time_s,j.position_rad,j.position_rad\n0,1,1\n1,1,1\n", "j.position_rad twice"),
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
    with pytest.raises(InputError, match=r"must end in \.csv, in \.script"):
        table().write(tmp_path / "way.txt")
    with pytest.raises(InputError, match="no step within"):
        sample_times(2.0, 0.1)
    assert sample_times(2.0, 500.0)[-1] == pytest.approx(2.0)
    assert sample_times(2.0001, 500.0)[-1] == pytest.approx(2.002)
