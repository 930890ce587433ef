"""Writes a run as a Rerun recording (.rrd): curves at every tick, and the scene at a limited frame rate.
Several arms of one scene write to one recording, each below its own name.
"""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from threading import Thread
from typing import Any, Final, cast, final

import numpy as np
import rerun as rr

from cosim.base.frames import IntArray
from cosim.errors import InputError, OutputError
from cosim.recording.arm_streams import ArmStream, SceneStream
from cosim.recording.blueprint import RunViews, blueprint
from cosim.recording.camera_views import CameraViews, camera_paths
from cosim.recording.colours import series_colours
from cosim.recording.columns import time_columns
from cosim.recording.eyes import close_eye, scene_eye
from cosim.recording.plot_buffer import PlotBuffer
from cosim.recording.plots import ERROR_BARS, plots_of
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.recording.rigid_meshes import log_rigid_meshes
from cosim.recording.scene import Scene
from cosim.recording.stress_legend import log_stress_legend
from cosim.telemetry import tick_batch
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot

APPLICATION_ID: Final = "cosim"
FRAMES_PER_S: Final = 60.0
_SECOND_NS: Final = 1_000_000_000
_GATHERED_S: Final = 1.0
"""Wall time after which the buffer is written; each write takes some ms, and 50 kB of the file."""
_SHOWN_S: Final = 0.25
"""The same with a viewer that shows the run while it is simulated."""
_GATHERED_FRACTION: Final = 0.01
"""Least time between writes as a fraction of the wall time so far, so that long runs have few chunks."""
_NODES_GATHERED: Final = 500_000
"""Nodes in all buffered frames, at which they are written earlier: some 50 MB of memory."""
_TICKS_GATHERED: Final = 50_000
"""Buffered ticks, at which they are written earlier: some 15 MB of curves."""
_ENDED_S: Final = 20.0
"""Wall time that closing a file may take, far more than it usually takes."""
_END: Final = b"RRF2FOOT"  # within the last 64 bytes of a complete file
_PHASE: Final = "/phase"
_SUMMARY: Final = "/summary"


@final
class RerunRecorder(Recorder):
    """Writes one file: curves at every tick, the scene at a limited frame rate.

    Ticks are buffered in memory. The buffer is written once per second of wall time, in long runs after a
    hundredth of the time so far, and earlier if it gets large. A process that is killed loses little more.

    Args:
        path: of the file; missing folders are made, an old file is replaced.
        frames_per_s: frames of the scene per simulated second.
        part: of the run, so that the recordings of its parts open as one; None for a single recording.
        viewer: address of a viewer that shows the run while it is simulated; None without one. The run goes
            on if the viewer is closed.

    Raises:
        InputError: the frame rate is impossible.
    """

    def __init__(
        self,
        path: Path,
        *,
        frames_per_s: float = FRAMES_PER_S,
        part: RecordingPart | None = None,
        viewer: str | None = None,
    ) -> None:
        if not 0.0 < frames_per_s < np.inf:
            raise InputError(f"frames_per_s is {frames_per_s}; it must be above 0")
        self._path = path
        self._frame_ns = _SECOND_NS / frames_per_s
        self._part = part
        self._viewer = viewer
        self._run: _Run | None = None
        self._shared: ArmStream | None = None

    def open(self, stage: RunInfo) -> None:
        """Make the file; see `Recorder.open`."""
        part = self._part
        self._run = _Run(self._shared or self._stream(), stage, self._frame_ns, self._viewer)
        if part is not None and part.before is not None:
            self._run.resume(*part.before)

    def _stream(self) -> rr.RecordingStream:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        part = self._part
        stream = rr.RecordingStream(APPLICATION_ID, recording_id=None if part is None else part.run_id)
        with _named(self._path):
            viewers = [] if self._viewer is None else [rr.GrpcSink(self._viewer)]
            stream.set_sinks(rr.FileSink(self._path), *viewers)
        return stream

    def of_arms(self, names: Sequence[str]) -> Mapping[str, Recorder]:
        """Make the file, and return the recorder of each arm; see `Recorder.of_arms`."""
        group, found = SceneStream(self._stream(), names, live=self._viewer is not None), {}
        for name in names:
            found[name] = one = copy(self)
            one._shared = group.of(name)
        return found

    def lay_out(self, first: Snapshot) -> None:
        """Lay out the views; see `Recorder.lay_out`."""
        if self._run is not None:
            self._run.lay_out(first)

    def record(self, batch: tick_batch.TickBatch) -> None:
        """Record some ticks; see `Recorder.record`.

        Raises:
            RuntimeError: the recorder is not open.
        """
        if self._run is None:
            raise RuntimeError("the recorder is not open: call open(stage) before record(batch)")
        with _named(self._path):
            self._run.record(batch)

    def mark_errors(self, phases: Mapping[int, dict[str, Any]]) -> None:
        """Add error bars to the plots, if it is open; see `Recorder.mark_errors`."""
        if self._run is not None:
            with _named(self._path):
                self._run.mark_errors(phases)

    def flush(self) -> None:
        """Write the buffer, if it is open; see `Recorder.flush`."""
        if self._run is not None:
            with _named(self._path):
                self._run.flush()

    def close(self, summary_markdown: str, status: str) -> None:
        """Write the rest and close the file, if it is open; see `Recorder.close`."""
        if self._run is not None:
            run, self._run = self._run, None
            with _named(self._path):
                run.close(summary_markdown, status)
                if self._shared is None or self._shared.leave():
                    run.end(self._path)


def _has_end(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            file.seek(-min(64, path.stat().st_size), os.SEEK_END)
            return _END in file.read()
    except OSError:
        return False


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Convert Rerun's error for a file that cannot be written to an `OutputError` that names the file."""
    try:
        yield
    except RuntimeError as error:
        raise OutputError(
            f"{path}: cannot be written; the disk may be full, or its folder is missing: {error}"
        ) from error


@final
class _Run:
    """State of one open recording."""

    def __init__(
        self, stream: rr.RecordingStream | ArmStream, stage: RunInfo, frame_ns: float, viewer: str | None
    ) -> None:
        self._to, self._stream = stream, cast(rr.RecordingStream, stream)
        self._viewer = viewer
        self._gathered_s = _GATHERED_S if viewer is None else _SHOWN_S
        self._stage = stage
        self._frame_ns = frame_ns
        self._tick_ns = round(stage.tick_s * _SECOND_NS)
        self._curves: PlotBuffer | None = None
        self._scene: Scene | None = None
        self._cameras = CameraViews(self._stream, stage, self._tick_ns)
        self._frames: list[tick_batch.TickBatch] = []
        self._drawn = 0
        self._frame = -1
        self._drawn_tick = -1
        self._frames_most = 1
        self._opened = time.perf_counter()
        self._due = self._opened + self._gathered_s
        self._written_tick = 0
        self._phase = -1
        self._phase_ends: dict[int, int] = {}
        self._last: tick_batch.TickBatch | None = None
        self._log_static()

    def record(self, batch: tick_batch.TickBatch) -> None:
        curves = self._curves or self.lay_out(batch.snapshot(0))
        if batch.phase[0] != self._phase:
            self._begin_phase(batch)
        curves.append(batch)
        for row, images in batch.images.items():
            for image in images:
                self._cameras.send(int(batch.tick[row]), image)
        self._last = batch
        self._phase_ends[self._phase] = int(batch.tick[-1])
        frames = (batch.tick * self._tick_ns / self._frame_ns).astype(np.int64)
        shown = (np.diff(frames, prepend=self._frame) != 0) | (batch.tick == self._stage.ticks)
        self._frame = int(frames[-1])
        self._draw(np.flatnonzero(shown))
        tick = int(batch.tick[-1])
        much = self._drawn >= self._frames_most or tick - self._written_tick >= _TICKS_GATHERED
        if much or time.perf_counter() >= self._due:
            self.flush()

    def _draw(self, rows: IntArray) -> None:
        """Add rows of the last batch to the buffered frames."""
        assert self._last is not None, "record() comes before"
        if len(rows):
            self._frames.append(self._last.some(rows))
            self._drawn += len(rows)
            self._drawn_tick = int(self._last.tick[rows[-1]])

    def mark_errors(self, phases: Mapping[int, dict[str, Any]]) -> None:
        for key, (entity, scale) in ERROR_BARS.items():
            bars = {self._phase_ends[phase]: found[key] for phase, found in sorted(phases.items())}
            known = {tick: scale * bar for tick, bar in bars.items() if bar is not None}
            if known and self._curves is not None:
                ticks, values = np.array(list(known)), np.array(list(known.values()))
                self._curves.mark(f"{entity}/error", "may be off by", ticks, values)

    def close(self, summary_markdown: str, status: str) -> None:
        if self._last is not None and self._last.tick[-1] != self._drawn_tick:
            self._draw(np.array([len(self._last) - 1]))
        text = f"{summary_markdown}\n\n{self._stage.report}"
        self._log_summary(text)
        self._stream.send_property("outcome", rr.AnyValues(status=status))
        self.flush()  # raises if the file cannot be written; closing the stream does not raise

    def end(self, path: Path) -> None:
        """Close the stream and its file.

        Rerun writes an index at the end of the file. If it cannot, it does not raise, and may not return. So
        it runs in another thread with a time limit, and then the end of the file is checked.

        Raises:
            RuntimeError: the index is missing.
        """
        ending = Thread(target=self._stream.disconnect, daemon=True)
        ending.start()
        ending.join(_ENDED_S)
        if ending.is_alive():
            rr.unregister_shutdown()  # it would wait at the end of the process
        if ending.is_alive() or not _has_end(path):
            raise RuntimeError("its end is missing")

    def _log_static(self) -> None:
        stage, stream = self._stage, self._stream
        stream.send_recording_name(f"{stage.scenario}: {stage.title}")
        parameters = rr.AnyValues(
            scenario=stage.scenario, mode=stage.mode, tick_s=stage.tick_s, ticks=stage.ticks
        )
        stream.send_property("run", parameters)
        stream.send_property("outcome", rr.AnyValues(status="running"))
        log_stress_legend(stream)
        log_rigid_meshes(stream, stage)
        names = list(stage.phase_names)
        colours = [(*colour, 255) for colour in series_colours(len(names))]
        phases = rr.StateConfiguration(values=names, labels=names, colors=colours)
        stream.log(_PHASE, phases, static=True)
        self._log_summary(f"# {stage.title}\n\nThe run has not ended yet.\n\n{stage.report}")

    def _log_summary(self, text: str) -> None:
        self._stream.log(_SUMMARY, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)

    def lay_out(self, first: Snapshot) -> PlotBuffer:
        """Write the layout and the static entities, which depend on the first shape; only the first time."""
        if self._curves is not None:
            return self._curves
        stage = self._stage
        plots = plots_of(stage, len(first.joint_position))
        names = [camera_paths(camera.name) for camera in stage.cameras]
        views = RunViews(plots, scene_eye(stage, first), close_eye(stage, first), names)
        if isinstance(self._to, ArmStream):
            self._to.show(views)
        else:
            self._to.send_blueprint(blueprint([views], live=self._viewer is not None))
        self._frames_most = max(1, _NODES_GATHERED // len(first.node_position))
        self._scene = Scene(self._stream, stage, first)
        self._curves = PlotBuffer(self._stream, plots, self._tick_ns)
        return self._curves

    def resume(self, first: Snapshot, last: Snapshot) -> None:
        """Write the layout for the first snapshot of the run, and continue from the last recorded one."""
        self.lay_out(first)
        assert self._scene is not None, "lay_out() has just made it"
        self._written_tick = last.tick
        self._scene.resume(last)
        self._frame = int(last.tick * self._tick_ns / self._frame_ns)

    def _begin_phase(self, batch: tick_batch.TickBatch) -> None:
        self._phase = int(batch.phase[0])
        name = self._stage.phase_names[self._phase]
        times = time_columns(batch.tick[:1], self._tick_ns)
        self._stream.send_columns(_PHASE, times, rr.StateChange.columns(state=[name]))

    def flush(self) -> None:
        if self._curves is not None:
            self._curves.flush()
        if self._scene is not None and self._frames:
            frames = tick_batch.TickBatch.joined(self._frames)
            self._scene.send(frames, time_columns(frames.tick, self._tick_ns))
            self._frames, self._drawn = [], 0
        self._flush_stream()
        self._written_tick = 0 if self._last is None else int(self._last.tick[-1])
        now = time.perf_counter()
        self._due = now + max(self._gathered_s, _GATHERED_FRACTION * (now - self._opened))

    def _flush_stream(self) -> None:
        """Write the buffer of the stream to the file and to the viewer."""
        try:
            self._stream.flush()
        except RuntimeError as error:
            # the user has closed the viewer; the file was written before
            if self._viewer is None or self._viewer not in str(error):
                raise
