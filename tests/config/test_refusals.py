"""Wrong scenarios are refused on the command line: one clear line, exit code 2, nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.resources import scenario_path
from cosim.cli.main import main

REFERENCE = "ur5e_hexagon_arm"

# a target that is reached with cables forbids tensions, whatever their number
TWO_FAULTS = {"phase.lift.cable_tension_N=[1, 2, 3]"}
# (assignment, key path in the message, word in the message)
WRONG_VALUES = {
    "unknown key": ("clock.tck_s=0.001", "clock.tck_s", "did you mean tick_s"),
    "unknown section": ("sollver.integrator=bdf2", "sollver", "did you mean solver"),
    "calibration": ("model.calibrated=true", "model.calibrated", 'film.law = "wrinkling"'),
    "other unit": ("phase.inflate.pressure_kPa=30", "phase.inflate.pressure_kPa", "write pressure_Pa"),
    "no unit": ("phase.inflate.duration=3", "phase.inflate.duration", "write duration_s"),
    "no such unit": ("contact.stiffness=1e8", "contact.stiffness", "write stiffness_N_m3 (in N/m^3"),
    "text for a number": ("phase.inflate.pressure_Pa=30kPa", "phase.inflate.pressure_Pa", "'30kPa'"),
    "bool for a number": ("clock.tick_s=true", "clock.tick_s", "expected a number"),
    "number for a text": ("title=3", "title", "expected a text"),
    "number for a switch": ("model.closed=1", "model.closed", "true or false"),
    "fraction for a count": ("phase.1.increments=2.5", "phase.hang.increments", "whole number"),
    "number for a table": ("clock=0.002", "clock", "expected a table"),
    "nan": ("phase.inflate.pressure_Pa=nan", "phase.inflate.pressure_Pa", "finite"),
    "infinity": ("phase.inflate.duration_s=inf", "phase.inflate.duration_s", "finite"),
    "zero tick": ("clock.tick_s=0", "clock.tick_s", "above 0"),
    "negative duration": ("phase.turn.duration_s=-1", "phase.turn.duration_s", "above 0"),
    "shorter than a tick": ("phase.turn.duration_s=0.0001", "phase.turn.duration_s", "shorter than a tick"),
    "negative thickness": ("soft_robot.film.thickness_m=-1e-4", "soft_robot.film.thickness_m", "above 0"),
    "poisson ratio": ("soft_robot.film.poisson_ratio=0.5", "soft_robot.film.poisson_ratio", "below 0.5"),
    "unknown film law": ("soft_robot.film.law=tension", "soft_robot.film.law", "'tension_field'"),
    "part of a law": (
        "soft_robot.film.compressive_fraction=0.1",
        "soft_robot.film.compressive_fraction",
        'film.law = "wrinkling"',
    ),
    "panels of a plain film": (
        'soft_robot={file="hexagon_arm",film={law="plain",wrinkle_panel_m=0.02}}',
        "soft_robot.film.wrinkle_panel_m",
        "'wrinkling'; the law is 'plain'",
    ),
    "buckling of a plain film": (
        'soft_robot={file="hexagon_arm",film={law="plain",buckling_force_N_m=10.0}}',
        "soft_robot.film.buckling_force_N_m",
        "'tension_field'; the law is 'plain'",
    ),
    "fabric beside a modulus": (
        'soft_robot={file="hexagon_arm",film={law="plain",fabric='
        "{modulus_warp_Pa=1e9,modulus_weft_Pa=1e9,shear_modulus_Pa=1e8}}}",
        "soft_robot.film.young_modulus_Pa",
        "both are given",
    ),
    "unknown frame": ("soft_robot.stiffener.kind=rigid", "soft_robot.stiffener.kind", "'stiff'"),
    "limp frame": ("soft_robot.stiffener.stiffness_N_m=0", "soft_robot.stiffener.stiffness_N_m", "above 0"),
    "beam without a section": (
        'soft_robot={file="framed_hexagon_arm",stiffener={kind="beam"}}',
        "soft_robot.stiffener.width_m",
        "missing; needed with kind = 'beam'",
    ),
    "section without a beam": (
        'soft_robot={file="hexagon_arm",stiffener={kind="none",height_m=2e-3}}',
        "soft_robot.stiffener.height_m",
        "the kind is 'none'",
    ),
    "unknown hinge rule": ("soft_robot.hinge.rule=plate", "soft_robot.hinge.rule", "'shell'"),
    "below vacuum": ("start.pressure_Pa=-2e5", "start.pressure_Pa", "at least -100000"),
    "unknown robot": ("robot=ur6e", "robot", "there are"),
    "unknown soft robot": ("soft_robot=hexagon_leg", "soft_robot", "hexagon_arm"),
    "unknown mode": ("mode=static", "mode", "'quasistatic'"),
    "vector of two": ("gravity_m_s2=[0, -9.81]", "gravity_m_s2", "must have 3"),
    "no direction": ("start.flange.direction=[0, 0, 0]", "start.flange.direction", "must not be zero"),
    "duplicate phase": ("phase.turn.name=lift", "phase.lift", "used twice"),
    "no phase": ("phase=[]", "phase", "holds its start without end"),
    "phase that is not there": ("phase.bend.pressure_Pa=1", "phase.bend", "inflate"),
    "missing key": ('phase=[{name="only"}]', "phase.only.duration_s", "missing"),
    "tension without cable": (
        "phase.lift.cable_tension_N=[1, 2, 3]",
        "phase.lift.cable_tension_N",
        "2 cables",
    ),
    "pushing cable": ("phase.lift.cable_tension_N=[1, -2]", "phase.lift.cable_tension_N.2", "at least 0"),
    "cable through no corner": ("soft_robot.cable.left.corner=6", "soft_robot.cable.left.corner", "0 to 5"),
    "cable through no unit": (
        "soft_robot.cable.left.units=[1, 11]",
        "soft_robot.cable.left.units",
        "1 to 10",
    ),
    "two friction laws": ("soft_robot.cable.left.friction_coefficient=0.1", "soft_robot.cable.left", "both"),
    "unknown ring": ('phase.lift.clamp=["unit_11.outer"]', "phase.lift.clamp", "unit_11.outer"),
    "hole wider than unit": (
        "soft_robot.stack.hole_radius_m=0.04",
        "soft_robot.stack.hole_radius_m",
        "below",
    ),
    "two poses at once": ("phase.turn.flange={position_m=[0,0,1],direction=[0,0,1]}", "phase.turn", "flange"),
    "target and motion": (
        "phase.turn.tip_target={position_m=[0,0,1]}",
        "phase.turn.flange_turn",
        "tip_target",
    ),
    "height without cables": ("phase.reach.tip_target={height_m=0.6}", "phase.reach.tip_target", "cables"),
    "damping that there is not": (
        "solver.stiffness_damping_s=0.01",
        "solver.stiffness_damping_s",
        "unknown key",
    ),
    "later schema": ("schema=3", "schema", "allowed: 2"),
    "size of a shape": (
        'object=[{name="ball",shape="sphere",size_m=[1,1],position_m=[0,0,0]}]',
        "object.ball.size_m",
        "a sphere has 1",
    ),
    "object of nothing": ('object=[{name="ball",position_m=[0,0,0]}]', "object.ball", "give a shape"),
    "unknown shape": (
        'object=[{name="ball",shape="cone",position_m=[0,0,0]}]',
        "object.ball.shape",
        "'ellipsoid', 'mesh'",
    ),
    "size of a part": (
        'object=[{name="plant",position_m=[0,0,0],part=[{shape="box",size_m=[1]}]}]',
        "object.plant.part.1.size_m",
        "a box has 3",
    ),
    "mesh without file": (
        'object=[{name="spool",shape="mesh",position_m=[0,0,0]}]',
        "object.spool.file",
        "is missing",
    ),
    "file of a ball": (
        'object=[{name="ball",shape="sphere",size_m=[1],file="spool.obj",position_m=[0,0,0]}]',
        "object.ball.file",
        "shape = 'mesh'",
    ),
    "two joints": (
        'object=[{name="lid",shape="sphere",size_m=[1],position_m=[0,0,0],mass_kg=1,'
        "hinge={axis=[0,0,1],anchor_m=[0,0,0]},slide={axis=[0,0,1]}}]",
        "object.lid.slide",
        "combined with hinge",
    ),
    "hinge without mass": (
        'object=[{name="lid",shape="sphere",size_m=[1],position_m=[0,0,0],slide={axis=[0,0,1]}}]',
        "object.lid.mass_kg",
        "is missing",
    ),
    "parent that is not there": (
        'object=[{name="lid",shape="sphere",size_m=[1],position_m=[0,0,0],mass_kg=1,'
        'slide={axis=[0,0,1],parent="box"}}]',
        "object.lid.slide.parent",
        "no object 'box'",
    ),
    "range without the start": (
        'object=[{name="lid",shape="sphere",size_m=[1],position_m=[0,0,0],mass_kg=1,'
        "hinge={axis=[0,0,1],anchor_m=[0,0,0],range_rad=[0.1,1]}}]",
        "object.lid.hinge.range_rad",
        "hold 0",
    ),
    "object that hangs on itself": (
        'object=[{name="lid",shape="sphere",size_m=[1],position_m=[0,0,0],mass_kg=1,'
        'slide={axis=[0,0,1],parent="lid"}}]',
        "object.lid",
        "lid on lid",
    ),
    "wire on nothing": (
        'wire=[{name="cord",points_m=[[0,0,0],[0,0,1]],radius_m=0.01,mass_kg=1,first="spool"}]',
        "wire.cord.first",
        "no object 'spool'",
    ),
    "wire of pearls": (
        'wire=[{name="cord",points_m=[[0,0,0],[0,0,1]],radius_m=0.03,mass_kg=1}]',
        "wire.cord.segments",
        "fewer than 16",
    ),
    "wire named like a wire": (
        'wire=[{name="a",points_m=[[0,0,0],[0,0,1]],radius_m=0.01,mass_kg=1},'
        '{name="a",points_m=[[0,0,0],[0,0,1]],radius_m=0.01,mass_kg=1}]',
        "wire.a",
        "used twice",
    ),
    "shake on a smooth ramp": (
        "phase.inflate.flange_shake={axis=[1,0,0],amplitude_m=0.01,frequency_Hz=2}",
        "phase.inflate.ramp",
        "linear",
    ),
    "shake of two periods": (
        'phase=[{name="a",duration_s=1,ramp="linear",flange_shake={axis=[1,0,0],amplitude_m=0.01,frequency_Hz=2}}]',
        "phase.a.duration_s",
        "3 periods",
    ),
    "mesh that is not there": (
        'object=[{name="spool",shape="mesh",file="reel.stl",position_m=[0,0,0]}]',
        "object.spool.file",
        "spool.obj",
    ),
}


def refused(arguments: list[str], directory: Path, capsys: pytest.CaptureFixture[str], lines: int = 1) -> str:
    """Run, check exit code 2 and that nothing was written; return the first line of the error."""
    assert main([*arguments, "--out", str(directory / "out")]) == 2
    assert not (directory / "out").exists()
    captured = capsys.readouterr()
    assert captured.out == ""
    told: list[str] = captured.err.splitlines()
    assert len(told) == lines
    return told[0]


@pytest.mark.parametrize(("assignment", "path", "word"), WRONG_VALUES.values(), ids=WRONG_VALUES.keys())
def test_wrong_values_are_refused(
    assignment: str, path: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = 2 if assignment in TWO_FAULTS else 1
    line = refused(["run", REFERENCE, "--set", assignment], tmp_path, capsys, lines)
    assert line.startswith(f"cosim: error: {path}")
    assert word.lower() in line.lower()


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("broken.toml", b"schema = ", "is not TOML"),
        ("latin.toml", b'title = "\xe9"', "is not UTF-8"),
        ("twice.toml", b"schema = 2\nschema = 2\n", "is not TOML"),
    ],
)
def test_wrong_files_are_refused(
    name: str, content: bytes, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert word in refused(["run", str(path)], tmp_path, capsys)


def test_every_missing_key_of_a_file_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "empty.toml"
    path.write_text("")
    assert main(["run", str(path)]) == 2
    told = capsys.readouterr().err.splitlines()
    keys = ("schema", "title", "robot", "soft_robot", "start")
    assert told == [f"cosim: error: {key}: is missing; it has no default" for key in keys]


def test_a_missing_scenario_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert REFERENCE in refused(["run", "ur5e_hexagon"], tmp_path, capsys)
    assert "no scenario" in refused(["run", str(tmp_path / "nope.toml")], tmp_path, capsys)


def test_an_unfinished_assignment_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "key=value" in refused(["run", REFERENCE, "--set", "mode"], tmp_path, capsys)


def test_a_foreign_directory_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("precious", encoding="utf-8")
    assert main(["run", REFERENCE, "--out", str(tmp_path)]) == 2
    assert "not known to be results of cosim (thesis.tex)" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_an_open_mesh_beside_the_scenario_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "leaf.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    scenario = tmp_path / "mine.toml"
    scenario.write_text(scenario_path(REFERENCE).read_text(encoding="utf-8"), encoding="utf-8")
    wrong = 'object=[{name="leaf",shape="mesh",file="leaf.obj",position_m=[0,0,0]}]'
    line = refused(["run", str(scenario), "--set", wrong], tmp_path, capsys)
    assert "object.leaf.file: leaf.obj: is not closed: 3 of 3 edges" in line


def test_units_are_recognised_in_files_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = scenario_path(REFERENCE).read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("tick_s = 0.01 ", "tick_ms = 2"), encoding="utf-8")
    assert "clock.tick_ms: unknown key" in refused(["run", str(path)], tmp_path, capsys)
