"""Files of schema 1 become files of schema 2: keys are renamed, all else stays as it is."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.resources import scenario_path, soft_robot_path
from cosim.cli.main import EXIT_INPUT, EXIT_UNWRITTEN, main
from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.upgrading import upgraded
from cosim.errors import ScenarioError
from tests.fuzz.tables import toml_text

SCENARIO = '''# Question: what becomes of [chamber]?
schema = 1                       # schema = 1 once
robot = "none"
title = """
schema = 1
[chamber]
a \\"" quote"""""
"soft_robot" = { file = 'arm.toml', chamber = { units = 2 }, frame.kind = "stiff" , "film".law = "plain" }
gravity_m_s2 = [ # schema = 1, chamber = 2
    0.0, 0.0,
    -9.81, ]

  [ "chamber" ]  # chamber
closed=true

[start]
flange = { position_m = [0.0, 0.0, 0.0], direction = [0.0, 0.0, 1.0] }

[[ phase ]]
name = 'chamber'
duration_s = 1.0
increments = 1_0
pressure_Pa.chamber = 10e3

[[pump]]
name = "pump"
schema = 1                       # of nothing
chamber = "chamber"
flow_kg_s = 1e-4
'''
NOW = (
    SCENARIO.replace("schema = 1                    ", "schema = 2                    ", 1)
    .replace(", chamber = { units", ", stack = { units")
    .replace("frame.kind", "stiffener.kind")
    .replace('[ "chamber" ]', "[ model ]")
)
ROBOT = "schema=1\r\nfile = 'hexagon_arm'\r\n'chamber'.refine = 0\r\n\r\n[frame]\r\nkind = \"stiff\"\r\n"
CABLE = '[[cable]]\r\nname = "a"\r\ncorner = 0\r\nunits = [1, 2]\r\ncapstan_factor = 0.8 # frame\r\n'
ATTACHED = """schema = 1
file = "hexagon_arm"
cable = []
[[attach]]
name = "one"
robot = { file = "arm.toml", chamber.units = 2, attach = [{ name = "two", robot.chamber.units = 1 }] }
[[attach]]
name = "frame"
[attach.robot]
schema = 1
[attach.robot.chamber]
units = 2
"""


def test_only_keys_of_renamed_tables_and_the_number_change() -> None:
    assert upgraded(SCENARIO) == (NOW, 4)
    assert upgraded(NOW) == (NOW, 0)


def test_line_ends_and_a_byte_order_mark_stay() -> None:
    text = "\ufeff" + ROBOT + CABLE
    new = (
        text.replace("schema=1", "schema=2").replace("'chamber'.", "stack.").replace("[frame]", "[stiffener]")
    )
    assert upgraded(text) == (new, 3)


def test_robots_that_are_carried_change_as_well() -> None:
    new, count = upgraded(ATTACHED)
    assert count == 5
    table = tomllib.loads(new)
    assert table["attach"][0]["robot"]["stack"] == {"units": 2}
    assert table["attach"][0]["robot"]["attach"][0]["robot"] == {"stack": {"units": 1}}
    assert table["attach"][1]["robot"] == {"schema": 2, "stack": {"units": 2}}
    assert table["attach"][1]["name"] == "frame"


def test_keys_that_are_no_more_go_with_their_line() -> None:
    text = NOW.replace("closed=true\n", "closed=true\nhandover = true  # to the film\n")
    assert upgraded(text) == (NOW, 1)
    dotted = "schema = 2\nrobot = 'none'\nmodel.handover = false"
    assert upgraded(dotted) == ("schema = 2\nrobot = 'none'\n", 1)
    solver = "schema = 2\nrobot = 'none'\n[solver]\nsubstep_error_m = 1e-5\ndamping_per_s = 2.0\n"
    assert upgraded(solver) == (solver.replace("substep_error_m = 1e-5\n", ""), 1)
    with pytest.raises(ValueError, match="not alone on its line"):
        upgraded("schema = 2\nrobot = 'none'\nmodel = { handover = true }\n")


def as_before(text: str) -> str:
    """Return a file of today as schema 1 would have it."""
    changes = (("schema = 2", "schema = 1"), ("[stack]", "[chamber]"), ("[model]", "[chamber]"))
    for new, old in (*changes, ("[stiffener]", "[frame]")):
        text = text.replace(new, old)
    return text


def test_files_are_rewritten_in_place_and_load(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario, robot = tmp_path / "mine.toml", tmp_path / "soft_arm.toml"
    text = scenario_path("ur5e_hexagon_arm").read_text()
    arm = soft_robot_path("framed_hexagon_arm").read_text()
    scenario.write_text(as_before(text).replace('"hexagon_arm"', '"soft_arm.toml"'))
    robot.write_text(as_before(arm))
    with pytest.raises(ScenarioError, match=r"^schema: is 1, .*cosim upgrade FILE"):
        load_scenario(scenario)
    assert main(["upgrade", str(scenario), str(robot)]) == 0
    assert capsys.readouterr().out == (
        f"{scenario}: upgraded to schema 2, 2 changes; "
        "only a run shows: whether the tip can follow phase 'lift', 'reach'\n"
        f"{robot}: upgraded to schema 2, 3 changes\n"
    )
    assert robot.read_text() == arm
    assert scenario.read_text() == text.replace('"hexagon_arm"', '"soft_arm.toml"')
    assert load_soft_robot(robot) == load_soft_robot("framed_hexagon_arm")
    assert main(["upgrade", str(robot)]) == 0
    assert capsys.readouterr().out == f"{robot}: nothing to upgrade\n"


def test_old_keys_are_refused_by_their_new_names() -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario("ur5e_hexagon_arm", {"chamber.closed": True, "soft_robot.frame": {}, "schema": 1})
    remedy = "; rewrite the file: cosim upgrade FILE"
    assert set(caught.value.faults) == {
        ("chamber", f"is called model since schema 2{remedy}"),
        ("soft_robot.frame", f"is called stiffener since schema 2{remedy}"),
        ("schema", f"is 1, that of older files{remedy}"),
    }


def test_an_old_key_of_a_robot_is_not_told_as_missing_too(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(as_before(soft_robot_path("square_core").read_text()))
    with pytest.raises(ScenarioError) as caught:
        load_soft_robot(path)
    old = ["soft_robot.schema", "soft_robot.chamber", "soft_robot.frame"]
    assert [place for place, _ in caught.value.faults] == old


@pytest.mark.parametrize(
    ("text", "word"),
    [("schema = ", "is not TOML"), ("[stack]\n[chamber]\n", "cannot be rewritten, do it by hand")],
)
def test_what_cannot_be_rewritten_stays(
    text: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    assert main(["upgrade", str(path)]) == 2
    assert word in capsys.readouterr().err
    assert path.read_text() == text
    assert [entry.name for entry in tmp_path.iterdir()] == ["mine.toml"]


def test_a_file_that_is_wrong_otherwise_is_upgraded_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('schema = 1\nname = "x"\n[chamber]\nsides = 2\n')
    assert main(["upgrade", str(path)]) == 2
    assert f"{path}: soft_robot.stack.sides: 2 is out of bounds" in capsys.readouterr().out
    assert path.read_text() == 'schema = 2\nname = "x"\n[stack]\nsides = 2\n'


KEYS = st.sampled_from(
    ["chamber", "frame", "schema", "attach", "robot", "soft_robot", "a b", "\"'", "x", "#"]
)
VALUES = st.recursive(
    st.integers(-9, 9) | st.booleans() | st.text(max_size=5).filter(str.isprintable),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=12,
)


@settings(deadline=None)
@given(st.dictionaries(KEYS, VALUES))
def test_every_old_key_of_a_text_is_found(table: dict[str, object]) -> None:
    upgraded(toml_text(table))  # checks what it has made against the tables


def old_file(folder: Path) -> Path:
    path = folder / "robot.toml"
    path.write_text(ROBOT, encoding="utf-8", newline="")
    return path


def test_links_and_mode_of_an_upgraded_file_stay(tmp_path: Path) -> None:
    path = old_file(tmp_path)
    path.chmod(0o600)
    (tmp_path / "hard.toml").hardlink_to(path)
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "soft.toml").symlink_to("../robot.toml")
    main(["upgrade", str(tmp_path / "far" / "soft.toml")])
    assert (tmp_path / "far" / "soft.toml").readlink() == Path("../robot.toml")
    assert path.samefile(tmp_path / "hard.toml")
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.read_bytes().decode() == upgraded(ROBOT)[0] != ROBOT
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["far", "hard.toml", "robot.toml"]
    assert [entry.name for entry in (tmp_path / "far").iterdir()] == ["soft.toml"]


def test_a_read_only_file_is_not_upgraded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = old_file(tmp_path)
    path.chmod(0o444)  # which holds for root as well
    assert main(["upgrade", str(path)]) == EXIT_INPUT
    told = capsys.readouterr().err
    assert f"{path}: is read-only and not upgraded" in told
    assert path.read_bytes().decode() == ROBOT
    subprocess.run(told.strip().rpartition("first: ")[2].split(), check=True)
    main(["upgrade", str(path)])
    assert path.read_bytes().decode() == upgraded(ROBOT)[0]


def test_files_beside_a_read_only_one_are_upgraded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = []
    for name in ("first", "second", "third", "fourth"):
        (tmp_path / name).mkdir()
        paths.append(old_file(tmp_path / name))
    locked = paths[1:3]
    for path in locked:
        path.chmod(0o444)
    assert main(["upgrade", *map(str, paths)]) == EXIT_INPUT
    told = capsys.readouterr().err
    assert all(f"{path}: is read-only and not upgraded" in told for path in locked)
    for path in paths:
        assert path.read_bytes().decode() == (ROBOT if path in locked else upgraded(ROBOT)[0])
    assert main(["upgrade", str(paths[0]), str(tmp_path / "absent.toml")]) == EXIT_INPUT


def test_a_file_that_cannot_be_written_whole_stays_as_it_was(tmp_path: Path) -> None:
    path, text = old_file(tmp_path), ROBOT.replace("'chamber'", "chamber")
    path.write_text(text, encoding="utf-8", newline="")
    assert len(upgraded(text)[0]) > len(text)
    # no file may become longer than this one: the disk is full for what upgrading adds
    code = (
        "import resource, sys; from cosim.cli.main import main; import cosim.cli.checking, cosim.cli.files;"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({len(text)}, {len(text)}));"
        f"sys.exit(main(['upgrade', {str(path)!r}]))"
    )
    ran = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr.count("\n")) == (EXIT_UNWRITTEN, 1), ran.stderr
    assert f"{path}: cannot be written: File too large" in ran.stderr
    assert path.read_bytes().decode() == text
    assert [entry.name for entry in tmp_path.iterdir()] == ["robot.toml"]
