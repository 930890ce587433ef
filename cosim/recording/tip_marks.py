"""Draws the path of the tip, and the target of the tip as a cross."""

from collections.abc import Sequence
from typing import Final, final

import numpy as np
import rerun as rr
from rerun import components

from cosim.base.frames import Array, IntArray
from cosim.recording import colours
from cosim.recording.columns import column
from cosim.recording.entity_paths import TIP_PATH
from cosim.recording.lines import send_lines, style_lines
from cosim.telemetry.tick_batch import TickBatch

_TARGET: Final = "/world/target"
_CROSS_M: Final = 0.06
_CROSS_RADIUS_M: Final = 1.3e-3
_PATH_RADIUS_M: Final = 8e-4


@final
class TipMarks:
    """Draws the path as one step per frame, which the viewer joins, and the target as a cross.

    Args:
        stream: to write to.
        start: (3,) [m], tip before the first frame.
    """

    def __init__(self, stream: rr.RecordingStream, start: Array) -> None:
        self._stream = stream
        self._tip = start
        style_lines(stream, TIP_PATH, _PATH_RADIUS_M, colours.PINK)
        style_lines(stream, _TARGET, _CROSS_RADIUS_M, colours.GREEN)
        label = rr.Points3D.from_fields(colors=[colours.GREEN], radii=[1e-4], labels=["target"])
        stream.log(f"{_TARGET}/label", label, static=True)

    def send(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> None:
        """Write frames; `times` has as many rows."""
        tips = np.concatenate([self._tip[None], frames.tip_position])
        self._tip = tips[-1]
        steps = np.stack([tips[:-1], tips[1:]], axis=1)
        ones = np.ones(len(frames), dtype=np.int64)
        send_lines(self._stream, TIP_PATH, times, steps.reshape(-1, 3), 2 * ones, ones)
        given = frames.has_tip_target
        target, tip = frames.tip_target[given], frames.tip_position[given]
        # a free component of the target is NaN; it is drawn at the tip
        self._send_targets(np.where(np.isnan(target), tip, target), given.astype(np.int64), times)

    def _send_targets(self, targets: Array, rows: IntArray, times: Sequence[rr.TimeColumn]) -> None:
        """Write targets (m, 3) [m], so many in each row."""
        arms = 0.5 * _CROSS_M * np.stack([-np.eye(3), np.eye(3)], axis=1)
        points = (targets[:, None, None] + arms).reshape(-1, 3)
        send_lines(self._stream, _TARGET, times, points, np.full(3 * len(targets), 2), 3 * rows)
        below = components.Position3DBatch(targets - (0.0, 0.0, 0.5 * _CROSS_M))
        columns = [column(rr.Points3D, "positions", below, rows)]
        self._stream.send_columns(f"{_TARGET}/label", times, columns)
