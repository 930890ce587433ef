"""The command `cosim twin`: predicts the soft robot while a real robot moves, and shows the predictions on a
line of the terminal, in a viewer or in a recording.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final
from uuid import uuid4

import numpy as np

from cosim.app import driver, run_files
from cosim.cli.interruption import Interruption
from cosim.cli.screen import draw, tell
from cosim.config.schema.settings import RecordingTable
from cosim.recording.recorder import Recorder, RecordingPart

if TYPE_CHECKING:
    from cosim.app.twin import Followed, Prediction
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
    """Predict along a robot's streams until they end, or until Ctrl-C; return the exit code.

    Args:
        simulation: of the soft robot.
        streams: addresses of the measured joints, see `open_stream`.
        settings: of the recording.
        out: file of the recording; None for none.
        live: viewer of the predictions; None for the line on the terminal alone.

    Raises:
        InputError: a stream is wrong.
        SolverError: the physics could not be solved.
    """
    from cosim.app.twin import Twin  # here: other commands do not need it

    with ExitStack() as stack, Interruption() as interruption:
        twin = stack.enter_context(Twin(simulation, streams))
        show: list[Callable[[Prediction], None]] = [_line()]
        if live is not None or out is not None:
            path = out or Path(stack.enter_context(TemporaryDirectory())) / run_files.RECORDING
            make = driver.rerun_recorder if live is None else live.recorder
            recorder = make(path, settings, RecordingPart(uuid4().hex))
            recorder.open(simulation.stage)
            stack.callback(lambda: recorder.close(repr(twin), "completed"))
            show.append(_recorded(recorder))
        interruption.open(simulation.stage)
        noted: frozenset[str] = frozenset()
        try:
            for prediction in twin:
                noted = _tell_new(twin.notes, noted)
                for each in show:
                    each(prediction)
                if interruption.reason() is not None:
                    break
        finally:
            draw("\n" * sys.stderr.isatty(), sys.stderr)
            tell(repr(twin))
    return 0


def _tell_new(notes: Mapping[str, int], noted: frozenset[str]) -> frozenset[str]:
    """Print the notes that are new, and return all notes so far."""
    for text in notes.keys() - noted:
        tell(f"twin: {text}")
    return frozenset(notes)


def _recorded(recorder: Recorder) -> Callable[[Prediction], None]:
    return lambda prediction: recorder.record(prediction.snapshot.table)


def prediction_line(seen: Prediction) -> str:
    """Return the line on the terminal: time of the robot, tip, sag, wrench on the flange, latency."""
    snapshot = seen.snapshot
    tip = ", ".join(f"{1e3 * value:.1f}" for value in snapshot.tip_position)
    wrench = snapshot.flange_wrench
    force, torque = np.linalg.norm(wrench.force), np.linalg.norm(wrench.torque)
    return (
        f"{seen.time_s:.2f} s  tip ({tip}) mm  sag {1e3 * snapshot.sag_m:.1f} mm  flange {force:.2f} N "
        f"{torque:.3f} N m  latency {1e3 * seen.latency_s:.1f} ms"
    )


def _line() -> Callable[[Prediction], None]:
    """Return a function that redraws the line of a terminal, or prints a line each second without one."""
    terminal = sys.stderr.isatty()
    start, end, every_s = ("\r\x1b[K", "", _REDRAW_S) if terminal else ("", "\n", _RETOLD_S)
    shown = [0.0]

    def show(prediction: Prediction) -> None:
        now = time.perf_counter()
        if now - shown[0] >= every_s:
            shown[0] = now
            draw(f"{start}{prediction_line(prediction)}{end}", sys.stderr)

    return show
