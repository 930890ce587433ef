"""Builds the film of a cut pattern from its table and drawing: sheets, seams, ports, creases and sets of
nodes.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cosim.base.drawing import Drawing, DrawnLine, read_drawing
from cosim.base.frames import in_mm
from cosim.config.schema.pattern import PatternSetTable, PatternTable
from cosim.errors import MeshError
from cosim.soft.geometry.cut_pattern import (
    CutPattern,
    DrawnCrease,
    NodeChoice,
    Placing,
    flat_film,
    inflatable,
)
from cosim.soft.geometry.named_mesh import NamedMesh

_GIVEN_LINE = "fold.line_m"


def drawn_pattern(table: PatternTable, base: str, framed: bool = False) -> NamedMesh:
    """Return the film of a cut pattern, flat, in the flange's frame.

    Args:
        table: of the pattern.
        base: name of the set whose middle is the flange's origin.
        framed: whether the robot has stiffeners along frames.

    Raises:
        MeshError: the drawing cannot be read, is not a pattern, or has frames without stiffeners or the
            reverse; the message has the place in the drawing.
    """
    pattern = cut_pattern(table)
    if framed != bool(pattern.frames):
        lines = ", ".join(line.where for line in pattern.frames) or "layer FRAME has no lines"
        raise MeshError(f"{lines}: [stiffener] with kind = 'beam' and lines of layer FRAME need one another")
    return inflatable(flat_film(pattern, table.along), pattern, placing(table, base))


def placing(table: PatternTable, base: str) -> Placing:
    """Return the placement of a pattern on the flange."""
    own = base if base in table.set_names() else table.sets[0].name
    return Placing(table.along, table.plane == "upright", own, table.tip, (own, *table.center))


def cut_pattern(table: PatternTable, drawing: Drawing | None = None) -> CutPattern:
    """Return the sheets, seams, ports and sets of a pattern, in the drawing's coordinates.

    Args:
        table: of the pattern.
        drawing: of its file, if it has been read already.

    Raises:
        MeshError: the drawing cannot be read, or a layer that is needed is empty.
    """
    if table.file is None:
        return _from_points(table)
    read = read_drawing(Path(table.file), table.unit) if drawing is None else drawing
    name = Path(table.file).name
    cut = _layer(read, "CUT", name)
    holes = read.layers.get("HOLE", ())
    seal = read.layers.get("SEAL", ())
    if table.edge == "sealed":
        seal = (*cut, *(holes if table.pair_height_m is None else ()), *seal)
    elif not seal:
        raise MeshError(
            f"{name}: layer SEAL is empty: draw the seams on it, or set body.edge = 'sealed' if all edges "
            "are welded"
        )
    creases = _creases(table, read, name)
    return CutPattern(
        cut=cut,
        holes=holes,
        seal=seal,
        ports=_ports(table, read, name),
        chambers=table.chambers,
        folds=(
            *(line for layer, lines in read.layers.items() if layer.startswith("FOLD") for line in lines),
            *(crease.line for crease in creases if crease.line.where == _GIVEN_LINE),
        ),
        creases=creases,
        frames=read.layers.get("FRAME", ()),
        sets=tuple(_choice(entry, read, name) for entry in table.sets),
        seam_width_m=table.seam_width_m,
        mesh_m=table.mesh_m,
        open_ends=table.edge == "open",
        pairs=table.pairs,
        pair_height_m=table.pair_height_m or 0.0,
    )


def _creases(table: PatternTable, drawing: Drawing | None, name: str) -> tuple[DrawnCrease, ...]:
    """Return the lines that rest at an angle."""
    found = []
    for entry in table.folds:
        if entry.layer is not None and drawing is not None:
            lines = _layer(drawing, entry.layer, name)
        else:
            lines = (DrawnLine(np.array(entry.line_m), _GIVEN_LINE),)
        found += [DrawnCrease(line, entry.sheet, entry.rest_angle_rad) for line in lines]
    return tuple(found)


def _ports(table: PatternTable, drawing: Drawing, name: str) -> tuple[DrawnLine, ...]:
    """Return the ports of a drawing, those of named chambers in the order of the names."""
    if not table.chambers:
        return _layer(drawing, "PORT", name)
    found = [_layer(drawing, f"PORT_{chamber}", name) for chamber in table.chambers]
    for chamber, lines in zip(table.chambers, found, strict=True):
        if len(lines) > 1:
            raise MeshError(
                f"{name}: layer PORT_{chamber.upper()} has {len(lines)} lines, one at "
                f"{in_mm(lines[1].middle)}; a chamber has one port"
            )
    return tuple(lines[0] for lines in found)


def _layer(drawing: Drawing, layer: str, name: str) -> tuple[DrawnLine, ...]:
    lines = drawing.layers.get(layer.upper(), ())
    if not lines:
        known = ", ".join(sorted(drawing.layers)) or "none with lines"
        raise MeshError(f"{name}: layer {layer} is empty; there are: {known}")
    return lines


def _from_points(table: PatternTable) -> CutPattern:
    assert table.outline_m is not None, "a checked pattern has a file or an outline"
    assert table.port_m is not None, "a checked outline has a port"
    cut = (_closed(table.outline_m, "outline_m"),)
    holes = tuple(
        _closed(corners, f"holes_m[{place}]") for place, corners in enumerate(table.holes_m, start=1)
    )
    sealed_holes = holes if table.pair_height_m is None else ()
    seams = tuple(
        DrawnLine(np.array(points), f"seams_m[{place}]")
        for place, points in enumerate(table.seams_m, start=1)
    )
    creases = _creases(table, None, "")
    return CutPattern(
        cut=cut,
        holes=holes,
        seal=(*cut, *sealed_holes, *seams) if table.edge == "sealed" else seams,
        ports=(DrawnLine(np.array([table.port_m]), "port_m"),),
        folds=tuple(crease.line for crease in creases),
        creases=creases,
        sets=tuple(_choice(entry, None, "") for entry in table.sets),
        seam_width_m=table.seam_width_m,
        mesh_m=table.mesh_m,
        open_ends=table.edge == "open",
        pairs=table.pairs,
        pair_height_m=table.pair_height_m or 0.0,
    )


def _closed(corners: Sequence[tuple[float, float]], where: str) -> DrawnLine:
    """Return the closed line through corners."""
    points = np.array(corners)
    if np.linalg.norm(points[0] - points[-1]) > 0.0:
        points = np.concatenate([points, points[:1]])
    return DrawnLine(points, where)


def _choice(entry: PatternSetTable, drawing: Drawing | None, name: str) -> NodeChoice:
    """Return the choice of nodes of a set's table."""
    if entry.layer is not None and drawing is not None:
        lines = _layer(drawing, entry.layer, name)
        return NodeChoice(entry.name, lines, sheet=entry.sheet, pair=entry.pair, corners_only=entry.is_cable)
    if entry.line_m is not None:
        lines = (DrawnLine(np.array(entry.line_m), f"set.{entry.name}.line_m"),)
        return NodeChoice(entry.name, lines, sheet=entry.sheet, pair=entry.pair)
    return NodeChoice(entry.name, box=np.array(entry.box_m), sheet=entry.sheet, pair=entry.pair)
