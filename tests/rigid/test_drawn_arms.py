"""An arm is drawn by the meshes of another description of it; what MuJoCo computes does not know of it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cosim.base.files import files_read
from cosim.base.frames import Array, Pose
from cosim.build.arms import find_arm, placed_arm
from cosim.config.arm_table import BaseTable, RailTable
from cosim.errors import ScenarioError
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene

_LINK = (
    '<link name="{}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>'
    '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual></link>'
)
_JOINT = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="{}"/><axis xyz="{}"/>'
    '<limit lower="-2" upper="2" effort="10" velocity="1"/></joint>'
)
OURS = f"""<robot name="two">{"".join(map(_LINK.format, ("root", "upper", "hand")))}
{_JOINT.format("swing", "root", "upper", "0 0 0.2", "0 0 1")}
{_JOINT.format("lift", "upper", "hand", "0.3 0 0", "0 1 0")}</robot>"""
# Half a turn about z at the base; frames of links elsewhere on their axes, and turned about them.
THEIRS = """<mujoco><compiler angle="radian"/>
<asset><mesh name="m" vertex="0.1 0 0  0 0.1 0  0 0 0.1  0 0 0"/></asset>
<default><geom type="mesh" mesh="m" contype="0" conaffinity="0" rgba="0.2 0.4 0.6 1"/></default>
<worldbody><body name="foot"><geom pos="0 0 0.05"/>
<body name="a" pos="0 0 0.5"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<joint name="j1" axis="0 0 1" range="-2 2"/><geom pos="-0.1 0 0"/>
<body name="b" pos="-0.3 0.07 -0.3" euler="0 0.4 0">
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<joint name="j2" axis="0 -1 0" range="-2 2"/>GEOM<site name="attachment_site" pos="-0.1 0 0"/></body>
</body></body></worldbody></mujoco>"""
INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
GEOM = '<geom pos="-0.2 0.01 0.02"/>'
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
ANGLES = np.array([0.7, -0.4])
NAMES = ("swing", "lift")

Install = Callable[[str], None]


@pytest.fixture(name="install")
def _install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    for name in ("MENAGERIE_CACHE_DIR", "ROBOT_DESCRIPTIONS_CACHE"):
        monkeypatch.setenv(name, str(tmp_path / "empty"))
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path / "menagerie"))

    def install(text: str) -> None:
        folder = tmp_path / "menagerie" / "acme_two"
        folder.mkdir(parents=True)
        (folder / "two.xml").write_text(text, encoding="utf-8")

    return install


@pytest.fixture(name="robot")
def _robot(tmp_path: Path) -> str:
    (tmp_path / "two.urdf").write_text(OURS, encoding="utf-8")
    path = tmp_path / "arm.toml"
    path.write_text('file = "two.urdf"\ndrawn_as = "menagerie:acme_two"\n', encoding="utf-8")
    return str(path)


def points_drawn(scene: CompiledScene, prefix: str = "") -> dict[str, list[Array]]:
    """Return the vertices of shapes, world, with joints of an arm at `ANGLES`, by the names of bodies."""
    model = scene.model()
    data = mujoco.MjData(model)
    for name, angle in zip(NAMES, ANGLES, strict=True):
        data.qpos[model.joint(prefix + name).qposadr] = angle
    mujoco.mj_kinematics(model, data)
    found: dict[str, list[Array]] = {}
    for shape in scene.shapes:
        points = shape.vertices @ data.xmat[shape.body].reshape(3, 3).T + data.xpos[shape.body]
        name = model.body(shape.body).name
        if name.startswith(prefix):
            found.setdefault(name.removeprefix(prefix), []).append(points)
    return found


def points_expected(text: str, base: Pose) -> dict[str, Array]:
    """Return the corners of the other description's meshes at the same angles, with its base half turned."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = ANGLES
    mujoco.mj_kinematics(model, data)
    found = {}
    for geom in range(model.ngeom):
        local = model.mesh_vert @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        name = {"foot": "root", "a": "upper", "b": "hand"}[model.body(model.geom_bodyid[geom]).name]
        found[name] = base.apply(local @ HALF_TURN)
    return found


def assert_drawn(found: dict[str, list[Array]], text: str, base: Pose) -> None:
    for name, points in points_expected(text, base).items():
        (drawn,) = found[name]
        assert len(drawn) == 4
        apart = np.linalg.norm(drawn[:, None] - points[None], axis=2)
        assert apart.min(axis=1).max() < 1e-6
        assert apart.min(axis=0).max() < 1e-6


BASES = {
    "as its file says": None,
    "hanging": BaseTable((0.1, 0.2, 1.5), (0.0, 1.0, 0.0, 0.0)),
    "on a rail": BaseTable((0.1, 0.2, 0.3), rails=(RailTable((1.0, 0.0, 0.0), (-0.5, 0.5), 1.0),)),
}


@pytest.mark.parametrize("case", BASES)
def test_meshes_move_with_the_links_of_the_arm(install: Install, robot: str, case: str) -> None:
    install(THEIRS.replace("GEOM", GEOM))
    arm = placed_arm(robot, BASES[case])
    scene = CompiledScene(SceneDescription(arm))
    assert_drawn(points_drawn(scene), THEIRS.replace("GEOM", GEOM), arm.world_from_base)
    assert scene.drawings[""].note == "drawn as menagerie:acme_two"


def test_each_of_two_arms_is_drawn(install: Install, robot: str) -> None:
    install(THEIRS.replace("GEOM", GEOM))
    place = Pose(np.eye(3), np.array([0.0, 1.0, 0.0]))
    left, right = (
        SceneDescription(find_arm(robot), prefix=prefix, world_from_base=base)
        for prefix, base in (("left/", Pose()), ("right/", place))
    )
    scene = CompiledScene(left, (right,))
    for one, base in ((left, Pose()), (right, place)):
        assert_drawn(points_drawn(scene, one.prefix), THEIRS.replace("GEOM", GEOM), base)


def test_a_link_without_mesh_keeps_its_own_shape(install: Install, robot: str) -> None:
    install(THEIRS.replace("GEOM", '<geom type="sphere" size="0.1"/>'))
    found = points_drawn(CompiledScene(SceneDescription(find_arm(robot))))
    assert [len(points) for points in found["upper"]] == [4]
    assert [len(points) for points in found["hand"]] == [24]  # of a box


def test_the_model_does_not_depend_on_what_is_installed(install: Install, robot: str) -> None:
    before = CompiledScene(SceneDescription(find_arm(robot)))
    own = [shape.vertices for shape in before.shapes if shape.body]
    install(THEIRS.replace("GEOM", GEOM))
    with files_read() as read:
        scene = RigidScene(SceneDescription(find_arm(robot)))
        drawn = [shape.vertices for shape in scene.shapes if shape.body]
    assert [len(points) for points in own][:3] == [24, 24, 24]
    assert [len(points) for points in drawn][-3:] == [4, 4, 4]
    assert sorted(Path(name).name for name in read) == ["arm.toml", "two.urdf"]  # inputs of a run
    models = before.model(), CompiledScene(scene.description).model()
    saved = [np.zeros(mujoco.mj_sizeModel(model), np.uint8) for model in models]
    for model, buffer in zip(models, saved, strict=True):
        mujoco.mj_saveModel(model, None, buffer)
    np.testing.assert_array_equal(saved[0], saved[1])


WRONG = {
    "none": (None, "acme_two is not on this machine"),
    "elsewhere": (THEIRS.replace("-0.3 0.07", "-0.33 0.07"), r"is another arm: .* 15\.0 mm and 0 rad away"),
    "other way": (THEIRS.replace('"0 -1 0"', '"0 -1 0.5"'), "is another arm: .* rad away"),
    "parallel": (THEIRS.replace('"0 -1 0"', '"-0.3894183 0 0.9210610"'), "all parallel at zero"),
    "broken": ("<mujoco><worldbody>", "not XML|no element|unclosed"),
    "more joints": (
        THEIRS.replace("<site", f'<body>{INERTIAL}<joint name="j3"/><site')
        .replace("</body>\n</body></body>", "</body></body></body></body>"), "has 3 joints, the arm 2"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_does_not_fit_leaves_the_arm_as_it_is(install: Install, robot: str, case: str) -> None:
    text, reason = WRONG[case]
    if text is not None:
        install(text.replace("GEOM", GEOM))
    scene = RigidScene(SceneDescription(find_arm(robot)))
    assert [len(shape.vertices) for shape in scene.shapes if shape.body][:3] == [24, 24, 24]
    assert scene.drawn_as.startswith("drawn by its own shapes: ")
    assert re.search(reason, scene.drawn_as), scene.drawn_as


def test_only_a_model_of_the_menagerie_is_named(robot: str) -> None:
    path = Path(robot)
    path.write_text(path.read_text().replace("menagerie:", ""), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"robot\.drawn_as: 'acme_two' is no model .* menagerie:MODEL"):
        find_arm(robot)
