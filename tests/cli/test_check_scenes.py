"""`cosim check` of scenarios finds what only the arm and its cell can say, by key, without a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.cli.main import main

CELL = """\
<mujoco>
  <worldbody>
    <body name="belt" pos="0.75 0 0.3">
      <joint name="belt" type="slide" axis="0 1 0" range="-0.1 0.1" limited="true"/>
      <geom type="box" size="0.1 0.3 0.01"/>
    </body>
    <body name="door" pos="0 0.9 0.3"><joint name="door"/><geom type="box" size="0.1 0.01 0.2"/></body>
  </worldbody>
</mujoco>
"""
SCENARIO = """\
schema = 2
title = "A finger goes down beside a belt"
robot = "{robot}"
soft_robot = "gripper_finger"
scene.mjcf = "cell.xml"
start.flange = {{ position_m = [{x}, 0.0, 0.7], direction = [0.0, 0.0, -1.0] }}

[[phase]]
name = "down"
duration_s = 0.5
flange_shift_m = [0.0, 0.0, {shift}]
{drive}

[[phase]]
name = "hold"
duration_s = 0.2
{later}
"""
POST = """
[[object]]
name = "post"
shape = "box"
size_m = [0.2, 0.2, 0.2]
position_m = [0.4, 0.0, 0.75]
"""
FINE = {"robot": "ur5e", "x": 0.4, "shift": -0.1, "drive": "cell_shift_m.belt = 0.05", "later": ""}


def said_of(changes: dict[str, object], folder: Path, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return the faults that are told of the scenario with some changes, as lines without the file's name."""
    file = folder / "mine.toml"
    (folder / "cell.xml").write_text(CELL, encoding="utf-8")
    file.write_text(SCENARIO.format(**FINE | changes), encoding="utf-8")
    code = main(["check", str(file)])
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(f"{file}: ") for line in lines)
    told = [line.removeprefix(f"{file}: ") for line in lines]
    assert code == (0 if told == ["fine"] else 2)
    return told


@pytest.mark.parametrize(
    ("changes", "starts"),
    [
        ({}, ["fine"]),
        ({"x": 1.4}, ["start.flange: arm 'ur5e' cannot bring its flange to (1.4000, 0.0000, 0.7000) m"]),
        ({"shift": -2.5}, ["phase.down.flange_shift_m: arm 'ur5e' cannot bring its flange to"]),
        ({"x": 0.1, "shift": 0.0}, ["start.flange: arm 'ur5e' cannot bring its flange to"]),
        ({"later": POST}, ["start.flange: the arm overlaps something: "]),
        (
            {"drive": "cell_shift_m.bellt = 0.05", "later": "cell_speed_m_s.door = 0.1"},
            [
                "phase.down.cell_shift_m.bellt: no slide of the cell 'bellt'; did you mean 'belt'?",
                "phase.hold.cell_speed_m_s.door: no slide of the cell 'door'",
            ],
        ),
        (
            {"drive": "cell_shift_m.belt = 0.2", "later": "cell_angle_rad.door = 0.3"},
            ["phase.down.cell_shift_m.belt: takes the cell's joint to 0.2 m; its range is -0.1 to 0.1 m"],
        ),
        (
            {
                "robot": "so100",
                "drive": "cell_shift_m.nothing = 0.1",
                "later": "tip_target.position_m = [0.2, 0.0, 0.2]",
            },
            ["phase.hold.tip_target: arm 'so100' has 5 joints", "phase.down.cell_shift_m.nothing: no slide"],
        ),
    ],
    ids=[
        "fine",
        "start too far",
        "way too far",
        "start too near",
        "start in an object",
        "joints of the cell",
        "range of the cell",
        "arm and cell",
    ],
)
def test_what_is_wrong_is_named_by_key(
    changes: dict[str, object], starts: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = said_of(changes, tmp_path, capsys)
    assert len(told) == len(starts), told
    assert all(line.startswith(start) for line, start in zip(told, starts, strict=True)), told


def test_an_arm_that_would_stand_in_the_floor_begins_otherwise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The configuration nearest to home has the upper arm 9 mm deep in the floor; others stand clear."""
    file = tmp_path / "low.toml"
    file.write_text(
        'schema = 2\ntitle = "x"\nrobot = "ur10"\nsoft_robot = "square_core"\n'
        "start.flange = { position_m = [0.0, -0.7, 0.5], direction = [0.0, 0.0, -1.0] }\n"
        '[[phase]]\nname = "wait"\nduration_s = 0.1\n',
        encoding="utf-8",
    )
    code = main(["check", str(file)])
    assert (code, capsys.readouterr().out) == (0, f"{file}: fine\n")
