"""Runs for other programs: tables, the film as meshes, a USD stage.

The deformed film as VTK files (PolyData in XML): triangles of the film, cables as lines, a file per time.

A `.pvd` file lists them with their times; ParaView and PyVista open it as a film in time.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from cosim.base.extras import extra_module
from cosim.base.files import whole_file, write_whole
from cosim.base.frames import Array, IntArray
from cosim.base.resources import writing
from cosim.base.solid import BodyShape
from cosim.errors import InputError
from cosim.results.result import COLUMNS, RunResult, array_texts


def write_csv(result: RunResult, path: Path) -> None:
    """Write all that has a row per tick; heads are such as `tip_position.x [m]`, numbers are whole.

    Args:
        result: of a run.
        path: of the file.

    Raises:
        OutputError: it cannot be written.
    """
    import pyarrow as pa  # here: it takes as long to load as half a run's start
    from pyarrow import csv

    columns: dict[str, Any] = {}
    for name in COLUMNS:
        text, array = array_texts(RunResult)[name], getattr(result, name)
        unit = "" if text.unit == "1" else f" [{text.unit}]"
        heads = [f"{name}.{part}{unit}" for part in text.components(result.stage, array.shape[1:])]
        if array.ndim == 1:
            heads = [f"{name}{unit}"]
        values = np.ascontiguousarray(array.reshape(len(array), len(heads)).T)
        columns.update(zip(heads, map(pa.array, values), strict=True))
    with writing(path), whole_file(path) as file:
        csv.write_csv(pa.table(columns), file, csv.WriteOptions(quoting_style="none"))


COLLECTION: Final = "film.pvd"
_HEAD: Final = '<?xml version="1.0"?>\n<VTKFile type="{}" version="1.0" byte_order="LittleEndian"{}>\n'
_TYPES: Final = {"f": "Float64", "i": "Int64"}


def write_film(
    result: RunResult, folder: Path, times_s: Sequence[float] = (), claim: Callable[[str], object] = str
) -> list[Path]:
    """Write the film at chosen times and the list of its files; return their paths, the list's first.

    Points carry their displacement [m] since the first frame.

    Args:
        result: of a run.
        folder: there.
        times_s: each is given the nearest frame; none: all frames.
        claim: told the name of each file before it is written.

    Raises:
        InputError: there is no film, no frame, or no such time.
        OutputError: a file cannot be written.
    """
    frames = _frames(result, times_s)
    names = [f"film-{place:04d}.vtp" for place in range(len(frames))]
    texts = [_poly_data(result, frame) for frame in frames]
    times = result.frame_time_s[frames].tolist()
    rows = [
        f'    <DataSet timestep="{time_s!r}" part="0" file={quoteattr(name)}/>\n'
        for time_s, name in zip(times, names, strict=True)
    ]
    head = _HEAD.format("Collection", "")
    listed = f"{head}  <Collection>\n{''.join(rows)}  </Collection>\n</VTKFile>\n"
    for name, text in zip((*names, COLLECTION), (*texts, listed), strict=True):
        claim(name)
        with writing(folder / name):
            write_whole(folder / name, text)
    return [folder / COLLECTION, *(folder / name for name in names)]


def _frames(result: RunResult, times_s: Sequence[float]) -> IntArray:
    """Return the frames to write.

    Raises:
        InputError: see `write_film`.
    """
    if not len(result.frame_time_s) or not len(result.stage.soft_triangles):
        raise InputError(f"{result.stage.scenario}: there is no frame of a film to write")
    if not len(times_s):
        return np.arange(len(result.frame_time_s))
    first, last = result.time_s[[0, -1]].tolist()
    for time_s in times_s:
        if not first <= time_s <= last:
            raise InputError(f"--at {time_s:g}: the run has the times {first:g} to {last:g} s")
    gaps = np.abs(result.frame_time_s[None] - np.array(times_s)[:, None])
    return np.unique(np.argmin(gaps, axis=1))


def _poly_data(result: RunResult, frame: int) -> str:
    nodes, cables = result.node_position[frame], result.stage.cables
    lines = list(_cells("Lines", np.concatenate([*cables, np.zeros(0, int)]), list(map(len, cables))))
    triangles = result.stage.soft_triangles
    polys = list(_cells("Polys", triangles.ravel(), [3] * len(triangles)))
    moved = nodes - result.node_position[0]
    pieces = [
        f'    <Piece NumberOfPoints="{len(nodes)}" NumberOfVerts="0" NumberOfLines="{len(cables)}" '
        f'NumberOfStrips="0" NumberOfPolys="{len(triangles)}">\n',
        "      <PointData>\n", _data("displacement_m", moved), "      </PointData>\n",
        "      <Points>\n", _data("position_m", nodes), "      </Points>\n", *lines, *polys, "    </Piece>\n",
    ]  # fmt: skip
    head = _HEAD.format("PolyData", ' header_type="UInt64"')
    return head + "  <PolyData>\n" + "".join(pieces) + "  </PolyData>\n</VTKFile>\n"


def _cells(kind: str, nodes: IntArray, sizes: Sequence[int]) -> Iterator[str]:
    yield f"      <{kind}>\n"
    yield _data("connectivity", nodes.astype(np.int64))
    yield _data("offsets", np.cumsum(np.array(sizes, np.int64)))
    yield f"      </{kind}>\n"


def _data(name: str, values: Array | IntArray | NDArray[Any]) -> str:
    """Return an array as VTK has it: its length in bytes before it, both in base 64."""
    data = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
    attributes: Mapping[str, object] = {
        "type": _TYPES[values.dtype.kind],
        "Name": name,
        "NumberOfComponents": values.shape[1] if values.ndim > 1 else 1,
        "format": "binary",
    }
    said = " ".join(f"{key}={quoteattr(str(value))}" for key, value in attributes.items())
    text = base64.b64encode(len(data).to_bytes(8, "little") + data).decode()
    return f"        <DataArray {said}>{text}</DataArray>\n"


USD: Final = "scene.usdc"
_FILM_COLOUR: Final = (0.85, 0.6, 0.3)
_CABLE_M: Final = 1.5e-3  # drawn width


def check_usd() -> Any:
    """Return the library that writes USD.

    Raises:
        InputError: it is not installed.
    """
    return extra_module("pxr.Usd", "usd")


def write_usd(result: RunResult, shapes: Sequence[BodyShape], path: Path) -> int:
    """Write a run as a USD stage in metres, z up, and return how many times it has.

    Time codes count frames of the recording. Bodies are `/World/Scene/NAME`, the film is `/World/Film`.

    Args:
        result: of a run.
        shapes: of the bodies, which results from files do not hold.
        path: of the file; one that is there is replaced.

    Raises:
        InputError: usd-core is not installed, or there is no frame.
        OutputError: it cannot be written.
    """
    check_usd()
    from pxr import Usd, UsdGeom

    if not len(result.frame_time_s):
        raise InputError(f"{result.stage.scenario}: there is no frame to write")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    rate = 1.0 / float(np.diff(result.frame_time_s).min()) if len(result.frame_time_s) > 1 else 1.0
    codes = (result.frame_time_s * rate).tolist()
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(codes[0])
    stage.SetEndTimeCode(codes[-1])
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    _add_bodies(stage, result, shapes, codes)
    if len(result.stage.soft_triangles):
        film = _mesh(stage, "/World/Film", result.stage.soft_triangles, _FILM_COLOUR)
        _set_points(film, result.node_position, codes)
    for k, nodes in enumerate(result.stage.cables):
        cable = UsdGeom.BasisCurves.Define(stage, f"/World/Cables/cable_{k}")
        cable.CreateTypeAttr(UsdGeom.Tokens.linear)
        cable.CreateCurveVertexCountsAttr([len(nodes)])
        cable.CreateWidthsAttr([_CABLE_M])
        cable.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        _set_points(cable, result.node_position[:, nodes], codes)
    with writing(path):
        path.touch()  # the library's own error names no reason
        stage.GetRootLayer().Export(str(path))
    return len(codes)


def _add_bodies(stage: Any, result: RunResult, shapes: Sequence[BodyShape], codes: Sequence[float]) -> None:
    """Add a frame for each body, which moves, with meshes of its shapes."""
    from pxr import Gf, Tf, UsdGeom

    rows = np.searchsorted(result.tick, result.frame_tick)
    paths, count = [], Counter[str]()
    for body, name in enumerate(result.stage.body_names):
        valid = Tf.MakeValidIdentifier(name)
        count[valid] += 1
        paths.append(f"/World/Scene/{valid}" + (f"_{count[valid]}" if count[valid] > 1 else ""))
        frame = UsdGeom.Xform.Define(stage, paths[-1])
        shift = frame.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
        turn = frame.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
        places, turns = result.body_position[rows, body], result.body_quaternion[rows, body]
        for code, place, quaternion in zip(codes, places.tolist(), turns.tolist(), strict=True):
            shift.Set(Gf.Vec3d(*place), code)
            turn.Set(Gf.Quatd(*quaternion), code)
    for number, shape in enumerate(shapes):
        mesh = _mesh(stage, f"{paths[shape.body]}/shape_{number}", shape.triangles, shape.rgba[:3])
        mesh.CreatePointsAttr(shape.vertices.astype(np.float32))
        mesh.CreateDisplayOpacityAttr([shape.rgba[3]])
        mesh.CreateExtentAttr(_extent(shape.vertices))


def _mesh(stage: Any, path: str, triangles: IntArray, colour: Sequence[float]) -> Any:
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(np.full(len(triangles), 3, np.int32))
    mesh.CreateFaceVertexIndicesAttr(triangles.ravel().astype(np.int32))
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateDisplayColorAttr([tuple(map(float, colour))])
    return mesh


def _set_points(drawn: Any, points: Array, codes: Sequence[float]) -> None:
    """Let a mesh or curves have points (frames, n, 3) [m] in time.

    USD keeps them in single precision, so they are given about their centre, which moves in double precision.
    """
    from pxr import Gf

    places, extent, shift = drawn.CreatePointsAttr(), drawn.CreateExtentAttr(), drawn.AddTranslateOp()
    for code, row in zip(codes, points, strict=True):
        center = row.mean(axis=0)
        shift.Set(Gf.Vec3d(*center.tolist()), code)
        places.Set((row - center).astype(np.float32), code)
        extent.Set(_extent(row - center), code)


def _extent(points: Array) -> Any:
    return np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float32)
