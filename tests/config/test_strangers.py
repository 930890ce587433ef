"""Files from strangers: what went wrong in trials is refused in one line that names the key.

The files are short ones of one scenario with a value, a name or a mesh put in; they are made here, as some
are long.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.app.preparation import build_simulation
from cosim.base.resources import list_soft_robots
from cosim.cli.main import main
from cosim.cli.screen import printable
from cosim.config.loading import load_scenario
from cosim.errors import ScenarioError

SHORT = """# Question: what does a short run do with this?
schema = 2
title = "short"
robot = "ur5e"
soft_robot = "hexagon_arm"
[clock]
tick_s = 0.002
[start]
flange = { position_m = [0.3, 0.0, 0.7], direction = [0.0, 0.0, -1.0], roll_rad = 0.0 }
[[phase]]
name = "inflate"
duration_s = 0.1
pressure_Pa = 30e3
[[phase]]
name = "move"
duration_s = 0.2
flange_shift_m = [0.02, 0.0, 0.0]
cable_tension_N = [1.0, 1.0]
"""
ROBOT = 'soft_robot = "hexagon_arm"'
FINEST = "stack = { units = 200, sides = 64, refine = 4, taper = 1.0 }"
MESH = '\n[[object]]\nname = "m"\nshape = "mesh"\nposition_m = [0.5, 0.0, 0.5]\nfile = "m.obj"\n'
WIRE = '[[wire]]\nname = "w"\npoints_m = [[0, 1, 1], [0, 2, 1]]\nradius_m = 1e-4\nsegments = 500\n'

CORNERS = "v 1 0 0\nv 0 1 0\nv 0 0 1\nv 0 0 0\n"
FACES = "f 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n"
PIECES = "".join(
    f"v {k} 0 0\nv {k}.1 0 0\nv {k} 0.1 0\nv {k} 0 0.1\nf -2 -3 -4\nf -1 -4 -3\nf -1 -3 -2\nf -1 -2 -4\n"
    for k in range(600)
)
# what is replaced, by what, the path that the refusal names, and a word of it
REPLACED = {
    "tick of nothing": ("tick_s = 0.002", "tick_s = 1e-300", "clock.tick_s", "at least 1e-06"),
    "endless phase": ("duration_s = 0.1", "duration_s = 1e300", "phase.inflate.duration_s", "1e+09"),
    "31 years": ("duration_s = 0.1", "duration_s = 1e9", "phase.inflate.duration_s", "5e+11 ticks"),
    "a million million increments": (
        "duration_s = 0.1",
        "duration_s = 0.1\nincrements = 1000000000000",
        "phase.inflate.increments",
        "at most 1e+06",
    ),
    "number of 5,000 digits": (
        "schema = 2",
        "schema = 2" + "0" * 5000,
        "scenario.toml",
        "more than 4300 digits",
    ),
    "number of 20,000 bits": ("schema = 2", "schema = 0x" + "f" * 5000, "schema", "20000 bits"),
    "the same for a length": (
        "[0.02,",
        "[0x" + "f" * 5000 + ",",
        "phase.move.flange_shift_m.1",
        "20000 bits",
    ),
    "2 km of shift": ("[0.02,", "[2000.0,", "phase.move.flange_shift_m.1", "within -100 and 100"),
    "900 brackets": ("schema = 2", "x = " + "[" * 900 + "]" * 900 + "\nschema = 2", "scenario.toml", "deep"),
    "120 brackets": ("schema = 2", "schema = " + "[" * 120 + "]" * 120, "schema", "allowed"),
    "name of 300 letters": (
        'title = "short"',
        f'title = "short"\nname = "{"n" * 300}"',
        "name",
        "300 characters",
    ),
    "phase of 300 letters": ('name = "move"', f'name = "{"n" * 300}"', "phase.2.name", "300 characters"),
    "robot of 300 letters": (ROBOT, f'soft_robot = "{"a" * 300}.toml"', "soft_robot", "no soft robot"),
    "path that may not be seen": (ROBOT, 'soft_robot = "/proc/1/x/y.toml"', "soft_robot", "no soft robot"),
    "null character": (ROBOT, r'soft_robot = "a\u0000b.toml"', "soft_robot", r"a\x00b"),
    "title that steers the terminal": (
        'title = "short"',
        r'title = "\u001b]0;pwn\u0007\u001b[2J"',
        "title",
        "control characters",
    ),
    "key that steers the terminal": (
        "schema = 2",
        '"\\u001b[2J\\n" = 1\nschema = 2',
        r'"\u001b[2J\n"',
        "unknown key",
    ),
    "key without a letter": ("schema = 2", '"" = 1\nschema = 2', '""', "unknown key"),
    "key of a million letters": (
        "schema = 2",
        "k" * 1_000_000 + " = 1\nschema = 2",
        "kkk",
        "1000000 characters",
    ),
    "title of a million letters": ('"short"', f'"{"t" * 1_000_000}"', "title", "1000000 characters"),
    "many phases": (
        "[[phase]]",
        '[[phase]]\nname = "p"\nduration_s = 1.0\n' * 20_000 + "[[phase]]",
        "phase",
        "20002",
    ),
    "finest mesh there could be": (
        ROBOT,
        f"soft_robot = {{ file = 'hexagon_arm', {FINEST} }}",
        "soft_robot.stack",
        "144,179,200 triangles",
    ),
    "number for a robot": (ROBOT, "soft_robot = 5", "soft_robot", "expected a table"),
    "list for a robot": (ROBOT, "soft_robot = [true]", "soft_robot", "expected a table"),
    "not a number for a robot": (ROBOT, "soft_robot = nan", "soft_robot", "expected a table"),
    "patterns": ('name = "move"', f'name = "move"\nclamp = ["{"*a" * 60}b"]', "phase.move.clamp", "no ring"),
    "turn without end": (
        "flange_shift_m = [0.02, 0.0, 0.0]",
        "flange_turn = { axis = [0.0, 0.0, 1.0], angle_rad = 8e3 }",
        "phase.move.flange_turn.angle_rad",
        "within -100 and 100",
    ),
    "shaken for hours": (
        "flange_shift_m = [0.02, 0.0, 0.0]",
        "flange_shake = { axis = [0, 0, 1], amplitude_m = 0.01, frequency_Hz = 9e3 }\nramp = 'linear'",
        "phase.move.flange_shake.frequency_Hz",
        "1800 periods",
    ),
    "wire as light as air": ("[clock]", f"{WIRE}mass_kg = 1e-9\n[clock]", "wire.w.mass_kg", "0.000125"),
    "mesh far away": ("[clock]", "[clock]", "object.m.file", "neither in the scenario's folder"),
}


def refusal(folder: Path, capsys: pytest.CaptureFixture[str], text: str | bytes = SHORT) -> str:
    """Run a scenario that must be refused and return what is said."""
    file, out = folder / "scenario.toml", folder / "out"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert main(["run", str(file), "--out", str(out)]) == 2
    assert not out.exists()
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("cosim: error: ")
    return said.removeprefix("cosim: error: ")


@pytest.mark.parametrize(("old", "new", "path", "word"), REPLACED.values(), ids=REPLACED)
def test_a_hostile_value_is_refused_in_one_line(
    old: str, new: str, path: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SHORT.replace(old, new, 1) + (MESH if "object.m" in path else "")
    said = refusal(tmp_path, capsys, text)
    place, _, problem = said.partition(": ")
    assert path in place
    assert word in problem
    assert len(said.replace(", ".join(list_soft_robots()), "")) < 600


MESHES = {
    "ragged": ("v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3", "vertex 2 has 2 coordinates"),
    "below the first vertex": (
        CORNERS + "f 1 2 -999999999999999999999",
        "names vertex -999999999999999999999",
    ),
    "as wide as floats go": (CORNERS.replace("1", "1e300") + FACES, "is 1e+300 wide"),
    "of a point": (CORNERS.replace("1", "1e-300") + FACES, "is 1e-300 wide"),
    "of 600 pieces": (PIECES, "600 shells"),
    "no mesh at all": ("root:x:0:0", "holds no triangles"),
}


@pytest.mark.parametrize(("content", "word"), MESHES.values(), ids=MESHES)
def test_a_hostile_mesh_is_refused_in_one_line(
    content: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.obj").write_text(content)
    said = refusal(tmp_path, capsys, SHORT + MESH)
    assert said.startswith("object.m.file: m.obj: " if "shells" not in word else "object.m.file: ")
    assert word in said


def test_a_scaled_mesh_stays_within_the_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.obj").write_text(CORNERS + FACES)
    said = refusal(tmp_path, capsys, SHORT + MESH + "scale = 1e4\n")
    assert said.startswith("object.m.scale: 10000 makes the mesh reach")


def test_what_the_rigid_engine_refuses_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball = (
        '[[object]]\nname = "{}"\nshape = "sphere"\nposition_m = [0, 0, 0.{}]\nsize_m = [{}]\nmass_kg = 1\n'
    )
    text = SHORT + ball.format("good", 5, 1e-2) + ball.format("bad", 6, 1e-8) + ball.format("fair", 7, 1e-2)
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=r"^object\.bad: MuJoCo refuses it: .*inertia") as caught:
        build_simulation(load_scenario(path))
    assert caught.value.path == "object.bad"


def test_a_wire_that_turns_back_is_named(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(SHORT + WIRE.replace("[0, 2, 1]", "[0, 2, 1], [0, 1.001, 1]") + "mass_kg = 1.0\n")
    with pytest.raises(ScenarioError, match="3 segments, the shortest") as caught:
        load_scenario(path, {"wire.w.radius_m": 1.5e-3, "wire.w.segments": 3})
    assert caught.value.path == "wire.w.segments"


def test_a_flange_far_out_of_reach_is_refused_before_its_way_is_followed() -> None:
    far = {"phase": [{"name": "away", "duration_s": 1.0, "flange_shift_m": [90.0, 0.0, 0.0]}]}
    with pytest.raises(ScenarioError, match="the arm's reach is") as caught:
        build_simulation(load_scenario("ur5e_hexagon_arm", far))
    assert caught.value.path == "phase.away.flange_shift_m"


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_other_encodings_are_refused(
    encoding: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SHORT.replace("short", "kürzer")
    assert "is not UTF-8 text" in refusal(tmp_path, capsys, text.encode(encoding))


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    path = tmp_path / "short.toml"
    path.write_bytes(b"\xef\xbb\xbf" + SHORT.encode())
    assert load_scenario(path).title == "short"


def test_a_file_of_many_megabytes_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "is longer than" in refusal(tmp_path, capsys, b"# x\n" * 2_000_000 + SHORT.encode())


@pytest.mark.parametrize("text", ['file = "loop.toml"', '[[attach]]\nname = "a"\nrobot = "loop.toml"'])
def test_a_robot_that_holds_itself_is_refused(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "loop.toml").write_text(text)
    said = refusal(tmp_path, capsys, SHORT.replace("hexagon_arm", "loop.toml"))
    assert said.startswith("soft_robot.")
    assert "'loop.toml' leads back to itself" in said


@pytest.mark.parametrize(("files", "word"), [(22, "after 8 files"), (7, "one robot too many")])
def test_files_that_attach_twice_each_are_refused(
    files: int, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k in range(files):
        robot = "hexagon_arm" if k == files - 1 else f"l{k + 1}.toml"
        attached = [f'[[attach]]\nname = "{name}"\nrobot = "{robot}"\n' for name in "ab"]
        (tmp_path / f"l{k}.toml").write_text('file = "hexagon_arm"\n' + "".join(attached))
    said = refusal(tmp_path, capsys, SHORT.replace("hexagon_arm", "l0.toml"))
    assert said.startswith("soft_robot.attach.a.robot")
    assert word in said


def test_tensions_by_name_beside_a_wrong_robot_or_start_are_not_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by_name = SHORT.replace("[1.0, 1.0]", "{ left = 1.0 }")
    number = by_name.replace('"hexagon_arm"', "0.3")
    assert refusal(tmp_path, capsys, number).startswith("soft_robot: expected a table, got the number 0.3")
    start = by_name.replace("[start]", "[start]\ncable_tension_N = 5")
    assert refusal(tmp_path, capsys, start).startswith("start.cable_tension_N: expected a list or a table")


def test_what_is_printed_cannot_steer_the_terminal() -> None:
    assert printable("\x1b[2J\tm\u00e9\u202e\n\x9b\x00") == "\\x1b[2J\tm\u00e9\\u202e\n\\x9b\\x00"


def test_a_name_that_no_file_has_is_cut() -> None:
    with pytest.raises(ScenarioError, match=r"no soft robot 'a{200}\.\.\.'") as caught:
        load_scenario("ur5e_hexagon_arm", {"soft_robot": "a" * 5000})
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("scenario", ["bellows_gripper_lifts_box", "pouch_gripper_lifts_ball"])
def test_a_name_of_a_mesh_or_a_drawing_that_is_not_there_is_cut(scenario: str) -> None:
    with pytest.raises(ScenarioError, match=r"no file '.*b{50}\.\.\.' beside") as caught:
        load_scenario(scenario, {"soft_robot.body.file": f"{'b' * 5000}.dxf"})
    assert len(str(caught.value)) < 1000
