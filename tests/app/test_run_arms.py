"""Several arms in one scene: far apart each is as alone; where they meet, both hold one object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.app.ended_run import found_recordings
from cosim.build.scene_objects import rigid_substeps
from cosim.build.simulation import build_arms
from cosim.cli.main import main
from cosim.config.several_arms import load_arms
from cosim.errors import InputError, ScenarioError

HOLD = "two_arms_hold_box"
SHARED = """
schema = 2
title = "x"
robot = "ur5e"
soft_robot = "square_core"
[solver]
damping_per_s = 2.0
[contact]
only_in_reach = false
"""
OWN = """
arm_base = {{ position_m = [{at}, 0.0, 0.0] }}
start.flange = {{ position_m = [{there}, 0.0, 0.6], direction = [0.0, 0.0, -1.0] }}
start.pressure_Pa = 2e3
{phase}
name = "move"
duration_s = 0.05
flange_shift_m = [0.0, {shift}, 0.02]
{phase}
name = "inflate"
duration_s = {last_s}
pressure_Pa = 4e3
"""
PLACES = {"left": (0.0, 0.01), "right": (3.0, -0.02)}


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def own(name: str, phase: str, last_s: float = 0.05) -> str:
    at, shift = PLACES[name]
    return OWN.format(at=at, there=at + 0.3, shift=shift, phase=phase, last_s=last_s)


def of_both(last_s: float = 0.05) -> str:
    lasting = {"left": 0.05, "right": last_s}
    arms = [f'[[arm]]\nname = "{name}"\n{own(name, "[[arm.phase]]", lasting[name])}' for name in PLACES]
    return "\n".join([SHARED, *arms])


def test_two_arms_far_apart_are_two_runs_with_one(tmp_path: Path) -> None:
    together = cosim.run_arms(written(tmp_path, "both", of_both()))
    for name in PLACES:
        first, mark, phases = own(name, "[[phase]]").partition("[[phase]]")
        text = SHARED.replace("[solver]", f"{first}[solver]") + mark + phases
        one, here = together[name], cosim.run(written(tmp_path, name, text), error=False)
        assert len(one.tick) == len(here.tick) == 51
        np.testing.assert_allclose(one.joint_position, here.joint_position, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(one.tip_position, here.tip_position, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(one.flange_force, here.flange_force, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(one.joint_torque, here.joint_torque, rtol=0.0, atol=1e-8)
        assert np.ptp(one.joint_position, axis=0).max() > 0.01


HELD: dict[str, Any] = {"clock.tick_s": 0.004}
for _arm in ("left", "right"):
    HELD |= {f"arm.{_arm}.phase.{name}.duration_s": 0.1 for name in ("carry", "hold")}
    HELD |= {f"arm.{_arm}.phase.carry.flange_shift_m": [0.0, 0.0, 0.0]}
    HELD |= {f"arm.{_arm}.phase.lift.flange_shift_m": [0.0, 0.0, 0.02]}


@pytest.fixture(scope="module")
def held() -> dict[str, cosim.RunResult]:
    """Two arms that have pressed a box and lift it a little."""
    return cosim.run_arms(HOLD, overrides=HELD)


def test_two_arms_hold_a_box_and_both_ledgers_balance(held: dict[str, cosim.RunResult]) -> None:
    for run in held.values():
        assert run.summary["status"] == "completed"
        assert run.summary["max_momentum_error"] < 1e-10
        box = run.stage.body_names.index("box")
        assert run.body_position[-1, box, 2] > run.body_position[0, box, 2] + 0.015


def test_both_arms_hold_the_box_and_neither_has_dropped_it(held: dict[str, cosim.RunResult]) -> None:
    for run in held.values():
        (box,) = run.summary["objects"]
        assert box["held"][-1]["until_s"] is None
        assert box["dropped_s"] == []


def test_the_box_gets_what_both_ledgers_hand_over(held: dict[str, cosim.RunResult]) -> None:
    """In the air m a is its weight and what both films press on it, tick by tick, to rounding.

    In n steps of h / n a speed v and a force lead to x + h v + h^2 a (n + 1) / 2 n.
    """
    left, right = held["left"], held["right"]
    box, mass, h = left.stage.body_names.index("box"), 0.3, left.stage.tick_s
    n = rigid_substeps(load_arms(HOLD, HELD).arms["left"])
    assert n > 1
    in_air = np.flatnonzero(left.phase >= 2)
    press = [run.body_contact_force[in_air, box] for run in (left, right)]
    np.testing.assert_array_equal(left.body_position, right.body_position)
    acceleration = sum(press) / mass + [0.0, 0.0, -9.81]
    before, after = acceleration[1:-1], acceleration[2:]
    change = np.diff(left.body_position[in_air, box], n=2, axis=0)
    wanted = h**2 * before + 0.5 * h**2 * (n + 1) / n * (after - before)
    assert np.abs(press).max(axis=(1, 2)).min() > 5.0
    np.testing.assert_allclose(mass * change / h, mass * wanted / h, rtol=0.0, atol=1e-10)


def test_an_arm_whose_phases_end_first_holds_until_the_others_end(tmp_path: Path) -> None:
    scenario = load_arms(written(tmp_path, "both", of_both(last_s=0.3)))
    ticks = {name: sum(one.ticks(phase) for phase in one.phases) for name, one in scenario.arms.items()}
    assert ticks == {"left": 175, "right": 175}
    assert scenario.arms["left"].phases[-1].settle_s == pytest.approx(0.25)


def test_what_ran_loads_to_the_same(tmp_path: Path) -> None:
    scenario = load_arms(HOLD)
    again = load_arms(written(tmp_path, "other", scenario.text()))
    assert again == scenario


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "key of an arm": ({"arm.left.phase.1.duration_s": -1.0}, "arm.left.phase.move.duration_s: -1"),
    "shared key": (
        {"arm.left.clock": {"tick_s": 0.001}},
        "arm.left.clock: is shared by all arms: give it above",
    ),
    "unknown key": ({"arm.left.robott": "ur3"}, "arm.left.robott: unknown key; did you mean robot or"),
    "shared value": ({"clock.tick_s": 1.0}, "clock.tick_s: 1"),
    "no such arm": ({"arm.middle.robot": "ur3"}, "arm.middle: no such arm; there are: left, right"),
    "statics": ({"mode": "quasistatic"}, "mode: several arms need 'dynamic'"),
    "scheme": ({"coupling.scheme": "iterated"}, "coupling.scheme: several arms need 'staggered'"),
    "no robot": ({"arm.right.robot": "none"}, "arm.right.arm_base: needs an arm"),
    "no phase": ({"arm.right.phase": []}, "arm.right.phase: is missing"),
    "name": (
        {"object": [{"name": "left", "shape": "sphere", "size_m": [0.1], "position_m": [9.0, 0.0, 1.0]}]},
        "arm.left: is the name of",
    ),
}


@pytest.mark.parametrize(("changes", "text"), WRONG.values(), ids=WRONG)
def test_what_several_arms_cannot_do_is_refused_by_key(
    changes: dict[str, Any], text: str, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError) as raised:
        load_arms(written(tmp_path, "both", of_both()), changes)
    assert text in str(raised.value)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("", "arm.2.name: is missing"),
        ('name = "left"', "arm.2.name: 'left' is the name of another arm"),
        ('name = "to the right"', "arm.2.name: 'to the right' must be a letter followed by"),
    ],
)
def test_each_arm_has_a_name_of_its_own(given: str, text: str, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as raised:
        load_arms(written(tmp_path, "both", of_both().replace('name = "right"', given)))
    assert text in str(raised.value)


def test_one_arm_alone_needs_no_table_of_arms(tmp_path: Path) -> None:
    alone = of_both().rpartition("[[arm]]")[0]
    with pytest.raises(ScenarioError, match=r"^arm: must be two or more tables \[\[arm\]\]"):
        load_arms(written(tmp_path, "one", alone))


def test_what_knows_one_arm_names_what_runs_several() -> None:
    for use in (cosim.Simulation, cosim.run, cosim.load_scenario, cosim.plan_path):
        with pytest.raises(InputError, match=r"arm: .*cosim run.*run_arms.*without \[\[arm\]\]"):
            use(HOLD)


def test_the_command_line_leaves_the_files_of_each_arm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario, out = written(tmp_path, "both", of_both()), tmp_path / "out"
    assert main(["check", str(scenario)]) == 0
    assert main(["run", str(scenario), "--out", str(out), "--set", "arm.left.start.pressure_Pa=3e3"]) == 0
    said = capsys.readouterr().err
    assert "left:" in said
    assert f"cosim view {out}" in said
    pressures = {}
    for name in PLACES:
        run = cosim.load_run(out / name)
        assert (run.summary["status"], len(run.tick)) == ("completed", 51)
        assert run.summary["error"]["reason"] == "error bars are known for runs of one arm only"
        pressures[name] = run.chamber_pressure_Pa[0, 0]
    assert pressures == {"left": 3e3, "right": 2e3}
    assert found_recordings(out / "left") == found_recordings(out) == [out / "recording.rrd"]
    with pytest.raises(InputError, match=rf"several arms, left, right; .* such as {out / 'left'}"):
        cosim.load_run(out)
    assert load_arms(out / "scenario.toml").arms["left"].start.pressure_Pa == 3e3
    assert main(["run", "--resume", str(out)]) == 2
    assert "start it again" in capsys.readouterr().err
    for option in (["--error"], ["--checkpoint-every", "5"]):
        assert main(["run", str(scenario), *option]) == 2
        assert capsys.readouterr().err.startswith(f"cosim: error: {option[0]}: several arms")


def test_arms_that_come_too_near_to_one_another_are_named_before_the_run() -> None:
    changes = {"arm.left.phase.carry.flange_shift_m": [0.25, 0.0, 0.1], "plan.clearance_m": 0.013}
    run = build_arms(load_arms(HOLD, changes).arms, lambda _text: None)
    for name, other in (("left", "right"), ("right", "left")):
        planned = run.runs[name].stage.arm
        assert planned is not None
        assert any(f"{name}/wrist" in line and f"{other}/wrist" in line for line in planned.warnings())
    with pytest.raises(
        ScenarioError, match=r"arm\.left\.phase\.\S+: left/soft robot touches right/soft robot"
    ):
        build_arms(load_arms(HOLD, changes | {"plan.collision": "refuse"}).arms, lambda _text: None)


def test_a_cell_that_drives_move_is_refused(tmp_path: Path) -> None:
    cell = tmp_path / "cell.xml"
    cell.write_text(
        "<mujoco><worldbody><body name='belt' pos='0 2 0.1'><joint type='slide'/>"
        "<geom type='box' size='.1 .1 .01'/></body></worldbody></mujoco>"
    )
    scenario = load_arms(written(tmp_path, "both", of_both()), {"scene.mjcf": str(cell)})
    with pytest.raises(ScenarioError, match=r"scene\.mjcf: has joints"):
        build_arms(scenario.arms, lambda _text: None)


def test_what_cannot_be_reached_is_named_with_its_arm() -> None:
    far = load_arms(HOLD, {"arm.right.phase.carry.flange_shift_m": [9.0, 0.0, 0.0]})
    with pytest.raises(ScenarioError, match=r"arm\.right\.phase\.carry\.flange_shift_m: arm 'ur5e' cannot"):
        build_arms(far.arms, lambda _text: None)


def test_a_film_that_cannot_be_made_is_named_with_its_arm() -> None:
    changes: dict[str, Any] = {"arm.right.soft_robot": {"file": "diamond_finger"}}
    changes |= {"arm.right.soft_robot.body.port_m": [0.5, 0.5]}
    fault = r"^arm\.right\.soft_robot\.body: port_m at .* is outside the sheet"
    with pytest.raises(ScenarioError, match=fault):
        cosim.run_arms(HOLD, overrides=changes)
    with pytest.raises(ScenarioError, match=fault):
        build_arms(load_arms(HOLD, changes).arms, lambda _text: None)


def test_arms_that_begin_in_one_another_are_refused_wherever_their_homes_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = of_both().replace("position_m = [3.0, 0.0, 0.0]", "position_m = [0.6, 0.0, 0.0]")
    near = written(tmp_path, "near", text.replace("[3.3, 0.0, 0.6]", "[0.35, 0.0, 0.6]"))
    for changes in ({}, {"plan.collision": "refuse"}):  # to lead the flange around it would not help
        with pytest.raises(ScenarioError, match=r"arm\.left\.start\.flange: the arm overlaps .* in right/"):
            build_arms(load_arms(near, changes).arms, lambda _text: None)
    assert main(["check", str(near)]) == 2
    assert f"{near}: arm.left.start.flange: the arm overlaps something" in capsys.readouterr().out
    apart = written(tmp_path, "apart", text.replace("[3.3, 0.0, 0.6]", "[0.6, -0.5, 0.6]"))
    build_arms(load_arms(apart).arms, lambda _text: None)
    assert main(["check", str(apart)]) == 0


FACING = """
schema = 2
title = "x"
robot = "ur5e"
soft_robot = "square_core"
[clock]
tick_s = 0.004
[[arm]]
name = "left"
arm_base = { position_m = [-0.65, 0.0, 0.0] }
start = { flange = { position_m = [-0.021, 0.0, 0.36], direction = [1.0, 0.0, 0.0] }, pressure_Pa = 10e3 }
[[arm.phase]]
name = "hold"
duration_s = 0.02
[[arm]]
name = "right"
arm_base = { position_m = [0.65, 0.0, 0.0], quaternion = [0.0, 0.0, 0.0, 1.0] }
start = { flange = { position_m = [0.021, 0.0, 0.36], direction = [-1.0, 0.0, 0.0] }, pressure_Pa = 10e3 }
[[arm.phase]]
name = "hold"
duration_s = 0.02
"""


def test_films_of_two_arms_that_are_in_one_another_are_reported_by_both(tmp_path: Path) -> None:
    found = cosim.run_arms(written(tmp_path, "facing", FACING))
    for name, other in (("left", "right"), ("right", "left")):
        summary = found[name].summary
        overlap = summary["overlaps"][-1]
        # tips of 30 mm face each other from 42 mm; deeper than 20 mm is not looked for
        assert overlap["arm"] == other
        assert 5e-3 < overlap["depth_m"] <= 20e-3
        assert any(f"passes through that of arm '{other}'" in text for text in summary["warnings"])
        left_out = {row["what"] for row in summary["modelled"] if not row["included"]}
        assert "contact with the films of other arms" in left_out
