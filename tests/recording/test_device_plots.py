"""Curves of devices: those that a scenario has, with one value each in every snapshot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.config.loading import load_scenario
from cosim.devices.device_report import ActuationReport, ControlReport, DeviceNames, PumpReport
from cosim.recording.plots import ERROR_BARS, plots_of
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch
from tests.conftest import made_up_snapshot, made_up_stage
from tests.ticks import changed

NAMES = DeviceNames(("main",), (("bend", "bending_angle_rad"), ("lift", "tip_height_m")), True, True)
REPORT = ActuationReport(
    cable_tension_N=np.array([1.0]),
    cable_length_m=np.array([0.2]),
    unstretched_m=np.array([np.nan]),
    off_drum_m=np.array([0.19]),
    lost_steps=np.array([3]),
    bending_angle_rad=np.pi / 6.0,
    pumps=(PumpReport(1e4, True, False, 2, 0.5, 1e-6),),
    controls=(ControlReport("bend", np.pi / 4.0, np.pi / 6.0),),
)


@pytest.fixture
def stage() -> RunInfo:
    return replace(made_up_stage(load_scenario("ur5e_hexagon_arm")), cable_names=("left",), devices=NAMES)


def values(stage: RunInfo, snapshot: Snapshot) -> dict[str, list[float]]:
    shown = [plot for plot in plots_of(stage, 6) if plot.tab == "Devices"]
    return {plot.entity: plot.values(TickBatch.of([snapshot])).ravel().tolist() for plot in shown}


def test_every_device_has_its_curve(stage: RunInfo) -> None:
    snapshot = changed(made_up_snapshot(3, 0.002), devices=REPORT)
    shown = values(stage, snapshot)
    assert shown["control/bending_angle_rad"] == pytest.approx([30.0])
    assert shown["control/bending_angle_rad/setpoint"] == pytest.approx([45.0])
    assert shown["control/tip_height_m"] == pytest.approx([1e3 * snapshot.tip_position[2]])
    assert np.isnan(shown["control/tip_height_m/setpoint"])  # its controller does not act
    assert shown["cable_length"] == shown["cable_unstretched"] == pytest.approx([200.0])
    assert shown["lost_steps"] == [3.0]
    assert shown["pump"] == [1.0, 0.0]
    assert shown["gas_delivered"] == pytest.approx([1.0])
    for plot in plots_of(stage, 6):
        assert plot.values(TickBatch.of([snapshot] * 2)).size == 2 * len(plot.series) == 2 * len(plot.colours)


def test_a_scenario_without_devices_has_no_such_curves(stage: RunInfo) -> None:
    assert values(replace(stage, devices=None), made_up_snapshot(3, 0.002)) == {}
    only_pump = replace(stage, devices=DeviceNames(("main",), (), False, False))
    assert values(only_pump, changed(made_up_snapshot(3, 0.002), devices=REPORT)).keys() == {
        "pump", "gas_delivered",
    }  # fmt: skip


def test_bars_of_errors_have_the_unit_of_their_plot(stage: RunInfo) -> None:
    batch = TickBatch.of([made_up_snapshot(3, 0.002)])
    shown = {plot.entity: plot.values(batch) for plot in plots_of(stage, 6)}
    for name, (entity, scale) in ERROR_BARS.items():
        figure = {"tip_m": "tip_position", "volume_m3": "chamber_volume_m3"}.get(name, name)
        np.testing.assert_allclose(shown[entity], scale * getattr(batch, figure), err_msg=name)
