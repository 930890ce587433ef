"""Arms in MuJoCo's own format: the chain that both engines are given is that of the file."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cosim.build.arms import find_arm
from cosim.build.engine_agreement import check_engines_agree
from cosim.cli.main import main
from cosim.errors import InputError
from cosim.kinematics.arm import Arm
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene
from tests.config.arm_texts import GANTRY_MJCF, SIX_JOINTS_MJCF

GRIPPER = """<body name="hand" pos="0 0 0.1"><inertial pos="0 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>
<body name="left"><joint name="l" type="slide" range="0 1"/><geom size="0.01 0.01"/></body>
<body name="right"><joint name="r" type="slide" range="0 1"/><geom size="0.01 0.01"/></body></body>
<camera name="eye"/>"""
MESH = '<asset><mesh name="m" vertex="0.1 0 0  0 0.1 0  0 0 0.1  0 0 0"/></asset><worldbody>'


def written(tmp_path: Path, text: str) -> str:
    """Return the path of an MJCF."""
    path = tmp_path / "six.xml"
    path.write_text(text)
    return str(path)


# Rounding: poses and matrices go through roll, pitch and yaw.
@pytest.mark.parametrize("text", [SIX_JOINTS_MJCF, GANTRY_MJCF], ids=["six joints", "gantry"])
def test_both_engines_have_the_arm_of_the_file(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    model = mujoco.MjModel.from_xml_path(path)
    model.opt.gravity = (0.0, 0.0, -9.81)
    data = mujoco.MjData(model)
    file = find_arm(path)
    scene, arm = RigidScene(SceneDescription(file)), Arm(file)
    check_engines_agree(scene, arm, file.armature)
    rng = np.random.default_rng(3)
    site = model.site("attachment_site").id
    for _ in range(100):
        q = rng.uniform(*arm.drawn_from)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        pose, here = arm.forward(q), scene.dynamics.at(q)
        np.testing.assert_allclose(pose.translation, data.site_xpos[site], atol=1e-12)
        np.testing.assert_allclose(pose.rotation, data.site_xmat[site].reshape(3, 3), atol=1e-12)
        mass = np.empty((6, 6))
        mujoco.mj_fullM(model, data, mass)
        np.testing.assert_allclose(here.mass_matrix, mass, atol=1e-12 * np.abs(mass).max())
        np.testing.assert_allclose(here.gravity_torque, data.qfrc_bias, atol=1e-11)


def test_what_the_file_says_is_kept(tmp_path: Path) -> None:
    arm = find_arm(written(tmp_path, SIX_JOINTS_MJCF))
    assert arm.joint_names == ("j1", "j2", "j3", "j4", "j5", "j6")
    assert arm.joint_kinds == ("revolute", "revolute", "continuous", "revolute", "revolute", "revolute")
    assert arm.notes[:2] == ("flange 'attachment_site', by its name", "home from its keyframe")
    assert [note.split(" in the file")[0] for note in arm.notes[2:]] == [
        "no effort limit",
        "no velocity limit",
    ]
    np.testing.assert_array_equal(arm.home, [-0.6, 1.7, -1.5, 0.1, -1.5, -1.3])
    np.testing.assert_array_equal(arm.armature, np.full(6, 0.2))
    kinematics, scene = Arm(arm), RigidScene(SceneDescription(arm))
    np.testing.assert_allclose(kinematics.upper[[0, 2]], [np.deg2rad(170.0), np.inf])
    np.testing.assert_allclose(kinematics.joint_damping, 0.5)
    np.testing.assert_array_equal(kinematics.effort_limit, [300.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(scene.effort_limit[:2], [300.0, np.inf])
    assert scene.tick_s == 0.002  # the scene's options, not the file's
    drawn = {scene.body_names[shape.body] for shape in scene.shapes}
    assert {"base", "link1", "link2", "link3"} <= drawn


def test_a_gantry_slides(tmp_path: Path) -> None:
    arm = find_arm(written(tmp_path, GANTRY_MJCF))
    assert arm.joint_kinds[0] == "prismatic"
    assert list(Arm(arm).turns_fully) == [False, False, True, False, False, False]


@pytest.mark.parametrize("site", [True, False], ids=["site", "no site"])
def test_hands_are_left_out(tmp_path: Path, site: bool) -> None:
    text = SIX_JOINTS_MJCF.replace('<camera name="eye"/>', GRIPPER).split("<keyframe>")[0] + "</mujoco>"
    if not site:
        text = text.replace("attachment_site", "grip").replace('name="flange"', 'name="face"')
    arm = find_arm(written(tmp_path, text))
    assert len(arm.joint_names) == 6
    left_out = "hand, left, right" if site else "left, right"
    assert arm.notes[1] == f"left out, because not on the way to the flange: {left_out}"
    if not site:
        assert arm.notes[0] == "flange 'hand', the last link before the chain branches or ends"
        assert arm.flange_frame == "hand_frame"


def test_meshes_are_kept_as_they_are(tmp_path: Path) -> None:
    geom = (
        '<geom type="mesh" mesh="m" pos="0.1 0 0" contype="0" conaffinity="0"/><geom fromto="0 0 0 0.3 0 0"/>'
    )
    text = SIX_JOINTS_MJCF.replace('<geom fromto="0 0 0 0.3 0 0"/>', geom).replace("<worldbody>", MESH)
    arm = find_arm(written(tmp_path, text))
    scene = RigidScene(SceneDescription(arm))
    (drawn,) = [shape for shape in scene.shapes if scene.body_names[shape.body] == "link2"]
    moved = np.array([0.1, 0.0, 0.0]) - [0.02, -0.01, 0.03]  # the geom, less the joint's place
    corners = moved + 0.1 * np.eye(4)[:, :3]
    found = drawn.vertices
    np.testing.assert_allclose(
        np.unique(np.round(found, 6), axis=0), np.unique(np.round(corners, 6), axis=0), atol=2e-6
    )


WRONG = {
    "URDF": (SIX_JOINTS_MJCF, "<robot/>", "is no MJCF: .*; a URDF ends in .urdf"),
    "no MJCF": ("<option", "<optoin", "MuJoCo refuses it: .*optoin"),
    "no flange": (SIX_JOINTS_MJCF, "<mujoco/>", "0 joints move the flange 'world'"),
    "ball": ('name="j4"', 'name="j4" type="ball" range="0 90"', "joint 'j4' is 'ball'"),
    "two joints": ('<joint name="j4"/>', '<joint name="j4"/><joint name="k"/>', "body 'link4' has 2 joints"),
    "spring": ('name="j4"', 'name="j4" stiffness="3"', "joint 'j4' has a spring"),
    "slides without limits": ('name="j4"', 'name="j4" type="slide" limited="false"', "slides without limits"),
    "tied": ("<actuator>", '<equality><joint joint1="j4" joint2="j5"/></equality><actuator>', "'j4' is tied"),
    "home outside": ("-0.6 1.7", "9 1.7", "joint 'j1': its home 9 is outside its limits"),
    "no mass": ('mass="0.5"', 'mass="0"', "MuJoCo refuses it: .*mass"),
    "place": ('pos="0.25 0 0"', 'pos="0.25 nan 0"', "<body name=.link4.>: pos is '0.25 nan 0'; every number"),
    "infinite gear": ('gear="60"', 'gear="inf"', "gear is 'inf'; every number must be finite"),
    "no mesh": ("<worldbody>", '<asset><mesh file="m.stl"/></asset><worldbody>', "refuses it: .*m.stl"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_refused(tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    before, after, words = WRONG[case]
    assert before in SIX_JOINTS_MJCF
    text = SIX_JOINTS_MJCF.replace(before, after, 1)
    if case in ("ball", "two joints"):
        text = text.split("<keyframe>")[0] + "</mujoco>"
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=words):
        find_arm(path)
    assert main(["check", path]) == 2
    assert capsys.readouterr().out.count("\n") == 1
