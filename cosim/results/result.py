"""The result of a run: its summary, and its arrays over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.column import listing_columns
from cosim.base.columns import RunColumns
from cosim.base.frames import Array
from cosim.config.schema.scenario import Scenario
from cosim.devices.device_report import SensorNames
from cosim.errors import InputError
from cosim.results.plots import Panel, figure_of
from cosim.results.run_columns import COLUMNS, FrameColumns, ImageColumns
from cosim.results.run_html import as_html
from cosim.telemetry.phase_ends import PhaseEnds
from cosim.telemetry.run_info import RunInfo

USUAL: Final = (
    "tip_position", "sag_m", "bending_angle_rad", "chamber_pressure_Pa", "cable_tension_N", "flange_force",
    "contact_force_N", "joint_position",
)  # fmt: skip
_PREFIXES: Final = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa"), "rad": (180.0 / np.pi, "degrees")}


@final
@listing_columns
@dataclass(frozen=True, eq=False, repr=False)
class CameraImages(ImageColumns):
    """The images of a camera, a row for each; columns are attributes.

    Args:
        arrays: columns by name.
    """

    arrays: Mapping[str, NDArray[Any]]

    def __repr__(self) -> str:
        """Return one line: number and size of the images."""
        return f"{len(self.tick)} pictures of {self.rgb.shape[2]} x {self.rgb.shape[1]} pixels"


@final
@listing_columns
@dataclass(frozen=True, eq=False, repr=False)
class RunResult(FrameColumns, RunColumns):
    """A run as arrays, one row per snapshot (the state before the first tick, then every tick).

    World frame, SI units. Columns are attributes, such as `tip_position`; node positions are recorded at the
    recording's frame rate only. The files of a run contain shape, unit and meaning as below; without [unit],
    the unit is the end of the name.

    Args:
        stage: description that does not change during the run: film triangles, cable routes, names of joints,
            bodies and objects; see `body`.
        summary: as in summary.json.
        directory: of the files; None if none were written.
        arrays: columns by name.
        images: of each camera of the scenario, by its name.
        scenario: of the run; None if it is in the directory, or unknown.
        ends: of the phases, for `cosim.error_bars`; None: the same.
    """

    stage: RunInfo
    summary: dict[str, Any]
    directory: Path | None
    arrays: Mapping[str, NDArray[Any]]
    images: Mapping[str, CameraImages] = field(default_factory=dict)
    scenario: Scenario | None = None
    ends: PhaseEnds | None = None

    @property
    def status(self) -> str:
        """How the run ended: "completed", "interrupted" or "failed"."""
        return str(self.summary["status"])

    def body(self, name: str) -> int:
        """Return the index of a body in `body_position`, `body_quaternion` and `body_contact_force`.

        Args:
            name: of an object of the scenario, or of a link of the arm.

        Raises:
            InputError: there is no such body.
        """
        names = self.stage.body_names
        if name not in names:
            raise InputError(f"there is no body '{name}'; there are {', '.join(names) or 'none'}")
        return names.index(name)

    def sensor(self, name: str) -> tuple[Array, Array]:
        """Return readings and exact values of a sensor, (rows, values) each, in its unit.

        Args:
            name: of a sensor of the scenario.

        Raises:
            InputError: there is no such sensor.
        """
        begin = 0
        for each in self.stage.sensors:
            end = begin + len(each.values)
            if each.name == name:
                return self.sensor_reading[:, begin:end], self.sensor_truth[:, begin:end]
            begin = end
        names = ", ".join(each.name for each in self.stage.sensors)
        raise InputError(f"there is no sensor '{name}'; there are {names or 'none'}")

    def plot(self, *names: str) -> Any:
        """Return a matplotlib figure of curves over time; `figure.savefig(path)` writes it.

        Args:
            names: of arrays with a row per tick, or of sensors; none: the usual ones.

        Raises:
            InputError: there is no such array, the run has no ticks, or matplotlib is not installed.
        """
        shown = list(panels(self, names))
        if not shown:
            raise InputError(
                f"{self.stage.scenario}: the run has no ticks to draw; its summary has the reason"
            )
        changes_s = self.time_s[np.flatnonzero(np.diff(self.phase))].tolist()
        return figure_of(shown, self.time_s, changes_s, f"{self.stage.title} ({self.status})")

    def _repr_html_(self) -> str:
        """Return the outcome and a table of the phases, for notebooks."""
        return as_html(repr(self), self.summary)

    def __repr__(self) -> str:
        """Return two lines: how the run ended, and the sizes of its arrays."""
        stage, rows, frames = self.stage, len(self.tick), len(self.frame_time_s)
        end_s, ticks = (self.time_s[-1], self.tick[-1]) if rows else (0.0, 0)
        sizes = [
            f"{len(stage.phase_names)} phases", f"{len(stage.joint_names)} joints",
            f"{len(stage.body_names)} bodies", f"{len(stage.chamber_names)} chambers",
            f"{len(stage.cables)} cables",
        ]  # fmt: skip
        where = "" if self.directory is None else f"; files in {self.directory}"
        return (
            f"RunResult of {stage.scenario}, {stage.mode}, {self.status}: {ticks} of {stage.ticks} ticks, "
            f"{end_s:g} of {stage.duration_s:g} s\n"
            f"{rows} rows of {len(COLUMNS)} arrays, {frames} frames of the film, {', '.join(sizes)}{where}"
        )


def panels(result: RunResult, names: Sequence[str] = ()) -> Iterator[Panel]:
    """Yield the panels of some arrays of a run, or of the usual arrays that are not 0 throughout.

    Args:
        result: of a run.
        names: of arrays with a row per tick, or of sensors; empty: the usual ones.

    Raises:
        InputError: there is no such array.
    """
    sensors = {each.name: each for each in result.stage.sensors}
    for name in names or (*USUAL, *sensors):
        if name in sensors:
            yield _sensor_panel(result, sensors[name])
            continue
        if name not in COLUMNS:
            there = ", ".join([*COLUMNS, *sensors])
            raise InputError(f"there is no array '{name}' over the ticks; there are {there}")
        array, column = getattr(result, name), COLUMNS[name]
        if not array.size or not (names or np.nan_to_num(array).any()):
            continue
        scale, unit = _PREFIXES.get(column.unit, (1.0, column.unit))
        labels = column.components(result.stage.names_along, array.shape[1:])
        title = name.removesuffix(f"_{column.unit}").replace("_", " ")
        yield Panel(title, unit, scale * array.reshape(len(array), -1), labels if len(labels) > 1 else [])


def _sensor_panel(result: RunResult, sensor: SensorNames) -> Panel:
    scale, unit = _PREFIXES.get(sensor.unit, (1.0, sensor.unit))
    labels = [" ".join(filter(None, pair)) for pair in product(("sensor", "truth"), sensor.values)]
    return Panel(sensor.name, unit, scale * np.hstack(result.sensor(sensor.name)), labels)
