"""The directory of a run: who reads in it sees whole files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cosim.app import run_files
from cosim.app.array_recorder import ArrayRecorder
from cosim.app.output_directory import MARKER, OutputDirectory
from cosim.app.run_files import ARRAYS, FRAMES, SUMMARY, RunFiles, default_directory, recordings
from cosim.config.loading import load_scenario
from cosim.errors import OutputError
from cosim.recording.recorder import RecordingPart
from cosim.results import array_files
from cosim.telemetry.tick_batch import TickBatch
from tests.conftest import made_up_snapshot, made_up_stage


def test_who_reads_a_summary_reads_one_to_its_end(tmp_path: Path) -> None:
    files = RunFiles(tmp_path)
    long, short = {"status": "interrupted", "ticks": list(range(5000))}, {"status": "completed"}
    files.finish(long)
    with (tmp_path / SUMMARY).open(encoding="utf-8") as reader:
        begun = reader.read(100)
        files.finish(short)  # written beside it and put in its place at once, not over it
        assert json.loads(begun + reader.read()) == long
    assert json.loads((tmp_path / SUMMARY).read_text(encoding="utf-8")) == short
    assert [path.name for path in tmp_path.iterdir()] == [SUMMARY]


def test_runs_of_one_second_get_directories_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_files.time, "strftime", lambda _form: "20260203-040506")
    for name in ("arm-20260203-040506", "arm-20260203-040506-2", "arm-20260203-040506-3"):
        assert default_directory("arm") == Path("runs", name)
        default_directory("arm").mkdir(parents=True)


def test_recordings_are_those_that_the_run_wrote(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path) as directory:
        directory.make()
        directory.claim("recording.rrd", "recording-2.rrd", "recording-10.rrd")
    for name in (
        "recording-2.rrd",
        "recording-10.rrd",
        "recording-3.rrd",
        "recording-best.rrd",
        "recording.rrd",
    ):
        (tmp_path / name).touch()
    names = [path.name for path in recordings(tmp_path)]
    assert names == ["recording.rrd", "recording-2.rrd", "recording-10.rrd"]
    # of a copy that has lost its marker, all that are named like one
    (tmp_path / MARKER).unlink()
    names = [path.name for path in recordings(tmp_path)]
    assert names == ["recording.rrd", "recording-2.rrd", "recording-3.rrd", "recording-10.rrd"]


@pytest.mark.parametrize("ticks", [0, 3])
def test_arrays_are_written_where_there_are_new_ones_and_at_least_once(ticks: int, tmp_path: Path) -> None:
    written: list[str] = []

    def next_part(name: str) -> Path:
        written.append(name)
        return tmp_path / f"{len(written)}-{name}"

    recorder = ArrayRecorder(next_part, 100.0, RecordingPart("run"))
    recorder.open(made_up_stage(load_scenario("ur5e_hexagon_arm")))
    if ticks:
        recorder.record(TickBatch.of([made_up_snapshot(tick, 0.002) for tick in range(ticks)]))
        recorder.flush()
    recorder.close("", "completed")
    assert written == [ARRAYS, FRAMES]


def test_no_tick_is_in_two_parts_after_a_disk_was_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = RunFiles(tmp_path)
    recorder = ArrayRecorder(files.next_part, 100.0, RecordingPart("run"))
    recorder.open(made_up_stage(load_scenario("ur5e_hexagon_arm")))
    recorder.record(TickBatch.of([made_up_snapshot(tick, 0.002) for tick in range(3)]))
    write = array_files.write_columns

    def full(path: Path, *further: Any) -> None:
        if path.name.startswith("arrays"):
            raise OutputError(f"{path}: no space left")
        write(path, *further)

    with files.out:
        files.out.make()
        monkeypatch.setattr(array_files, "write_columns", full)
        recorder.flush()
        monkeypatch.undo()
        recorder.close("", "completed")
    assert sorted(path.name for path in tmp_path.glob("*.parquet")) == [ARRAYS, FRAMES]
    for path in (tmp_path / ARRAYS, tmp_path / FRAMES):
        assert array_files.read_stage(path).ticks
