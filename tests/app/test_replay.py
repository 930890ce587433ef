"""What a robot was asked for drives a scenario, and what was measured is compared with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.app.replay import APPROACH_s, Replayed, SETTLE_s
from cosim.build import section_models
from cosim.cli.main import main
from cosim.errors import InputError
from cosim.results.joint_table import JointTable
from tests.small_section import on_a_ur5e, section

DELAY_s, NOISE_RAD = 0.04, 2e-3
PHASES = """
[[phase]]
name = "swing"
duration_s = 1.0
settle_s = 0.6
pressure_Pa = 25e3
cable_tension_N = [1.0, 0.0]
flange_shift_m = [0.1, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, JointTable, Replayed]:
    """Return a scenario, the table of its plan, and a replay of that."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("replay")
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        patch.setattr(section_models, "build_model", lambda *_: section().model)
        file = folder / "small.toml"
        file.write_text(on_a_ur5e(20e3, PHASES), encoding="utf-8")
        table = cosim.plan_path(file, whole=True, rate_Hz=125.0)
        return file, table, cosim.replay(file, table)


@pytest.fixture(autouse=True)
def _built_before(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)


def measured(asked: tuple[Path, JointTable, Replayed]) -> JointTable:
    """Return the table with a joint and the tip as somebody would have measured them: late and noisy."""
    _, table, found = asked
    run = found.result
    since, late = run.time_s - found.begin_s, table.time_s - DELAY_s
    noise = np.random.default_rng(4).normal(size=len(late)) * NOISE_RAD
    joint = np.interp(late, since, run.joint_position[:, 1]) + noise
    tip = np.interp(late, since, run.tip_position[:, 0]) + 0.003
    columns = (*table.columns, "shoulder_lift_joint.measured_rad", "tip.x_m")
    return replace(table, columns=columns, values=np.column_stack([table.values, joint, tip]))


def test_a_replayed_plan_moves_as_the_planned_run(asked: tuple[Path, JointTable, Replayed]) -> None:
    file, _, found = asked
    planned = cosim.run(file)
    assert found.begin_s == APPROACH_s + SETTLE_s
    first = int(np.argmin(np.abs(found.result.time_s - found.begin_s)))
    count = len(planned.tick)
    assert len(found.result.tick) == first + count
    np.testing.assert_allclose(found.result.joint_position[first:], planned.joint_position, atol=1e-6)
    np.testing.assert_allclose(found.result.tip_position[first:], planned.tip_position, atol=2e-5)
    np.testing.assert_allclose(found.result.pressure_Pa[-1], 25e3)
    np.testing.assert_allclose(found.result.cable_tension_N[-1], [1.0, 0.0])
    assert not found.compared
    assert "the file has no measured columns" in repr(found)


def test_speeds_are_those_of_the_planned_motion_and_zero_at_its_ends() -> None:
    s = np.linspace(0.0, 1.0, 126)
    smooth = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)  # a ramp of 1 rad and 1 s, from rest to rest
    table = JointTable("ramp", ("j.position_rad",), s, smooth[:, None])
    np.testing.assert_allclose(table.joint_speeds[:, 0], 30.0 * s**2 * (1.0 - s) ** 2, atol=2e-5)
    assert table.joint_speeds[[0, -1], 0].tolist() == [0.0, 0.0]


def test_delay_noise_and_offset_of_what_was_measured_are_found(
    asked: tuple[Path, JointTable, Replayed], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured(asked).write(tmp_path / "bench.csv")
    found = cosim.replay(asked[0], tmp_path / "bench.csv")
    joint, tip = found.compared
    assert joint.delay_s == pytest.approx(DELAY_s, rel=0.1)
    assert joint.rms == pytest.approx(NOISE_RAD, rel=0.1)
    assert joint.rms_undelayed > 2.0 * joint.rms
    assert abs(joint.bias) < 0.2 * NOISE_RAD
    assert tip.bias == pytest.approx(0.003, rel=0.1)
    assert (
        main(["compare", str(asked[0]), str(tmp_path / "bench.csv"), "--plot", str(tmp_path / "b.png")]) == 0
    )
    said = capsys.readouterr().out
    assert "shoulder_lift_joint.measured_rad: rms 0.00" in said
    assert (tmp_path / "b.png").stat().st_size > 1000


def test_rough_rows_are_followed_evenly(asked: tuple[Path, JointTable, Replayed]) -> None:
    file, table, smooth = asked
    noise = np.zeros(table.values.shape)
    noise[:, :6] = np.random.default_rng(6).normal(size=(len(table.time_s), 6)) * NOISE_RAD
    noise[-1] = 0.0
    rough = replace(table, values=table.values + noise)
    found = cosim.replay(file, rough, overrides={"fidelity": "rigid"}).result
    apart = found.joint_position - smooth.result.joint_position
    assert apart.std() < 2.0 * NOISE_RAD  # along cubics 2.4 times the noise


SMALL = {"fidelity": "rigid", "contact.enabled": False}


def test_a_short_record_that_begins_at_any_time_is_compared(asked: tuple[Path, JointTable, Replayed]) -> None:
    file, table, _ = asked
    first = replace(
        table,
        columns=(*table.columns, "shoulder_lift_joint.measured_rad"),
        time_s=1.7e9 + table.time_s[:51],  # 0.4 s, from a unix time on
        values=np.column_stack([table.values, table.values[:, 1]])[:51],
    )
    found = cosim.replay(file, first, overrides=SMALL)
    (joint,) = found.compared
    assert found.too_fast == 0
    assert joint.rms < 1e-3
    assert abs(joint.delay_s) < 0.05
    assert joint.rms_undelayed < 5e-3
    cut = replace(first, time_s=first.time_s[:2], values=first.values[:2])
    assert cosim.replay(file, cut, overrides=SMALL).compared[0].rms < 1e-3


def test_columns_that_would_have_no_effect_are_refused(asked: tuple[Path, JointTable, Replayed]) -> None:
    file, table, _ = asked
    for name in ("shoulder_lift.measured_rad", "shoulder_lift_joint.measured_m", "chamber.presure_Pa"):
        more = replace(
            table, columns=(*table.columns, name), values=np.column_stack([table.values, table.time_s])
        )
        with pytest.raises(InputError, match=f"unknown columns {name};.*and measured tip.x_m"):
            cosim.replay(file, more, overrides=SMALL)


def test_joints_beyond_their_bounds_are_refused_and_too_fast_ones_are_counted(
    asked: tuple[Path, JointTable, Replayed],
) -> None:
    file, table, _ = asked
    values = table.values.copy()
    values[:, :6] = np.degrees(values[:, :6])
    with pytest.raises(InputError, match=r"at 0 s, position of shoulder.* rad; its bounds .* degrees"):
        cosim.replay(file, replace(table, values=values), overrides=SMALL)
    values = table.values[:4].copy()
    values[2:, 0] += 1.0
    fast = replace(table, time_s=table.time_s[:4], values=values)
    found = cosim.replay(file, fast, overrides=SMALL)
    assert "1 rows exceed a joint's bound of speed" in repr(found)


def test_joints_of_another_arm_are_refused(asked: tuple[Path, JointTable, Replayed]) -> None:
    file, table, _ = asked
    columns = ("elbow.position_rad", *table.columns[1:])
    with pytest.raises(InputError, match=r"has the joints elbow, .*; the arm has shoulder_pan_joint"):
        cosim.replay(file, replace(table, columns=columns))
