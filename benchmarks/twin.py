"""Follows a simulated UR for a minute of wall time: readings lost, and latency from sending to prediction.

    python benchmarks/twin.py [--fidelity section] [--tick 0.004] [--seconds 60] [--viewer]

Another process plays the planned motion of light_hexagon_arm forth and back, 125 times a second by RTDE, and
sends pressures of 20 to 30 kPa 25 times a second as lines of JSON. It notes when it sends a reading; the
latency is from then on.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import multiprocessing
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

import cosim
from cosim.app.driver import rerun_recorder
from cosim.base.frames import Array
from cosim.recording.recorder import RecordingPart
from cosim.telemetry.tick_batch import TickBatch

_SCENARIO: Final = "light_hexagon_arm"
_PEER: Final = Path(__file__).resolve().parents[1] / "docs" / "rtde_peer.py"
_START_Pa: Final = 25e3
_SETTLED_s: Final = 3.0
"""Of the begin, in which the simulation catches up with what was sent while it went to the first reading."""


def peer(ends: Connection, joints: Array, pressure_Pa: Array) -> None:
    """Play rows to one program, and return when each was sent."""
    spec = importlib.util.spec_from_file_location("rtde_peer", _PEER)
    assert spec is not None and spec.loader is not None, _PEER  # noqa: PT018
    played = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(played)
    with socket.create_server(("127.0.0.1", 0)) as rtde, socket.create_server(("127.0.0.1", 0)) as told:
        ends.send((rtde.getsockname()[1], told.getsockname()[1]))
        line, _ = told.accept()
        robot, _ = rtde.accept()
        with line, robot:
            robot.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            played.answer(robot)
            sent, began = [], time.monotonic()
            for k, (row, pressure) in enumerate(zip(joints.tolist(), pressure_Pa.tolist(), strict=True)):
                time.sleep(max(began + k / played.RATE_Hz - time.monotonic(), 0.0))
                if k % 5 == 0:
                    line.sendall(json.dumps({"pressure_Pa": {"chamber": pressure}}).encode() + b"\n")
                robot.sendall(played.package(ord("U"), struct.pack(">B7d", 1, k / played.RATE_Hz, *row)))
                sent.append(time.monotonic())
    ends.send(sent)


def motion(seconds: float) -> tuple[Array, Array]:
    """Return joints (n, 6) of the planned motion, forth and back, and pressures (n,) [Pa]."""
    joints = cosim.plan_path(_SCENARIO, whole=True, rate_Hz=125.0).joints
    rows = np.resize(np.concatenate([joints, joints[::-1]]), (round(125.0 * seconds), 6))
    return rows, _START_Pa + 5e3 * np.sin(0.2 * np.pi * np.arange(len(rows)) / 125.0)


@contextmanager
def recorder(simulation: cosim.Simulation, viewer: bool) -> Iterator[Any]:
    """Give what records a prediction, or does nothing with it."""
    if not viewer:
        yield lambda _: None
        return
    with TemporaryDirectory() as folder:
        made = rerun_recorder(Path(folder) / "twin.rrd", simulation.scenario.recording, RecordingPart("twin"))
        made.open(simulation.stage)
        yield lambda seen: made.record(TickBatch.of([seen.snapshot]))
        made.close("", "completed")


def main() -> None:
    """Play, follow, and print what was lost and how late predictions were."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--fidelity", default="section", choices=("section", "lumped"))
    parser.add_argument("--tick", type=float, default=0.004)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--viewer", action="store_true", help="record as well, as with --live")
    options = parser.parse_args()
    joints, pressure_Pa = motion(options.seconds)
    given = {"fidelity": options.fidelity, "clock.tick_s": options.tick, "contact.enabled": False}
    given["start.pressure_Pa"] = _START_Pa
    simulation = cosim.Simulation(_SCENARIO, overrides={**given, "phase": []})
    ours, theirs = multiprocessing.Pipe()
    playing = multiprocessing.get_context("spawn").Process(target=peer, args=(theirs, joints, pressure_Pa))
    playing.start()
    rtde, told = ours.recv()
    there = {}
    with ExitStack() as stack:
        names = [f"tcp:127.0.0.1:{told}", f"rtde:127.0.0.1:{rtde}"]
        twin = stack.enter_context(cosim.Twin(simulation, names))
        record = stack.enter_context(recorder(simulation, options.viewer))
        began = time.process_time()
        for seen in twin:
            there[round(125.0 * seen.time_s)] = time.monotonic()
            record(seen)
    spent = time.process_time() - began
    sent = ours.recv()
    playing.join()
    late = 1e3 * np.array([at - sent[k] for k, at in there.items() if k > 125.0 * _SETTLED_s])
    lost = len(sent) - 1 - len(there)
    figures = "median {:.1f} ms, 99 % within {:.1f} ms, largest {:.1f} ms".format(
        *np.percentile(late, [50.0, 99.0, 100.0])
    )
    print(f"{options.fidelity}, ticks of {1e3 * options.tick:g} ms: {len(sent)} readings sent, {lost} lost")
    print(f"  latency {figures}; {spent / options.seconds:.0%} of a core")
    print(f"  {twin!r}")


if __name__ == "__main__":
    main()
