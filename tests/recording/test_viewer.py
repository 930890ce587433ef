"""Runs looked at while they last, and videos: who sees them, and what happens where nothing can be drawn."""

from __future__ import annotations

import contextlib
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import pytest
from rerun.experimental import ViewerClient

from cosim.cli import viewing
from cosim.cli.main import main
from cosim.config.schema.settings import RecordingTable
from cosim.errors import InputError, OutputError
from cosim.recording import pictures
from cosim.recording.pictures import Pictures, write_video
from cosim.recording.rerun_recorder import RerunRecorder
from cosim.recording.viewer import Viewer, check_display, start_viewer
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

MakeStage = Callable[..., RunInfo]
MakeSnapshot = Callable[..., Snapshot]
LOOPBACK = "0100007F"
"""127.0.0.1 as /proc/net/tcp writes it."""
LISTENS = "0A"
needs_control = pytest.mark.skipif(not hasattr(ViewerClient, "get_state"), reason="rerun-sdk before 0.41")
DRAWS_NOTHING = {"VK_DRIVER_FILES": "/nowhere", "VK_ICD_FILENAMES": "/nowhere"}


@pytest.fixture
def recorded(
    tmp_path: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> Callable[..., Iterator[RerunRecorder]]:
    """Return a function that records a made-up run of 0.2 s, and yields half-way."""

    def record(path: Path = tmp_path / "recording.rrd", **options: Any) -> Iterator[RerunRecorder]:
        stage = make_stage(ticks=100, duration_s=0.2)
        recorder = RerunRecorder(path, **options)
        recorder.open(stage)
        for ticks in (range(50), range(50, 101)):
            recorder.record(TickBatch.of([make_snapshot(stage, tick) for tick in ticks]))
            recorder.flush()
            yield recorder
        recorder.close("## The end", "completed")

    return record


@pytest.fixture
def viewer() -> Iterator[Callable[..., Viewer]]:
    """Return `start_viewer`; what it has started is ended with the test."""
    started: list[Viewer] = []

    def start(*arguments: Any) -> Viewer:
        started.append(start_viewer(*arguments))
        return started[-1]

    yield start
    for one in started:
        one.stop()


def drawn(what: Callable[[], Any]) -> Any:
    """Return what needs a driver to draw with, or skip the test where there is none."""
    try:
        return what()
    except OutputError as error:
        if "no Vulkan driver" in str(error):
            pytest.skip(str(error))
        raise


def listening(process: int) -> list[str]:
    """Return the addresses that a process listens on, from the kernel's tables of sockets."""
    links = []
    for link in Path(f"/proc/{process}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the process has closed it meanwhile
            links.append(link.readlink().name)
    inodes = {match[1] for name in links if (match := re.fullmatch(r"socket:\[(\d+)\]", name))}
    tables = [Path(f"/proc/net/{name}").read_text(encoding="ascii") for name in ("tcp", "tcp6")]
    rows = [line.split() for table in tables for line in table.splitlines()]
    return [row[1].partition(":")[0] for row in rows if row[3] == LISTENS and row[9] in inodes]


@pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's tables of sockets")
def test_a_page_is_served_to_this_machine_alone(
    recorded: Callable[..., Iterator[RerunRecorder]], viewer: Callable[..., Viewer], tmp_path: Path
) -> None:
    assert len(list(recorded())) == 2
    served = viewer("page", [tmp_path / "recording.rrd"])
    assert listening(served.process.pid) == [LOOPBACK, LOOPBACK]  # of the page, and of the data
    assert served.page is not None
    with urlopen(served.page) as answer:
        assert answer.status == 200


@needs_control
@pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's tables of sockets")
def test_a_live_view_shows_the_run_before_it_ends_and_the_file_is_written(
    recorded: Callable[..., Iterator[RerunRecorder]],
    viewer: Callable[..., Viewer],
    read: Callable[[Path], Any],
    tmp_path: Path,
) -> None:
    def seen_s() -> float:
        state = drawn(lambda: answered(shown, client.get_state))
        lines = [line for one in state.recordings for line in one.timelines]
        return max((line.end * 1e-9 for line in lines if line.name == "sim_time"), default=0.0)

    def shows(end_s: float) -> bool:
        until = time.monotonic() + 30.0
        while seen_s() < end_s and time.monotonic() < until:
            time.sleep(0.05)
        return seen_s() == pytest.approx(end_s)

    shown = viewer("nowhere")
    assert listening(shown.process.pid) == [LOOPBACK]
    client = drawn(lambda: answered(shown, lambda: ViewerClient.connect(shown.address)))
    run = recorded(viewer=shown.address)
    next(run)
    assert shows(0.098)
    next(run)
    assert shows(0.2)
    assert list(run) == []
    times = read(tmp_path / "recording.rrd").by_time("/plots/pressure", "Scalars:scalars")
    assert list(times) == [2_000_000 * tick for tick in range(101)]


def answered(shown: Viewer, ask: Callable[[], Any]) -> Any:
    """Return what a viewer answers; one that has nothing to draw with still answers before it ends."""
    until = time.monotonic() + 30.0
    while True:
        try:
            return ask()
        except ConnectionError:
            shown.check()
            if time.monotonic() > until:
                raise
            time.sleep(0.05)


def test_a_viewer_that_is_closed_ends_no_run(
    recorded: Callable[..., Iterator[RerunRecorder]],
    viewer: Callable[..., Viewer],
    read: Callable[[Path], Any],
    tmp_path: Path,
) -> None:
    shown = viewer("page")
    run = recorded(viewer=shown.address)
    next(run)
    shown.stop()
    assert len(list(run)) == 1
    found = read(tmp_path / "recording.rrd")
    assert len(found.by_time("/plots/pressure", "Scalars:scalars")) == 101
    assert "The end" in found.static("/summary", "TextDocument:text")[0]


@needs_control
def test_a_video_has_the_frames_of_the_run(
    recorded: Callable[..., Iterator[RerunRecorder]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    assert len(list(recorded())) == 2
    recording, video = tmp_path / "recording.rrd", tmp_path / "run.mp4"
    options = ["--size", "320x180", "--fps", "10", "--view", "Scene"]
    code = main(["video", str(recording), str(video), *options])
    told = capsys.readouterr()
    if code == 3 and "no Vulkan driver" in told.err:
        pytest.skip(told.err)
    assert code == 0
    assert told.out == f"{video}: 3 frames, 0.3 s\n"
    assert imageio_ffmpeg.count_frames_and_secs(str(video)) == (3, pytest.approx(0.3))
    assert [path.name for path in tmp_path.iterdir() if "part" in path.name] == []
    with pytest.raises(InputError, match=r"there is no view 'Nothing'; there are .*Scene"):
        write_video([recording], video, view="Nothing")


@needs_control
def test_without_a_driver_a_video_is_refused_by_name(
    recorded: Callable[..., Iterator[RerunRecorder]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(list(recorded())) == 2
    for name, value in DRAWS_NOTHING.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(OutputError, match="no Vulkan driver"), Pictures([tmp_path / "recording.rrd"]):
        pass


def test_impossible_videos_are_refused_before_anything_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    video = tmp_path / "run.mp4"
    with pytest.raises(InputError, match="above 0"):
        write_video([tmp_path], video, speed=0.0)
    with pytest.raises(InputError, match="even"):
        write_video([tmp_path], video, size=(321, 180))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'cosim\[video\]'"):
        write_video([tmp_path], video)


def test_without_a_display_it_is_said_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "recording.rrd").touch()
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert main(["view", str(tmp_path / "recording.rrd")]) == 2
    told = capsys.readouterr().err
    assert all(remedy in told for remedy in ("--web", "ssh -L", "cosim video"))
    assert main(["run", "ur5e_hexagon_arm", "--live", "--out", str(tmp_path / "out")]) == 2
    assert "--web" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    check_display("", {"WAYLAND_DISPLAY": "wayland-0"})


def test_a_live_view_needs_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "ur5e_hexagon_arm", "--web", "--no-recording", "--out", str(tmp_path / "out")]
    assert main(command) == 2
    assert "--no-recording" in capsys.readouterr().err


def test_a_page_is_served_on_after_the_run_and_ended_after_that(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    class Page:
        page, address = "http://127.0.0.1:9090", "rerun+http://127.0.0.1:9876/proxy"

        def wait(self) -> None:
            done.append("wait")
            raise KeyboardInterrupt

        def stop(self) -> None:
            done.append("stop")

    monkeypatch.setattr(viewing, "start_viewer", lambda shown: Page())
    monkeypatch.setattr(viewing, "RerunRecorder", lambda _path, **given: done.append(given["viewer"]))
    with viewing.live_view(web=True, recording=True) as live:
        live.recorder(Path("a.rrd"), RecordingTable(), None)  # type: ignore[arg-type]
        live.serve_on()
    assert done == [Page.address, "wait", "stop", "stop"]


def test_an_old_viewer_is_refused_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(ViewerClient, "get_state", raising=False)
    with (
        pytest.raises(OutputError, match=r"0\.41 or later.*pip install 'rerun-sdk>=0\.41'"),
        Pictures([Path("run.rrd")]),
    ):
        pass


@needs_control
def test_a_recording_without_frames_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[str] = []
    shows_nothing = SimpleNamespace(address="", check=lambda: None, stop=lambda: ended.append("viewer"))
    answers = SimpleNamespace(get_state=lambda: None)
    monkeypatch.setattr(pictures, "start_viewer", lambda *_, **__: shows_nothing)
    monkeypatch.setattr(ViewerClient, "connect", lambda _: answers)
    monkeypatch.setattr(pictures, "_WAIT_S", 0.0)
    with (
        pytest.raises(OutputError, match=r"^empty\.rrd: holds no frame of a run$"),
        Pictures([Path("empty.rrd")]),
    ):
        pass
    assert ended == ["viewer"]
