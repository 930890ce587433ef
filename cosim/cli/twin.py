"""`cosim twin`: follows a robot, and shows what is predicted of the soft robot meanwhile."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final
from uuid import uuid4

import numpy as np

from cosim.app.driver import rerun_recorder
from cosim.app.run_files import RECORDING
from cosim.app.twin import Followed, Prediction, Twin
from cosim.cli.screen import Interruption, draw, tell
from cosim.config.schema.scenario import RecordingTable
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.cli.viewing import LiveView

_REDRAW_S: Final = 0.2
_RETOLD_S: Final = 1.0


def twin_command(
    simulation: Followed,
    streams: Sequence[str],
    settings: RecordingTable,
    out: Path | None,
    live: LiveView | None,
) -> int:
    """Follow a robot until its streams end, or Ctrl-C; return the exit code.

    Args:
        simulation: that follows.
        streams: see `open_stream`.
        settings: of a recording.
        out: file of the recording; None: none.
        live: shows what is predicted; None: the line on the screen alone.

    Raises:
        InputError: a stream is wrong.
        SolverError: the physics could not be solved.
    """
    with ExitStack() as stack, Interruption() as interruption:
        twin = stack.enter_context(Twin(simulation, streams))
        show: list[Callable[[Prediction], None]] = [_line()]
        if live is not None or out is not None:
            path = out or Path(stack.enter_context(TemporaryDirectory())) / RECORDING
            make = rerun_recorder if live is None else live.recorder
            recorder = make(path, settings, RecordingPart(uuid4().hex))
            recorder.open(simulation.stage)
            stack.callback(lambda: recorder.close(repr(twin), "completed"))
            show.append(_recorded(recorder))
        interruption.open(simulation.stage)
        try:
            for prediction in twin:
                for each in show:
                    each(prediction)
                if interruption.reason() is not None:
                    break
        finally:
            draw("\n" * sys.stderr.isatty(), sys.stderr)
            tell(repr(twin))
    return 0


def _recorded(recorder: Recorder) -> Callable[[Prediction], None]:
    return lambda prediction: recorder.record(TickBatch.of([prediction.snapshot]))


def prediction_line(seen: Prediction) -> str:
    """Return the line on the screen: time of the robot, tip, sag, wrench on the flange, latency."""
    snapshot = seen.snapshot
    tip = ", ".join(f"{1e3 * value:.1f}" for value in snapshot.tip_position)
    wrench = snapshot.ledger.wrench
    force, torque = np.linalg.norm(wrench.force), np.linalg.norm(wrench.torque)
    return (
        f"{seen.time_s:.2f} s  tip ({tip}) mm  sag {1e3 * snapshot.sag_m:.1f} mm  flange {force:.2f} N "
        f"{torque:.3f} N m  latency {1e3 * seen.latency_s:.1f} ms"
    )


def _line() -> Callable[[Prediction], None]:
    """Return what draws the line, again and again on a terminal, once a second elsewhere."""
    terminal = sys.stderr.isatty()
    start, end, every_s = ("\r\x1b[K", "", _REDRAW_S) if terminal else ("", "\n", _RETOLD_S)
    shown = [0.0]

    def show(prediction: Prediction) -> None:
        now = time.perf_counter()
        if now - shown[0] >= every_s:
            shown[0] = now
            draw(f"{start}{prediction_line(prediction)}{end}", sys.stderr)

    return show
