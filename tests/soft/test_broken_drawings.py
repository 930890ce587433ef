"""Forty broken drawings and meshes, and more: each gets one error with its place, or is read rightly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.build.soft_body import build_soft_body
from cosim.config.schema.body_sources import MeshTable, NodeSetTable
from cosim.config.schema.pattern import PatternSetTable, PatternTable
from cosim.config.schema.settings import ModelTable
from cosim.config.schema.soft_robot import HingeTable, SoftRobotTable
from cosim.errors import MeshError
from tests.soft.test_cut_pattern import SETS, SHEET, Sheet, rectangle, understood

ezdxf = pytest.importorskip("ezdxf", reason="needs the extra pattern")


def open_seam(sheet: Sheet) -> None:
    sheet.pouch("SEAL").line("SEAL", [(0, 60), (0, 0), (40, 0), (40, 120), (0, 120), (0, 70)])


def crossing(sheet: Sheet) -> None:
    sheet.pouch("CUT").line("CUT", [(0, 0), (40, 0), (0, 120), (40, 120)], close=True)


def port_outside(sheet: Sheet) -> None:
    sheet.pouch("PORT").port(55.0, 60.0)


def second_port(sheet: Sheet) -> None:
    sheet.pouch().port(20.0, 90.0)


def no_port(sheet: Sheet) -> None:
    sheet.pouch("PORT")


def no_cut(sheet: Sheet) -> None:
    sheet.pouch("CUT")


def no_seal(sheet: Sheet) -> None:
    sheet.pouch("SEAL")


def no_tip(sheet: Sheet) -> None:
    sheet.pouch("TIP")


def gap(sheet: Sheet) -> None:
    sheet.pouch("CUT").line("CUT", [(0, 0.3), (0, 120), (40, 120), (40, 0), (0, 0)])


def two_outlines(sheet: Sheet) -> None:
    sheet.pouch().line("CUT", [(100, 0), (140, 0), (140, 50)], close=True)


def crossing_outlines(sheet: Sheet) -> None:
    sheet.pouch().line("HOLE", [(30, 80), (50, 80), (50, 100), (30, 100)], close=True)


def port_on_seam(sheet: Sheet) -> None:
    sheet.pouch().line("SEAL", [(0, 60), (40, 60)])


def a_mere_point(sheet: Sheet) -> None:
    sheet.pouch().space.add_point((1, 1), dxfattribs={"layer": "SEAL"})


def far_too_small(sheet: Sheet) -> None:
    sheet.scale = 1e-4
    sheet.pouch()


def seam_outside(sheet: Sheet) -> None:
    sheet.pouch().line("SEAL", [(20, 60), (60, 60)])


def unsealed_hole(sheet: Sheet) -> None:
    sheet.pouch().space.add_circle((20, 90), 5, dxfattribs={"layer": "HOLE"})


def open_frame(sheet: Sheet) -> None:
    sheet.pouch().line("FRAME", [(0, 60), (40, 60)])


def frame_over_a_chamber(sheet: Sheet) -> None:
    sheet.pouch().line("FRAME", rectangle(inset=5.0), close=True)


def on(layer: str) -> dict[str, str]:
    return {"layer": layer}


def circle_of_no_size(sheet: Sheet) -> None:
    sheet.pouch().space.add_circle((5, 7), 0.0, dxfattribs=on("SEAL"))


def open_spline(sheet: Sheet) -> None:
    points = [(0, 0), (40, 0), (40, 120), (0, 120), (0, 20)]
    sheet.pouch("CUT").space.add_spline(points, dxfattribs=on("CUT"))


def bulge_that_crosses(sheet: Sheet) -> None:
    corners = [(0, 0, 0), (40, 0, 0), (40, 120, -6), (0, 120, 0)]
    sheet.pouch("CUT").space.add_lwpolyline(corners, format="xyb", close=True, dxfattribs=on("CUT"))


def block_within_itself(sheet: Sheet) -> None:
    block = sheet.document.blocks.new("LOOP")
    block.add_blockref("LOOP", (1, 1))
    sheet.pouch().space.add_blockref("LOOP", (0, 0))


def block_that_is_missing(sheet: Sheet) -> None:
    sheet.pouch().space.add_blockref("NOTHING", (0, 0))


def sheet_that_rises(sheet: Sheet) -> None:
    corners = [(0, 0, 0), (40, 0, 0), (40, 120, 30), (0, 120, 30)]
    sheet.pouch("CUT").space.add_polyline3d(corners, close=True, dxfattribs=on("CUT"))


def line_without_end(sheet: Sheet) -> None:
    sheet.pouch().space.add_xline((0, 0), (1, 0), dxfattribs=on("SEAL"))


def not_a_number(sheet: Sheet) -> None:
    sheet.pouch().space.add_line((5, 5), (float("nan"), 10), dxfattribs=on("SEAL"))


def outline_beside_outline(sheet: Sheet) -> None:
    sheet.pouch().line("CUT", [(0.1, 0), (40.1, 0), (40.1, 120), (0.1, 120)], close=True)


def hole_at_the_edge(sheet: Sheet) -> None:
    sheet.pouch().line("HOLE", [(0, 60), (10, 60), (10, 70), (0, 70)], close=True)


def port_in_a_hole_at_the_corner(sheet: Sheet) -> None:
    sheet.pouch("PORT").line("HOLE", rectangle(10, 10), close=True).port(5, 5)


def hole_within_a_hole(sheet: Sheet) -> None:
    for radius in (5, 2):
        for layer in ("HOLE", "SEAL"):
            sheet.space.add_circle((20, 90), radius, dxfattribs=on(layer))
    sheet.pouch("PORT").port(20, 20)


def outline_of_no_area(sheet: Sheet) -> None:
    sheet.pouch("CUT").line("CUT", [(0, 0), (40, 0), (0, 0)], close=True)


def outline_that_goes_back(sheet: Sheet) -> None:
    sheet.pouch("CUT").line("CUT", [(0, 0), (40, 0), (40, 120), (40, 60), (40, 120), (0, 120)], close=True)


def seam_that_crosses_itself(sheet: Sheet) -> None:
    sheet.pouch().line("SEAL", [(10, 30), (30, 30), (20, 20), (20, 50)])


def seam_of_no_length(sheet: Sheet) -> None:
    sheet.pouch().line("SEAL", [(20, 30), (20.002, 30)])


def fold_outside(sheet: Sheet) -> None:
    sheet.pouch().line("FOLD", [(0, 60), (60, 60)])


def text_on_the_layer(sheet: Sheet) -> None:
    sheet.pouch("CUT").space.add_text("cut here", dxfattribs=on("CUT"))


def metres_for_millimetres(sheet: Sheet) -> None:
    sheet.document.header["$INSUNITS"] = 6
    sheet.pouch()


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (
            open_seam,
            r"chamber of CIRCLE #\w+ of layer PORT is open at \(0\.00, 6\d\.\d\d\) mm: no seam closes it",
        ),
        (crossing, r"LWPOLYLINE #\w+ of layer CUT crosses or covers itself at \(20\.00, 60\.00\) mm"),
        (port_outside, r"CIRCLE #\w+ of layer PORT at \(55\.00, 60\.00\) mm is outside the sheet"),
        (second_port, r"at \(20\.00, 90\.00\) mm leads into the chamber of CIRCLE #\w+ of layer PORT"),
        (no_port, "layer PORT is empty; there are: CUT, SEAL, TIP"),
        (no_cut, "layer CUT is empty; there are: PORT, SEAL, TIP"),
        (no_seal, r"layer SEAL is empty: draw the seams on it, or set body\.edge = 'sealed'"),
        (no_tip, "layer TIP is empty; there are: CUT, PORT, SEAL"),
        (gap, r"the outline is open at \(0\.00, 0\.\d\d\) mm"),
        (two_outlines, r"the outline has 2 pieces side by side, one at \(1[23]\d\.\d\d, \d+\.\d\d\) mm"),
        (
            crossing_outlines,
            r"of layer CUT crosses LWPOLYLINE #\w+ of layer HOLE at \(40\.00, (8|10)0\.00\) mm",
        ),
        (port_on_seam, r"CIRCLE #\w+ of layer PORT at \(20\.00, 60\.00\) mm lies on a seam"),
        (a_mere_point, r"POINT #\w+ of layer SEAL at \(1\.00, 1\.00\) mm has no length"),
        (far_too_small, r"the outline is 0\.004 x 0\.012 mm; at least 1 mm are meshed: is the unit right"),
        (seam_outside, r"LWPOLYLINE #\w+ of layer SEAL leaves the outline at \((5\d|60)\.\d\d, 60\.00\) mm"),
        (unsealed_hole, r"is open at \((1|2)\d\.\d\d, (8|9)\d\.\d\d\) mm: no seam closes it"),
        (
            open_frame,
            r"LWPOLYLINE #\w+ of layer FRAME is open at \(40\.00, 60\.00\) mm: a frame is a closed line",
        ),
        (
            frame_over_a_chamber,
            r"LWPOLYLINE #\w+ of layer FRAME is over a chamber at \(.*\) mm: draw it along seams",
        ),
        (circle_of_no_size, r"CIRCLE #\w+ of layer SEAL at \(5\.00, 7\.00\) mm has no length"),
        (open_spline, r"the outline is open at \(0\.00, 20\.00\) mm"),
        (
            bulge_that_crosses,
            r"LWPOLYLINE #\w+ of layer CUT crosses or covers itself at \(-?0\.00, 3\.\d\d\) mm",
        ),
        (block_within_itself, "blocks lie 16 deep within one another; do they hold themselves"),
        (
            block_that_is_missing,
            r"INSERT #\w+ of layer 0 draws block 'NOTHING', which the file does not have",
        ),
        (sheet_that_rises, r"POLYLINE #\w+ of layer CUT is not flat: it rises by 30\.00 mm in z"),
        (line_without_end, r"XLINE #\w+ of layer SEAL: cannot be drawn as a line: explode it"),
        (not_a_number, r"LINE #\w+ of layer SEAL has a coordinate that is not finite"),
        (
            outline_beside_outline,
            r"of layer CUT touches LWPOLYLINE #\w+ of layer CUT at \(\d+\.\d\d, (12)?0\.00\)",
        ),
        (
            hole_at_the_edge,
            r"of layer CUT touches LWPOLYLINE #\w+ of layer HOLE at \(0\.00, [67]\d\.\d\d\) mm",
        ),
        (
            port_in_a_hole_at_the_corner,
            r"of layer CUT touches LWPOLYLINE #\w+ of layer HOLE at \(\d+\.\d\d, \d",
        ),
        (
            hole_within_a_hole,
            r"the outline has 2 pieces side by side, one at \((19|20)\.\d\d, (89|9\d)\.\d\d\) mm",
        ),
        (
            outline_of_no_area,
            r"LWPOLYLINE #\w+ of layer CUT crosses or covers itself at \(40\.00, 0\.00\) mm",
        ),
        (
            outline_that_goes_back,
            r"LWPOLYLINE #\w+ of layer CUT crosses or covers itself at \(40\.00, 60\.00\) mm",
        ),
        (seam_that_crosses_itself, r"of layer SEAL crosses or covers itself at \(20\.00, 30\.00\) mm"),
        (seam_of_no_length, r"LWPOLYLINE #\w+ of layer SEAL at \(20\.00, 30\.00\) mm has no length"),
        (fold_outside, r"LWPOLYLINE #\w+ of layer FOLD leaves the outline at \(60\.00, 60\.00\) mm"),
        (text_on_the_layer, "layer CUT is empty; there are: PORT, SEAL, TIP"),
        (metres_for_millimetres, r"of layer CUT reaches beyond 100 m; the drawing is in m: is that its unit"),
    ],
)
def test_a_broken_pattern_is_told_what_and_where(broken: Any, message: str, tmp_path: Path) -> None:
    sheet = Sheet()
    broken(sheet)
    with pytest.raises(MeshError, match=message):
        understood(sheet.table(tmp_path))


@pytest.mark.parametrize(
    ("unit", "given", "message"),
    [
        (0, None, r"states no unit: give body\.unit, such as unit = 'mm'"),
        (4, "in", r"is in mm, body\.unit says in"),
        (2, None, r"has \$INSUNITS 2; read are 1 \(in\), 4 \(mm\)"),
    ],
)
def test_a_wrong_or_missing_unit_is_refused(unit: int, given: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=message):
        understood(Sheet(unit).pouch().table(tmp_path, unit=given))


def leak(sheet: Sheet) -> None:
    sheet.pouch("PORT").line("SEAL", [(20, 0), (20, 119)])


def seam_on_seam(sheet: Sheet) -> None:
    sheet.pouch("PORT", "SEAL")
    for x in (0, 20):
        sheet.line("SEAL", [(x, 0), (x + 20, 0), (x + 20, 120), (x, 120)], close=True)


def one_point_of_two(sheet: Sheet) -> None:
    sheet.pouch("PORT", "SEAL")
    sheet.line("SEAL", [(0, 0), (40, 0), (20, 60), (0, 120), (40, 120), (20, 60), (0, 0)])


@pytest.mark.parametrize(
    ("drawn", "right", "found"),
    [
        (
            leak,
            "RIGHT",
            r"POINT #\w+ of layer PORT_RIGHT at \(30\.00, 60\.00\) mm leads into the chamber of POINT",
        ),
        (seam_on_seam, "RIGHT", (0, 1)),
        (
            seam_on_seam,
            "LEFT",
            r"layer PORT_LEFT has 2 lines, one at \(30\.00, 60\.00\) mm; a chamber has one port",
        ),
        (
            seam_on_seam,
            "CENTRE",
            "layer PORT_right is empty; there are: CUT, PORT_CENTRE, PORT_LEFT, SEAL, TIP",
        ),
    ],
)
def test_two_chambers_that_touch_are_two_or_are_told(
    drawn: Callable[[Sheet], None], right: str, found: Any, tmp_path: Path
) -> None:
    sheet = Sheet()
    drawn(sheet)
    for name, x in (("LEFT", 10.0), (right, 30.0)):
        sheet.space.add_point((x, 60.0), dxfattribs=on(f"PORT_{name}"))
    if right == "LEFT":
        sheet.space.add_point((30.0, 30.0), dxfattribs=on("PORT_RIGHT"))
    table = sheet.table(tmp_path, chambers=("left", "right"))
    if isinstance(found, str):
        with pytest.raises(MeshError, match=found):
            understood(table)
    else:
        assert set(understood(table).chamber.tolist()) == set(found)


PAGE = 'width="40mm" height="120mm" viewBox="0 0 40 120"'
RECTANGLES = '<rect id="CUT" width="40" height="120"/><rect id="SEAL" width="40" height="120"/>'
PORT = '<circle id="PORT" cx="20" cy="60" r="1"/>'
POUCH = RECTANGLES + PORT


@pytest.mark.parametrize(
    ("page", "shapes", "message"),
    [
        ('width="100%" height="100%" viewBox="0 0 40 120"', POUCH, r"pouch\.svg: states no unit"),
        ('width="40pt" height="120pt"', POUCH, r"pouch\.svg: states no unit"),
        ('width="0mm" height="120mm"', POUCH, "has width '0mm' and height '120mm'; give the true size"),
        ('width="40mm" viewBox="0 0 40 120"', POUCH, "has width '40mm' and height ''; give the true size"),
        (
            PAGE,
            f'<g transform="scale(1e4)">{POUCH}</g>',
            "rect 'CUT' of layer CUT reaches beyond 100 m; the drawing is in mm",
        ),
        (PAGE, POUCH.replace("CUT", "CUTS"), "layer CUT is empty; there are: PORT, SEAL"),
        (
            PAGE,
            POUCH.replace('cx="20"', 'cx="60"'),
            r"circle 'PORT' of layer PORT at \(60\.00, 60\.00\) mm is outside",
        ),
        (
            PAGE,
            POUCH.replace(
                '<rect id="CUT" width="40" height="120"/>', '<path id="CUT" d="M0 0 L40 120 H0 L40 0 Z"/>'
            ),
            r"path 'CUT' of layer CUT crosses or covers itself at \(20\.00, 60\.00\) mm",
        ),
        (
            PAGE,
            POUCH.replace(
                '<rect id="CUT" width="40" height="120"/>',
                '<path id="CUT" d="M0 0 C9 9 30 -9 40 0 V120 H0 V1"/>',
            ),
            r"the outline is open at \(0\.00, 119\.00\) mm",
        ),
    ],
)
def test_a_broken_svg_is_told_what_and_where(page: str, shapes: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=message):
        understood(svg(tmp_path, page, shapes))


@pytest.mark.parametrize(
    "shapes",
    [
        f'<g transform="translate(40 120) rotate(180)">{POUCH}</g>',
        f'<g transform="translate(40 0) scale(-2 2)"><g transform="scale(.5)">{POUCH}</g></g>',
        f'<g transform="rotate(-90)"><g transform="rotate(90)">{POUCH}</g></g>',
        '<defs><rect id="a" width="40" height="120"/></defs>'
        f'<use id="CUT" href="#a"/><use id="SEAL" href="#a"/>{PORT}',
        f'<svg width="40" height="120" viewBox="0 0 80 240"><g transform="scale(2)">{POUCH}</g></svg>',
        POUCH.replace('id="CUT"', 'style="stroke:#f00"').replace('id="SEAL"', 'style="stroke:blue"'),
    ],
)
def test_nested_transforms_uses_and_colours_are_read_rightly(shapes: str, tmp_path: Path) -> None:
    film = understood(svg(tmp_path, PAGE, shapes))
    x = film.mesh.positions
    np.testing.assert_allclose([x.min(axis=0), x.max(axis=0)], [[0.0, 0.0], [0.04, 0.12]], atol=1e-9)
    assert (film.chamber == 0).all()


def svg(folder: Path, page: str, shapes: str, **keys: Any) -> PatternTable:
    path = folder / "pouch.svg"
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {page}>{shapes}</svg>', encoding="utf-8")
    sets = (SETS[0], PatternSetTable("tip", box_m=((0.0, 0.11), (0.04, 0.12))))
    return PatternTable(file=str(path), sets=sets, **keys)


def test_another_unit_than_an_svg_has_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"pouch\.svg: is in mm, body\.unit says in"):
        understood(svg(tmp_path, PAGE, POUCH, unit="in"))


BOX = [(x, y, z) for z in (0, 50) for x, y in ((0, 0), (20, 0), (20, 20), (0, 20))]
SIDES = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
ENDS = [(0, 3, 2, 1), (4, 5, 6, 7)]
BESIDE = [(x + 20, y, z) for x, y, z in BOX]
APART = [(x + 40, y, z + 10) for x, y, z in BOX]
ON_THE_WALL = {0: 1, 3: 2, 4: 5, 7: 6}


def obj(vertices: Any, faces: Any) -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    return "\n".join([*lines, *("f " + " ".join(str(k + 1) for k in face) for face in faces)])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "turned.obj",
            obj(BOX, [SIDES[0][::-1], *SIDES[1:], *ENDS]),
            r"edge \[\d, \d\] at \(\d+\.00, 0\.00, \d+\.00\) mm in the same sense",
        ),
        (
            "inside_out.obj",
            obj(BOX, [face[::-1] for face in (*SIDES, *ENDS)]),
            r"inside_out\.obj: is inside out",
        ),
        (
            "fin.obj",
            obj([*BOX, (40, 0, 25)], [*SIDES, *ENDS, (0, 4, 8)]),
            r"edge \[0, \d\] at \(0\.00, 0\.00, 25\.00\) mm belongs to 3",
        ),
        (
            "twice.obj",
            obj(BOX, [*SIDES, *ENDS, SIDES[0]]),
            r"edge \[\d, \d\] at \(.*\) mm belongs to 3 triangles",
        ),
        (
            "sliver.obj",
            obj([*BOX, (10, 0, 0)], [(0, 3, 2, 1, 8), ENDS[1], *SIDES, (0, 8, 1)]),
            r"triangle \d+ .* at \(10\.00, 0\.00, 0\.00\) mm is degenerate",
        ),
        (
            "chambers.obj",
            obj(
                [*BOX, *BESIDE],
                [
                    *SIDES,
                    *ENDS,
                    *(tuple(ON_THE_WALL.get(k, k + 8) for k in face) for face in (*SIDES[:3], *ENDS)),
                ],
            ),
            r"edge \[\d+, \d+\] at \(20\.00, .*\) mm belongs to 3 triangles",
        ),
        (
            "two.obj",
            obj([*BOX, *APART], [*SIDES, *ENDS, *(tuple(k + 8 for k in face) for face in (*SIDES, *ENDS))]),
            r"piece of film around \(50\.00, 10\.00, 35\.00\) mm shares no node .* no base \(base\)",
        ),
        (
            "corner.obj",
            obj(
                [*BOX, *((x + 20, y + 20, z + 50) for x, y, z in BOX)],
                [*SIDES, *ENDS, *(tuple(6 if k == 0 else k + 8 for k in face) for face in (*SIDES, *ENDS))],
            ),
            r"corner\.obj: two parts of the film touch only in node \d+ at \(20\.00, 20\.00, 50\.00\) mm",
        ),
        ("index.obj", obj(BOX, [*SIDES, (0, 1, 20)]), "a face names vertex 21; there are 8"),
        (
            "nan.obj",
            obj([("nan", 0, 0), *BOX[1:]], [*SIDES, *ENDS]),
            "nan.obj: holds a number that is not finite",
        ),
        ("empty.obj", "# nothing", "empty.obj: holds no triangles"),
        ("short.stl", "solid\nfacet", r"short\.stl: "),
        (
            "metres.obj",
            obj(1e3 * np.array(BOX), [*SIDES, *ENDS]),
            r"set 'tip' is at z = 0\.05 m, where no node is; the film reaches from 0 m to 50 m",
        ),
    ],
)
def test_a_broken_mesh_is_told_what_and_where(name: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(MeshError, match=message):
        film_of(tmp_path / name)


def film_of(path: Path) -> Any:
    sets = (NodeSetTable("base", axis="z", at_m=0.0), NodeSetTable("tip", axis="z", at_m=0.05))
    body = MeshTable(file=str(path), scale=1e-3, sets=sets)
    robot = SoftRobotTable("box", "a test", SHEET, body=body, base=("base",), hinge=HingeTable("shell"))
    return build_soft_body(robot, ModelTable())


def test_open_ends_points_that_are_twice_and_points_of_no_face_do_not_matter(tmp_path: Path) -> None:
    twice = [BOX[k] for face in SIDES for k in face]
    quads = [tuple(range(4 * k, 4 * k + 4)) for k in range(4)]
    for vertices, faces in ((BOX, SIDES), (twice, quads), ([*BOX, (99, 0, 0)], SIDES)):
        (tmp_path / "tube.obj").write_text(obj(vertices, faces), encoding="utf-8")
        body = film_of(tmp_path / "tube.obj")
        assert (len(body.positions), len(body.triangles), len(body.caps)) == (8, 8, 2)


@pytest.mark.parametrize("text", ["", "0\nSECTION\n", "not a drawing", "<svg"])
@pytest.mark.parametrize("suffix", [".dxf", ".svg"])
def test_what_is_no_drawing_is_refused(suffix: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / f"broken{suffix}"
    path.write_text(text)
    with pytest.raises(MeshError, match=rf"broken\{suffix}: "):
        understood(PatternTable(file=str(path), unit="mm", sets=SETS))
