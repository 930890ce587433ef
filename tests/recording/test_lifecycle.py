"""How a recording begins and ends, whatever happens in between."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr

from cosim.errors import InputError, OutputError
from cosim.recording import rerun_recorder
from cosim.recording.recorder import Recorders, RecordingPart
from cosim.recording.rerun_recorder import RerunRecorder
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

pytestmark = pytest.mark.usefixtures("strict")

MakeStage = Callable[..., RunInfo]
MakeSnapshot = Callable[..., Snapshot]
Read = Callable[[Path], Any]


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_killed_process_leaves_all_but_the_last_second(rrd: Path, tmp_path: Path, read: Read) -> None:
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, runpy, sys, time\n"
        "from pathlib import Path\n"
        "from cosim.recording.rerun_recorder import RerunRecorder\n"
        "from cosim.telemetry.tick_batch import Snapshot, TickBatch\n"
        f"made_up = runpy.run_path({str(Path(__file__).with_name('conftest.py'))!r})\n"
        "stage = made_up['make_stage']()\n"
        "recorder = RerunRecorder(Path(sys.argv[1]))\n"
        "recorder.open(stage)\n"
        "for tick in range(101):\n"
        "    time.sleep(1.05 * (tick == 70))\n"
        "    recorder.record(TickBatch.of([made_up['make_snapshot'](stage, tick)]))\n"
        "os._exit(1)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    subprocess.run([sys.executable, str(script), str(rrd)], check=False, env=environment, timeout=60)
    times = read(rrd).by_time("/plots/pressure", "Scalars:scalars")
    assert list(times)[:71] == [2_000_000 * tick for tick in range(71)]


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_what_is_gathered_does_not_grow_without_bound(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, read: Read, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rerun_recorder, "_GATHERED_S", 1e9)
    stage = make_stage()
    monkeypatch.setattr(rerun_recorder, "_NODES_GATHERED", 4 * len(make_snapshot(stage, 0).node_position))
    recorder = RerunRecorder(rrd, frames_per_s=500.0)
    recorder.open(stage)
    for tick in range(13):
        recorder.record(TickBatch.of([make_snapshot(stage, tick)]))
    times = read(rrd).by_time("/world/soft/film", "Mesh3D:vertex_positions")
    assert list(times) == [2_000_000 * tick for tick in range(12)]  # four frames, three times
    recorder.close("", "completed")
    assert len(read(rrd).by_time("/world/soft/film", "Mesh3D:vertex_positions")) == 13


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_curves_without_frames_do_not_grow_without_bound(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, read: Read, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rerun_recorder, "_GATHERED_S", 1e9)
    monkeypatch.setattr(rerun_recorder, "_TICKS_GATHERED", 5)
    stage = make_stage()
    recorder = RerunRecorder(rrd, frames_per_s=1.0)
    recorder.open(stage)
    for tick in range(13):
        recorder.record(TickBatch.of([make_snapshot(stage, tick)]))
    times = read(rrd).by_time("/plots/pressure", "Scalars:scalars")
    assert list(times) == [2_000_000 * tick for tick in range(11)]
    recorder.close("", "completed")


def test_a_long_run_is_not_written_in_splinters(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage, now, written = make_stage(), 0.0, []
    monkeypatch.setattr(rerun_recorder.time, "perf_counter", lambda: now)
    flush = rerun_recorder.PlotBuffer.flush
    monkeypatch.setattr(rerun_recorder.PlotBuffer, "flush", lambda b: (written.append(now), flush(b)))
    recorder = RerunRecorder(rrd, frames_per_s=1.0)
    recorder.open(stage)
    for tick in range(740):
        now = 0.5 * tick
        recorder.record(TickBatch.of([make_snapshot(stage, tick)]))
    steps = np.diff(written)
    assert set(steps[:50]) == {1.0}
    assert set(steps[-5:]) == {3.5, 4.0}  # a hundredth of 370 s, in half seconds
    monkeypatch.undo()
    recorder.close("", "completed")


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_bare_stage_is_recorded(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, read: Read, mode: str
) -> None:
    # One triangle, no cable, nothing rigid, no weight, no gravity.
    triangle = np.array([[0, 1, 2]])
    stage = make_stage(
        mode=mode,
        shapes=(),
        cables=(),
        soft_triangles=triangle,
        soft_weight_N=0.0,
        gravity=np.zeros(3),
        membrane_stress=lambda positions: np.zeros(1),
    )
    recorder = RerunRecorder(rrd)
    recorder.open(stage)
    corners = np.array([[0.3, 0, 0.5], [0.4, 0, 0.5], [0.3, 0.1, 0.4]])
    for tick in range(20):
        table = make_snapshot(stage, tick, cable_tension_N=np.zeros(0), tip_target=None).table
        recorder.record(replace(table, film=FilmShapes(None, corners[None], table.film.figures)))
    recorder.close("", "completed")
    recorded = read(rrd)
    assert recorded.static("/world/soft/film", "Mesh3D:triangle_indices") == [[0, 1, 2]]
    cost = next(iter(recorded.by_time("/plots/tick_cost", "Scalars:scalars").values()))
    assert cost == ([1.0, 2.0] if mode == "dynamic" else [1.0])  # a tick has no length in statics


def test_run_without_a_tick_leaves_a_readable_file(rrd: Path, make_stage: MakeStage, read: Read) -> None:
    recorder = RerunRecorder(rrd)
    recorder.open(make_stage())
    recorder.close("nothing", "failed")
    recorder.close("again", "failed")  # closing twice changes nothing
    assert read(rrd).static("/__properties/outcome", "status") == ["failed"]


def test_equal_ids_join_recordings(rrd: Path, make_stage: MakeStage) -> None:
    ids = []
    for name in ("a", "b"):
        recorder = RerunRecorder(rrd.with_name(name), part=RecordingPart("run-7"))
        recorder.open(make_stage())
        recorder.close("", "completed")
        ids.append(rrd.with_name(name).read_bytes().count(b"run-7"))
    assert min(ids) > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames_per_s": 0.0}, r"frames_per_s is 0\.0"),
        ({"frames_per_s": float("nan")}, "frames_per_s is nan"),
    ],
)
def test_impossible_options_are_refused(rrd: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        RerunRecorder(rrd, **options)
    assert not rrd.parent.exists()


def test_recording_before_opening_is_refused(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    with pytest.raises(RuntimeError, match=r"call open\(stage\)"):
        RerunRecorder(rrd).record(TickBatch.of([make_snapshot(make_stage(), 0)]))


def test_no_recorders_write_nothing(
    tmp_path: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    recorder = Recorders(())
    recorder.open(make_stage())
    recorder.record(TickBatch.of([make_snapshot(make_stage(), 0)]))
    recorder.close("", "completed")
    assert list(tmp_path.iterdir()) == []


def test_a_later_part_is_laid_out_as_the_first(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, read: Read
) -> None:
    stage = make_stage()
    first, last = make_snapshot(stage, 0), make_snapshot(stage, 400)
    paths = [rrd.with_name(name) for name in ("whole.rrd", "later.rrd")]
    for path, part, begin in ((paths[0], None, 0), (paths[1], RecordingPart("run-7", (first, last)), 401)):
        recorder = RerunRecorder(path, part=part)
        recorder.open(stage)
        for tick in range(begin, 421):
            recorder.record(TickBatch.of([make_snapshot(stage, tick)]))
        recorder.close("", "completed")
    whole, later = (read(path) for path in paths)
    seams, tip = "/world/soft/seams", "/world/soft/tip_path"
    assert whole.entities == later.entities
    for entity in (seams, tip):
        drawn = later.by_time(entity, "LineStrips3D:strips")
        expected = whole.by_time(entity, "LineStrips3D:strips")
        assert len(drawn) > 1
        assert drawn == {time: expected[time] for time in drawn}


def test_a_file_that_cannot_be_written_is_named(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = RerunRecorder(rrd)
    stage = make_stage()
    recorder.open(stage)
    recorder.record(TickBatch.of([make_snapshot(stage, 0)]))

    def full(self: Any) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")  # what Rerun says of a full disk

    with monkeypatch.context() as patch:
        patch.setattr(rr.RecordingStream, "flush", full)
        for act in (recorder.flush, lambda: recorder.close("", "completed")):
            with pytest.raises(OutputError, match=f"{rrd.name}: cannot be written"):
                act()
    recorder.close("", "completed")
