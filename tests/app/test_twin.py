"""A twin follows what a simulated robot sends: joints by RTDE, pressures by a serial line, lines of JSON."""

from __future__ import annotations

import importlib.util
import json
import os
import pty
import socket
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.app.twin import APPROACH_s, GAP_s
from cosim.build import section_models
from cosim.cli.main import main
from cosim.devices.live import streams
from cosim.errors import InputError
from tests.small_section import on_a_ur5e, section

PEER = Path(__file__).resolve().parents[2] / "docs" / "rtde_peer.py"
HOME = np.array([-0.4, -1.6, 1.7, -1.7, -1.57, 0.0])
COUNT = 250  # 2 s at 125 Hz


@pytest.fixture(autouse=True)
def scenario(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)
    file = tmp_path / "small.toml"
    text = on_a_ur5e(20e3, "[contact]\nenabled = false\n[clock]\ntick_s = 0.002\n")
    file.write_text(text, encoding="utf-8")
    return str(file)


def simulated(scenario: str) -> cosim.Simulation:
    return cosim.Simulation(scenario, overrides={"phase": []})


def joints_at(time_s: float) -> list[float]:
    return [*(HOME + 0.05 * np.sin(2.0 * time_s))]


def peer() -> Any:
    spec = importlib.util.spec_from_file_location("rtde_peer", PEER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def controller(rows: list[list[float]]) -> Iterator[str]:
    """Answer one program as a UR's controller does, as fast as it reads; give the stream's name."""
    played = peer()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(played.package(ord("M"), b"a text in between"))
                played.answer(connection)
                connection.sendall(played.package(ord("M"), b""))  # of three bytes, the fewest
                played.play(connection, rows, paced=False)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"rtde:127.0.0.1:{server.getsockname()[1]}"
        thread.join(10.0)


def lines(path: Path, readings: list[dict[str, Any]]) -> str:
    path.write_text("".join(json.dumps(one) + "\n" for one in readings), encoding="utf-8")
    return f"file:{path}"


def test_every_reading_of_a_ur_is_followed_at_its_time(scenario: str) -> None:
    rows = [joints_at(k / 125.0) for k in range(COUNT)]
    with controller(rows) as name, cosim.Twin(simulated(scenario), [name]) as twin:
        found = list(twin)
    assert [one.time_s for one in found] == [k / 125.0 for k in range(1, COUNT)]  # the first is gone to
    assert (twin.followed, twin.gaps) == (COUNT - 1, 0)
    first = round(APPROACH_s / 0.002)
    ticks = [one.snapshot.tick for one in found]
    assert ticks == [first + 4 * k for k in range(1, COUNT)]  # 8 ms each
    targets = np.array([one.snapshot.joint_target for one in found])
    # the target of a tick is that of its begin: 2 ms before the reading
    np.testing.assert_allclose(targets, [joints_at(k / 125.0 - 0.002) for k in range(1, COUNT)], atol=2e-6)
    reached = np.array([one.snapshot.joint_position for one in found])
    np.testing.assert_allclose(reached[30:], rows[31:], atol=2e-3)
    assert "249 readings followed, 0 gaps" in repr(twin)


def test_a_twin_predicts_what_the_same_commands_do(scenario: str, tmp_path: Path) -> None:
    readings = [{"time_s": 5.0 + k / 50.0, "joint_position": joints_at(k / 50.0)} for k in range(20)]
    readings[7]["pressure_Pa"] = {"chamber": 15e3}
    readings.insert(12, {"cable_tension_N": {"right": 1.0}})
    with cosim.Twin(simulated(scenario), [lines(tmp_path / "told.jsonl", readings)]) as twin:
        found = list(twin)
    here = simulated(scenario)
    here.step(cosim.Command(joint_position=joints_at(0.0)), ticks=round(APPROACH_s / 0.002))
    for k in range(1, 20):
        pressure = {"chamber": 15e3} if k >= 7 else {}
        tension = {"right": 1.0} if k >= 12 else {}
        asked = cosim.Command(
            joint_position=joints_at(k / 50.0), pressure_Pa=pressure, cable_tension_N=tension
        )
        here.step(asked, ticks=10)
        np.testing.assert_array_equal(found[k - 1].snapshot.tip_position, here.snapshot.tip_position)
        wrench = found[k - 1].snapshot.wrench
        np.testing.assert_array_equal(wrench.force, here.snapshot.wrench.force)
    assert here.snapshot.chamber_pressure_Pa[0] == 15e3


def test_times_between_ticks_and_jumps_of_the_clock(scenario: str, tmp_path: Path) -> None:
    times = [0.0, 0.003, 0.006, 0.0065, 40.0, 40.002, 1.0, 1.004]
    readings = [{"time_s": each, "joint_position": [*HOME]} for each in times]
    with cosim.Twin(simulated(scenario), [lines(tmp_path / "told.jsonl", readings)]) as twin:
        ticks = [one.snapshot.tick for one in twin]
    gap = round(GAP_s / 0.002)
    assert np.diff([round(APPROACH_s / 0.002), *ticks]).tolist() == [1, 2, 0, gap, 1, gap, 2]
    assert twin.gaps == 2


def test_pressures_come_from_a_serial_line(scenario: str) -> None:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    stream = streams.open_stream(f"file:{os.ttyname(theirs)}")
    os.write(ours, b'ure_Pa": {"chamber": 1}}\n{"pressure_Pa": {"chamber": 16000.0}}\n{"time_s": 1.0}\n')
    both = streams.Streams()
    both.add(stream)
    first, second = both.next(5.0), both.next(5.0)
    assert first is not None
    assert second is not None
    assert (first.pressure_Pa, first.time_s, second.time_s) == ({"chamber": 16e3}, None, 1.0)
    assert both.next(0.0) is None
    both.close()
    os.close(ours)
    os.close(theirs)


def test_the_command_shows_what_it_predicts(
    scenario: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    readings = [{"time_s": 0.02 * k, "joint_position": joints_at(0.02 * k)} for k in range(5)]
    record = tmp_path / "seen.rrd"
    assert main(["twin", scenario, lines(tmp_path / "told.jsonl", readings), "--out", str(record)]) == 0
    said = capfd.readouterr().err
    assert "0.02 s  tip (" in said
    assert "mm  flange " in said
    assert "4 readings followed, 0 gaps" in said
    assert record.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"time_s": 0.0}\n{"times": 1}\n', "must be an object with the keys time_s, joint_position"),
        ('{"time_s": 0.0}\n{"time_s": "1"}\n', "time_s is '1'; must be a number"),
        ('{"time_s": 0.0}\n{"time_s": 0.1, "pressure_Pa": {"other": 1.0}}\n', "other"),
        ('{"time_s": 0.0}\n{"time_s": 0.1, "joint_position": [0.0]}\n', "joint_position"),
        ('{"pressure_Pa": {"chamber": 1.0}}\n', "no stream has sent a time_s"),
        ('{"time_s": 0.0, "presure_Pa": {"chamber": 1.0}}\n', "must be an object with the keys"),
        (
            '{"time_s": 0.0}\n{"time_s": 0.1, "pressure_Pa": 3e4}\n',
            "pressure_Pa is 30000.0; must be numbers by",
        ),
        ('{"time_s": 0.0}\n' + "[" * 100_000 + "\n", "line b"),
        ('{"time_s": 0.0}\n' + " " * 1_100_000, "a line is longer than 1000000 bytes; end every reading"),
        ('{"time_s": 0.0}\n{"time_s": ' + "1" * 400 + "}\n", "time_s is beyond the largest number"),
        (
            json.dumps({"time_s": 0.0, "joint_position": [*np.degrees(HOME)]}),
            r"of shoulder_pan_joint is -22.92 rad; its bounds are -6.283 to 6.283 rad: .* degrees",
        ),
    ],
)
def test_what_cannot_be_followed_is_refused(scenario: str, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "told.jsonl").write_text(text, encoding="utf-8")
    with (
        pytest.raises(InputError, match=said),
        cosim.Twin(simulated(scenario), [f"file:{tmp_path}/told.jsonl"]) as twin,
    ):
        list(twin)


TIMES = [{"time_s": 0.02 * k} for k in range(4)]
NAN = float("nan")


@pytest.mark.parametrize(
    ("readings", "end", "followed", "note"),
    [
        (TIMES, "", 3, ""),
        ([*TIMES, {"time_s": 0.08, "pressure_Pa": None}], "\n", 4, ""),
        ([*TIMES, "{"], "", 3, "the last 1 bytes are no whole reading"),
        (['me_s": 0.0}', *TIMES], "\n", 3, "the first line is not JSON"),
        ([*TIMES[:2], {"time_s": NAN}, *TIMES[2:]], "\n", 3, "time_s is not finite"),
        (
            [*TIMES, {"time_s": 0.08, "joint_position": [NAN] * 6}],
            "\n",
            4,
            "joint_position that is not finite",
        ),
        (
            [*TIMES, {"time_s": 0.08, "pressure_Pa": {"chamber": NAN}}],
            "\n",
            4,
            "of 'chamber' that is not finite",
        ),
        ([*TIMES, {"time_s": 0.08, "cable_tension_N": {"right": -0.01}}], "\n", 4, "lowest right: -0.01 N"),
    ],
)
def test_what_is_left_out_is_counted(
    scenario: str, tmp_path: Path, readings: list[Any], end: str, followed: int, note: str
) -> None:
    texts = [one if isinstance(one, str) else json.dumps(one) for one in readings]
    (tmp_path / "told.jsonl").write_text("\n".join(texts) + end, encoding="utf-8")
    simulation = simulated(scenario)
    with cosim.Twin(simulation, [f"file:{tmp_path}/told.jsonl"]) as twin:
        found = list(twin)
    assert (len(found), twin.followed, twin.gaps) == (followed, followed, 0)
    assert note in repr(twin)
    assert bool(twin.notes) == bool(note)
    np.testing.assert_array_equal(simulation.measure().cable_tension_N["right"], 0.0)


def test_readings_out_of_order_by_less_than_a_tick_are_sorted(scenario: str, tmp_path: Path) -> None:
    times = [0.0, 0.004, 0.0078, 0.0085, 0.012, 0.016]
    readings = [{"time_s": each, "joint_position": joints_at(each)} for each in times]
    swapped = [readings[k] for k in (0, 1, 3, 2, 4, 5)]
    ends = []
    for order in (readings, swapped):
        simulation = simulated(scenario)
        with cosim.Twin(simulation, [lines(tmp_path / "told.jsonl", order)]) as twin:
            assert [one.time_s for one in twin] == times[1:]
        assert twin.gaps == 0
        ends.append(simulation.snapshot)
    assert ends[0].tick == ends[1].tick
    np.testing.assert_array_equal(ends[0].tip_position, ends[1].tip_position)


def test_a_reading_that_arrives_late_does_not_undo_a_newer_one(scenario: str) -> None:
    ours, theirs = os.pipe()
    simulation = simulated(scenario)
    sent = [(0.0, 0.0), (0.0085, 0.02), (0.0078, -0.3), (0.012, None)]
    rows = [
        {"time_s": time_s} | ({} if turn is None else {"joint_position": [HOME[0] + turn, *HOME[1:]]})
        for time_s, turn in sent
    ]
    os.write(theirs, (json.dumps(rows[0]) + "\n").encode())
    with cosim.Twin(simulation, [streams.LineStream("pipe", ours)]) as twin:
        followed = iter(twin)
        for row in rows[1:]:
            os.write(theirs, (json.dumps(row) + "\n").encode())
            next(followed)
        os.close(theirs)
        assert (list(followed), twin.gaps) == ([], 0)
    assert simulation.snapshot.tick == round(APPROACH_s / 0.002) + 6
    assert simulation.snapshot.joint_target[0] == pytest.approx(HOME[0] + 0.02, abs=1e-9)


def test_readings_faster_than_the_joints_are_named(scenario: str, tmp_path: Path) -> None:
    there = [*HOME[:-1], HOME[-1] + 0.2]
    readings = [{"time_s": 0.0, "joint_position": [*HOME]}, {"time_s": 0.02, "joint_position": there}]
    with cosim.Twin(simulated(scenario), [lines(tmp_path / "told.jsonl", readings)]) as twin:
        list(twin)
    assert "readings faster than the arm's bounds of speed (1 times)" in repr(twin)


def test_what_a_ur_sends_wrong_is_named(scenario: str) -> None:
    rows = [joints_at(k / 125.0) for k in range(5)]
    played = peer()
    with controller(rows) as name:
        stream = streams.open_stream(name)
        nan = played.package(ord("U"), b"\x01" + np.array([np.nan, *HOME], ">f8").tobytes())
        stream._held = nan  # comes first
        with cosim.Twin(simulated(scenario), [stream]) as twin:
            assert len(list(twin)) == 4
    assert (twin.gaps, twin.notes) == (0, {"left out: readings whose time_s is not finite": 1})
    for noise in (b"\x00\x3bU" + bytes(56), b"\x12\x34\x99" + bytes(200)):
        with controller(rows) as name:
            stream = streams.open_stream(name)
            stream._held = noise
            with pytest.raises(InputError, match="and a kind of RTDE"):
                stream.read()
            stream.close()


@pytest.mark.parametrize("given", ["udp:host:1", "tcp:host", "rtde:", "rtde:host:x", "told.jsonl"])
def test_a_stream_that_is_none_is_refused(given: str) -> None:
    with pytest.raises(InputError, match=r"give rtde:HOST\[:PORT\]"):
        streams.open_stream(given)


def test_what_answers_otherwise_than_a_ur_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(peer().package(ord("V"), b"\x00"))
                connection.recv(100)

        threading.Thread(target=serve, daemon=True).start()
        with pytest.raises(InputError, match="refuses protocol version 2"):
            streams.open_stream(f"rtde:127.0.0.1:{port}")
    with pytest.raises(InputError, match="cannot be connected to"):
        streams.open_stream(f"rtde:127.0.0.1:{port}")
