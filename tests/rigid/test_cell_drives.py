"""Joints of a cell go where the phases say, and carry what lies on them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build.arms import find_arm
from cosim.config.loading import load_scenario
from cosim.errors import InputError
from cosim.rigid.build.cell import read_cell
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene

CELL = """<mujoco><default><geom friction="0.8 0.005 0.0001"/></default><worldbody>
<body name="belt" pos="0.6 0 0.1"><joint name="belt" type="slide" axis="0 1 0" range="-0.1 0.5"/>
<geom type="box" size="0.2 0.6 0.1"/>
<body name="lid" pos="0 -0.6 0.15"><joint type="hinge" axis="1 0 0"/>
<geom type="box" size="0.1 0.02 0.05"/></body></body>
<body name="rail" pos="0.6 0 0.05"><geom type="box" size="0.1 0.8 0.06"/></body>
</worldbody></mujoco>
"""
SCENARIO = """schema = 2
title = "a conveyor"
robot = "ur5e"
soft_robot = "gripper_finger"
fidelity = "rigid"
clock.tick_s = 0.002

[start]
flange.position_m = [0.3, -0.4, 0.5]
flange.direction = [0.0, 0.0, -1.0]

[scene]
mjcf = "cell.xml"

[[phase]]
name = "run"
duration_s = 0.4
settle_s = 0.1
cell_speed_m_s = { belt = 0.2 }
cell_angle_rad = { lid = 0.3 }

[[phase]]
name = "on"
duration_s = 0.1

[[phase]]
name = "stop"
duration_s = 0.2
settle_s = 0.1
cell_shift_m = { belt = 0.15 }
"""
BOX = """
[[object]]
name = "box"
shape = "box"
size_m = [0.1, 0.1, 0.1]
position_m = [0.6, 0.0, 0.25]
mass_kg = 0.5
"""


def written(folder: Path, more: str = "", cell: str = CELL) -> Path:
    (folder / "cell.xml").write_text(cell, encoding="utf-8")
    path = folder / "s.toml"
    path.write_text(SCENARIO + more, encoding="utf-8")
    return path


def track(result: cosim.Result, body: str) -> Any:
    return result.body_position[:, result.stage.body_names.index(body)]


def test_a_belt_runs_as_the_phases_say_and_carries_what_lies_on_it(tmp_path: Path) -> None:
    """The belt stands in its rail, in the floor and in an object, which do not hold it."""
    foot = (
        BOX.replace('"box"\nshape', '"foot"\nshape').replace("0.25]", "0.1]").replace("mass_kg = 0.5\n", "")
    )
    result = cosim.run(written(tmp_path, BOX + foot))
    t, belt, box = result.time_s, track(result, "cell/belt"), track(result, "box")
    # at an even speed for 0.6 s, the second phase says nothing; then to its place along the quintic
    expected = np.where(t <= 0.6, 0.2 * t, np.nan)
    u = np.clip((t - 0.6) / 0.2, 0.0, 1.0)
    ramped = 0.12 + 0.03 * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
    np.testing.assert_allclose(belt[:, 1], np.where(t <= 0.6, expected, ramped), atol=1e-12)
    assert np.abs(belt[:, [0, 2]] - belt[0, [0, 2]]).max() == 0.0
    # v^2 / (2 mu g) is slipped where the belt starts at once, and back where it stops; beside that some
    # 10 ms go by until MuJoCo's contacts bear the weight
    slip = 0.2**2 / (2.0 * 0.8 * 9.81)
    assert box[t.searchsorted(0.5), 1] == pytest.approx(0.1 - slip, abs=1e-3)
    assert box[-1, 1] == pytest.approx(0.15, abs=1e-3)
    turned = result.body_quaternion[-1, result.stage.body_names.index("cell/lid")]
    np.testing.assert_allclose(turned, [np.cos(0.15), np.sin(0.15), 0.0, 0.0], atol=1e-12)


def test_what_pushes_a_drive_does_not_move_it(tmp_path: Path) -> None:
    scene = RigidScene(SceneDescription(find_arm("ur5e"), cell=read_cell(_cell(tmp_path))))
    body = np.array([scene.body_names.index("cell/belt")])
    for _ in range(5):
        scene.bodies.apply(body, np.array([[0.0, 1e3, 0.0]]), np.zeros((1, 3)))
        scene.cell.aim(np.array([0.0, 0.0]), np.zeros(2))
        scene.step()
    assert np.abs(scene.body_poses()[0][body[0], 1]) == 0.0
    assert not scene.bodies.movable(body).any()


def test_film_is_dragged_along(tmp_path: Path) -> None:
    """Where it presses, the belt gets the film's friction against its motion."""
    path = written(tmp_path)
    text = SCENARIO.partition('[[phase]]\nname = "on"')[0].replace("settle_s = 0.1", "")
    path.write_text(text.replace('fidelity = "rigid"', ""), encoding="utf-8")
    changes = {
        "start.flange.position_m": [0.6, 0.0, 0.253], "phase.run.cell_speed_m_s.belt": 0.01,
        "phase.run.duration_s": 0.06,
        "solver.integrator": "implicit_euler",  # the film settles on the belt at once
    }  # fmt: skip
    result = cosim.run(path, overrides=changes)
    force = result.body_contact_force[-1, result.stage.body_names.index("cell/belt")]
    assert force[2] < -0.01
    assert force[1] < -0.1 * abs(force[2])
    assert "cell/belt, cell/lid can move" in result.stage.report


def test_a_planned_way_into_what_moves_is_foreseen(tmp_path: Path) -> None:
    """The belt's lid comes to the arm, which stands still."""
    cell = CELL.replace('pos="0 -0.6 0.15"', 'pos="-0.3 -0.5 0.35"').replace(
        '"0.1 0.02 0.05"', '"0.1 0.02 0.2"'
    )
    words = r"phase\.(run|on).*(wrist|forearm)\w+ touches cell/lid from 0\."
    with pytest.raises(cosim.ScenarioError, match=words):
        cosim.run(written(tmp_path, cell=cell), overrides={"plan.collision": "refuse"})


def _cell(folder: Path, text: str = CELL) -> Path:
    path = folder / "cell.xml"
    path.write_text(text, encoding="utf-8")
    return path


REFUSED = {
    "unknown": ({"phase.run.cell_speed_m_s": {"band": 0.1}}, r"phase\.run\.cell_speed_m_s\.band: .*belt"),
    "turns": ({"phase.run.cell_angle_rad": {"belt": 0.1}}, r"cell_angle_rad\.belt: .*lid"),
    "twice": ({"phase.run.cell_shift_m": {"belt": 0.1}}, r"belt: is given a place and a speed"),
    "too far": (
        {"phase.stop.cell_shift_m": {"belt": 0.6}},
        r"phase\.stop\.cell_shift_m\.belt: .*-0\.1 to 0\.5 m",
    ),
    "statics": ({"mode": "quasistatic"}, r"phase\.run\.cell_angle_rad: needs mode = 'dynamic'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_driven_is_refused(tmp_path: Path, case: str) -> None:
    changes, words = REFUSED[case]
    with pytest.raises(cosim.ScenarioError, match=words):
        cosim.run(written(tmp_path), overrides=changes)


def test_drives_need_a_cell(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace('[scene]\nmjcf = "cell.xml"\n', ""))
    with pytest.raises(InputError, match=r"cell_speed_m_s: needs a cell"):
        load_scenario(path)


def test_a_run_goes_on_from_the_middle_of_a_drive(tmp_path: Path) -> None:
    whole = cosim.Simulation(written(tmp_path, BOX))
    whole.step(100)
    state = whole.save()
    there = whole.step(50)
    whole.restore(state)
    again = whole.step(50)
    np.testing.assert_array_equal(there.body_position, again.body_position)
