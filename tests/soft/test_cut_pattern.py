"""Cut patterns: what a drawing becomes, and what broken ones are told."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.drawing import DrawnLine, read_drawing
from cosim.base.frames import Array, in_mm, rotation_from_vector
from cosim.bench.known_answers import UNLOADED, Specimen
from cosim.build.patterns import cut_pattern, drawn_pattern
from cosim.build.soft_body import build_film, build_soft_body
from cosim.config.schema.film import FilmTable
from cosim.config.schema.pattern import PatternFoldTable, PatternSetTable, PatternTable
from cosim.config.schema.settings import ModelTable
from cosim.config.schema.soft_robot import FaceGroupTable, HingeTable, SoftRobotTable, StiffenerTable
from cosim.errors import MeshError
from cosim.soft.beams.beam_rings import BeamRings
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.contact.self_contact_faces import FilmFaces
from cosim.soft.elements.hinge import bending_measure
from cosim.soft.elements.material import Film
from cosim.soft.elements.pressure import GasChambers
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.cut_pattern import CutPattern, FlatFilm, flat_film
from cosim.soft.geometry.flat_mesh import LineKind, signed_area, smallest_angles
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.solve.newton_options import NewtonOptions

ezdxf = pytest.importorskip("ezdxf", reason="needs the extra pattern")

WIDTH, LENGTH = 40.0, 120.0
SETS = (PatternSetTable("base", box_m=((0.0, 0.0), (0.04, 0.004))), PatternSetTable("tip", layer="TIP"))


def rectangle(width: float = WIDTH, length: float = LENGTH, inset: float = 0.0) -> list[tuple[float, float]]:
    """Return the corners of an upright rectangle."""
    low, right, top = inset, width - inset, length - inset
    return [(low, low), (right, low), (right, top), (low, top)]


class Sheet:
    """A DXF drawing of a pouch, to be changed."""

    def __init__(self, unit: int = 4, scale: float = 1.0) -> None:
        self.document = ezdxf.new(units=unit)
        self.space, self.scale = self.document.modelspace(), scale

    def line(self, layer: str, points: Any, close: bool = False) -> Sheet:
        """Add a polyline."""
        scaled = [tuple(self.scale * c for c in point) for point in points]
        self.space.add_lwpolyline(scaled, close=close, dxfattribs={"layer": layer})
        return self

    def port(self, x: float, y: float) -> Sheet:
        """Add a port."""
        self.space.add_circle(
            (self.scale * x, self.scale * y), self.scale * 1.0, dxfattribs={"layer": "PORT"}
        )
        return self

    def pouch(self, *without: str) -> Sheet:
        """Add all that a pouch has."""
        for layer in ("CUT", "SEAL"):
            if layer not in without:
                self.line(layer, rectangle(), close=True)
        if "TIP" not in without:
            self.line("TIP", [(0.0, LENGTH), (WIDTH, LENGTH)])
        return self if "PORT" in without else self.port(20.0, 60.0)

    def table(self, folder: Path, **keys: Any) -> PatternTable:
        """Write the file, and return a table that names it."""
        self.document.saveas(folder / "pouch.dxf")
        return PatternTable(file=str(folder / "pouch.dxf"), **{"sets": SETS, **keys})


def understood(table: PatternTable) -> FlatFilm:
    return flat_film(cut_pattern(table))


def outline_length(film: FlatFilm) -> float:
    x = film.mesh.positions[film.mesh.edges_of(LineKind.CUT)]
    return float(np.linalg.norm(x[:, 1] - x[:, 0], axis=1).sum())


def test_a_drawn_pouch_is_two_sheets_on_one_seam(tmp_path: Path) -> None:
    table = Sheet().pouch().table(tmp_path)
    film, mesh = understood(table), drawn_pattern(table, "base")
    x, triangles = film.mesh.positions, film.mesh.triangles
    assert signed_area(x, triangles).sum() == pytest.approx(0.04 * 0.12, rel=1e-12)
    assert outline_length(film) == pytest.approx(0.32, rel=1e-12)
    assert np.degrees(smallest_angles(x, triangles)).min() > 25.0
    assert (film.chamber == 0).all()
    seam = np.flatnonzero(film.shared)
    assert len(mesh.positions) == 2 * len(x) - len(seam)
    assert np.isin(np.round(x[seam] / (0.04, 0.12), 9), (0.0, 1.0)).any(axis=1).all()
    assert mesh.positions[mesh.ring("tip")].mean(axis=0) == pytest.approx(
        (0.0, 0.0, 0.12 - x[film.sets["base"], 1].mean())
    )


def test_the_mesh_of_a_symmetric_outline_is_symmetric(tmp_path: Path) -> None:
    film = understood(Sheet().pouch().table(tmp_path))
    for axis, size in ((0, 0.04), (1, 0.12)):
        x = film.mesh.positions
        turned = x.copy()
        turned[:, axis] = size - turned[:, axis]
        nodes = {tuple(row): k for k, row in enumerate(np.round(x, 9).tolist())}
        number = np.array([nodes[tuple(row)] for row in np.round(turned, 9).tolist()])
        here = {tuple(row) for row in np.sort(film.mesh.triangles, axis=1).tolist()}
        assert {tuple(row) for row in np.sort(number[film.mesh.triangles], axis=1).tolist()} == here


@pytest.mark.parametrize("off", [-1e-9, 0.0, 1e-9])
def test_a_seam_on_an_axis_of_symmetry_is_kept_whatever_rounding_does(off: float, tmp_path: Path) -> None:
    sheet = Sheet().pouch("PORT").port(20.0, 30.0)
    sheet.line("SEAL", [(10.0, 60.0 + off), (30.0, 60.0 - off)])
    mesh = understood(sheet.table(tmp_path)).mesh
    x = mesh.positions[mesh.edges_of(LineKind.SEAL)]
    assert np.linalg.norm(x[:, 1] - x[:, 0], axis=1).sum() == pytest.approx(0.34, rel=1e-6)


def test_a_port_within_the_width_of_a_seam_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        MeshError, match=r"\(20\.00, 60\.00\) mm lies within a seam of 100 mm: set seam_width_m"
    ):
        understood(Sheet().pouch().table(tmp_path, seam_width_m=0.1))


def test_an_acute_corner_is_meshed(tmp_path: Path) -> None:
    sheet = Sheet().line("CUT", [(0, 0), (40, 2), (40, 0)], close=True).port(35, 1)
    sets = (
        PatternSetTable("base", box_m=((0.035, 0.0), (0.04, 0.002))),
        PatternSetTable("tip", box_m=((0, 0), (0.02, 0.001))),
    )
    film = understood(sheet.table(tmp_path, edge="sealed", sets=sets))
    assert signed_area(film.mesh.positions, film.mesh.triangles).sum() == pytest.approx(40e-6, rel=1e-9)


def test_no_edge_within_a_chamber_joins_seam_and_seam(tmp_path: Path) -> None:
    film = understood(Sheet().pouch().table(tmp_path))
    seams = {tuple(edge) for edge in film.mesh.edges_of(LineKind.SEAL).tolist()}
    edges = np.sort(film.mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    dead = [tuple(edge) for edge in edges.tolist() if film.shared[edge].all() and tuple(edge) not in seams]
    assert dead == []


def test_an_area_without_a_port_is_welded_flat_and_an_inner_seam_is_gone_around(tmp_path: Path) -> None:
    sheet = Sheet().pouch().line("SEAL", [(20.0, 30.0), (20.0, 50.0)])
    sheet.space.add_circle((20.0, 90.0), 5.0, dxfattribs={"layer": "SEAL"})
    film = understood(sheet.table(tmp_path, mesh_m=0.003))
    welded = film.chamber < 0
    area = signed_area(film.mesh.positions, film.mesh.triangles)
    assert area[welded].sum() == pytest.approx(math.pi * 0.005**2, rel=0.1)
    assert film.shared[film.mesh.triangles[welded]].all()
    x = film.mesh.positions
    line = (np.abs(x[:, 0] - 0.02) < 1e-9) & (x[:, 1] > 0.0299) & (x[:, 1] < 0.0501)
    assert film.shared[line].all()
    assert line.sum() >= 7
    mesh = drawn_pattern(sheet.table(tmp_path, mesh_m=0.003), "base")
    assert len(mesh.face_groups["welded"]) == 2 * welded.sum()
    # sheets welded flat lie on one another as drawn: they do not press on one another
    assert not FilmFaces.of(
        SoftBody.from_arrays(mesh.positions, mesh.triangles, Film(1e9, 0.3, 1e-4))
    ).can_meet


def test_a_seam_has_the_width_it_is_given(tmp_path: Path) -> None:
    film = understood(Sheet().pouch().table(tmp_path, seam_width_m=0.004, mesh_m=0.004))
    area = signed_area(film.mesh.positions, film.mesh.triangles)
    assert area[film.chamber == 0].sum() == pytest.approx(0.036 * 0.116, rel=1e-6)
    assert area.sum() == pytest.approx(0.04 * 0.12, rel=1e-6)


@pytest.mark.parametrize(("unit", "scale"), [(4, 1.0), (5, 0.1), (6, 1e-3), (1, 1.0 / 25.4)])
def test_units_are_those_of_the_file(unit: int, scale: float, tmp_path: Path) -> None:
    film = understood(Sheet(unit, scale).pouch().table(tmp_path))
    assert outline_length(film) == pytest.approx(0.32, rel=1e-9)


def test_arcs_bulges_splines_and_nested_blocks_are_drawn_out(tmp_path: Path) -> None:
    document = ezdxf.new(units=4)
    inner, outer = document.blocks.new("ARCS"), document.blocks.new("POUCH")
    radius = 10.0  # a stadium: a half circle by a bulge, one by an arc, straight sides as lines
    inner.add_lwpolyline([(10.0, 0.0, 1.0), (-10.0, 0.0, 0.0)], format="xyb", dxfattribs={"layer": "0"})
    inner.add_arc((0.0, -20.0), radius, 180.0, 360.0, dxfattribs={"layer": "0"})
    for side in (-10.0, 10.0):
        inner.add_line((side, -20.0), (side, 0.0), dxfattribs={"layer": "0"})
    outer.add_blockref("ARCS", (0.0, 0.0), {"rotation": 90.0, "xscale": 2.0, "yscale": 2.0, "layer": "0"})
    for layer in ("CUT", "SEAL"):
        document.modelspace().add_blockref("POUCH", (5.0, 7.0), {"rotation": -90.0, "layer": layer})
    document.saveas(tmp_path / "stadium.dxf")
    drawing = read_drawing(tmp_path / "stadium.dxf")
    points = np.concatenate([line.points for line in drawing.layers["CUT"]])
    assert points.min(axis=0) == pytest.approx((-0.015, -0.053), abs=1e-5)
    assert points.max(axis=0) == pytest.approx((0.025, 0.027), abs=1e-5)
    film = flat_film(
        CutPattern(drawing.layers["CUT"], drawing.layers["SEAL"], (DrawnLine(np.array([[5e-3, 0.0]])),))
    )
    assert outline_length(film) == pytest.approx(2.0 * math.pi * 0.02 + 0.08, rel=5e-3)


@pytest.mark.parametrize("along", ["+x", "-x", "-y"])
def test_a_turned_drawing_gives_the_same_film(along: str, tmp_path: Path) -> None:
    turn = {"+x": lambda x, y: (y, -x), "-x": lambda x, y: (-y, x), "-y": lambda x, y: (-x, -y)}[along]

    def film(along: str, place: Any) -> Any:
        sheet = Sheet()
        for layer in ("CUT", "SEAL"):
            sheet.line(layer, [place(x, y) for x, y in rectangle()], close=True)
        sheet.line("SEAL", [place(10.0, 30.0), place(30.0, 50.0)])  # no axis of symmetry is left
        sheet.line("BASE", [place(0.0, 0.0), place(WIDTH, 0.0)])
        sheet.line("TIP", [place(0.0, LENGTH), place(WIDTH, LENGTH)]).port(*place(20.0, 60.0))
        sets = (PatternSetTable("base", layer="BASE"), PatternSetTable("tip", layer="TIP"))
        return drawn_pattern(sheet.table(tmp_path, sets=sets, along=along), "base")

    upright, turned = film("+y", lambda x, y: (x, y)), film(along, turn)
    assert np.array_equal(turned.triangles, upright.triangles)
    assert turned.positions == pytest.approx(upright.positions, abs=1e-9)  # the drawing's own rounding


def test_a_spline_keeps_its_length(tmp_path: Path) -> None:
    sheet = Sheet()
    sheet.space.add_spline([(0.0, 0.0), (30.0, 20.0), (60.0, 0.0)], dxfattribs={"layer": "CUT"})
    sheet.space.add_line((60.0, 0.0), (0.0, 0.0), dxfattribs={"layer": "CUT"})
    sheet.document.saveas(tmp_path / "spline.dxf")
    curve, _ = read_drawing(tmp_path / "spline.dxf").layers["CUT"]
    x = np.linspace(0.0, 0.06, 20001)  # the cubic through three points with natural ends here is a parabola
    length = float(np.hypot(np.diff(x), np.diff(0.02 * (1.0 - ((x - 0.03) / 0.03) ** 2))).sum())
    assert np.linalg.norm(np.diff(curve.points, axis=0), axis=1).sum() == pytest.approx(length, rel=2e-2)


SVG = """<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
  {size} viewBox="0 0 80 240">
  <g transform="translate(10 20)"><g transform="scale(2)">
    <g inkscape:groupmode="layer" inkscape:label="CUT" id="layer1"><rect width="30" height="90"/></g>
    <path id="SEAL-1" d="M 0 0 h 30 v 90 h -30 z"/>
    <circle stroke="#0f0" cx="15" cy="45" r="1"/>
    <line stroke="none" id="TIP" x1="0" y1="0" x2="30" y2="0"/>
  </g></g>
</svg>"""


def test_an_svg_has_its_lengths_through_nested_transforms(tmp_path: Path) -> None:
    path = tmp_path / "pouch.svg"
    path.write_text(SVG.format(size='width="40mm" height="120mm"').replace('id="TIP"', 'id="CABLE_tip"'))
    drawing = read_drawing(path)
    assert set(drawing.layers) == {"CUT", "SEAL", "PORT", "CABLE_TIP"}
    for layer in ("CUT", "SEAL"):
        (line,) = drawing.layers[layer]
        assert np.ptp(line.points, axis=0) == pytest.approx((0.03, 0.09), rel=1e-9)
        assert line.closed
    assert drawing.layers["CUT"][0].points.min(axis=0) == pytest.approx((0.005, 0.02), rel=1e-9)
    top = drawing.layers["CABLE_TIP"][0].points  # y leads upwards
    assert top[:, 1] == pytest.approx(drawing.layers["CUT"][0].points[:, 1].max())


def test_an_svg_without_a_length_needs_a_unit(tmp_path: Path) -> None:
    path = tmp_path / "pouch.svg"
    path.write_text(SVG.format(size='width="80" height="240"'))
    with pytest.raises(MeshError, match=r"pouch\.svg: states no unit: give body\.unit"):
        read_drawing(path)
    (line,) = read_drawing(path, "mm").layers["CUT"]
    assert np.ptp(line.points, axis=0) == pytest.approx((0.06, 0.18), rel=1e-9)


def test_points_and_lines_that_are_there_twice_do_not_matter(tmp_path: Path) -> None:
    once = understood(Sheet().pouch().table(tmp_path))
    doubled = [corner for corner in rectangle() for _ in range(2)]
    sheet = Sheet().pouch("CUT").line("CUT", doubled, close=True).line("SEAL", rectangle(), close=True)
    assert len(understood(sheet.table(tmp_path)).mesh.positions) == len(once.mesh.positions)


def test_ends_that_nearly_meet_are_joined(tmp_path: Path) -> None:
    corners: Array = np.array([*rectangle(), rectangle()[0]])
    sheet = Sheet().pouch("CUT", "SEAL")
    for layer in ("CUT", "SEAL"):
        for k, (a, b) in enumerate(pairwise(corners)):
            off = 0.006 * np.array([math.cos(k), math.sin(k)])
            sheet.line(layer, [tuple(a + off), tuple(b)])
    film = understood(sheet.table(tmp_path))
    assert (film.chamber == 0).all()


def test_a_place_is_told_in_mm() -> None:
    assert in_mm(np.array([0.01234, -0.5])) == "(12.34, -500.00) mm"
    assert in_mm(np.array([0.01234, -0.5, 0.0])) == "(12.34, -500.00, 0.00) mm"


def test_pairs_of_sheets_are_joined_at_their_hole_and_closed_at_both_ends(tmp_path: Path) -> None:
    half, hole = 0.03, 0.004
    angles = (2.0 * math.pi * k / 96 for k in range(96))
    corners = tuple((math.cos(angle), math.sin(angle)) for angle in angles)
    rim = tuple((hole * x, hole * y) for x, y in (*corners, corners[0]))
    sets = (
        PatternSetTable("base", line_m=rim, sheet="back", pair=1),
        PatternSetTable("tip", line_m=rim, sheet="front", pair=3),
    )
    table = PatternTable(
        outline_m=tuple((half * x, half * y) for x, y in corners),
        holes_m=(tuple((hole * x, hole * y) for x, y in corners),),
        port_m=(0.01, 0.0),
        edge="sealed",
        plane="flat",
        pairs=3,
        pair_height_m=0.002,
        mesh_m=0.002,
        sets=sets,
    )
    mesh = drawn_pattern(table, "base")
    assert len(mesh.caps) == 2
    x, caps = mesh.positions, [mesh.ring("base"), mesh.ring("tip")]
    assert [x[cap, 2].mean() for cap in caps] == pytest.approx([0.0, 0.006])
    gas = GasChambers([(mesh.triangles, mesh.caps)])
    cones = 3 * math.pi * 0.002 / 3.0 * (half**2 + half * hole + hole**2)  # from seam to hole
    assert gas.enclosed_volumes(x[None])[0, 0] == pytest.approx(cones, rel=0.01)
    body = SoftBody.from_arrays(x, mesh.triangles, Film(1e9, 0.3, 1e-4), caps=mesh.caps, tip=mesh.ring("tip"))
    assert body.tip_direction(x) == pytest.approx((0.0, 0.0, 1.0))


def test_panels_of_a_unit_reach_from_its_seam_to_its_hole_as_those_of_a_stack() -> None:
    half, hole = 0.03, 0.002
    square = tuple((half * x, half * y) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    around = tuple((hole * x, hole * y) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    box = ((-hole, -hole), (hole, hole))
    table = PatternTable(
        outline_m=square,
        holes_m=(around,),
        seams_m=((*square, square[0]),),
        port_m=(0.01, 0.0),
        edge="open",
        plane="flat",
        mesh_m=0.004,
        sets=(
            PatternSetTable("base", box_m=box, sheet="back"),
            PatternSetTable("tip", box_m=box, sheet="front"),
        ),
    )
    stack = PolygonalStack(4, 1, math.sqrt(2.0) * half, math.sqrt(2.0) * hole, 0.002).mesh()
    unit = drawn_pattern(table, "base").face_values["wrinkle_panel_m"]
    assert unit == pytest.approx(stack.face_values["wrinkle_panel_m"][0])
    raised = drawn_pattern(replace(table, edge="sealed", seams_m=(), pair_height_m=0.002), "base")
    assert [raised.positions[cap, 2].mean() for cap in raised.caps] == pytest.approx([0.0, 0.002])
    assert [len(cap) for cap in raised.caps] == [32, 32]  # however long the other edges are
    assert raised.face_values["wrinkle_panel_m"] == pytest.approx(unit)
    with pytest.raises(MeshError, match="no hole is open"):
        understood(replace(table, edge="sealed", holes_m=(), pair_height_m=0.002))
    ring = understood(replace(table, edge="sealed"))  # from the outer seam to that of the hole
    assert ring.panel_m == pytest.approx(2.0 * (half - hole) * (2.0 - math.sqrt(2.0)), rel=0.05)


def test_the_direction_of_a_tip_that_is_a_line_is_that_of_the_centre_line(tmp_path: Path) -> None:
    mesh = drawn_pattern(Sheet().pouch().table(tmp_path), "base")
    rings = {"base": mesh.ring("base")}
    body = SoftBody.from_arrays(
        mesh.positions, mesh.triangles, Film(1e9, 0.3, 1e-4), tip=mesh.ring("tip"), rings=rings
    )
    assert body.tip_is_line
    rotation = rotation_from_vector(np.array([0.3, -0.4, 0.2]))
    x = mesh.positions @ rotation.T
    assert TipFrame.of(body, x).direction == pytest.approx(rotation[:, 2])
    moved = 1e-7 * np.random.default_rng(1).normal(size=x.shape)
    turn = TipFrame.of(body, x).motion(body, x, moved)
    after = rotation_from_vector(turn[3:]) @ TipFrame.of(body, x).rotation
    assert TipFrame.of(body, x + moved).rotation == pytest.approx(after, abs=1e-10)


@pytest.mark.parametrize("right", [0.0, 9.0])
def test_the_direction_of_a_flat_tip_is_that_of_the_film_there(tmp_path: Path, right: float) -> None:
    sheet = Sheet().pouch("TIP").line("TIP", [(0.0, LENGTH), (WIDTH - right, LENGTH)])
    body = build_soft_body(robot_of(sheet.table(tmp_path)), ModelTable())
    assert body.tip_direction(body.positions) == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    # rolled into an arc of 80 degrees: normals of the sheets do not stretch
    x, turn = body.positions, np.radians(80.0) / 0.118
    angle = turn * x[:, 2]
    rolled = np.stack([x[:, 0], (1.0 - np.cos(angle)) / turn, np.sin(angle) / turn], axis=1)
    end = np.degrees(np.arctan2(*body.tip_direction(rolled)[1:]))
    assert end == pytest.approx(80.0, abs=3.0)  # half a row of triangles before the tip
    assert body.tip_measured_by.startswith("film of ")
    frame, moved = TipFrame.of(body, rolled), 1e-7 * np.random.default_rng(1).normal(size=x.shape)
    after = rotation_from_vector(frame.motion(body, rolled, moved)[3:]) @ frame.rotation
    assert TipFrame.of(body, rolled + moved).rotation == pytest.approx(after, abs=1e-9)


def test_a_welded_area_bends_eight_times_as_hard_as_a_sheet(tmp_path: Path) -> None:
    sheet = Sheet().pouch("PORT").line("SEAL", [(0.0, 60.0), (WIDTH, 60.0)]).port(20.0, 30.0)
    robot = robot_of(sheet.table(tmp_path))
    body = build_soft_body(robot, ModelTable())
    hinges, x = body.hinges, body.positions
    upper = x[hinges.nodes].mean(axis=1)[:, 2] + 1e-9 > 0.065
    lower = x[hinges.nodes].mean(axis=1)[:, 2] < 0.05
    rigidity = build_film(robot.film).flexural_rigidity_Nm
    for part, factor, area in ((upper, 8.0, 0.04 * 0.05), (lower, 2.0, 0.04 * 0.05)):
        measure = bending_measure(x, hinges.nodes[part], hinges.stiffness[part])
        assert measure / rigidity / area == pytest.approx(factor, rel=0.12)


SHEET = FilmTable(young_modulus_Pa=1e9, poisson_ratio=0.3, thickness_m=1e-4, density_kg_m3=1000.0)


def robot_of(table: PatternTable) -> SoftRobotTable:
    return SoftRobotTable("pouch", "a test", SHEET, body=table, base=("base",), hinge=HingeTable("shell"))


def test_chambers_have_the_names_of_their_ports_and_their_own_gas(tmp_path: Path) -> None:
    sheet = Sheet().pouch("PORT").line("SEAL", [(20.0, 0.0), (20.0, LENGTH)])
    for name, x in (("LEFT", 10.0), ("RIGHT", 30.0)):
        sheet.space.add_point((x, 60.0), dxfattribs={"layer": f"PORT_{name}"})
    table = sheet.table(tmp_path, chambers=("right", "left"))
    thick = FaceGroupTable("left", replace(SHEET, thickness_m=2e-4))
    robot = replace(robot_of(table), groups=(thick,))
    body = build_soft_body(robot, ModelTable())
    assert robot.chamber_names() == ("right", "left") == tuple(part.name for part in body.gas_chambers)
    bulged = body.positions.copy()  # the front of the right half, towards -y
    front = np.unique(
        drawn_pattern(table, "base").triangles[drawn_pattern(table, "base").face_groups["front"]]
    )
    seam = np.isin(np.arange(len(bulged)), np.unique(body.triangles)) & (np.abs(bulged[:, 0]) < 1e-9)
    right = front[(bulged[front, 0] > 0.0) & ~seam[front]]
    bulged[right, 1] -= 1e-3
    volumes = GasChambers(body.enclosures).enclosed_volumes(bulged[None])[0]
    assert volumes[0] > 1e-6
    assert volumes[1] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("sheet", "side"), [("front", 1.0), ("back", -1.0)])
def test_a_crease_of_a_welded_tab_rests_at_its_angle_with_its_ridge_outside(
    sheet: Any, side: float, tmp_path: Path
) -> None:
    drawn = Sheet().pouch("PORT").line("SEAL", [(0.0, 60.0), (WIDTH, 60.0)]).port(20.0, 30.0)
    drawn.line("FOLD_TAB", [(0.0, 90.0), (WIDTH, 90.0)])
    fold = PatternFoldTable(0.6, layer="FOLD_TAB", sheet=sheet)
    body = build_soft_body(robot_of(drawn.table(tmp_path, folds=(fold,))), ModelTable())
    flat = body.positions
    height = flat[:, 2].max() - 0.03  # of the crease
    resting = {}
    for angle in (0.6, -0.6):  # the front faces -y: with its ridge there the tab leans to +y
        x = flat.copy()
        beyond = flat[:, 2] > height + 1e-9
        x[beyond, 1] = side * math.sin(angle) * (flat[beyond, 2] - height)
        x[beyond, 2] = height + math.cos(angle) * (flat[beyond, 2] - height)
        system = FilmPotential(body)
        system.evaluate(x, Loads(gravity=(0.0, 0.0, 0.0)), np.zeros(0), system.memory, hessian=False)
        resting[angle] = np.abs(system.gradient).max()
    assert resting[0.6] < 1e-9
    assert resting[-0.6] > 1e-2


def test_creases_of_a_chamber_fold_both_sheets_outwards_and_points_do_as_a_layer(tmp_path: Path) -> None:
    line = ((0.0, 0.09), (0.04, 0.09))
    table = Sheet().pouch().table(tmp_path, folds=(PatternFoldTable(0.5, line_m=line),))
    hinges = build_soft_body(robot_of(table), ModelTable()).hinges
    turned = np.flatnonzero(np.abs(hinges.rest_angle - math.pi) > 1e-9)
    np.testing.assert_allclose(hinges.rest_angle[turned], math.pi - 0.5)
    x = build_soft_body(robot_of(table), ModelTable()).positions
    edges = x[hinges.nodes[turned, 1:3]]
    assert np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum() == pytest.approx(2.0 * 0.04)
    np.testing.assert_allclose(edges[:, :, 2], x[:, 2].max() - 0.03)
    with pytest.raises(MeshError, match=r"layer FOLD_RIDGE is empty; there are: CUT, PORT, SEAL, TIP"):
        understood(Sheet().pouch().table(tmp_path, folds=(PatternFoldTable(0.5, layer="FOLD_RIDGE"),)))


def test_a_frame_along_the_seam_keeps_the_width_of_a_pouch(tmp_path: Path) -> None:
    beam = StiffenerTable("beam", width_m=10e-3, height_m=6e-3, young_modulus_Pa=1.7e9)
    widths, lengths = [], []
    for framed in (False, True):
        sheet = Sheet().pouch()
        if framed:
            sheet.line("FRAME", rectangle(), close=True)
        robot = replace(
            robot_of(sheet.table(tmp_path, mesh_m=0.01)), stiffener=beam if framed else StiffenerTable()
        )
        body = build_soft_body(robot, ModelTable())
        lengths += [frame.lengths.sum() for frame in body.elements if isinstance(frame, BeamRings)]
        middle = np.flatnonzero(np.abs(body.positions[:, 2] - body.positions[:, 2].mean()) < 6e-3)
        held = np.zeros_like(body.positions, dtype=bool)
        held[body.base] = True
        specimen = Specimen(body, held, NewtonOptions(tolerance_N=1e-4, iterations_max=400, step_max_m=5e-3))
        start = body.positions + 1e-4 * np.random.default_rng(1).normal(size=body.positions.shape)
        start[body.base] = body.positions[body.base]
        loads = replace(UNLOADED, pressure_Pa=(1e3,))
        x = specimen.solve(specimen.drawn(start), loads).state.positions
        widths.append(np.ptp(x[middle, 0]))
    assert lengths == [pytest.approx(0.32)]
    assert widths[0] < 0.038
    assert widths[1] > 0.0395
    with pytest.raises(MeshError, match=r"layer FRAME.*need one another"):
        build_soft_body(replace(robot, stiffener=StiffenerTable()), ModelTable())
