"""Commands to a robot at a fixed rate, as a table: CSV, URScript, or a trajectory of ROS 2."""

import csv
import io
import json
import math
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Self, final

import numpy as np

from cosim.base import whole_files, writing
from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.results.urscript import program
from cosim.telemetry.held_parts import HeldPart

CSV: Final = ".csv"
URSCRIPT: Final = ".script"
TRAJECTORY: Final = ".yaml"
PAYLOAD: Final = (
    "payload.mass_kg", "payload.center_x_m", "payload.center_y_m", "payload.center_z_m",
    "payload.inertia_xx_kg_m2", "payload.inertia_yy_kg_m2", "payload.inertia_zz_kg_m2",
    "payload.inertia_xy_kg_m2", "payload.inertia_xz_kg_m2", "payload.inertia_yz_kg_m2",
)  # fmt: skip
"""Columns of the payload: centre in the flange frame, inertia about the centre, flange axes."""
_TIME: Final = "time_s"
_UR_JOINTS: Final = 6
_UNEVEN: Final = 0.01
"""Largest difference of two time steps over the shortest one, for URScript."""


@final
@dataclass(frozen=True, eq=False)
class JointTable:
    """Commands to a robot, at a fixed rate.

    Args:
        name: of the phase, or of the scenario.
        columns: without the time: joints end in ".position_rad" (sliding joints in ".position_m"), cables in
            ".tension_N" or ".length_m" (length off the drum), chambers in ".pressure_Pa"; for a run also
            those of `PAYLOAD`.
        time_s: (n,), from 0 on.
        values: (n, columns) [rad, m, N, Pa], units as at the end of the column's name.
        held: held objects, with times; the payload includes them during these.
    """

    name: str
    columns: tuple[str, ...]
    time_s: Array
    values: Array
    held: tuple[HeldPart, ...] = ()

    @cached_property
    def _joint_columns(self) -> list[int]:
        return [k for k, head in enumerate(self.columns) if head.rpartition(".")[2].startswith("position")]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Base to flange."""
        return tuple(self.columns[k].rpartition(".")[0] for k in self._joint_columns)

    @property
    def payload(self) -> Array | None:
        """(n, 10), as `PAYLOAD`; None if the table does not have all of it."""
        if not {*PAYLOAD} <= {*self.columns}:
            return None
        return self.values[:, [self.columns.index(head) for head in PAYLOAD]]

    @cached_property
    def joints(self) -> Array:
        """(n, joints) [rad], of sliding joints [m]."""
        return self.values[:, self._joint_columns]

    @property
    def joint_speeds(self) -> Array:
        """(n, joints) of the cubic spline through the joints, from rest to rest [rad/s, m/s].

        Differences would have an error of a sixth of the jerk times the square of a step, which disturbs
        servos.
        """
        speeds = np.asarray(CubicSpline(self.time_s, self.joints, (0.0, 0.0))(self.time_s, 1))
        speeds[[0, -1]] = 0.0  # without rounding errors
        return speeds

    def csv_text(self) -> str:
        """Return the table as CSV: a line of heads, then numbers in full precision."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([_TIME, *self.columns])
        writer.writerows(np.column_stack([self.time_s, self.values]).tolist())
        return stream.getvalue()

    def urscript_text(self) -> str:
        """Return a program for the controller of a UR arm, see `cosim.results.urscript`.

        Raises:
            InputError: the arm has other joints than a UR, or the rows are not evenly spaced in time.
        """
        turning = [column for column in self.columns if column.endswith(".position_rad")]
        if len(turning) != _UR_JOINTS or len(self.joint_names) != _UR_JOINTS:
            raise InputError(
                f"URScript moves {_UR_JOINTS} joints that turn; this arm has {', '.join(self.joint_names)}: "
                f"write a {CSV} file"
            )
        steps_s = np.diff(self.time_s)
        if np.ptp(steps_s) > _UNEVEN * steps_s.min():
            raise InputError(
                f"{self.name}: URScript has one row per time step, and these rows are {steps_s.min():.6g} to "
                f"{steps_s.max():.6g} s apart: interpolate them at a fixed rate, or write a {TRAJECTORY} file"
            )
        return program(self.name, self.joint_names, self.time_s, self.joints, self.payload, self.held)

    def trajectory_text(self) -> str:
        """Return a `trajectory_msgs/msg/JointTrajectory` of ROS 2 as YAML, for `ros2 topic pub`.

        It has positions, and velocities of a spline, but no tensions and pressures.
        """
        lines = ["header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}"]
        lines += [f"joint_names: {json.dumps(self.joint_names)}", "points:"]
        for time_s, position, rate in zip(
            self.time_s.tolist(), self.joints.tolist(), self.joint_speeds.tolist(), strict=True
        ):
            sec, nanosec = divmod(round(1e9 * time_s), 10**9)
            lines.append(
                f"- {{positions: {position}, velocities: {rate}, accelerations: [], effort: [], "
                f"time_from_start: {{sec: {sec}, nanosec: {nanosec}}}}}"
            )
        return "\n".join([*lines, ""])

    def write(self, path: str | Path) -> None:
        """Write a .csv file, a .script file of URScript, or a .yaml file of a ROS 2 trajectory.

        Args:
            path: of the file; its ending selects the format.

        Raises:
            InputError: the ending is another one, or the arm is no UR.
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
            InputError: the file cannot be read, or is no such table.
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
        if twice := [head for head, count in Counter(heads).items() if count > 1]:
            raise InputError(f"{path}: has {twice[0]} twice; give each column its own head")
        if len(rows) < 2 or not (np.diff(rows[:, 0]) > 0.0).all():
            raise InputError(f"{path}: must have two rows at least, and {_TIME} must increase")
        return cls(path.stem, tuple(heads[1:]), rows[:, 0], rows[:, 1:])


def check_name(path: Path) -> None:
    """Check the ending of a file's name.

    Raises:
        InputError: it is that of no known format.
    """
    if path.suffix not in (CSV, URSCRIPT, TRAJECTORY):
        raise InputError(
            f"{path}: the name must end in {CSV}, in {URSCRIPT} for URScript, or in {TRAJECTORY} for a ROS 2 "
            "trajectory"
        )


def sample_times(duration_s: float, rate_Hz: float) -> Array:
    """Return instants (n,) [s] at a rate, from 0 to the first one at or after the end.

    Args:
        duration_s: of the sampled motion.
        rate_Hz: of the controller.

    Raises:
        InputError: the rate is not a number above 0, or too low for one step.
    """
    if not (math.isfinite(rate_Hz) and rate_Hz * duration_s >= 1.0):
        raise InputError(
            f"a rate of {rate_Hz:g} Hz gives no step within {duration_s:.4g} s; controllers take 100 to 1000"
        )
    return np.arange(math.ceil(duration_s * rate_Hz - 1e-9) + 1) / rate_Hz
