"""Poses out of the arm's reach: refused by the key that asks for them, before anything is solved for it."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.base.resources import arm_path
from cosim.build.arms import find_arm
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.errors import ScenarioError, UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import solve
from cosim.plan import static_plan
from cosim.plan.flange_motion import rotation_from_direction
from cosim.plan.joint_planner import plan_joints

DOWN = [0.0, 0.0, -1.0]
FAR = {"position_m": [1.6, 0.6, 0.6], "direction": DOWN}
INSIDE = {
    "position_m": [0.05, 0.05, 0.4],
    "direction": DOWN,
}  # within reach of the wrist, but not of the elbow
PLACE = np.array([0.4, 0.1, 0.5])
ROLL = re.compile(r"; it can be there if you (add|subtract) (\d\.\d\d) (?:to|from) its roll_rad$")


def refuse_statics(*arguments: Any) -> None:
    raise AssertionError("the statics were solved before the arm's reach was checked")


@pytest.mark.parametrize(
    ("changes", "key", "reason"),
    [
        ({"start.flange": FAR}, "start.flange", "the arm's reach is"),
        ({"start.flange": INSIDE}, "start.flange", "starts found no configuration"),
        ({"phase.inflate.flange": FAR}, "phase.inflate.flange", "the arm's reach is"),
        ({"phase.inflate.flange": INSIDE}, "phase.inflate.flange", "starts found no configuration"),
        ({"phase.hang.flange_shift_m": [2.0, 0.0, 0.0]}, "phase.hang.flange_shift_m", "the arm's reach is"),
    ],
)
def test_given_poses_are_refused_before_any_statics(
    changes: dict[str, Any], key: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(static_plan, "start_equilibrium", refuse_statics)
    scenario = load_scenario("ur5e_hexagon_arm", {"model.published": True, **changes})
    with pytest.raises(ScenarioError) as caught:
        build(scenario)
    assert str(caught.value).startswith(f"{key}: ")
    assert reason in str(caught.value)


def test_an_arm_that_cannot_hold_its_load_is_named_before_any_statics(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where the first phase has a target of the tip, which takes statics to plan for."""
    monkeypatch.setattr(static_plan, "start_equilibrium", refuse_statics)
    target = {"name": "reach", "duration_s": 1.0, "tip_target": {"position_m": [0.4, 0.0, 0.2]}}
    scenario = load_scenario("tip_path", {"phase": [target], "soft_robot.mass.node_mass_kg": 1.0})
    with pytest.raises(ScenarioError, match=r"^start\.flange: the arm cannot hold itself and a payload of"):
        build(scenario)


def test_a_refusal_names_the_wanted_pose_not_where_the_path_broke_off() -> None:
    scenario = load_scenario(
        "ur5e_hexagon_arm", {"phase": [{"name": "go", "duration_s": 1.0, "flange": FAR}]}
    )
    with pytest.raises(
        ScenarioError, match=r"phase\.go\.flange: .* flange to \(1\.6000, 0\.6000, 0\.6000\) m"
    ):
        build(scenario)


def test_a_path_that_breaks_off_is_named_where_its_end_can_be_reached() -> None:
    # straight through the column of the arm, to a pose like the first one on its other side
    phases = [{"name": "through", "duration_s": 1.0, "flange_shift_m": [-0.6, 0.0, 0.0]}]
    scenario = load_scenario("ur5e_hexagon_arm", {"phase": phases})
    with pytest.raises(ScenarioError, match=r"phase\.through\.flange_shift_m: .* branch followed ends"):
        build(scenario)


def test_a_tip_target_out_of_reach_is_refused_by_its_key() -> None:
    changes = {"model.published": True, "phase.reach.tip_target": {"position_m": [0.9, 0.9, 0.9]}}
    with pytest.raises(ScenarioError, match=r"^phase\.reach\.tip_target: .* the arm's reach is"):
        build(load_scenario("ur5e_hexagon_arm", changes))


def stiff_wrist(folder: Path, turns_rad: float) -> Arm:
    """Return a UR5e whose last joint turns by so much either way, and no more."""
    table = arm_path("ur5e").read_text(encoding="utf-8").replace("ur5e.urdf", str(find_arm("ur5e").path))
    limits = f"[limits]\nlower = [-3, -3, -3, -3, -3, -{turns_rad}]\nupper = [3, 3, 3, 3, 3, {turns_rad}]\n"
    (folder / "arm.toml").write_text(table.replace("[limits]\n", limits), encoding="utf-8")
    return Arm(find_arm(str(folder / "arm.toml")))


def refusal(arm: Arm, roll_rad: float) -> str:
    """Return why the flange cannot start there with this roll; empty if it can."""
    pose = Pose(rotation_from_direction(np.array(DOWN), roll_rad), PLACE)
    try:
        plan_joints(arm, pose, [], lambda _: "start.flange")
    except UnreachableError as error:
        return str(error)
    return ""


def test_a_roll_that_no_joint_allows_is_refused_with_one_that_will_do(tmp_path: Path) -> None:
    arm = stiff_wrist(tmp_path, 0.5)
    refused = {roll: text for roll in np.arange(4) * math.pi / 2.0 if (text := refusal(arm, roll))}
    assert refused
    for roll_rad, text in refused.items():
        told = ROLL.search(text)
        assert told, text
        assert not refusal(arm, roll_rad + float(told[2]) * {"add": 1.0, "subtract": -1.0}[told[1]])


def test_a_roll_is_named_only_if_it_will_do_in_the_digits_that_are_shown(tmp_path: Path) -> None:
    # the last joint turns by less than what a quarter turn loses when it is rounded to two digits
    arm = stiff_wrist(tmp_path, 4e-4)
    free = Arm(find_arm("ur5e"))
    fits = -solve(free, Pose(rotation_from_direction(np.array(DOWN)), PLACE), free.home).q[-1]
    assert not refusal(arm, fits)
    asked = fits + math.pi / 2.0
    told = ROLL.search(refusal(arm, asked))
    assert told is None or not refusal(arm, asked + float(told[2]) * {"add": 1.0, "subtract": -1.0}[told[1]])
