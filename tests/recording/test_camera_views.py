"""Sensors and cameras in a recording: curves of readings and truth, pictures and where they were taken."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.devices.device_report import SensorNames
from cosim.recording.plots import plots_of
from cosim.telemetry.camera_image import CameraImage, CameraInfo
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

EYE = CameraInfo("eye", (6, 4), np.pi / 2.0, 10.0)
IMAGE = CameraImage(
    "eye",
    np.full((4, 6, 3), 200, np.uint8),
    np.full((4, 6), np.inf, np.float32),
    np.tile(np.arange(3, dtype=np.int16), (4, 2)),
    np.array([0.1, 0.2, 0.3]),
    np.eye(3)[[1, 2, 0]],
)


@pytest.mark.usefixtures("strict")
def test_pictures_stand_at_their_ticks_with_the_place_of_the_camera(
    rrd: Path, record: Any, make_stage: Callable[..., RunInfo], make_snapshot: Callable[..., Snapshot]
) -> None:
    def seen(stage: RunInfo, tick: int) -> Snapshot:
        return make_snapshot(stage, tick, images=(IMAGE,) if tick % 50 == 0 else ())

    found = record(rrd, make_stage(cameras=(EYE,)), seen, 120)
    at = [0, 100_000_000, 200_000_000]
    path = "/world/cameras/eye"
    places = found.by_time(path, "Transform3D:translation")
    assert list(places) == at
    assert places[0][0] == pytest.approx([0.1, 0.2, 0.3])
    assert found.by_time(path, "Transform3D:mat3x3")[0][0] == IMAGE.rotation.T.ravel().tolist()
    assert list(found.by_time(f"{path}/rgb", "EncodedImage:blob")) == at
    depth = found.by_time("/cameras/eye/depth", "DepthImage:buffer")[0][0]
    assert np.frombuffer(bytes(depth), np.float32).tolist() == [0.0] * 24  # nothing was hit
    segments = found.by_time("/cameras/eye/segments", "SegmentationImage:buffer")[0][0]
    assert np.frombuffer(bytes(segments), np.uint16).tolist() == [0, 1, 2] * 8
    # a view of 90 degrees over 4 pixels: the focal length is 2
    lens = found.static(path, "Pinhole:image_from_camera")
    assert lens[0] == pytest.approx([2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 3.0, 2.0, 1.0])


def test_every_sensor_has_a_plot_of_its_readings_and_of_the_truth(
    make_stage: Callable[..., RunInfo], make_snapshot: Callable[..., Snapshot]
) -> None:
    stage = make_stage(sensors=(SensorNames("gauge", "Pa", ("",)), SensorNames("tip", "m", ("x", "y"))))
    reading, truth = np.array([1e4, 0.1, 0.2]), np.array([2e4, 0.3, 0.4])
    batch = TickBatch.of([make_snapshot(stage, 3, sensor_reading=reading, sensor_truth=truth)] * 2)
    shown = {plot.entity: plot for plot in plots_of(stage, 2) if plot.tab == "Sensors"}
    assert [plot.title for plot in shown.values()] == ["Sensor gauge [kPa]", "", "Sensor tip [mm]", ""]
    assert shown["sensors/tip"].values(batch) == pytest.approx(np.array([[100.0, 200.0]] * 2))
    assert shown["sensors/tip/truth"].values(batch) == pytest.approx(np.array([[300.0, 400.0]] * 2))
    assert shown["sensors/gauge"].values(batch) == pytest.approx(np.array([[10.0]] * 2))
    assert shown["sensors/tip/truth"].series == ("truth x", "truth y")
