"""Cells from MJCF: what stands in them is touched as the same objects are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.files import files_read
from cosim.build.arms import find_arm
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.errors import InputError
from cosim.rigid.build.cell import read_cell
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene

CELL = """<mujoco model="bench"><compiler angle="degree"/>
<option timestep="0.001" integrator="RK4"/>
<default><geom friction="0.8 0.005 0.0001"/></default>
<asset><material name="steel" rgba="0.2 0.3 0.4 1"/></asset>
<worldbody><light pos="0 0 3"/>
<body name="table" pos="0.5 0 0.1" euler="0 0 20">
<geom name="top" type="box" size="0.3 0.2 0.1" material="steel"/>
<body name="post" pos="-0.1 0.05 0.25"><geom type="cylinder" size="0.05 0.15"/>
<geom type="sphere" size="0.06" pos="0 0 0.15"/></body></body>
<body pos="1 1 0"><geom type="capsule" size="0.05 0.2"/>
<geom size="0.3" contype="0" conaffinity="0" group="3"/></body></worldbody>
<keyframe><key name="home"/></keyframe></mujoco>
"""
OBJECTS = """
[[object]]
name = "table"
shape = "box"
size_m = [0.6, 0.4, 0.2]
position_m = [0.5, 0.0, 0.1]
quaternion = [0.984807753012208, 0.0, 0.0, 0.17364817766693033]

[[object]]
name = "post"
shape = "cylinder"
size_m = [0.05, 0.3]
position_m = [0.3889297307551257, 0.012782616706728554, 0.35]

[[object.part]]
shape = "sphere"
size_m = [0.06]
position_m = [0.0, 0.0, 0.15]
"""
SCENARIO = """schema = 2
title = "a finger is pressed on a post"
robot = "ur5e"
soft_robot = "gripper_finger"

[start]
flange.position_m = [0.389, 0.013, 0.65]
flange.direction = [0.0, 0.0, -1.0]

[[phase]]
name = "press"
duration_s = 0.5
flange_shift_m = [0.01, 0.0, -0.06]
"""


def written(tmp_path: Path, text: str) -> Path:
    """Return the path of a cell's file."""
    path = tmp_path / "cell.xml"
    path.write_text(text)
    return path


def test_a_cell_stands_around_the_arm_with_the_options_of_the_scene(tmp_path: Path) -> None:
    cell = read_cell(written(tmp_path, CELL))
    assert cell.ignored == ("integrator 1", "timestep 0.001")
    assert (cell.touched, cell.has_plane) == (4, False)
    arm = find_arm("ur5e")
    plain, scene = RigidScene(SceneDescription(arm)), RigidScene(SceneDescription(arm, cell=cell))
    assert scene.tick_s == 0.002
    assert scene.body_names[: len(plain.body_names)] == plain.body_names
    assert scene.body_names[len(plain.body_names) :] == (
        "cell", "cell/table", "cell/post", "cell/body_3",
    )  # fmt: skip
    assert len(scene.contact_query(fixed_only=True)) == len(plain.contact_query(fixed_only=True)) + 4
    drawn = [shape for shape in scene.shapes if scene.body_names[shape.body] == "cell/table"]
    assert drawn[0].rgba == pytest.approx((0.2, 0.3, 0.4, 1.0))
    assert "cell/body_3" in {scene.body_names[shape.body] for shape in scene.shapes}


def test_distances_are_those_of_the_shapes(tmp_path: Path) -> None:
    """Of the sphere on the post, whose centre the file gives."""
    scene = RigidScene(SceneDescription(find_arm("ur5e"), cell=read_cell(written(tmp_path, CELL))))
    query = scene.contact_query(fixed_only=True)
    place = scene.body_poses()[0][scene.body_names.index("cell/post")] + [0.0, 0.0, 0.15]
    hits = query.distances(place[None] + np.array([[0.0, 0.0, 0.1]]), 0.05)
    np.testing.assert_allclose(hits.distance.min(), 0.04, atol=1e-12)


def test_a_plane_of_the_cell_is_the_floor(tmp_path: Path) -> None:
    plane = '<worldbody><geom type="plane" size="1 1 0.1" pos="0 0 -0.2"/>'
    cell = read_cell(written(tmp_path, CELL.replace("<worldbody>", plane)))
    scene = RigidScene(SceneDescription(find_arm("ur5e"), cell=cell))
    assert cell.has_plane
    assert "floor" not in scene.body_names
    assert "its plane is the floor" in cell.report


def test_a_cell_is_touched_as_the_same_objects_are(tmp_path: Path) -> None:
    written(tmp_path, CELL)
    with_cell, with_objects = tmp_path / "cell.toml", tmp_path / "objects.toml"
    with_cell.write_text(SCENARIO + '\n[scene]\nmjcf = "cell.xml"\n')
    with_objects.write_text(SCENARIO + OBJECTS)
    runs = [cosim.run(path) for path in (with_cell, with_objects)]
    assert runs[0].contact_force_N.max() > 1.0  # N: it is pressed on
    # rounding, as the places of the same shapes are worked out in another order
    np.testing.assert_allclose(runs[0].contact_force_N, runs[1].contact_force_N, atol=1e-8)
    np.testing.assert_allclose(runs[0].tip_position, runs[1].tip_position, atol=1e-12)
    np.testing.assert_allclose(runs[0].joint_position, runs[1].joint_position, atol=1e-12)


def test_thirty_geoms_are_as_far_away_as_the_same_objects(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    geoms, objects = [], []
    sizes = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3}
    for k in range(30):
        shape = list(sizes)[k % 5]
        size, place = rng.uniform(0.02, 0.1, sizes[shape]), rng.uniform(-1.0, 1.0, 3)
        turn = rng.normal(size=4)
        words = [" ".join(map(repr, values.tolist())) for values in (size, place, turn)]
        geoms.append(f'<geom type="{shape}" size="{words[0]}" pos="{words[1]}" quat="{words[2]}"/>')
        # MuJoCo has half edges and half lengths, objects whole ones
        full = size * {"box": [2, 2, 2], "cylinder": [1, 2], "capsule": [1, 2]}.get(shape, 1.0)
        whole = tuple(full.tolist())
        objects.append(SceneObject(f"o{k}", shape, whole, tuple(place.tolist()), tuple(turn.tolist())))
    text = f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>"
    arm, options = find_arm("ur5e"), {"floor_height_m": None}
    scenes = (
        RigidScene(SceneDescription(arm, cell=read_cell(written(tmp_path, text)), **options)),
        RigidScene(SceneDescription(arm, objects=tuple(objects), **options)),
    )
    points = rng.uniform(-1.0, 1.0, (10_000, 3))
    found = [scene.contact_query(fixed_only=True).distances(points, 0.05) for scene in scenes]
    assert len(found[0].distance) > 200
    for name in ("point", "shape"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))
    np.testing.assert_allclose(found[0].distance, found[1].distance, atol=1e-12)


def test_links_that_stand_in_a_cell_are_named(tmp_path: Path) -> None:
    scene = RigidScene(SceneDescription(find_arm("ur5e")))
    x, y, z = scene.body_poses()[0][scene.body_names.index("wrist_2_link")]
    text = CELL.replace('name="table" pos="0.5 0 0.1"', f'name="table" pos="{x} {y} {z}"')
    arm = find_arm("ur5e")
    found = RigidScene(SceneDescription(arm, cell=read_cell(written(tmp_path, text)))).links.at(arm.home)
    assert "cell/table" in {contact.other for contact in found}
    assert not any(contact.movable for contact in found)


def test_the_cell_counts_among_what_a_run_was_loaded_from(tmp_path: Path) -> None:
    written(tmp_path, CELL)
    path = tmp_path / "s.toml"
    path.write_text(SCENARIO + '\n[scene]\nmjcf = "cell.xml"\n')
    scenario = load_scenario(path)
    assert scenario.scene is not None
    assert scenario.scene.mjcf == str(tmp_path / "cell.xml")
    with files_read() as found:
        read_cell(Path(scenario.scene.mjcf))
    assert str(tmp_path / "cell.xml") in found


COPIED = '<replicate count="100">'
WRONG = {
    "moves": (
        'name="post" pos="-0.1 0.05 0.25">',
        'name="post"><joint type="ball"/>',
        "joint 'post' is of type 'ball'; .*object",
    ),
    "two of a name": (
        'name="post" pos="-0.1 0.05 0.25">',
        'name="post"><joint type="hinge"/><joint type="slide"/>',
        "two joints are called 'post'",
    ),
    "no MJCF": (CELL, "<robot/>", "is no MJCF"),
    "no XML": ("</mujoco>", "", "is not XML"),
    "unknown": ("<option", "<optoin", "MuJoCo refuses it: .*optoin"),
    "place": ('pos="1 1 0"', 'pos="1 nan 0"', "<body>: pos is '1 nan 0'; every number must be finite"),
    "mass that MuJoCo leaves out": ('size="0.06"', 'size="0.06" mass="nan"', "<geom>: mass is 'nan'"),
    "infinite margin": ('size="0.06"', 'size="0.06" margin="inf"', "<geom>: margin is 'inf'"),
    "inertia beyond all numbers": (
        'size="0.06"',
        'size="1e200"',
        r"body 'post': \w+ is inf.*; every number must be finite",
    ),
    "copies": (
        "<worldbody>",
        '<worldbody><replicate count="100000"><geom size="1"/></replicate>',
        'describes more than 4000 elements, <replicate count="100000"> among them',
    ),
    "copies of copies": (
        "<worldbody>",
        f"<worldbody>{2 * COPIED}<geom size='1'/>{2 * '</replicate>'}",
        "describes more than 4000 elements",
    ),
    "bodies": ("<worldbody>", f"<worldbody>{20_000 * '<body/>'}", "describes more than 4000 elements"),
    "fine height field": (
        "<asset>",
        '<asset><hfield name="h" nrow="10000" ncol="+10000" size="1 1 1 1"/>',
        'name="h" nrow="10000" ncol="[+]10000"> has more than 1000000 points',
    ),
    "fine mesh": (
        "<asset>",
        '<asset><mesh name="m" builtin="supersphere" params="2000.0 1 1"/>',
        'mesh name="m"> has more than 1000000 points',
    ),
    "itself": ("<asset>", '<asset><model name="m" file="cell.xml"/>', "<model .*> is this file, or one that"),
    "deep": (
        "<worldbody>",
        f"<worldbody>{400 * '<body>'}{400 * '</body>'}",
        "nested too deeply; at most 300",
    ),
    "height field": (
        "<worldbody>",
        '<asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset><worldbody>'
        '<geom name="hill" type="hfield" hfield="h"/>',
        "geom 'hill' is of type 'hfield'",
    ),
}


def test_a_height_field_that_nothing_touches_is_drawn(tmp_path: Path) -> None:
    field = '<hfield name="h" nrow="2" ncol="3" size="0.4 0.3 0.2 0.1" elevation="0 0 0 0 0 1"/>'
    hill = '<geom type="hfield" hfield="h" pos="0 0 1" contype="0" conaffinity="0"/>'
    text = CELL.replace("<asset>", f"<asset>{field}").replace("<worldbody>", f"<worldbody>{hill}")
    scene = RigidScene(SceneDescription(find_arm("ur5e"), cell=read_cell(written(tmp_path, text))))
    (shape,) = (shape for shape in scene.shapes if scene.body_names[shape.body] == "cell")
    assert len(shape.triangles) == 4
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    np.testing.assert_allclose((low, high), ((-0.4, -0.3, 1.0), (0.4, 0.3, 1.2)), atol=1e-12)
    # MuJoCo's rows of a file run from the largest y to the smallest
    np.testing.assert_allclose(shape.vertices[shape.vertices[:, 2].argmax(), :2], (0.4, -0.3), atol=1e-12)


def test_a_mesh_that_is_rewritten_at_once_is_read_anew(tmp_path: Path) -> None:
    corners = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    mesh = '<asset><mesh name="m" file="m.obj"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody>'
    widths = []
    for size in (1.0, 2.0):
        (tmp_path / "m.obj").write_text(corners.format(size))
        cell = read_cell(written(tmp_path, f"<mujoco>{mesh}</mujoco>"))
        scene = RigidScene(SceneDescription(find_arm("ur5e"), cell=cell, floor_height_m=None))
        drawn = [shape for shape in scene.shapes if scene.body_names[shape.body] == "cell"]
        widths.append(float(np.ptp(drawn[0].vertices, axis=0).max()))
    assert widths[1] == pytest.approx(2.0 * widths[0])


@pytest.mark.parametrize("case", WRONG)
def test_wrong_cells_are_refused(tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    before, after, words = WRONG[case]
    assert before in CELL
    path = written(tmp_path, CELL.replace(before, after, 1))
    with pytest.raises(InputError, match=words):
        read_cell(path)
    scenario = tmp_path / "s.toml"
    scenario.write_text(SCENARIO + '\n[scene]\nmjcf = "cell.xml"\n')
    assert main(["run", str(scenario), "--out", str(tmp_path / "out")]) == 2
    (line,) = [row for row in capsys.readouterr().err.splitlines() if row.startswith("cosim: error")]
    assert line.startswith("cosim: error: scene.mjcf: cell file")


def test_a_cell_that_is_not_there_or_has_no_arm_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(SCENARIO + '\n[scene]\nmjcf = "cell.xml"\n')
    with pytest.raises(InputError, match=r"scene\.mjcf: .*no file that ends in \.xml"):
        load_scenario(path)
    written(tmp_path, CELL)
    with pytest.raises(InputError, match="scene: needs an arm"):
        load_scenario(path, {"robot": "none"})
