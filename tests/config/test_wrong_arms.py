"""Wrong files of arms are refused by the name of what is wrong: one line, exit code 2, nothing runs."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cosim.base.resources import arm_path, robots_directory
from cosim.build.arms import find_arm
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.kinematics.arm import Arm
from cosim.plan.flange_motion import pose_of
from tests.config.arm_texts import INERTIAL, TWO_JOINTS, scenario_with

LIFT_LIMIT = '<limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>'
HAND = f'<link name="hand">{INERTIAL}</link>'
MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
BOX = '<collision><geometry><box size="0.1 0 0.1"/></geometry></collision>'
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/></joint></robot>'

# (text that is replaced, by what, words of the refusal)
WRONG = {
    "no XML": ("</robot>", "", "is not XML"),
    "no URDF": (TWO_JOINTS, "<sdf/>", "its first element is <sdf>"),
    "MJCF": (TWO_JOINTS, "<mujoco/>", "an MJCF file ends in .xml"),
    "xacro": ("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', None),
    "macro": (
        "</robot>", '<x:if xmlns:x="http://www.ros.org/wiki/xacro"/></robot>',
        r"xacro arm\.urdf > arm\.plain\.urdf$",
    ),
    "entities": ("<robot", '<!DOCTYPE r [<!ENTITY a "b">]><robot', "declares a document type"),
    "huge": ("</robot>", "</robot>" + " " * 4_000_000, "is longer than 4000000 bytes"),
    "not text": ("two", "\udcff", "is not UTF-8 text: byte 13"),
    "no links": (TWO_JOINTS, "<robot/>", "0 joints move the flange 'world'"),
    "too many links": ("</robot>", '<link name="a"/>' * 500 + "</robot>", "has 503 links; at most 500"),
    "deep": ("</robot>", f"{400 * '<x>'}{400 * '</x>'}</robot>", "is nested too deeply; at most 300 levels"),
    "another root": ("</robot>", '<link name="cart"/></robot>', None),
    "no joint": ("revolute", "fixed", "0 joints move the flange 'hand'"),
    "floating": ('"lift" type="revolute"', '"lift" type="floating"', "joint 'lift' is 'floating'"),
    "planar": ('"lift" type="revolute"', '"lift" type="planar"', "joint 'lift' is 'planar'"),
    "no limits": (LIFT_LIMIT, "</joint></robot>", "joint 'lift': its limits leave no way: .* or make it "),
    "no way": (LIFT_LIMIT, LIFT_LIMIT.replace("-1", "1"), "joint 'lift': its limits leave no way: lower 1"),
    "effort": (LIFT_LIMIT, LIFT_LIMIT.replace('"10"', '"-10"'), "joint 'lift': its effort limit is -10;"),
    "acceleration": (LIFT_LIMIT, LIFT_LIMIT.replace("/>", ' acceleration="0"/>'), "limit is 0; give"),
    "words": (LIFT_LIMIT, LIFT_LIMIT.replace('"10"', '"much"'), "joint 'lift': effort 'much' is no number"),
    "mimic": (LIFT_LIMIT, f'<mimic joint="swing"/>{LIFT_LIMIT}', "joint 'lift': it mimics another joint"),
    "not a number": ("0.3 0 0", "nan 0 0", "<origin>: xyz is 'nan 0 0'; every number must be finite"),
    "far away": ("0.3 0 0", "1e9 0 0", "link 'hand': body_pos 1e.09 is too large; at most 1e.07"),
    "no mesh": ("<inertial>", f"{MESH.format('hand.stl')}<inertial>", "mesh 'hand.stl' not found"),
    "no package": (
        "<inertial>", f"{MESH.format('package://lab/hand.stl')}<inertial>",
        "mesh 'package://lab/hand.stl' not found .* package_paths",
    ),
    "heavy": (HAND, HAND.replace('value="1"', 'value="1e30"'), "link 'hand': body_mass 1e.30 is too large"),
}  # fmt: skip

# what MuJoCo refuses, as a tree, by its names, as it reads and compiles links and shapes: (replaced, by what)
REFUSED = {
    "circle": ("</robot>", JOINT.format("back", "fixed", "hand", "root")),
    "two joints of a name": ('"lift"', '"swing"'),
    "no mass": (HAND, HAND.replace('<mass value="1"/>', "")),
    "inertia": (HAND, HAND.replace('izz="0.01"', 'izz="0.03"')),
    "no shape": ("<inertial>", "<visual/><inertial>"),
    "flat box": ("<inertial>", f"{BOX}<inertial>"),
}

# (text of an arm.toml, words of the refusal)
WRONG_TABLES = {
    "no file": ("", "robot.file: is missing"),
    "unknown key": ('file = "arm.urdf"\nflang = "hand"', "robot.flang: unknown key; did you mean flange"),
    "file that is not there": ('file = "leg.urdf"', "file 'leg.urdf' not found"),
    "package folder that is not there": (
        'file = "arm.urdf"\npackage_paths = [".", "none"]',
        "robot.package_paths.2: '.*none' is no folder that can be read: No such file",
    ),
    "package folder that is a file": (
        'file = "arm.urdf"\npackage_paths = ["arm.urdf"]', "robot.package_paths.1: .*: Not a directory",
    ),
    "package folder of a long name": (
        f'file = "arm.urdf"\npackage_paths = ["{300 * "x"}"]', "robot.package_paths.1: .* too long",
    ),
    "home that is no number": ('file = "arm.urdf"\nhome = [nan, 0.0]', "robot.home.1"),
    "infinite limit": ('file = "arm.urdf"\nlimits.upper = [1.0, inf]', "robot.limits.upper.2"),
    "flange that is not there": ('file = "arm.urdf"\nflange = "foot"', "no link, body or site 'foot'; there"),
    "home of three": ('file = "arm.urdf"\nhome = [0, 0, 0]', "home has 3 entries; there are 2 joints: swing"),
    "home outside": ('file = "arm.urdf"\nhome = [0.0, 2.0]', "joint 'lift': its home 2 is outside its"),
    "limits of one": ('file = "arm.urdf"\nlimits.upper = [1.0]', "limits.upper has 1 entries"),
    "no way": ('file = "arm.urdf"\nlimits.upper = [1.0, -2.0]', "joint 'lift': its limits leave no way"),
    "armature": ('file = "arm.urdf"\nservos.armature = [-1.0, 0.0]', "robot.servos.armature.1: -1"),
    "adapter": (
        'file = "arm.urdf"\nadapter = { position_m = [0.0, 0.0, 0.0], mass_kg = 1.0 }',
        "an adapter of length 0 has no mass",
    ),
}  # fmt: skip


def refusal(robot: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that `cosim check` says about a file of an arm."""
    assert main(["check", str(robot)]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize("case", WRONG)
def test_wrong_urdf(tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    before, after, words = WRONG[case]
    assert before in TWO_JOINTS
    path = tmp_path / "arm.urdf"
    path.write_bytes(TWO_JOINTS.replace(before, after).encode("utf-8", "surrogateescape"))
    if words is None:  # the name of the namespace alone is no macro; what is off the chain is left out
        assert main(["check", str(path)]) == 0
        return
    line = refusal(path, capsys)
    assert line.startswith(str(path))
    assert re.search(words, line), line


@pytest.mark.parametrize("case", REFUSED)
def test_what_mujoco_refuses_is_refused_with_the_file(
    tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before, after = REFUSED[case]
    assert before in TWO_JOINTS
    path = tmp_path / "arm.urdf"
    path.write_text(TWO_JOINTS.replace(before, after))
    line = refusal(path, capsys)
    assert re.match(f"{path}: .*MuJoCo refuses ", line), line
    assert len(line) < 800


@pytest.mark.parametrize(("name", "plain"), [("arm.urdf.xacro", "arm.urdf"), ("arm.xacro", "arm.urdf")])
def test_a_file_of_macros_is_to_be_expanded_beside_itself(
    tmp_path: Path, name: str, plain: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_text(TWO_JOINTS)
    assert refusal(path, capsys).endswith(f"expand them first: xacro {name} > {plain}")


@pytest.mark.parametrize("case", WRONG_TABLES)
def test_wrong_arm_toml(tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    text, words = WRONG_TABLES[case]
    (tmp_path / "arm.urdf").write_text(TWO_JOINTS)
    path = tmp_path / "arm.toml"
    path.write_text(text)
    assert re.search(words, refusal(path, capsys))


def joined(name: str, kind: str, parent: str, child: str) -> str:
    """Return a link on a joint."""
    joint = JOINT.format(name, kind, parent, child).removesuffix("</robot>")
    joint = joint.replace("</joint>", '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>')
    return f'<link name="{child}">{INERTIAL}</link>{joint}'


def test_a_flange_that_nothing_moves_is_refused_with_the_ends_of_chains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a robot that branches at its root: most joints first, none behind a joint that is not handled."""
    left = joined("shoulder", "revolute", "root", "left") + joined("pad", "fixed", "left", "left_pad")
    beyond = joined("ball", "floating", "hand", "ball") + joined("wheel", "revolute", "ball", "wheel")
    still = joined("bolt", "fixed", "root", "plate")
    path = tmp_path / "arm.urdf"
    path.write_text(TWO_JOINTS.replace("</robot>", f"{left}{beyond}{still}</robot>"))
    line = refusal(path, capsys)
    assert "0 joints move the flange 'root';" in line
    assert line.endswith("such as (joints that move it): 'hand' (2), 'left_pad' (1)"), line


def test_a_chain_that_is_too_long_is_refused_with_its_last_usable_link(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = "".join(
        joined(f"j{k}", "revolute", f"l{k - 1}" if k > 3 else "hand", f"l{k}") for k in range(3, 13)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(TWO_JOINTS.replace("</robot>", f"{more}</robot>"))
    line = refusal(path, capsys)
    assert "12 joints move the flange 'l12'" in line
    assert line.endswith("(joints that move it): 'l10' (10)"), line


def test_a_scenario_on_a_wrong_arm_is_refused_by_check_and_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.urdf").write_text(TWO_JOINTS.replace('value="1"', 'value="-1"'))
    path = tmp_path / "s.toml"
    path.write_text(scenario_with("arm.urdf"))
    assert main(["check", str(path)]) == 2
    assert "robot: arm file" in capsys.readouterr().out
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("cosim: error: robot: arm file") == 1
    assert not (tmp_path / "out").exists()


def test_arms_with_too_few_joints_are_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.urdf").write_text(TWO_JOINTS)
    path = tmp_path / "s.toml"
    path.write_text(scenario_with("arm.urdf"))
    assert main(["run", str(path), "--quiet", "--no-recording", "--out", str(tmp_path / "out")]) == 2
    text = capsys.readouterr().err
    assert "robot: arm 'arm' has 2 joints (swing, lift); at least 4 are needed" in text


def test_fine_arms_are_told_what_was_found(capsys: pytest.CaptureFixture[str]) -> None:
    path = robots_directory() / "ur5e" / "ur5e.urdf"
    assert main(["check", str(path)]) == 0
    line = capsys.readouterr().out
    assert "fine: 6 joints; flange 'tool0', by its name; home found" in line
    assert "both engines agree" in line
    assert main(["list", "arms"]) == 0
    assert "ur5e    6 joints, flange 'tool0'  Universal Robots UR5e" in capsys.readouterr().out


def test_joints_without_a_bound_of_torque_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (robots_directory() / "ur5e" / "ur5e.urdf").read_text(encoding="utf-8")
    bare = re.sub(r'(<joint name="elbow_joint".*?<limit [^>]*?) effort="[^"]*"', r"\1", text, flags=re.DOTALL)
    assert bare != text
    (tmp_path / "arm.urdf").write_text(bare, encoding="utf-8")
    assert main(["check", str(tmp_path / "arm.urdf")]) == 0
    assert "; no effort limit in the file, so none is checked: elbow_joint; " in capsys.readouterr().out


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_the_home_that_is_told_is_a_start(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The line that is printed, put into a scenario, is the pose of the home, its roll included."""
    assert main(["check", str(arm_path(name))]) == 0
    told = re.search(r"at home: (start\.flange = \{.*?\})", capsys.readouterr().out)
    assert told is not None
    start = tomllib.loads(told[1])["start"]
    asked = pose_of(load_scenario("ur5e_hexagon_arm", {"start": start}).start.flange)
    file = find_arm(name)
    home = Arm(file).forward(file.home)
    assert np.allclose(asked.translation, home.translation, atol=1e-4)
    assert np.allclose(asked.rotation, home.rotation, atol=3e-4)


def test_an_arm_at_the_end_of_a_long_row_of_links_is_read(tmp_path: Path) -> None:
    row = "".join(
        f'<link name="l{k}"/><joint name="f{k}" type="fixed"><parent link="{f"l{k - 1}" if k else "hand"}"/>'
        f'<child link="l{k}"/></joint>'
        for k in range(480)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(TWO_JOINTS.replace("</robot>", f"{row}</robot>"))
    assert main(["check", str(path)]) == 0
