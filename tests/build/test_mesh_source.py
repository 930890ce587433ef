"""A soft robot whose film is a mesh file: node sets, caps, cables, and films by groups, from files alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build.given_body import NamedBody
from cosim.build.soft_body import build_soft_body
from cosim.cli.main import main
from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.errors import MeshError, ScenarioError
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.elements.membrane import Membranes
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import interior_hinges
from tests.soft.own_tube import LENGTH_M, RADIUS_M, ROWS, SIDES, tube

ROBOT = """\
schema = 2
name = "tube"
source = "made up"
base = ["base"]

[body]
kind = "mesh"
file = "tube.obj"
scale = 0.001

[[body.set]]
name = "base"
axis = "z"
at_m = 0.0

[[body.set]]
name = "middle"
axis = "z"
at_m = {middle}

[[body.set]]
name = "tip"
axis = "z"
at_m = {length}

[[body.set]]
name = "side"
points_m = {side}

[[body.set]]
name = "cuff"
group = "cuff"

[film]
young_modulus_Pa = 20e6
poisson_ratio = 0.3
thickness_m = 1e-4

[hinge]
stiffness_factor = 1.0

[mass]
node_mass_kg = 5e-4

[[cable]]
name = "side"
line = "side"
capstan_factor = 0.9
"""
CUFF = """
[[group]]
name = "cuff"
film = { young_modulus_Pa = 20e6, poisson_ratio = 0.3, thickness_m = 2e-4, density_kg_m3 = 1000.0 }
"""
PAIR = """\
[[body.set]]
name = "pair"
points_m = [[0.03, 0.0, 0.2], [-0.03, 0.0, 0.2]]

[film]
"""
SCENARIO = """\
schema = 2
title = "a tube from a mesh file"
robot = "none"
soft_robot = "tube.toml"

[start]
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [0.0, 0.0, -1.0]

[[phase]]
name = "bend"
duration_s = 0.04
settle_s = 0.0
pressure_Pa = 5e3
cable_tension_N = { side = 2.0 }
"""


def written(folder: Path, more: str = "", **changes: str) -> Path:
    """Write robot, mesh in mm and scenario; return the robot's file."""
    body = tube().body
    x, triangles = body.positions, body.triangles
    lower = (x[triangles][:, :, 2] < 0.3 * LENGTH_M).all(axis=1)
    lines = [f"v {a!r} {b!r} {c!r}" for a, b, c in (1e3 * x).tolist()]
    for name, rows in (("wall", triangles[~lower]), ("wall cuff", triangles[lower])):
        lines += [f"g {name}", *(f"f {a} {b} {c}" for a, b, c in (rows + 1).tolist())]
    (folder / "tube.obj").write_text("\n".join(lines), encoding="utf-8")
    side = [[RADIUS_M, 1e-4, k * LENGTH_M / ROWS] for k in range(1, ROWS + 1)]
    text = ROBOT.format(middle=0.5 * LENGTH_M, length=LENGTH_M, side=side) + more
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "tube.toml").write_text(text, encoding="utf-8")
    (folder / "scenario.toml").write_text(SCENARIO, encoding="utf-8")
    return folder / "tube.toml"


def built(file: Path) -> SoftBody:
    scenario = load_scenario(file.parent / "scenario.toml")
    robot = scenario.soft_robot
    assert isinstance(robot, SoftRobotTable)
    return build_soft_body(robot, scenario.model)


def at(x: np.ndarray[Any, Any]) -> set[tuple[int, ...]]:
    """Return places in micrometres."""
    return {tuple(row) for row in np.round(1e6 * x).astype(int).tolist()}


def test_the_film_is_that_of_the_file_with_its_sets_and_caps(tmp_path: Path) -> None:
    here, given = built(written(tmp_path)), tube().body
    assert at(here.positions) == at(given.positions)
    assert len(here.caps) == 2
    for name in ("base", "tip", "middle"):
        expected = {"base": given.base, "tip": given.tip}.get(name, given.rings.get(name))
        assert at(here.positions[here.rings[name]]) == at(given.positions[expected])
    np.testing.assert_allclose(
        here.positions[here.cables[0].nodes], given.positions[given.cables[0].nodes], atol=1e-12
    )
    np.testing.assert_allclose(here.tip_direction(here.positions), [0.0, 0.0, 1.0], atol=1e-12)
    assert len(here.rings["cuff"]) == 4 * SIDES
    volume = [FilmPotential(body).gas.enclosed_volumes(body.positions[None])[0, 0] for body in (here, given)]
    assert volume[0] == pytest.approx(volume[1], rel=1e-12)
    assert len(here.hinges.nodes) == len(interior_hinges(given.triangles))


def test_the_command_line_runs_it_and_the_tube_bends_towards_its_cable(tmp_path: Path) -> None:
    written(tmp_path)
    out = tmp_path / "out"
    assert main(["run", str(tmp_path / "scenario.toml"), "--out", str(out), "--no-recording"]) == 0
    again = cosim.run(out / "scenario.toml")  # which holds the whole robot
    assert again.tip_position[-1, 0] > 1e-4
    own = tmp_path / "own.toml"
    own.write_text(SCENARIO.replace('soft_robot = "tube.toml"\n', ""), encoding="utf-8")
    given = tube()
    wall = Membranes.from_shape(given.body.positions, given.body.triangles, Film(20e6, 0.3, 1e-4))
    body = given.body.with_other(Membranes, wall)  # without the cuff
    arrays = cosim.run(own, body=NamedBody(body, "tube", given.cable_names))
    # the same film with other numbers of its nodes: solved to a residual of 1e-4 N
    np.testing.assert_allclose(again.tip_position, arrays.tip_position, atol=1e-6)


def test_a_group_has_a_film_of_its_own(tmp_path: Path) -> None:
    plain, cuffed = built(written(tmp_path)), built(written(tmp_path, CUFF))
    thin, thick = cuffed.membranes
    assert (thin.film.thickness_m, thick.film.thickness_m) == (1e-4, 2e-4)
    ratio = np.unique(np.round(cuffed.hinges.stiffness / plain.hinges.stiffness[0], 6))
    # t^3, and at the cuff's edge 2 / (1 / 1 + 1 / 8): one moment bends both films
    assert ratio.tolist() == pytest.approx([1.0, 16.0 / 9.0, 8.0], abs=1e-6)
    area = thick.areas.sum()
    assert cuffed.mass_kg - plain.mass_kg == pytest.approx(1000.0 * 2e-4 * area, rel=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("tube.obj", "tub.obj", r"soft_robot\.body\.file: no file 'tub\.obj' beside"),
        ('"mesh"', '"sheet"', r"soft_robot\.body.*'sheet'.*mesh"),
        (
            'axis = "z"\nat_m = 0.0\n',
            'axis = "z"\n',
            r"body\.set\.base: give axis and at_m, or points_m, or group",
        ),
        ('name = "middle"', 'name = "base"', r"body\.set\.base: the name is used twice"),
        ('name = "tip"', 'name = "end"', r"body\.tip: no set 'tip'"),
        ('line = "side"', 'line = "sight"', r"cable\.side\.line: no set 'sight'.*side"),
        ('line = "side"', "corner = 0\nunits = [1, 3]", r"cable\.side: runs along no stack of units"),
        ('base = ["base"]', 'base = ["bottom"]', r"soft_robot\.base: no ring 'bottom'"),
        ("[hinge]", '[stiffener]\nkind = "stiff"\n\n[hinge]', r"stiffener\.kind: is of stacks of units"),
    ],
)
def test_wrong_values_are_told_with_their_place(tmp_path: Path, old: str, new: str, text: str) -> None:
    written(tmp_path, **{old: new})
    with pytest.raises(ScenarioError, match=text):
        load_scenario(tmp_path / "scenario.toml")


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "at_m = 0.0",
            "at_m = 1.0",
            r"set 'base' is at z = 1 m, where no node is; the film reaches from 0 m",
        ),
        ('group = "cuff"', 'group = "sleeve"', "set 'cuff' is of group 'sleeve'; the file has: wall, cuff"),
        ("points_m = [[0.03", "points_m = [[0.3", "set 'side': point .* further than the longest edge"),
    ],
)
def test_nodes_that_are_not_there_are_told(tmp_path: Path, old: str, new: str, text: str) -> None:
    robot = load_soft_robot(written(tmp_path, **{old: new}))
    with pytest.raises(MeshError, match=text):
        build_soft_body(robot, load_scenario(tmp_path / "scenario.toml").model)


def test_a_tip_that_is_no_ring_is_told(tmp_path: Path) -> None:
    pair = {"scale = 0.001": 'scale = 0.001\ntip = "pair"', "[film]": PAIR}
    robot = load_soft_robot(written(tmp_path, **pair))
    with pytest.raises(MeshError, match="the tip, 'pair', has 2 nodes; a ring of 3 is needed"):
        build_soft_body(robot, load_scenario(tmp_path / "scenario.toml").model)


def test_a_film_inside_out_is_told(tmp_path: Path) -> None:
    robot = load_soft_robot(written(tmp_path))
    mesh = tmp_path / "tube.obj"
    faces = re.sub(r"^f (\d+) (\d+)", r"f \2 \1", mesh.read_text(encoding="utf-8"), flags=re.MULTILINE)
    mesh.write_text(faces, encoding="utf-8")
    with pytest.raises(MeshError, match=r"tube\.obj: is inside out; turn its triangles over"):
        build_soft_body(robot, load_scenario(tmp_path / "scenario.toml").model)


def test_a_node_without_mass_is_told(tmp_path: Path) -> None:
    light = {"node_mass_kg = 5e-4": "", "thickness_m = 1e-4": "thickness_m = 1e-4\ndensity_kg_m3 = 1e-6"}
    robot = load_soft_robot(written(tmp_path, **light))
    with pytest.raises(MeshError, match=r"has a mass of .* kg; every node needs 1e-12 kg at least"):
        build_soft_body(robot, load_scenario(tmp_path / "scenario.toml").model)


@pytest.mark.parametrize(
    ("changes", "more", "key"),
    [
        ({"[film]\n": '[film]\nlaw = "wrinkling"\n'}, "", "soft_robot.film.wrinkle_panel_m"),
        (
            {},
            CUFF.replace("film = {", 'film = { law = "wrinkling",'),
            "soft_robot.group.cuff.film.wrinkle_panel_m",
        ),
    ],
)
def test_a_wrinkling_mesh_is_refused_by_the_key_that_mends_it(
    changes: dict[str, str], more: str, key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, scenario = written(tmp_path, more, **changes), tmp_path / "scenario.toml"
    assert main(["check", str(robot), str(scenario)]) == 2
    told = f"{key}: is required for mesh bodies"
    for file, line in zip((robot, scenario), capsys.readouterr().out.splitlines(), strict=True):
        assert line.startswith(f"{file}: {told}")
    assert main(["run", str(scenario), "--no-recording", "--out", str(tmp_path / "refused")]) == 2
    assert told in capsys.readouterr().err
    # followed to the letter
    mended = ["--set", f"{key}=0.04", "--set", "phase.bend.duration_s=0.004"]
    assert main(["run", str(scenario), "--no-recording", "--out", str(tmp_path / "mended"), *mended]) == 0
    assert main(["check", str(tmp_path / "mended" / "scenario.toml")]) == 0


def test_a_robot_file_is_built_by_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = written(tmp_path, **{'group = "cuff"': 'group = "sleeve"'})
    assert main(["check", str(robot), str(tmp_path / "scenario.toml")]) == 2
    for line in capsys.readouterr().out.splitlines():
        assert "soft_robot.body: set 'cuff' is of group 'sleeve'; the file has: wall, cuff" in line


def test_only_stacks_have_sections_finer_meshes_and_published_hinges(tmp_path: Path) -> None:
    written(tmp_path)
    for changes in (
        {"fidelity": "section"},
        {"fidelity": "refined"},
        {"model.all_hinges": False},
        {"model.published": True},
    ):
        with pytest.raises(ScenarioError, match="not drawn as a stack of units alone"):
            load_scenario(tmp_path / "scenario.toml", changes)
    sets = [{"name": name, "group": name} for name in ("wall", "cuff")]
    with pytest.raises(ScenarioError, match=r"body: cannot be combined with stack"):
        load_scenario("ur5e_hexagon_arm", {"soft_robot.body": {"kind": "mesh", "file": "a.obj", "set": sets}})


def test_three_triangles_on_an_edge_are_refused(tmp_path: Path) -> None:
    robot, mesh = written(tmp_path), tmp_path / "tube.obj"
    text = mesh.read_text(encoding="utf-8")
    first, second, _ = re.findall(r"^f (\d+) (\d+) (\d+)$", text, re.MULTILINE)[40]
    count = len(re.findall(r"^v ", text, re.MULTILINE))
    for times in (1, 1000):  # thousands of them are not listed
        more = f"\nv 0.0 0.0 100.0\nf {first} {second} {count + 1}\n"
        mesh.write_text(text + times * more, encoding="utf-8")
        with pytest.raises(MeshError, match="edge") as refused:
            built(robot)
        assert len(str(refused.value)) < 300
