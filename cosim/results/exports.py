"""Runs for other programs: tables, joints for controllers, the film as meshes, a USD stage.

The deformed film as VTK files (PolyData in XML): triangles of the film, cables as lines, a file per time.

A `.pvd` file lists them with their times; ParaView and PyVista open it as a film in time.
"""

import base64
import csv
import io
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Self, final
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from cosim.base import resources, whole_files, writing
from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array, IntArray
from cosim.base.solid import BodyShape
from cosim.errors import InputError
from cosim.results.result import COLUMNS, RunResult
from cosim.telemetry.holding import HeldPart


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
    for name, column in COLUMNS.items():
        array, names = getattr(result, name), result.stage.names_along
        unit = "" if column.unit == "1" else f" [{column.unit}]"
        heads = [f"{name}.{part}{unit}" for part in column.components(names, array.shape[1:])]
        if array.ndim == 1:
            heads = [f"{name}{unit}"]
        values = np.ascontiguousarray(array.reshape(len(array), len(heads)).T)
        columns.update(zip(heads, map(pa.array, values), strict=True))
    with writing.writing(path), whole_files.whole_file(path) as file:
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
        with writing.writing(folder / name):
            whole_files.write_whole(folder / name, text)
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
    return resources.extra_module("pxr.Usd", "usd")


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
    with writing.writing(path):
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


CSV: Final = ".csv"
URSCRIPT: Final = ".script"
TRAJECTORY: Final = ".yaml"
TOLD_EVERY_s: Final = 0.5
"""Time between two payload updates in URScript; the controller changes the payload evenly in between."""
PAYLOAD: Final = (
    "payload.mass_kg", "payload.center_x_m", "payload.center_y_m", "payload.center_z_m",
    "payload.inertia_xx_kg_m2", "payload.inertia_yy_kg_m2", "payload.inertia_zz_kg_m2",
    "payload.inertia_xy_kg_m2", "payload.inertia_xz_kg_m2", "payload.inertia_yz_kg_m2",
)  # fmt: skip
"""Columns of what hangs on the flange: centre in the flange frame, inertia about the centre, flange axes."""
_TIME: Final = "time_s"
_LOOKAHEAD_s: Final = 0.1
_GAIN: Final = 300
_ROUNDING_s: Final = 1e-9
_APPROACH: Final = "a=0.5, v=0.3"
_STOP_rad_s2: Final = 2.0
_UR_JOINTS: Final = 6


@final
@dataclass(frozen=True, eq=False)
class JointTable:
    """Commands to a robot, at a fixed rate.

    Args:
        name: of the phase, or of the scenario.
        columns: after the time: joints end in ".position_rad" (sliding ones in ".position_m"), cables in
            ".tension_N" or ".length_m" (length off the drum), chambers in ".pressure_Pa"; of a run also
            those of `PAYLOAD`.
        time_s: (n,), from 0 on.
        values: (n, columns) [rad, m, N, Pa], as their names end.
        held: objects that are held, with their times; the payload has them then.
    """

    name: str
    columns: tuple[str, ...]
    time_s: Array
    values: Array
    held: tuple[HeldPart, ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Base to flange."""
        return tuple(
            c.rpartition(".")[0] for c in self.columns if c.rpartition(".")[2].startswith("position")
        )

    @property
    def payload(self) -> Array | None:
        """(n, 10) of `PAYLOAD`; None where the table does not know it."""
        if PAYLOAD[0] not in self.columns:
            return None
        first = self.columns.index(PAYLOAD[0])
        return self.values[:, first : first + len(PAYLOAD)]

    @property
    def joints(self) -> Array:
        """(n, joints) [rad], of sliding ones [m]."""
        return self.values[:, : len(self.joint_names)]

    @property
    def joint_speeds(self) -> Array:
        """(n, joints) of the cubic spline through the joints, from rest to rest [rad/s, m/s].

        Differences would miss a sixth of the jerk times the square of a step, which servos see.
        """
        speeds = np.asarray(CubicSpline(self.time_s, self.joints, (0.0, 0.0))(self.time_s, 1))
        speeds[[0, -1]] = 0.0  # not rounded ones
        return speeds

    def csv_text(self) -> str:
        """Return the table as CSV: a line of heads, then numbers that read back to the bit."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([_TIME, *self.columns])
        writer.writerows(np.column_stack([self.time_s, self.values]).tolist())
        return stream.getvalue()

    def urscript_text(self) -> str:
        """Return a program for the controller of a UR arm: a move to the begin, then `servoj` at every step.

        Where the payload is known, `set_target_payload` sets it before the move, and every 0.5 s what it
        will be 0.5 s later (PolyScope 5.10 and later). When an object is taken or let go, it is set at once,
        with a comment.

        Raises:
            InputError: the arm has other joints than a UR.
        """
        turning = [column for column in self.columns if column.endswith(".position_rad")]
        if len(turning) != _UR_JOINTS or len(self.joint_names) != _UR_JOINTS:
            raise InputError(
                f"URScript moves {_UR_JOINTS} joints that turn; this arm has {', '.join(self.joint_names)}: "
                f"write a {CSV} file"
            )
        step_s = float(self.time_s[1] - self.time_s[0])
        end = f"0, 0, {step_s:.9g}, {_LOOKAHEAD_s:g}, {_GAIN}"
        rows = ["[" + ", ".join(f"{angle:.9f}" for angle in row) + "]" for row in self.joints.tolist()]
        first, ahead = self._payload_calls(step_s)
        calls = [line for k, row in enumerate(rows) for line in (*ahead[k], f"  servoj({row}, {end})")]
        return "\n".join(
            [
                f"# phase {self.name}: {len(rows)} points, {step_s:.9g} s apart; joints "
                f"{', '.join(self.joint_names)}",
                f"def {self.name.replace('-', '_')}():",
                *first,
                f"  movej({rows[0]}, {_APPROACH})",
                *calls,
                f"  stopj({_STOP_rad_s2:g})",
                "end",
                "",
            ]
        )

    def _payload_calls(self, step_s: float) -> tuple[list[str], list[list[str]]]:
        """Return lines that tell of the payload: before the move, and before every row, in most rows none."""
        payload = self.payload
        ahead: list[list[str]] = [[] for _ in self.time_s]
        if payload is None:
            return [], ahead
        every, last = max(round(TOLD_EVERY_s / step_s), 1), len(payload) - 1
        changes = self._changes()
        edges = [*(k for k in changes if k), last + 1]
        for first, end in pairwise([0, *edges]):
            if first:
                ahead[first] += [f"  # {changes[first]}", _payload_call(payload[first], 0.0)]
            for k in range(first, min(end, last), every):
                to = min(k + every, end - 1)
                within_s = (to - k if end <= last else every) * step_s
                ahead[k] += [_payload_call(payload[to], within_s)] if to > k else []
        begin = [f"  # {changes[0]}"] if 0 in changes else []
        return [*begin, _payload_call(payload[0], 0.0)], ahead

    def _changes(self) -> dict[int, str]:
        """Return at which rows objects are taken or let go, in order, and what to say of it."""
        found: dict[int, list[str]] = {}
        times = self.time_s + _ROUNDING_s
        for part in self.held:
            what = f"'{part.name}', {part.mass_kg:.4g} kg"
            for verb, at_s in (("takes", part.since_s), ("lets go of", part.until_s)):
                row = int(np.searchsorted(times, at_s))
                if at_s > 0.0 and row < len(times):
                    found.setdefault(row, []).append(f"{verb} {what}")
            if part.since_s <= 0.0:
                found.setdefault(0, []).append(f"holds {what}")
        payload = self.payload
        assert payload is not None, "whoever asks has looked"
        return {
            row: f"{'; '.join(found[row])}: payload {payload[row, 0]:.4g} kg, "
            f"{payload[max(row - 1, 0), 0]:.4g} kg until here"
            for row in sorted(found)
        }

    def trajectory_text(self) -> str:
        """Return a `trajectory_msgs/msg/JointTrajectory` of ROS 2 as YAML, as `ros2 topic pub` takes it.

        Positions, and velocities of a spline; tensions and pressures have no place in it.
        """
        lines = ["header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}"]
        lines += [f"joint_names: {json.dumps(self.joint_names)}", "points:"]
        for time_s, place, rate in zip(
            self.time_s.tolist(), self.joints.tolist(), self.joint_speeds.tolist(), strict=True
        ):
            sec, nanosec = divmod(round(1e9 * time_s), 10**9)
            lines.append(
                f"- {{positions: {place}, velocities: {rate}, accelerations: [], effort: [], "
                f"time_from_start: {{sec: {sec}, nanosec: {nanosec}}}}}"
            )
        return "\n".join([*lines, ""])

    def write(self, path: str | Path) -> None:
        """Write a .csv file, a .script file of URScript, or a .yaml file of a ROS 2 trajectory.

        Args:
            path: of the file; its ending says which.

        Raises:
            InputError: the name ends otherwise, or the arm is no UR.
            OutputError: it cannot be written.
        """
        path = Path(path)
        check_name(path)
        made = {CSV: self.csv_text, URSCRIPT: self.urscript_text, TRAJECTORY: self.trajectory_text}
        text = made[path.suffix]()
        with writing.writing(path):
            whole_files.write_whole(path, text)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return the table of a CSV file; its name is that of the file.

        Raises:
            InputError: it cannot be read, or is no such table.
        """
        path = Path(path)
        try:
            with path.open(encoding="utf-8-sig", newline="") as stream:
                heads, *lines = list(csv.reader(stream)) or [[]]
            rows = np.array([[float(cell) for cell in line] for line in lines])
        except (OSError, ValueError, csv.Error) as error:
            raise InputError(f"{path}: cannot be read as a table of joints: {error}") from error
        if heads[:1] != [_TIME] or rows.shape != (len(lines), len(heads)) or not np.isfinite(rows).all():
            raise InputError(
                f"{path}: must have the column {_TIME} first, and a finite number under every head"
            )
        if len(rows) < 2 or not (np.diff(rows[:, 0]) > 0.0).all():
            raise InputError(f"{path}: must have two rows at least, and {_TIME} must increase")
        return cls(path.stem, tuple(heads[1:]), rows[:, 0], rows[:, 1:])


def _payload_call(row: Array, within_s: float) -> str:
    mass, *others = (f"{value:.6g}" for value in row.tolist())
    return f"  set_target_payload({mass}, [{', '.join(others[:3])}], [{', '.join(others[3:])}], {within_s:g})"


def check_name(path: Path) -> None:
    """Raise InputError where a file's name does not say what is to be in it."""
    if path.suffix not in (CSV, URSCRIPT, TRAJECTORY):
        raise InputError(
            f"{path}: the name must end in {CSV}, in {URSCRIPT} for URScript, or in {TRAJECTORY} for a ROS 2 "
            "trajectory"
        )


def sample_times(duration_s: float, rate_Hz: float) -> Array:
    """Return instants (n,) [s] at a rate, from 0 to the first one not before the end.

    Args:
        duration_s: of what is sampled.
        rate_Hz: of the controller.

    Raises:
        InputError: the rate is not a number above 0, or gives less than a step.
    """
    if not (math.isfinite(rate_Hz) and rate_Hz * duration_s >= 1.0):
        raise InputError(
            f"a rate of {rate_Hz:g} Hz gives no step within {duration_s:.4g} s; controllers take 100 to 1000"
        )
    return np.arange(math.ceil(duration_s * rate_Hz - 1e-9) + 1) / rate_Hz
