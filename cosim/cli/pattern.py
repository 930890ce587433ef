"""The commands `cosim pattern` and `cosim new --pattern`: check, draw and export cut patterns, and write a
soft robot that is cut from a drawing.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from cosim.base import resources, whole_files, writing
from cosim.base.drawing import DRAWING_SUFFIXES, Drawing, read_drawing, write_dxf
from cosim.base.frames import in_mm
from cosim.build.patterns import cut_pattern
from cosim.cli.files import check_new_name
from cosim.cli.screen import printable
from cosim.config.loading import load_file
from cosim.config.schema.pattern import PatternSetTable, PatternTable
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.errors import InputError, MeshError
from cosim.results.plots import figure_kind
from cosim.soft.geometry.cut_pattern import CutPattern, FlatFilm, film_area, flat_film
from cosim.soft.geometry.flat_mesh import LineKind, signed_area, smallest_angles

_LONGEST_NAME: Final = 58  # with _robot
_BASE_HEIGHT: Final = 0.04  # over the height of the drawing, if it has no layer BASE
_COLOURS: Final = {
    LineKind.CUT: "black",
    LineKind.HOLE: "tab:pink",
    LineKind.SEAL: "tab:blue",
    LineKind.FOLD: "tab:cyan",
}
ROBOT: Final = """\
# A soft robot cut from two sheets, see {drawing}
schema = 2
name = "{name}"
source = "{drawing}"
base = ["base"]

[known]                         # what you have measured or read: move it to measured or published
assumed = ["body", "film", "hinge"]

[body]
kind = "pattern"
file = "{drawing}"
{more}
{sets}
[film]                          # of each sheet: yours
law = "wrinkling"
young_modulus_Pa = 0.5e9
poisson_ratio = 0.3
thickness_m = 0.08e-3
density_kg_m3 = 950.0

[hinge]
rule = "shell"
{cables}"""
SCENARIO: Final = """\
# Question: what does {name} do when it is inflated?
schema = 2
title = "{name} is inflated"
robot = "none"                  # or an arm: "ur5e"
soft_robot = "{name}_robot.toml"
mode = "quasistatic"            # or "dynamic"

[start]                         # the base hangs half a metre above the floor and points down
flange = {{ position_m = [0.0, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }}

[[phase]]
name = "inflate"
duration_s = 1.0
increments = 20
pressure_Pa = 5e3
"""


def check_pattern_command(name: str, unit: Any, sealed: bool, png: Path | None) -> None:
    """Print how a drawing, or a robot's pattern, is interpreted, and draw the pattern.

    Args:
        name: path of a .dxf or .svg file, or name or path of a robot's file.
        unit: of the drawing's numbers, if the drawing has no unit.
        sealed: whether all edges of the sheets are welded.
        png: file for the picture, or None.

    Raises:
        InputError: the drawing is no pattern; the message has the position in the drawing.
    """
    if png is not None:
        figure_kind()
    path = Path(name)
    try:
        drawing: Drawing | None
        if path.suffix.lower() in DRAWING_SUFFIXES:
            read = drawing = read_drawing(path, unit)
            table = _table_of(path, read, unit, sealed)
        else:
            table = _robot_pattern(name)
            drawing = None if table.file is None else read_drawing(Path(table.file), table.unit)
        pattern = cut_pattern(table, drawing)
        film = flat_film(pattern, table.along)
    except MeshError as error:
        raise InputError(str(error)) from None
    for line in _lines(pattern, film, drawing):
        print(printable(line))
    if png is not None:
        with writing.writing(png):
            _figure(pattern, film).savefig(png, dpi=110)
        print(printable(f"drawn: {png}"))


def _robot_pattern(name: str) -> PatternTable:
    """Return the pattern of a robot's file.

    Raises:
        InputError: there is no such robot, or it has no cut pattern.
    """
    found = load_file(Path(name) if resources.is_file(Path(name)) else resources.soft_robot_path(name))
    if not isinstance(found, SoftRobotTable):
        raise InputError(f"{name}: is no soft robot's file")
    if not isinstance(found.body, PatternTable):
        drawn = "[stack]" if found.body is None else f"[body] kind = '{found.body.kind}'"
        raise InputError(f"{name}: has no cut pattern; {drawn} draws it")
    return found.body


def _table_of(path: Path, drawing: Drawing, unit: Any, sealed: bool) -> PatternTable:
    """Return the table of a drawing. Base and tip are layers BASE and TIP, or its lower and upper end."""
    cut = [line.points for line in drawing.layers.get("CUT", ())]
    if not cut:
        known = ", ".join(sorted(drawing.layers)) or "none with lines"
        raise MeshError(f"{path.name}: layer CUT is empty; there are: {known}")
    low, high = np.concatenate(cut).min(axis=0), np.concatenate(cut).max(axis=0)
    low, high = np.round(low, 7), np.round(high, 7)
    rise = round(_BASE_HEIGHT * float(high[1] - low[1]), 5)
    sets = []
    if "BASE" in drawing.layers:
        sets.append(PatternSetTable("base", layer="BASE"))
    else:
        sets.append(
            PatternSetTable("base", box_m=(tuple(low.tolist()), (float(high[0]), float(low[1]) + rise)))
        )
    if "TIP" in drawing.layers:
        sets.append(PatternSetTable("tip", layer="TIP"))
    else:
        sets.append(
            PatternSetTable("tip", box_m=((float(low[0]), float(high[1]) - rise), tuple(high.tolist())))
        )
    sets += [
        PatternSetTable(layer.lower(), layer=layer, sheet="front")
        for layer in sorted(drawing.layers)
        if layer.startswith("CABLE")
    ]
    sealed = sealed or "SEAL" not in drawing.layers
    return PatternTable(file=str(path), unit=unit, edge="sealed" if sealed else "drawn", sets=tuple(sets))


def _lines(pattern: CutPattern, film: FlatFilm, drawing: Drawing | None) -> Iterator[str]:
    """Yield lines that describe how a pattern is interpreted."""
    mesh, x = film.mesh, film.mesh.positions
    if drawing is not None:
        layers = ", ".join(f"{name} {len(lines)}" for name, lines in sorted(drawing.layers.items()))
        left = f"; left out: {', '.join(drawing.left_out)}" if drawing.left_out else ""
        yield f"drawing: in {drawing.unit}; lines on layers: {layers}{left}"
    size, area = 1e3 * np.ptp(x, axis=0), 1e4 * signed_area(x, mesh.triangles).sum()
    yield f"sheets:  2 of {size[0]:.2f} x {size[1]:.2f} mm, {area:.2f} cm^2 each"
    yield f"seams:   {1e3 * _length(mesh.positions, mesh.edges_of(LineKind.SEAL)):.2f} mm"
    for number, port in enumerate(pattern.ports):
        yield f"chamber: {1e4 * film_area(film, number):.2f} cm^2 of each sheet, port at {in_mm(port.middle)}"
    welded = film_area(film, -1)
    yield f"welded:  {1e4 * welded:.2f} cm^2 flat" + (", where no port leads" if welded else "")
    for choice in pattern.sets:
        what = "eyelets" if choice.corners_only else "nodes of a sheet"
        yield f"set:     {choice.name}, {len(film.sets[choice.name])} {what}"
    angle = np.degrees(smallest_angles(x, mesh.triangles))
    edge = 1e3 * np.sqrt(np.median(signed_area(x, mesh.triangles)) / 0.433)
    yield (
        f"mesh:    {len(mesh.triangles)} triangles a sheet, edges of {edge:.2f} mm, smallest angle "
        f"{angle.min():.0f} degrees"
    )


def _length(x: Any, edges: Any) -> float:
    return float(np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1).sum())


def _figure(pattern: CutPattern, film: FlatFilm) -> Any:
    """Return a figure of a pattern: chambers, welds, lines, ports, sets and the mesh."""
    mesh = film.mesh
    x, size = 1e3 * mesh.positions, np.ptp(mesh.positions, axis=0)
    figure = figure_kind()(figsize=(5.0 + 3.0, max(3.0, min(11.0, 5.0 * size[1] / size[0]))))
    axes = figure.add_subplot()
    axes.tripcolor(x[:, 0], x[:, 1], mesh.triangles, film.chamber % 8, cmap="Pastel1", vmin=-1, vmax=8)
    axes.triplot(x[:, 0], x[:, 1], mesh.triangles, color="0.6", linewidth=0.3)
    for kind, colour in _COLOURS.items():
        for number, edge in enumerate(mesh.edges_of(kind)):
            axes.plot(*x[edge].T, color=colour, linewidth=2.5 if kind == LineKind.SEAL else 1.0,
                      label=kind.name if number == 0 else None)  # fmt: skip
    for number, port in enumerate(pattern.ports):
        axes.plot(*(1e3 * port.middle), "o", color="tab:green", label="PORT" if number == 0 else None)
    for choice in pattern.sets:
        nodes = x[film.sets[choice.name]]
        axes.plot(*nodes.T, "s-" if choice.corners_only else ".", markersize=5, label=f"set {choice.name}")
    axes.set_aspect("equal")
    axes.set_xlabel("mm")
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
    figure.tight_layout()
    return figure


def export_pattern_command(name: str, out: Path) -> None:
    """Write the cut pattern of a robot as a DXF file in mm, with its true lengths.

    Args:
        name: name or path of a robot's file.
        out: path of the file, with suffix .dxf.

    Raises:
        InputError: the robot has no cut pattern, or the path has another suffix.
        OutputError: the file cannot be written.
    """
    if out.suffix.lower() != ".dxf":
        raise InputError(f"{out}: must end in .dxf")
    table = _robot_pattern(name)
    try:
        pattern = cut_pattern(table)
    except MeshError as error:
        raise InputError(str(error)) from None
    drawn = {
        "CUT": pattern.cut,
        "HOLE": pattern.holes,
        "SEAL": pattern.seal,
        "PORT": pattern.ports,
        "FOLD": pattern.folds,
        "FRAME": pattern.frames,
    }
    layers = {layer: list(lines) for layer, lines in drawn.items()}
    for entry, choice in zip(table.sets, pattern.sets, strict=True):
        layers.setdefault((entry.layer or entry.name).upper(), []).extend(choice.lines)
    with writing.writing(out):
        write_dxf(out, layers)
    length = sum(
        np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum() for line in (*pattern.cut, *pattern.holes)
    )
    print(printable(f"{out}: {1e3 * length:.2f} mm to cut, in mm"))


def new_pattern_command(name: str | None, drawing: Path, unit: Any, sealed: bool) -> None:
    """Write a soft robot's file and a scenario for a drawing into the working directory.

    Args:
        name: of the scenario; None for the name of the drawing.
        drawing: path of a .dxf or .svg file.
        unit: of the drawing's numbers, if the drawing has no unit.
        sealed: whether all edges of the sheets are welded.

    Raises:
        InputError: the drawing is no pattern, the name is invalid, or a file exists already.
        OutputError: a file cannot be written.
    """
    name = drawing.stem if name is None else name
    check_new_name(name, _LONGEST_NAME)
    try:
        read = read_drawing(drawing, unit)
        table = _table_of(drawing, read, unit, sealed)
        flat_film(cut_pattern(table, read))
    except MeshError as error:
        raise InputError(str(error)) from None
    more = f'unit = "{unit}"\n' if unit is not None else ""
    more += (
        'edge = "sealed"               # all edges of the sheets are welded\n'
        if table.edge == "sealed"
        else ""
    )
    cables = [entry for entry in table.sets if entry.is_cable]
    text = ROBOT.format(
        name=name,
        drawing=Path(os.path.relpath(drawing)).as_posix(),
        more=more,
        sets="\n".join(_set_text(entry) for entry in table.sets),
        cables="".join(_cable_text(entry.name) for entry in cables),
    )
    robot, scenario = Path(f"{name}_robot.toml"), Path(f"{name}.toml")
    for path in (robot, scenario):
        if path.exists():
            raise InputError(f"new {name}: {path} is there and is not overwritten; give another name")
    for path, content in ((robot, text), (scenario, SCENARIO.format(name=name))):
        with writing.writing(path):
            whole_files.write_whole(path, content)
    print(f"{robot} and {scenario} written; set the film in {robot}, then: cosim run {scenario}")


def _set_text(entry: PatternSetTable) -> str:
    where = (
        f'layer = "{entry.layer}"'
        if entry.layer
        else f"box_m = {[list(corner) for corner in entry.box_m or ()]}"
    )
    sheet = f'\nsheet = "{entry.sheet}"' if entry.sheet != "both" else ""
    return f'[[body.set]]\nname = "{entry.name}"\n{where}{sheet}\n'


def _cable_text(name: str) -> str:
    return f'\n[[cable]]\nname = "{name}"\nline = "{name}"\nfriction_coefficient = 0.2\n'
