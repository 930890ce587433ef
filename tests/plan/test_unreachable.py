"""Poses out of the arm's reach: refused by the key that asks for them, before anything is solved for it."""

from __future__ import annotations

from typing import Any

import pytest

from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.errors import ScenarioError
from cosim.plan import plan

DOWN = [0.0, 0.0, -1.0]
FAR = {"position_m": [1.6, 0.6, 0.6], "direction": DOWN}
INSIDE = {
    "position_m": [0.05, 0.05, 0.4],
    "direction": DOWN,
}  # within reach of the wrist, but not of the elbow


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
    monkeypatch.setattr(plan, "start_equilibrium", refuse_statics)
    scenario = load_scenario("ur5e_hexagon_arm", {"model.published": True, **changes})
    with pytest.raises(ScenarioError) as caught:
        build(scenario)
    assert str(caught.value).startswith(f"{key}: ")
    assert reason in str(caught.value)


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
