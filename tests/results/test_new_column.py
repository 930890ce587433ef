"""A further figure of a run is one entry in the table of columns: all that shows figures reads it there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import csv, parquet

import cosim
from cosim.app import preparation
from cosim.base.column import Column, RunFigure, View
from cosim.base.columns import RunColumns
from cosim.recording.plots import plots_of
from cosim.results import csv_table
from cosim.results.run_columns import COLUMNS

NAME = "servo_power_W"


@pytest.fixture
def entry(monkeypatch: pytest.MonkeyPatch) -> None:
    column = Column(
        "rows",
        "W",
        "mechanical power of the servos.",
        RunFigure("max_servo_power_W", "largest", "largest power of the servos [W]"),
        read=lambda ticks: (ticks.joint_torque * ticks.joint_velocity).sum(axis=1),
        view=View("Run", 9, "servo_power", "Power of the servos [W]", label="power"),
    )
    column.__set_name__(RunColumns, NAME)
    monkeypatch.setattr(RunColumns, NAME, column, raising=False)
    monkeypatch.setitem(COLUMNS, NAME, column)


def test_a_further_column_is_in_results_files_summary_and_plots(
    entry: None, made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(preparation, "build_simulation", made_up_build())
    result = cosim.run("ur5e_hexagon_arm", out=tmp_path)
    power = (result.joint_torque * result.joint_velocity).sum(axis=1)
    assert np.ptp(power) > 0.0
    for found in (result, cosim.load_run(tmp_path)):
        np.testing.assert_array_equal(found.arrays[NAME], power)
        np.testing.assert_array_equal(getattr(found, NAME), power)
        assert found.summary["max_servo_power_W"] == np.abs(power).max()
    field = parquet.read_schema(tmp_path / "arrays.parquet").field(NAME)
    assert (field.metadata[b"unit"], field.metadata[b"meaning"]) == (b"W", b"mechanical power of the servos.")
    csv_table.write_csv(result, tmp_path / "arrays.csv")
    assert csv.read_csv(tmp_path / "arrays.csv")[f"{NAME} [W]"].to_pylist() == power.tolist()
    assert [axes.get_ylabel() for axes in result.plot(NAME).axes] == ["servo power [W]"]
    shown = {plot.entity: plot for plot in plots_of(result.stage, 6)}
    assert (shown["servo_power"].title, shown["servo_power"].series) == (
        "Power of the servos [W]",
        ("power",),
    )
