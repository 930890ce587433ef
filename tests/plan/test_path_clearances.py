"""A planned way through something is refused, warned of or let pass, by link, object and time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.frames import Pose
from cosim.build.simulation import build
from cosim.cli.main import EXIT_INPUT, main
from cosim.config.loading import load_scenario
from cosim.config.schema.settings import PlanTable
from cosim.kinematics.clearance import Clearance
from cosim.plan.path_clearance import path_clearances
from cosim.plan.required_motion import required_motion

SCENARIO = """schema = 2
title = "a finger beside a table"
robot = "ur5e"
soft_robot = "gripper_finger"
fidelity = "rigid"

[start]
flange.position_m = {start}
flange.direction = {direction}

[[phase]]
name = "hang"
duration_s = 0.1

[[phase]]
name = "down"
duration_s = 1.0
flange_shift_m = {shift}

[[object]]
name = "table"
shape = "box"
size_m = {size}
position_m = {place}
"""
ELBOW = {
    "start": [0.3, 0.0, 0.7], "direction": [0.0, 0.0, -1.0], "shift": [0.1, 0.0, -0.25],
    "size": [0.06, 0.4, 0.06], "place": [0.05, 0.0, 0.57],
}  # fmt: skip
FINGER = ELBOW | {"size": [0.2, 0.2, 0.1], "place": [0.4, 0.0, 0.38]}


def written(folder: Path, more: str = "", **values: object) -> Path:
    path = folder / "s.toml"
    path.write_text(SCENARIO.format(**(ELBOW | values)) + more, encoding="utf-8")
    return path


def test_a_path_through_a_table_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = written(tmp_path), tmp_path / "out"
    assert main(["run", str(path), "--set", "plan.collision=refuse", "--out", str(out)]) == EXIT_INPUT
    said = capsys.readouterr().err
    assert not out.exists()
    assert "phase.down.flange_shift_m: forearm_link touches table from 0." in said
    assert "s on, in phase 'down', up to" in said
    assert "plan.collision = 'warn'" in said
    with pytest.raises(cosim.ScenarioError, match="forearm_link touches table") as refusal:
        cosim.run(path, overrides={"plan.collision": "refuse"})
    # the first instant of the planned way at which MuJoCo sees them overlap
    scenario = load_scenario(path)
    simulation = build(scenario)
    scene, asked = simulation._parts.carrier._scene, required_motion(simulation._parts.plan, 0.002)
    overlap = [bool(scene.links.at(q)) for q in asked.joints.position]
    assert f"from {asked.time_s[overlap.index(True)]:.3f} s on" in str(refusal.value)


def test_it_is_warned_of_or_nobody_looks(tmp_path: Path) -> None:
    warned = build(load_scenario(written(tmp_path))).stage.arm
    assert warned is not None
    (line,) = warned.warnings()
    assert line.startswith("planned: forearm_link touches table from 0.")
    figures = json.loads(json.dumps(warned.figures()))
    assert figures["clearance"]["links"]["distance_m"] == pytest.approx(-figures["contacts"][0]["depth_m"])
    assert figures["clearance"]["soft_robot"]["distance_m"] > 0.01
    unseen = build(load_scenario(written(tmp_path), {"plan.collision": "off"})).stage.arm
    assert unseen is not None
    assert unseen.warnings() == []
    assert unseen.figures()["clearance"] is None


def test_a_way_that_only_comes_near_counts_within_the_clearance_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path, place=[0.05, 0.35, 0.57])
    arm = build(load_scenario(path, {"plan.collision": "refuse"})).stage.arm
    assert arm is not None
    nearest = arm.figures()["clearance"]["links"]
    assert 0.0 < nearest["distance_m"] < 0.2
    assert nearest["other"] == "table"
    more = {"plan.collision": "refuse", "plan.clearance_m": nearest["distance_m"] + 1e-6}
    with pytest.raises(cosim.ScenarioError, match=f"{nearest['link']} comes near table"):
        build(load_scenario(path, more))
    build(load_scenario(path, more | {"plan.clearance_m": nearest["distance_m"] - 1e-6}))


def test_the_soft_robot_may_touch_what_its_contact_is_modelled_with(tmp_path: Path) -> None:
    path, refuse = written(tmp_path, **FINGER), {"plan.collision": "refuse"}
    arm = build(load_scenario(path, refuse)).stage.arm
    assert arm is not None
    assert arm.figures()["clearance"]["soft_robot"]["distance_m"] < 0.0
    assert arm.warnings() == []
    with pytest.raises(cosim.ScenarioError, match=r"phase\.down\..*: soft robot touches table from"):
        build(load_scenario(path, refuse | {"contact.enabled": False}))


def test_pairs_that_are_passed_over_are_no_nearer(tmp_path: Path) -> None:
    simulation = build(load_scenario(written(tmp_path, place=[0.05, 0.35, 0.57])))
    parts = simulation._parts
    scene, asked = parts.carrier._scene, required_motion(parts.plan, 0.002)
    quick = path_clearances(scene, parts.plan, parts.soft.body, PlanTable(), film_touches=True)
    assert quick is not None
    assert quick.links is not None
    found = scene.links.solids()
    clearance = Clearance(found.solids)
    least = np.inf
    for q in asked.joints.position:
        between = clearance.at(*scene.dynamics.places(q))
        least = min(least, *(between(a, b) for a in found.links for b in found.others))
    assert quick.links.distance_m == pytest.approx(least, abs=1e-12)


BASES = {
    "table": ([0.0, 0.0, 0.4], [1.0, 0.0, 0.0, 0.0]),
    "wall": (
        [0.0, 0.0, 1.0],
        [0.7071067811865476, 0.0, 0.7071067811865476, 0.0],
    ),  # its z axis is the world's x
    "ceiling": ([0.0, 0.0, 1.6], [0.0, 1.0, 0.0, 0.0]),
}
PLATE = """
[[object]]
name = "plate"
shape = "box"
size_m = [1.2, 1.2, 0.04]
position_m = {place}
quaternion = {quaternion}
"""


@pytest.mark.parametrize("where", BASES)
def test_an_arm_on_a_table_a_wall_or_a_ceiling(tmp_path: Path, where: str) -> None:
    """The plate that it stands on is below its base, and is not in its way, unless it is led into it."""
    position, quaternion = BASES[where]
    base = Pose.from_quaternion(np.array(quaternion), np.array(position))
    start, mouth = base.apply(np.array([[0.35, 0.1, 0.45]]))[0], base.rotation @ [0.0, 0.0, -1.0]
    sideways = base.rotation @ [0.0, 0.1, 0.0]
    plate = PLATE.format(place=base.apply(np.array([[0.0, 0.0, -0.021]]))[0].tolist(), quaternion=quaternion)
    path = written(
        tmp_path, plate, start=start.tolist(), direction=mouth.tolist(), shift=sideways.tolist(),
        place=[0.0, 5.0, 0.0],
    )  # fmt: skip
    stand = {"arm_base.position_m": position, "arm_base.quaternion": quaternion}
    refuse = stand | {"plan.collision": "refuse", "contact.enabled": False}
    simulation = build(load_scenario(path, refuse))
    np.testing.assert_allclose(simulation._parts.plan.start.translation, start)
    assert simulation.stage.arm is not None
    into = (base.rotation @ [0.0, 0.1, -0.44]).tolist()
    with pytest.raises(cosim.ScenarioError, match="soft robot touches plate from"):
        build(load_scenario(path, refuse | {"phase.down.flange_shift_m": into}))


def test_a_base_needs_an_arm() -> None:
    with pytest.raises(cosim.ScenarioError, match="arm_base: needs an arm"):
        load_scenario("pumped_arm", {"arm_base.position_m": [0.0, 0.0, 1.0]})
