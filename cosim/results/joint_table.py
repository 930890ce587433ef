"""Joint angles and commands at the rate of a robot's controller: as a table, CSV, URScript, for ROS 2."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self, final

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.base.files import write_whole
from cosim.base.frames import Array
from cosim.base.resources import writing
from cosim.errors import InputError

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
    """

    name: str
    columns: tuple[str, ...]
    time_s: Array
    values: Array

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
        speeds = np.asarray(CubicSpline(self.time_s, self.joints, bc_type="clamped")(self.time_s, 1))
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
        will be 0.5 s later (PolyScope 5.10 and later).

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
        for k in range(0, last, every):
            ahead[k].append(_payload_call(payload[min(k + every, last)], every * step_s))
        return [_payload_call(payload[0], 0.0)], ahead

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
        with writing(path):
            write_whole(path, text)

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
