"""Cost and curves of a candidate's run. The speed is simulated time over CPU time, of the loop with its
recording and of the whole command; wall time would depend on other work of the machine. The flange force is
averaged over time, as its values at single ticks do not converge with the tick.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, final
from uuid import uuid4

import numpy as np

from cosim.app.run_files import RECORDING
from cosim.base.frames import Array
from cosim.config.schema.settings import RecordingTable
from cosim.recording.recorder import RecordingPart
from cosim.recording.rerun_recorder import RerunRecorder
from cosim.sweeps.trade_results import FORCE_WINDOW_S
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch

SAMPLE_S: Final = 0.02
STRETCH_S: Final = 0.2
"""Simulated time over which a run must not be slower than its bound."""
_COLUMNS: Final = "time_s", "tip_position", "flange_force", "contact_force_N", "phase", "newton_iterations"


@final
@dataclass
class Tracer:
    """Observes a candidate's run: measures its cost and gathers the curves that are compared.

    Args:
        slowest: real-time factor below which the run is stopped; 0: none.
        movable: names of the objects that can move.
        recording: settings of the recording, which is deleted after the run.
    """

    slowest: float
    movable: tuple[str, ...]
    recording: RecordingTable

    def open(self, stage: RunInfo) -> None:
        """Start the clock, after the state at rest is known."""
        self._stage, self._batches = stage, list[tuple[Array, ...]]()
        self._bodies = [k for k, name in enumerate(stage.body_names) if name in self.movable]
        self._folder = TemporaryDirectory()
        path = Path(self._folder.name) / RECORDING
        part, frames_per_s = RecordingPart(uuid4().hex), self.recording.frames_per_s
        self._recorder = RerunRecorder(path, frames_per_s=frames_per_s, part=part)
        self._recorder.open(stage)
        self._began = self._stretch_began = time.process_time()
        self._stretch_from_s = self._cpu_s = 0.0

    def observe(self, batch: TickBatch) -> None:
        """Record and gather some ticks."""
        self._recorder.record(batch)
        columns = (getattr(batch, name) for name in _COLUMNS)
        self._batches.append((batch.body_position[:, self._bodies], *columns))

    def stop(self) -> str | None:
        """Return a text with the time at which the run was slower than its bound; None if it was not."""
        phase, time_s = (self._batches[-1][k][-1] for k in (5, 1))
        now, stretch_s = time.process_time(), time_s - self._stretch_from_s
        if self.slowest * (now - self._stretch_began) > max(stretch_s, STRETCH_S):
            where = f"{time_s:.2f} s, in '{self._stage.phase_names[phase]}'"
            return f"slower than x{self.slowest:g} real time at {where}"
        if stretch_s >= STRETCH_S:
            self._stretch_from_s, self._stretch_began = time_s, now
        return None

    def close(self) -> None:
        """Stop the clock, after the recording is written."""
        self._recorder.close("", "completed")
        self._cpu_s = time.process_time() - self._began
        self._folder.cleanup()

    def figures(self, command_cpu_s: float) -> dict[str, Any]:
        """Return both speeds, Newton iterations a tick, and the curves at common times; see `sampled`."""
        objects, time_s, tip, force, contact, phase, iterations = map(
            np.concatenate, zip(*self._batches, strict=True)
        )
        last = len(phase) - 1
        ends = [k for k in range(1, last + 1) if k == last or phase[k + 1] != phase[k]]
        curves = {"tip_m": tip, "contact_N": contact, **({"objects_m": objects} if self._bodies else {})}
        compared = {**sampled(time_s, curves, force), "end_tip_m": tip[ends]}
        return {
            "real_time_factor": float(time_s[-1]) / command_cpu_s,
            "loop_factor": float(time_s[-1]) / self._cpu_s,
            "iterations": int(iterations[1:].sum()) / max(1, last),
            "curves": {name: values.tolist() for name, values in compared.items()},
        }


def sampled(time_s: Array, curves: Mapping[str, Array], force: Array) -> dict[str, Array]:
    """Return curves every 20 ms, linear between ticks, and as `force_N` the force's mean over 40 ms.

    The window is centred on each time, shifted into the run at its ends, and cut to the length of the run.

    Args:
        time_s: (k,).
        curves: (k, ...) each.
        force: (k, 3) [N].
    """
    last_s = float(time_s[-1])
    times = np.arange(0.0, last_s + 0.5 * SAMPLE_S, SAMPLE_S)
    window_s = min(FORCE_WINDOW_S, last_s)
    begin_s = np.clip(times - 0.5 * window_s, 0.0, last_s - window_s)
    samples = {name: _at(times, time_s, values) for name, values in curves.items()}
    # the force is linear between ticks, so a window may begin and end between them
    all_s = np.unique(np.concatenate([time_s, begin_s, begin_s + window_s]))
    fine = _at(all_s, time_s, force)
    each = 0.5 * (fine[1:] + fine[:-1]) * np.diff(all_s)[:, None]
    impulse = np.concatenate([np.zeros((1, 3)), np.cumsum(each, axis=0)])
    ends = impulse[np.searchsorted(all_s, begin_s + window_s)] - impulse[np.searchsorted(all_s, begin_s)]
    return {**samples, "force_N": ends / window_s}


def _at(times: Array, time_s: Array, values: Array) -> Array:
    columns = [np.interp(times, time_s, column) for column in values.reshape(len(values), -1).T]
    return np.array(columns).T.reshape(len(times), *values.shape[1:])
