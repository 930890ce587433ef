"""Arms by name and from files: what is kept of them, and what is found, replaced, and left out."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from cosim.base.files import changed_file, files_read
from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.config.loading import load_scenario
from cosim.errors import InputError, ScenarioError
from tests.config.arm_texts import TWO_JOINTS, scenario_with


def test_every_named_arm_is_found() -> None:
    for name in list_arms():
        arm = find_arm(name)
        assert arm.home.shape == (len(arm.joint_names),)
        assert arm.home_known
        assert arm.flange_frame in arm.urdf
        assert "package://" not in arm.urdf
    assert {"kinova", "panda", "so100", "so101", "ur10", "ur3", "ur5", "ur5e", "xarm7", "z1"} <= set(
        list_arms()
    )


def test_only_the_chain_to_the_flange_is_kept() -> None:
    arm = find_arm("panda")
    assert "panda_finger_joint1" in arm.path.read_text()
    assert "finger" not in arm.urdf
    assert arm.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert any("left out" in note and "panda_leftfinger" in note for note in arm.notes)


def test_unknown_name_lists_what_exists() -> None:
    with pytest.raises(InputError, match=r"no arm 'ur6'; did you mean 'ur\d+'\? There are: .*panda.*\.urdf"):
        find_arm("ur6")


def test_home_cannot_be_changed_by_accident() -> None:
    with pytest.raises(ValueError, match="read-only"):
        find_arm("ur5e").home[0] = 1.0


def test_a_file_of_ones_own_is_read(tmp_path: Path) -> None:
    path = tmp_path / "mine.urdf"
    path.write_text(TWO_JOINTS)
    arm = find_arm(str(path))
    assert (arm.name, arm.joint_names) == ("mine", ("swing", "lift"))
    assert arm.joint_kinds == ("revolute", "revolute")
    assert arm.flange_frame == "hand"
    assert "flange 'hand', the last link before the chain branches or ends" in arm.notes
    assert "home found far from singularities" in arm.notes


@pytest.mark.parametrize(
    ("names", "found", "how"),
    [
        ("tool0", "tool0", "by its name"),
        ("flange tool0", "tool0", "by its name"),
        ("tool0 attachment_site", "attachment_site", "by its name"),
        ("left_tool0 gripper", "left_tool0", "by the end of its name"),
        ("left_tool0 right_tool0", "hand", "the last link"),
        ("tip", "tip", "the last link"),
    ],
)
def test_the_flange_is_found(tmp_path: Path, names: str, found: str, how: str) -> None:
    frames = "".join(
        f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="hand"/>'
        f'<child link="{name}"/></joint>'
        for name in names.split()
    )
    path = tmp_path / "arm.urdf"
    path.write_text(TWO_JOINTS.replace("</robot>", f"{frames}</robot>"))
    arm = find_arm(str(path))
    assert arm.flange_frame == found
    assert arm.notes[0].startswith(f"flange '{found}', {how}")


def test_what_an_arm_toml_says_is_put_in(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(TWO_JOINTS)
    table = tmp_path / "arm.toml"
    table.write_text(
        'file = "arm.urdf"\nhome = [0.3, -0.2]\nbase.position_m = [0.0, 0.0, 1.0]\n'
        "limits.upper = [0.5, 0.6]\nlimits.acceleration = [4.0, 5.0]\nlimits.effort = [3.0, 2.0]\n"
        "servos.stiffness = [100.0, 50.0]\nservos.armature = [0.2, 0.1]\n"
        "adapter = { position_m = [0.0, 0.0, 0.02], mass_kg = 0.3 }\n"
    )
    arm = find_arm(str(table))
    assert arm.name == tmp_path.name
    np.testing.assert_array_equal(arm.home, [0.3, -0.2])
    np.testing.assert_array_equal(arm.acceleration_bound, [4.0, 5.0])
    np.testing.assert_array_equal(arm.armature, [0.2, 0.1])
    np.testing.assert_array_equal(arm.world_from_base.translation, [0.0, 0.0, 1.0])
    assert arm.flange_frame == "adapter"
    limits = [joint.find("limit") for joint in ElementTree.fromstring(arm.urdf).findall("joint")[:2]]
    assert [limit.get("upper") for limit in limits] == ["0.5", "0.6"]
    assert [limit.get("effort") for limit in limits] == ["3.0", "2.0"]
    assert arm.files[:2] == (table, tmp_path / "arm.urdf")


def test_packages_are_looked_for_above_the_file_and_where_an_arm_toml_says(tmp_path: Path) -> None:
    mesh = '<visual><geometry><mesh filename="package://parts/meshes/hand.obj"/></geometry></visual>'
    text = TWO_JOINTS.replace('<link name="hand">', f'<link name="hand">{mesh}')
    inside, beside = tmp_path / "parts" / "urdf" / "arm.urdf", tmp_path / "alone" / "arm.urdf"
    for path in (inside, beside, tmp_path / "parts" / "meshes" / "hand.obj"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert find_arm(str(inside)).files[-1] == tmp_path / "parts" / "meshes" / "hand.obj"
    assert find_arm(str(beside)).files[-1] == tmp_path / "parts" / "meshes" / "hand.obj"  # a folder above
    far = tmp_path / "elsewhere"
    far.mkdir()
    (tmp_path / "parts").rename(far / "parts")
    with pytest.raises(InputError, match=r"mesh 'package://parts/meshes/hand.obj' not found .*package_paths"):
        find_arm(str(beside))
    (beside.parent / "arm.toml").write_text('file = "arm.urdf"\npackage_paths = ["../elsewhere"]\n')
    assert find_arm(str(beside.parent / "arm.toml")).files[-1] == far / "parts" / "meshes" / "hand.obj"


def test_meshes_that_cannot_be_read_become_boxes_of_the_same_inertia(tmp_path: Path) -> None:
    """The hand is 1 kg with the inertia of a box of 0.1 m, 0.2 m, 0.3 m."""
    mesh = '<collision><geometry><mesh filename="hand.dae"/></geometry></collision>'
    moments = [(b * b + c * c) / 12.0 for b, c in ((0.2, 0.3), (0.1, 0.3), (0.1, 0.2))]
    inertia = f'<inertia ixx="{moments[0]!r}" iyy="{moments[1]!r}" izz="{moments[2]!r}"/>'
    text = TWO_JOINTS.replace('<link name="hand">', f'<link name="hand">{mesh}')
    head, tail = text.split('<link name="hand">')
    path = tmp_path / "arm.urdf"
    path.write_text(
        head + '<link name="hand">' + tail.replace('<inertia ixx="0.01" iyy="0.01" izz="0.01"/>', inertia)
    )
    (tmp_path / "hand.dae").write_text("<COLLADA/>")
    arm = find_arm(str(path))
    box = next(ElementTree.fromstring(arm.urdf).iter("box"))
    np.testing.assert_allclose(
        sorted(float(word) for word in box.get("size", "").split()), [0.1, 0.2, 0.3], rtol=1e-12
    )
    assert "meshes that cannot be read are replaced by boxes of the same inertia: hand" in arm.notes
    assert find_arm("kinova").notes[1].startswith("meshes that cannot be read are replaced")


def test_paths_in_a_scenario_start_from_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "lab"
    folder.mkdir()
    (folder / "mine.urdf").write_text(TWO_JOINTS)
    path = folder / "s.toml"
    path.write_text(scenario_with("mine.urdf"))
    scenario = load_scenario(path)
    assert scenario.robot == str(folder / "mine.urdf")
    assert load_scenario(scenario).robot == scenario.robot
    with pytest.raises(ScenarioError, match=r"robot: arm file .*other\.urdf does not exist"):
        load_scenario(path, {"robot": "other.urdf"})
    monkeypatch.chdir(folder)  # what the command line sets starts from where it is given
    assert load_scenario("ur5e_hexagon_arm", {"robot": "mine.urdf"}).robot == scenario.robot


def test_continuous_joints_get_limits_that_an_arm_toml_gives(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(
        TWO_JOINTS.replace('"lift" type="revolute"', '"lift" type="continuous"')
    )
    table = tmp_path / "arm.toml"
    table.write_text('file = "arm.urdf"\n')
    assert find_arm(str(table)).joint_kinds == ("revolute", "continuous")
    table.write_text('file = "arm.urdf"\nlimits.lower = [-1.0, -2.0]\nlimits.upper = [1.0, 2.0]\n')
    assert find_arm(str(table)).joint_kinds == ("revolute", "revolute")
    table.write_text('file = "arm.urdf"\nlimits.lower = [-1.0, -2.0]\n')
    with pytest.raises(InputError, match=r"joint 'lift': turns without limits; limits.lower alone"):
        find_arm(str(table))


def test_all_files_of_an_arm_count_among_what_a_run_was_loaded_from(tmp_path: Path) -> None:
    folder = tmp_path / "lab"
    folder.mkdir()
    (folder / "mine.urdf").write_text(TWO_JOINTS)
    (folder / "arm.toml").write_text('file = "mine.urdf"\n')
    (tmp_path / "s.toml").write_text(scenario_with("lab/arm.toml"))
    scenario = load_scenario(tmp_path / "s.toml")
    with files_read() as before:
        find_arm(scenario.robot)
    assert set(before) == {str(folder / "arm.toml"), str(folder / "mine.urdf")}
    assert changed_file(before) is None
    (folder / "arm.toml").write_text('file = "mine.urdf"\nhome = [0.1, 0.2]\n')
    assert changed_file(before) == str(folder / "arm.toml")


@pytest.mark.parametrize(
    ("name", "effort", "velocity"),
    [
        ("ur3", [56.0, 56.0, 28.0, 12.0, 12.0, 12.0], [180.0] * 3 + [360.0] * 3),
        ("ur5", [150.0] * 3 + [28.0] * 3, [180.0] * 6),
        ("ur5e", [150.0] * 3 + [28.0] * 3, [180.0] * 6),
        ("ur10", [330.0, 330.0, 150.0] + [56.0] * 3, [120.0] * 2 + [180.0] * 4),
        ("xarm7", [50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0], [180.0] * 7),
    ],
)
def test_named_arms_have_the_limits_that_their_makers_publish(
    name: str, effort: list[float], velocity: list[float]
) -> None:
    limits = [joint.find("limit") for joint in ElementTree.fromstring(find_arm(name).urdf).iter("joint")]
    found = [limit.attrib for limit in limits if limit is not None and float(limit.get("effort", "0")) > 0.0]
    assert [float(each["effort"]) for each in found] == effort
    assert np.rad2deg([float(each["velocity"]) for each in found]) == pytest.approx(velocity, rel=1e-6)


def test_an_arm_says_which_of_its_limits_are_assumed() -> None:
    assert find_arm("kinova").notes[-1] == "assumed limits, not from a data sheet: effort, velocity"
    assert not any("assumed" in note for note in find_arm("panda").notes)
