"""Tables of a cut pattern, two sheets welded along seams, which draws a film: `[body] kind = "pattern"`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final, Literal, final

from annotated_types import Interval, Len

from cosim.base.drawing import DRAWING_SUFFIXES, Unit
from cosim.base.resources import is_file, quoted_name
from cosim.config.schema.body_sources import BodySourceTable
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.quantities import Count, Length, Name, NonNegativeLength, PositiveLength, Text
from cosim.config.toml.rules import Violations, rule
from cosim.config.toml.tables import Table

Point = tuple[Length, Length]
Polyline = Annotated[tuple[Point, ...], Len(min_length=2)]

GROUPS: Final = ("front", "back", "welded")
"""Face groups that every pattern has."""


@final
@dataclass(frozen=True)
class PatternSetTable(Table):
    """A named set of nodes of a pattern, selected in one of three ways, in the drawing's coordinates.

    Args:
        name: of the set; base, tip, cables, supports and forces name it.
        layer: of the drawing: nodes on its open lines and within its closed ones. Of a layer whose name
            begins with CABLE: the corners of its lines, in order from the base to the tip.
        box_m: two opposite corners of a box: all nodes within.
        line_m: points of a line: all nodes on it, in order.
        sheet: "front" faces the viewer of the drawing; nodes on seams belong to both.
        pair: number of the pair of sheets, from 1; omitted: all pairs.
    """

    name: Name
    layer: Text | None = None
    box_m: tuple[Point, Point] | None = None
    line_m: Polyline | None = None
    sheet: Literal["both", "front", "back"] = "both"
    pair: Count | None = None

    @rule
    def _is_said_once(self) -> Violations:
        if sum(way is not None for way in (self.layer, self.box_m, self.line_m)) != 1:
            yield "", "give layer, box_m or line_m, and one of these"

    @rule
    def _runs_on_a_sheet(self) -> Violations:
        if self.is_cable and self.sheet == "both":
            yield "sheet", "is missing: a cable runs on one sheet, sheet = 'front' or 'back'"

    @property
    def is_cable(self) -> bool:
        """Whether its nodes are the corners of cables' lines."""
        return self.layer is not None and self.layer.upper().startswith("CABLE")


@final
@dataclass(frozen=True)
class PatternFoldTable(Table):
    """A crease: the lines of a layer, or points, along which the film rests at an angle.

    Args:
        rest_angle_rad: from flat, without load; positive: the ridge is on the outer side of the sheet.
        layer: of the drawing, such as FOLD or FOLD_valley.
        line_m: points of a line, in the drawing's coordinates.
        sheet: that is folded; sheets that are welded flat fold together. "both": both sheets of a chamber,
            each outwards.
    """

    rest_angle_rad: Annotated[float, Interval(gt=-3.1, lt=3.1)]
    layer: Text | None = None
    line_m: Polyline | None = None
    sheet: Literal["both", "front", "back"] = "both"

    @rule
    def _is_said_once(self) -> Violations:
        if (self.layer is None) == (self.line_m is None):
            yield "", "give layer or line_m, and one of these"


@final
@dataclass(frozen=True, kw_only=True)
class PatternTable(BodySourceTable):
    """A film of two flat sheets that are welded along seams, drawn as its cut pattern.

    Args:
        kind: of `[body]`.
        file: DXF or SVG in the folder of the robot's file, with layers CUT, SEAL, HOLE, PORT, CABLE, FOLD,
            FRAME; or give `outline_m`.
        unit: of the drawing's numbers; omitted: the unit that the drawing states.
        outline_m: corners of the sheets, in place of a drawing.
        seams_m: points of each further seam, in place of a drawing.
        holes_m: corners of each hole, in place of a drawing.
        port_m: a point within the chamber, in place of a drawing.
        chambers: names of several chambers: NAME has its port on layer PORT_NAME. Omitted: there is one,
            with its port on layer PORT.
        edge: "drawn": the sheets are welded only along layer SEAL, or `seams_m`, and these close every
            chamber; "sealed": also along all edges of the sheets; "open": as drawn, and a chamber may have
            open ends, which caps close and carry the pressure.
        pairs: number of pairs of sheets, one on the other, away from the flange with plane = "flat";
            neighbours are joined along the holes, which `edge` then does not seal, and caps close the first
            and the last one.
        pair_height_m: drawn height of a pair, needed for several: each sheet is drawn half of it apart at
            the hole. A single pair with it is one such unit, its holes closed by caps.
        seam_width_m: of the welds, half of it on each side of a seam; 0: a line.
        mesh_m: length of the triangles' edges; omitted: a quarter of the largest distance to a seam.
        along: direction in the drawing that leads away from the base.
        plane: "upright": that direction is the flange's z axis, and the sheets lie in its xz plane, the front
            towards -y. "flat": the sheets lie in the flange's xy plane, the front towards +z.
        folds: `[[body.fold]]` in the file, of a single pair; lines of layer FOLD without an entry are flat
            without load.
        sets: `[[body.set]]` in the file; the middle of the robot's first base is the flange's origin.
        tip: the set at the free end.
        center: sets that the centre line runs through between base and tip; the tip's direction points from
            the last of them to the tip. Omitted: a flat tip has the direction of the film there.
    """

    kind: Literal["pattern"] = "pattern"
    file: Text | None = None
    unit: Unit | None = None
    outline_m: Annotated[tuple[Point, ...], Len(min_length=3)] | None = None
    seams_m: tuple[Polyline, ...] = ()
    holes_m: tuple[Annotated[tuple[Point, ...], Len(min_length=3)], ...] = ()
    port_m: Point | None = None
    chambers: tuple[Name, ...] = ()
    edge: Literal["drawn", "sealed", "open"] = "drawn"
    pairs: Annotated[int, Interval(ge=1, le=200)] = 1
    pair_height_m: PositiveLength | None = None
    seam_width_m: NonNegativeLength = 0.0
    mesh_m: PositiveLength | None = None
    along: Literal["+x", "-x", "+y", "-y"] = "+y"
    plane: Literal["upright", "flat"] = "upright"
    sets: Annotated[tuple[PatternSetTable, ...], Len(min_length=2)] = field(metadata={"alias": "set"})
    folds: tuple[PatternFoldTable, ...] = field(default=(), metadata={"alias": "fold"})
    tip: Name = "tip"
    center: tuple[Name, ...] = ()

    @rule
    def _is_drawn_once(self) -> Violations:
        if (self.file is None) == (self.outline_m is None):
            yield "file", "give file, or outline_m, and one of these"
            return
        if self.file is None and self.port_m is None:
            yield "port_m", "is missing: give a point within the chamber"
        for key in ("seams_m", "holes_m", "port_m") if self.file is not None else ("unit",):
            if getattr(self, key):
                yield key, f"goes with {'outline_m' if self.file else 'file'}, which is not given"

    @rule
    def _has_its_file(self) -> Violations:
        if self.file is None:
            return
        if Path(self.file).suffix.lower() not in DRAWING_SUFFIXES:
            yield "file", f"is '{Path(self.file).name}'; a drawing ends in {' or '.join(DRAWING_SUFFIXES)}"
        elif not is_file(Path(self.file)):
            yield "file", f"no file {quoted_name(self.file)} beside the one that names it"

    @rule
    def _has_its_tip(self) -> Violations:
        if self.tip not in self.set_names():
            yield "tip", unknown_name_message("set", self.tip, self.set_names())
        for name in [name for name in self.center if name not in self.set_names()][:1]:
            yield "center", unknown_name_message("set", name, self.set_names())

    @rule
    def _is_stacked(self) -> Violations:
        if self.pairs > 1 and self.pair_height_m is None:
            yield "pair_height_m", "is missing; needed with pairs above 1"
        for entry in self.sets:
            if entry.pair is not None and entry.pair > self.pairs:
                yield f"set.{entry.name}.pair", f"{entry.pair} does not exist; pairs 1 to {self.pairs} do"

    @rule
    def _has_layers(self) -> Violations:
        for entry in self.sets if self.file is None else ():
            if entry.layer is not None:
                yield f"set.{entry.name}.layer", "is of a drawing; give box_m or line_m"
        if self.folds and self.pair_height_m is not None:
            yield "fold", "is of a single, flat pair of sheets; pair_height_m is set"
        elif self.file is None and any(entry.layer is not None for entry in self.folds):
            yield "fold.layer", "is of a drawing; give line_m"

    @rule
    def _has_chambers(self) -> Violations:
        if self.chambers and self.file is None:
            yield "chambers", "are those of a drawing; an outline of points has one"
        elif len(set(self.chambers)) < len(self.chambers):
            yield "chambers", f"are {list(self.chambers)}; names must differ"
        for name in [name for name in self.chambers if name in GROUPS][:1]:
            yield "chambers", f"'{name}' is the name of sheets; take another"

    def has_frames(self) -> bool:
        """Whether its layer FRAME may have lines."""
        return self.file is not None and self.pairs == 1

    def set_names(self) -> tuple[str, ...]:
        """Return the names of the node sets."""
        return tuple(entry.name for entry in self.sets)

    def chamber_names(self) -> tuple[str, ...]:
        """Return the names of the chambers."""
        return self.chambers or super().chamber_names()


BodySourceTable.kinds["pattern"] = PatternTable
