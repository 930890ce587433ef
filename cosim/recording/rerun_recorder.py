"""Writes a run as a Rerun recording.

One recording of several arms: each writes as if it were alone, below its own name.
"""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any, Final, cast, final

import numpy as np
import rerun as rr

from cosim.base.frames import IntArray
from cosim.errors import InputError, OutputError
from cosim.recording.blueprint import TICKS, TIMELINE, RunViews, blueprint, path_of_arm
from cosim.recording.colours import series_colours
from cosim.recording.columns import time_columns
from cosim.recording.eyes import close_eye, scene_eye
from cosim.recording.plot_buffer import PlotBuffer
from cosim.recording.plots import ERROR_BARS, plots_of
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.recording.rigid_meshes import log_rigid_meshes
from cosim.recording.scene import Scene
from cosim.recording.stress_legend import log_stress_legend
from cosim.telemetry import cameras, tick_batch
from cosim.telemetry.snapshot import CameraImage, RunInfo, Snapshot

_JPEG: Final = 90
_DRAWN_AT_M: Final = 0.15
"""Distance from a camera at which its picture is drawn: there ends what is drawn of its field of view."""
_RIGID = "/world/rigid/"
APPLICATION_ID: Final = "cosim"
FRAMES_PER_S: Final = 60.0
_SECOND_NS: Final = 1_000_000_000
_GATHERED_S: Final = 1.0
"""Wall time after which what was gathered is written: each time takes some ms, and 50 kB of the file."""
_SHOWN_S: Final = 0.25
"""The same with a viewer that follows the run."""
_GATHERED_SHARE: Final = 0.01
"""Share of the wall time so far, before which nothing is written: long runs must not end in splinters."""
_NODES_GATHERED: Final = 500_000
"""Nodes in all frames gathered, from which on they are written before: a bound of the memory, some 50 MB."""
_TICKS_GATHERED: Final = 50_000
"""The same of ticks, some 15 MB of curves."""
_ENDED_S: Final = 20.0
"""Wall time that ending a file may take, far more than it does."""
_END: Final = b"RRF2FOOT"  # within the last 64 bytes of a whole file
_PHASE: Final = "/phase"
_SUMMARY: Final = "/summary"


def camera_paths(name: str) -> tuple[str, str, str]:
    """Return the entities of a camera's colours, depths and segments; the first is below its place."""
    part = rr.escape_entity_path_part(name)
    return f"/world/cameras/{part}/rgb", f"/cameras/{part}/depth", f"/cameras/{part}/segments"


@final
class CameraViews:
    """Writes the pictures of cameras.

    Args:
        stream: to write to.
        stage: what is run.
        tick_ns: length of a tick [ns].
    """

    def __init__(self, stream: rr.RecordingStream, stage: RunInfo, tick_ns: int) -> None:
        self._stream, self._tick_ns = stream, tick_ns
        names = list(cameras.segment_names(stage.body_names).items())
        for camera in stage.cameras:
            rgb, _, segments = camera_paths(camera.name)
            width, height = camera.size
            pinhole = rr.Pinhole(
                focal_length=camera.focal_length, width=width, height=height,
                camera_xyz=rr.ViewCoordinates.RUB, image_plane_distance=_DRAWN_AT_M,
            )  # fmt: skip
            stream.log(rgb.removesuffix("/rgb"), pinhole, static=True)
            stream.log(segments, rr.AnnotationContext(names), static=True)

    def send(self, tick: int, image: CameraImage) -> None:
        """Write a picture that was taken after a tick."""
        stream, (rgb, depth, segments) = self._stream, camera_paths(image.camera)
        stream.set_time(TIMELINE, duration=np.timedelta64(tick * self._tick_ns, "ns"))
        stream.set_time(TICKS, sequence=tick)
        placed = rr.Transform3D(translation=image.position, mat3x3=image.rotation)
        stream.log(rgb.removesuffix("/rgb"), placed)
        stream.log(rgb, rr.Image(image.rgb).compress(jpeg_quality=_JPEG))
        stream.log(depth, rr.DepthImage(np.where(np.isfinite(image.depth_m), image.depth_m, 0.0), meter=1.0))
        stream.log(segments, rr.SegmentationImage(image.segments.astype(np.uint16)))
        stream.reset_time()


@final
class ArmsStream:
    """The stream of all arms.

    Args:
        stream: to write to.
        arms: their names; the first one writes what all share: bodies, name and properties of the recording.
        live: whether a viewer follows.
    """

    def __init__(self, stream: rr.RecordingStream, arms: Sequence[str], *, live: bool) -> None:
        self.stream, self._live = stream, live
        self._views: dict[str, RunViews | None] = dict.fromkeys(arms)
        self._open = set(arms)

    def of(self, arm: str) -> "ArmStream":
        """Return the stream of one arm."""
        return ArmStream(self, arm, shared=arm == next(iter(self._views)))

    def show(self, views: RunViews) -> None:
        """Lay the recording out, once the views of all arms are known."""
        self._views[views.arm] = views
        known = [each for each in self._views.values() if each is not None]
        if len(known) == len(self._views):
            self.stream.send_blueprint(blueprint(known, live=self._live))

    def leave(self, arm: str) -> bool:
        """Let an arm write no more; return whether it was the last one."""
        self._open.discard(arm)
        return not self._open


@final
class ArmStream:
    """What one arm writes to, in place of a `rr.RecordingStream`.

    Args:
        group: of all arms.
        arm: its name.
        shared: whether it writes what all share.
    """

    def __init__(self, group: ArmsStream, arm: str, *, shared: bool) -> None:
        self._group, self._arm, self._shared = group, arm, shared

    def log(self, path: str, entity: Any, **options: Any) -> None:
        """Log an entity of the arm."""
        if self._shared or not path.startswith(_RIGID):
            self._group.stream.log(path_of_arm(self._arm, path), entity, **options)

    def send_columns(self, path: str, *columns: Any) -> None:
        """Write columns of an entity of the arm."""
        if self._shared or not path.startswith(_RIGID):
            self._group.stream.send_columns(path_of_arm(self._arm, path), *columns)

    def send_recording_name(self, name: str) -> None:
        """Name the recording."""
        if self._shared:
            self._group.stream.send_recording_name(name.removesuffix(f": {self._arm}"))

    def send_property(self, name: str, values: Any) -> None:
        """Write a property of the recording."""
        if self._shared:
            self._group.stream.send_property(name, values)

    def show(self, views: RunViews) -> None:
        """Lay out the views of the arm."""
        self._group.show(replace(views, arm=self._arm))

    def leave(self) -> bool:
        """Write no more; return whether no arm does."""
        return self._group.leave(self._arm)

    def flush(self) -> None:
        """Bring all to the file."""
        self._group.stream.flush()

    def disconnect(self) -> None:
        """End the file."""
        self._group.stream.disconnect()


@final
class RerunRecorder(Recorder):
    """Writes one file: curves at every tick, the scene at a limited frame rate.

    What was gathered in memory is written once a second (of wall time), later on after a hundredth of the
    time so far, and before it gets large: a process that is killed loses little more.

    Args:
        path: of the file; missing folders are made, an old file is replaced.
        frames_per_s: frames of the scene per simulated second.
        part: of the run, so that its recordings open as one; None for a recording that stands alone.
        viewer: address of a viewer that is shown the run at once; None for the file alone. A viewer that is
            closed meanwhile ends nothing.

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
            self._run.go_on(*part.before)

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
        group, found = ArmsStream(self._stream(), names, live=self._viewer is not None), {}
        for name in names:
            found[name] = one = copy(self)
            one._shared = group.of(name)
        return found

    def lay_out(self, first: Snapshot) -> None:
        """Lay out the views; see `Recorder.lay_out`."""
        if self._run is not None:
            self._run.lay_out(first)

    def record(self, batch: tick_batch.TickBatch) -> None:
        """Take in some ticks; see `Recorder.record`.

        Raises:
            RuntimeError: the recorder is not open.
        """
        if self._run is None:
            raise RuntimeError("the recorder is not open: call open(stage) before record(batch)")
        with _named(self._path):
            self._run.record(batch)

    def mark_errors(self, phases: Mapping[int, dict[str, Any]]) -> None:
        """Show them beside their figures; does nothing if it is not open. See `Recorder.mark_errors`."""
        if self._run is not None:
            with _named(self._path):
                self._run.mark_errors(phases)

    def flush(self) -> None:
        """Write what was gathered so far; does nothing if it is not open. See `Recorder.flush`."""
        if self._run is not None:
            with _named(self._path):
                self._run.flush()

    def close(self, summary_markdown: str, status: str) -> None:
        """Write what is left and end the file; does nothing if it is not open. See `Recorder.close`."""
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
    """Turn Rerun's word for a file that cannot be written into an error that names it."""
    try:
        yield
    except RuntimeError as error:
        raise OutputError(
            f"{path}: cannot be written, for want of room or of its directory: {error}"
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
        """Keep rows of the last ticks as frames."""
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
        self.flush()  # says what cannot be written, as ending the file does not

    def end(self, path: Path) -> None:
        """End the stream and its file.

        Rerun writes an index as the file's end, and neither raises nor always returns where it cannot: it is
        waited for in another thread, for a while, and the end is looked at.

        Raises:
            RuntimeError: the file has no end.
        """
        ending = Thread(target=self._stream.disconnect, daemon=True)
        ending.start()
        ending.join(_ENDED_S)
        if ending.is_alive():
            rr.unregister_shutdown()  # which would wait for it at the end of the process
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
        """Lay out the views and draw what stands still, unless that is done: both need the first shape."""
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

    def go_on(self, first: Snapshot, last: Snapshot) -> None:
        """Lay out the views as for the first snapshot of the run, and continue from the last one recorded."""
        self.lay_out(first)
        assert self._scene is not None, "lay_out() has just made it"
        self._written_tick = last.tick
        self._scene.go_on(last)
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
        self._due = now + max(self._gathered_s, _GATHERED_SHARE * (now - self._opened))

    def _flush_stream(self) -> None:
        """Bring to the file, and to the viewer, what the stream holds."""
        try:
            self._stream.flush()
        except RuntimeError as error:
            # the file comes first and is written then; the viewer has been closed, which is its user's right
            if self._viewer is None or self._viewer not in str(error):
                raise
