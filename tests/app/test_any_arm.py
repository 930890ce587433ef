"""Every arm runs: it hangs, its soft finger is inflated, and it turns a little."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.cli.main import main
from cosim.kinematics.arm import Arm
from cosim.plan.flange_motion import rotation_from_direction
from tests.config.arm_texts import GANTRY_MJCF, SIX_JOINTS_MJCF
from tests.pages import page

SCENARIO = """schema = 2
title = "a finger on any arm"
robot = "{robot}"
soft_robot = "gripper_finger"
model.published = true

[start]
flange.position_m = {position}
flange.direction = {direction}
flange.roll_rad = {roll}

[[phase]]
name = "hang"
duration_s = 0.02

[[phase]]
name = "inflate"
duration_s = 0.04
pressure_Pa = 5e3

[[phase]]
name = "turn"
duration_s = 0.5
flange_turn = {{ axis = {axis}, angle_rad = 0.1 }}
"""


def written(tmp_path: Path, robot: str) -> Path:
    """Return the scenario of an arm that starts at its home and turns about a level axis across its way."""
    arm = Arm(find_arm(robot))
    pose = arm.forward(arm.home)
    outwards = pose.translation - arm.shoulder
    rolled = rotation_from_direction(pose.rotation[:, 2]).T @ pose.rotation
    path = tmp_path / "s.toml"
    path.write_text(
        SCENARIO.format(
            robot=robot,
            position=pose.translation.tolist(),
            direction=pose.rotation[:, 2].tolist(),
            roll=float(np.arctan2(rolled[1, 0], rolled[0, 0])),
            axis=np.cross([0.0, 0.0, 1.0], outwards).tolist(),
        )
    )
    return path


def check(path: Path, arm: Arm) -> None:
    """Run a scenario; the arm must stay within its bounds and the flange where it is asked to be."""
    result = cosim.run(path)
    found = result.summary["arm"]["run"]
    assert result.summary["status"] == "completed"
    for name in ("position", "velocity", "acceleration", "torque", "tracking_error"):
        assert found[name] is None or not found[name]["beyond"], (name, found[name])
    assert found["contacts"] == []
    home = arm.forward(arm.home)
    last = arm.forward(result.joint_position[-1])
    np.testing.assert_allclose(last.translation, home.translation, atol=5e-3)  # the turn is about its origin
    # of 0.1 rad; the arm follows within its servos' error
    assert float(last.rotation[:, 2] @ home.rotation[:, 2]) == pytest.approx(np.cos(0.1), abs=5e-3)


@pytest.mark.parametrize("name", list_arms())
def test_arms_that_come_with_cosim(tmp_path: Path, name: str) -> None:
    check(written(tmp_path, name), Arm(find_arm(name)))


@pytest.mark.parametrize("text", [SIX_JOINTS_MJCF, GANTRY_MJCF], ids=["six joints", "gantry"])
def test_arms_of_ones_own(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.xml"
    path.write_text(text)
    check(written(tmp_path, str(path)), Arm(find_arm(str(path))))


def test_the_page_on_extending_is_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its files are written where it says, its commands are run as they stand."""
    section = page("extending").partition("\n## An arm\n")[2].partition("\n## ")[0]
    texts = re.findall(r"```(?:xml|toml)\n(.*?)```", section, re.DOTALL)
    for name, text in zip(("scara/scara.urdf", "scara/arm.toml", "lower.toml"), texts, strict=True):
        assert f"`{name}`" in section
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (commands,) = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    for command in commands.splitlines():
        program, *arguments = command.split()
        assert program == "cosim"
        assert main([*arguments, *(["--no-recording"] if arguments[0] == "run" else [])]) == 0
    assert "fine: 4 joints; flange 'spindle'" in capsys.readouterr().out
    (summary,) = tmp_path.glob("runs/*/summary.json")
    found = json.loads(summary.read_text(encoding="utf-8"))
    assert found["status"] == "completed"
    assert not any(entry["beyond"] for entry in found["arm"]["run"].values() if "beyond" in entry)
    assert found["arm"]["run"]["velocity"]["unit"] == "m/s"  # the quill's, nearest to its bound


def test_tip_targets_need_an_arm_that_follows_rolls(tmp_path: Path) -> None:
    path = written(tmp_path, "so101")
    text = path.read_text().partition("flange_turn")[0]
    path.write_text(text + "tip_target = { position_m = [0.2, 0.0, 0.1] }\n")
    with pytest.raises(cosim.ScenarioError, match=r"phase\.turn\.tip_target: arm 'so101' has 5 joints"):
        cosim.run(path)
