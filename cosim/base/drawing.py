"""Drawings from DXF and SVG files: lines by layer, in metres, curves as fine polylines.

Blocks, nested transforms, arcs, bulges and splines are drawn out. A DXF file's layers have names; in an SVG
file a layer is a group or line whose label or id is the layer's name, or the colour of its stroke, see
`LAYER_COLOURS`.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from cosim.base import files, resources
from cosim.base.frames import Array
from cosim.errors import MeshError

DRAWING_SUFFIXES = (".dxf", ".svg")
LAYERS: Final = ("CUT", "SEAL", "HOLE", "PORT", "CABLE", "FOLD", "FRAME")
LAYER_COLOURS: Final = {
    "#ff0000": "CUT",
    "#0000ff": "SEAL",
    "#ff00ff": "HOLE",
    "#00ff00": "PORT",
    "#ff8000": "CABLE",
    "#00ffff": "FOLD",
}
"""Strokes of an SVG file that has no layers of these names."""
Unit = Literal["mm", "cm", "m", "in"]
SAME_PLACE_M: Final = 2e-5
"""Ends of lines that are nearer than this meet: drawings are true to a hundredth of a millimetre."""
_METRES: Final[Mapping[str, float]] = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_DXF_UNITS: Final = {1: "in", 4: "mm", 5: "cm", 6: "m"}
_PX_PER_INCH: Final = 96.0
_SAGITTA_M: Final = 5e-6  # of the polylines that curves become
_LARGEST_M: Final = 100.0
_LARGEST_BYTES: Final = 50_000_000
_MOST_LINES: Final = 20_000
_DEEPEST: Final = 16  # blocks within blocks
_UNDRAWN: Final = (
    "TEXT", "MTEXT", "DIMENSION", "HATCH", "LEADER", "MULTILEADER", "ATTDEF", "ATTRIB", "IMAGE",
)  # fmt: skip


@final
@dataclass(frozen=True)
class DrawnLine:
    """A line of a drawing, or a single point.

    Args:
        points: (k, 2) [m]; a closed line ends with its first point.
        where: in the drawing, for messages.
    """

    points: Array
    where: str = ""

    @property
    def closed(self) -> bool:
        """Whether it ends where it begins."""
        return len(self.points) > 3 and bool(np.linalg.norm(self.points[0] - self.points[-1]) < SAME_PLACE_M)

    @property
    def middle(self) -> Array:
        """Mean of its points (2,) [m]."""
        return np.asarray(self.points[: -1 if self.closed else None].mean(axis=0))


@final
@dataclass(frozen=True)
class Drawing:
    """The lines of a drawing.

    Args:
        layers: lines by the names of their layers, in capitals.
        unit: of the file's numbers.
        left_out: text on everything in the file that is no line.
    """

    layers: Mapping[str, tuple[DrawnLine, ...]]
    unit: str
    left_out: tuple[str, ...] = ()


def read_drawing(path: Path, unit: str | None = None) -> Drawing:
    """Return the lines of a DXF or SVG file.

    Args:
        path: of the file.
        unit: of its numbers, "mm", "cm", "m" or "in"; None: the file says.

    Raises:
        MeshError: the file cannot be read, states no unit or another one, or is far too large.
        InputError: the library that reads it is not installed.
    """
    files.note_file(path)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise MeshError(f"{path.name}: cannot be read: {error.strerror}") from error
    if size > _LARGEST_BYTES:
        raise MeshError(f"{path.name}: has {size} bytes; at most {_LARGEST_BYTES} are read")
    read = _read_dxf if path.suffix.lower() == ".dxf" else _read_svg
    found = read(path, unit)
    for lines in found.layers.values():
        for line in lines:
            if not np.isfinite(line.points).all():
                raise MeshError(
                    f"{path.name}: {line.where} has a coordinate that is not finite: draw it again"
                )
            if np.abs(line.points).max() > _LARGEST_M:
                raise MeshError(
                    f"{path.name}: {line.where} reaches beyond {_LARGEST_M:g} m; the drawing is in "
                    f"{found.unit}: is that its unit?"
                )
    return replace(
        found, layers={name: tuple(_cleaned(line) for line in lines) for name, lines in found.layers.items()}
    )


def _cleaned(line: DrawnLine) -> DrawnLine:
    """Return a line without points that repeat the one before; a closed one ends exactly as it begins."""
    points = line.points
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], steps > 0.05 * SAME_PLACE_M])]
    cleaned = replace(line, points=points)
    if cleaned.closed:
        points = np.concatenate([points[:-1], points[:1]])
    return replace(line, points=points)


def _checked_unit(path: Path, stated: str | None, given: str | None) -> str:
    """Return the unit of a drawing.

    Raises:
        MeshError: it is not stated, or two different ones are.
    """
    if stated is None and given is None:
        raise MeshError(
            f"{path.name}: states no unit: give body.unit, such as unit = 'mm' (DXF: header $INSUNITS; SVG: "
            "a width in mm)"
        )
    if stated is not None and given is not None and stated != given:
        raise MeshError(
            f"{path.name}: is in {stated}, body.unit says {given}: remove body.unit, or change the file"
        )
    return stated or given or ""


def _read_dxf(path: Path, given: str | None) -> Drawing:
    ezdxf = resources.extra_module("ezdxf", "pattern")
    try:
        document = ezdxf.readfile(path)
    except Exception as error:  # whatever the parser stumbles over
        problem = f"{error!s:.120}" or "it ends too early"
        raise MeshError(f"{path.name}: is not a DXF file: {problem}") from error
    code = int(document.header.get("$INSUNITS", 0))
    if code and code not in _DXF_UNITS and given is None:
        raise MeshError(
            f"{path.name}: has $INSUNITS {code}; read are 1 (in), 4 (mm), 5 (cm), 6 (m), or give body.unit"
        )
    unit = _checked_unit(path, _DXF_UNITS.get(code), given)
    layers: dict[str, list[DrawnLine]] = {}
    left_out = Counter[str]()
    for layer, entity in _entities(document.modelspace(), None, 0):
        kind = entity.dxftype()
        if kind in _UNDRAWN:
            left_out[f"{kind} of layer {layer}"] += 1
            continue
        where = f"{kind} #{entity.dxf.handle or 'in a block'} of layer {layer}"
        for points in _dxf_points(entity, _METRES[unit], where):
            layers.setdefault(layer, []).append(DrawnLine(_METRES[unit] * points, where))
        if sum(map(len, layers.values())) > _MOST_LINES:
            raise MeshError(f"{path.name}: has more than {_MOST_LINES} lines; draw fewer")
    return _drawing(layers, unit, left_out)


def _drawing(layers: Mapping[str, list[DrawnLine]], unit: str, left_out: Counter[str]) -> Drawing:
    counts = tuple(f"{count} {what}" for what, count in left_out.items())
    return Drawing({name: tuple(lines) for name, lines in layers.items()}, unit, counts)


def _entities(entities: Any, around: str | None, depth: int) -> Iterator[tuple[str, Any]]:
    """Yield the layer and the entity of everything drawn; entities on layer 0 of a block have its layer."""
    if depth > _DEEPEST:
        raise MeshError(f"blocks lie {_DEEPEST} deep within one another; do they hold themselves?")
    for entity in entities:
        layer = str(entity.dxf.layer)
        layer = around if around is not None and layer == "0" else layer.upper()
        if entity.dxftype() == "INSERT":
            if entity.block() is None:
                raise MeshError(
                    f"INSERT #{entity.dxf.handle} of layer {layer} draws block '{entity.dxf.name}', which "
                    "the file does not have"
                )
            copies = entity.multi_insert() if entity.mcount > 1 else (entity,)
            for copy in copies:
                yield from _entities(copy.virtual_entities(), layer, depth + 1)
        else:
            yield layer, entity


def _dxf_points(entity: Any, metres: float, where: str) -> Iterator[Array]:
    """Yield the points (k, 2) of an entity's lines, in the file's unit."""
    path = resources.extra_module("ezdxf.path", "pattern")
    if entity.dxftype() == "POINT":
        yield np.array([[entity.dxf.location.x, entity.dxf.location.y]])
        return
    try:
        made = path.make_path(entity)
    except (TypeError, ValueError, ZeroDivisionError) as error:
        raise MeshError(
            f"{where}: cannot be drawn as a line: explode it, or move it to another layer"
        ) from error
    for piece in made.sub_paths():
        # a circle of radius 0 has a start only
        points = np.array(
            [tuple(p) for p in piece.flattening(_SAGITTA_M / metres, segments=4)]
            or [entity.dxf.get("center", made.start)]
        )
        rise_m = metres * np.ptp(points[:, 2])
        if rise_m > SAME_PLACE_M:
            raise MeshError(
                f"{where} is not flat: it rises by {1e3 * rise_m:.2f} mm in z; draw it in the xy plane"
            )
        yield points[:, :2]


def _read_svg(path: Path, given: str | None) -> Drawing:
    svg = resources.extra_module("svgelements", "pattern")
    try:
        document = svg.SVG.parse(str(path), reify=True, ppi=_PX_PER_INCH)
    except Exception as error:  # whatever the parser stumbles over
        raise MeshError(f"{path.name}: is not an SVG file: {error!s:.120}") from error
    attributes = (document.values or {}).get("attributes", {})
    width = str(attributes.get("width", "")).strip()
    stated = width.lstrip("0123456789.+-eE ")
    known = stated in _METRES
    unit = _checked_unit(path, stated if known else None, given)
    # a stated width has made px of its units; otherwise a px is the unit
    metres = _METRES[unit]
    if known:
        size = float(width.removesuffix(stated))
        if not size > 0.0 or not attributes.get("height"):
            raise MeshError(
                f"{path.name}: has width '{width}' and height '{attributes.get('height', '')}'; give the "
                "true size of the page, such as width='80mm' height='120mm'"
            )
        metres *= size / float(document.width)
    height = float(document.height or 0.0)  # y leads upwards, from the lower left corner of the page
    layers: dict[str, list[DrawnLine]] = {}
    left_out = Counter[str]()
    for layer, where, element in _svg_shapes(document, None):
        if layer is None:
            left_out["shapes without a layer"] += 1
            continue
        for points in _svg_points(element, metres):
            upwards = metres * (points * (1.0, -1.0) + (0.0, height))
            layers.setdefault(layer, []).append(DrawnLine(upwards, f"{where} of layer {layer}"))
        if sum(map(len, layers.values())) > _MOST_LINES:
            raise MeshError(f"{path.name}: has more than {_MOST_LINES} lines; draw fewer")
    return _drawing(layers, unit, left_out)


def _svg_shapes(group: Any, around: str | None) -> Iterator[tuple[str | None, str, Any]]:
    """Yield layer, words and element of all shapes of a group."""
    svg = resources.extra_module("svgelements", "pattern")
    for element in group:
        layer = _svg_layer(element) or around
        if isinstance(element, svg.Group | svg.Use):
            yield from _svg_shapes(element, layer)
        elif isinstance(element, svg.Shape):
            name = f" '{element.id}'" if getattr(element, "id", None) else ""
            stroke = getattr(element, "stroke", None)
            colour = None if stroke is None or stroke.value is None else stroke.hex[:7].lower()
            if layer is None and colour is not None:
                layer = LAYER_COLOURS.get(_long_colour(colour))
            yield layer, f"{type(element).__name__.lower()}{name}", element


def _long_colour(colour: str) -> str:
    return "#" + "".join(2 * digit for digit in colour[1:]) if len(colour) == 4 else colour


def _svg_layer(element: Any) -> str | None:
    """Return the layer that an element's label or id names, in capitals; None for none.

    Args:
        element: a shape or group; "CUT", "CUT_left" and "CUT-2" are of layers CUT, CUT_LEFT and CUT.
    """
    values = getattr(element, "values", None) or {}
    attributes = values.get("attributes", values)
    labels = [value for key, value in attributes.items() if key.endswith("label")]
    for name in (*labels, attributes.get("id")):
        if not name:
            continue
        word = str(name).upper().split("-")[0].strip()
        if word.split("_")[0] in LAYERS or labels:
            return word
    return None


def _svg_points(element: Any, metres: float) -> Iterator[Array]:
    """Yield the points (k, 2) of an element's lines, in px, y downwards."""
    svg = resources.extra_module("svgelements", "pattern")
    for piece in abs(
        svg.Path(element)
    ).as_subpaths():  # abs: with transforms that no rect or circle can take up
        points: list[tuple[float, float]] = []
        for segment in svg.Path(piece):
            if isinstance(segment, svg.Move):
                points.append((segment.end.x, segment.end.y))
            elif isinstance(segment, svg.Line | svg.Close):
                if segment.end is not None:
                    points.append((segment.end.x, segment.end.y))
            else:
                points += _curve(segment, metres)
        if points:
            yield np.array(points, dtype=np.float64)


def _curve(segment: Any, metres: float) -> list[tuple[float, float]]:
    """Return points along a curve, after its first: so many that none is further off than the sagitta."""
    coarse = np.array([(p.x, p.y) for p in (segment.point(t) for t in np.linspace(0.0, 1.0, 33))])
    bend = np.linalg.norm(coarse[2:] - 2.0 * coarse[1:-1] + coarse[:-2], axis=1).max() * metres / 8.0
    parts = min(2000, max(4, math.ceil(32.0 * math.sqrt(bend / _SAGITTA_M))))
    return [(p.x, p.y) for p in (segment.point(t) for t in np.linspace(0.0, 1.0, parts + 1)[1:])]


def write_dxf(path: Path, layers: Mapping[str, Sequence[DrawnLine]]) -> None:
    """Write lines to a DXF file in mm; single points become points.

    Args:
        path: of the file.
        layers: lines by the names of their layers.

    Raises:
        OSError: the file cannot be written.
        InputError: the library that writes it is not installed.
    """
    ezdxf = resources.extra_module("ezdxf", "pattern")
    document = ezdxf.new(units=4)
    space = document.modelspace()
    for layer, lines in layers.items():
        for line in lines:
            points, on = (1e3 * line.points).tolist(), {"layer": layer}
            if len(points) == 1:
                space.add_point(points[0], dxfattribs=on)
            elif line.closed:
                space.add_lwpolyline(points[:-1], close=True, dxfattribs=on)
            else:
                space.add_lwpolyline(points, dxfattribs=on)
    document.saveas(path)
