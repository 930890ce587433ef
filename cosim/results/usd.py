"""A run as a USD stage: bodies, film and cables over time."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cosim.base import resources, writing
from cosim.base.frames import Array, IntArray
from cosim.base.solid import BodyShape
from cosim.errors import InputError
from cosim.results.result import RunResult

USD: Final = "scene.usdc"
_FILM_COLOUR: Final = (0.85, 0.6, 0.3)
_CABLE_M: Final = 1.5e-3  # drawn width


def check_usd() -> Any:
    """Return the library that writes USD.

    Raises:
        InputError: it is not installed.
    """
    return resources.extra_module("pxr.Usd", "usd")


def write_usd(result: RunResult, shapes: Sequence[BodyShape], path: Path) -> int:
    """Write a run as a USD stage in metres, z up, and return its number of times.

    Time codes count frames of the recording. Bodies are `/World/Scene/NAME`, the film is `/World/Film`.

    Args:
        result: of a run.
        shapes: of the bodies; results from files do not have them.
        path: of the file; an existing file is replaced.

    Raises:
        InputError: usd-core is not installed, or there is no frame.
        OutputError: it cannot be written.
    """
    check_usd()
    from pxr import Usd, UsdGeom

    if not len(result.frame_time_s):
        raise InputError(
            f"{result.stage.scenario}: there is no frame to write; the summary of the run has the reason"
        )
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
    with writing.writing(path):
        path.touch()  # raises with a reason, which the library's error lacks
        stage.GetRootLayer().Export(str(path))
    return len(codes)


def _add_bodies(stage: Any, result: RunResult, shapes: Sequence[BodyShape], codes: Sequence[float]) -> None:
    """Add a moving frame for each body, with meshes of its shapes."""
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
        positions, turns = result.body_position[rows, body], result.body_quaternion[rows, body]
        for code, position, quaternion in zip(codes, positions.tolist(), turns.tolist(), strict=True):
            shift.Set(Gf.Vec3d(*position), code)
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
    """Set the points (frames, n, 3) [m] of a mesh or curves over time.

    USD has points in single precision, so they are relative to their centre, which is in double precision.
    """
    from pxr import Gf

    positions, extent, shift = drawn.CreatePointsAttr(), drawn.CreateExtentAttr(), drawn.AddTranslateOp()
    for code, row in zip(codes, points, strict=True):
        center = row.mean(axis=0)
        shift.Set(Gf.Vec3d(*center.tolist()), code)
        positions.Set((row - center).astype(np.float32), code)
        extent.Set(_extent(row - center), code)


def _extent(points: Array) -> Any:
    return np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float32)
