"""A view of a run: the speed of the tip, as its own recording."""

from __future__ import annotations

from typing import final

import numpy as np
import rerun as rr

from cosim.base.frames import Array
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch


@final
class TipSpeed:
    """Records how fast the tip moves while a run lasts.

    Args:
        file: of the recording.
    """

    def __init__(self, file: str) -> None:
        self._file, self._stream = file, rr.RecordingStream("tip_speed")
        self._times: Array = np.zeros(0)  # the last one of the batch before
        self._places: Array = np.zeros((0, 3))

    def open(self, stage: RunInfo) -> None:
        """Begin the recording; `stage` is what does not change during the run, such as names."""
        self._stream.save(self._file)

    def observe(self, batch: TickBatch) -> None:
        """Record some ticks of one phase: every field of a batch has a row for each."""
        times = np.concatenate([self._times, batch.time_s])
        places = np.concatenate([self._places, batch.tip_position])
        if len(times) > 1:
            speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
            index = rr.TimeColumn("sim_time", duration=times[1:])
            self._stream.send_columns("tip/speed_m_s", [index], rr.Scalars.columns(scalars=speeds))
        self._times, self._places = times[-1:], places[-1:]

    def close(self) -> None:
        """End it, however the run has ended."""
        self._stream.flush()
        self._stream.disconnect()
