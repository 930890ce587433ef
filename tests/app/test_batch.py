"""`cosim.Batch`: many runs in processes, each as it is alone; failures are named, the others go on."""

from __future__ import annotations

import os
import signal
from dataclasses import fields
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import pytest

import cosim
from cosim import Batch, Command, Simulation
from cosim.app.workers import THREADS, Workers
from cosim.errors import InputError, ScenarioError, SolverError, WorkerError
from tests.devices import device_parts

START: dict[str, Any] = {"start.pressure_Pa": 20e3, "phase": []}
CHANGES: list[dict[str, Any] | None] = [
    None,
    {"start.pressure_Pa": 15e3},
    {"solver.damping_per_s": 5.0},
    {"gravity_m_s2": [0.0, 0.0, -9.81]},
]
COMMANDS = [
    Command(pressure_Pa={"chamber": 18e3 + 500.0 * k}, cable_tension_N={"corner_0": 0.1 * k})
    for k in range(4)
]


def same(found: cosim.Measurement | None, expected: cosim.Measurement) -> bool:
    """Return whether two measurements are equal in every bit."""
    names = [entry.name for entry in fields(cosim.Measurement)]
    shown = [[repr(getattr(one, name)) for name in names] for one in (found, expected) if one is not None]
    arrays = [getattr(one, "tip_position").tobytes() for one in (found, expected) if one is not None]  # noqa: B009
    return len(shown) == 2 and shown[0] == shown[1] and arrays[0] == arrays[1]


def alone(scenario: Any) -> list[list[cosim.Measurement]]:
    """Return what is measured of the runs after two steps, and after a reset and one more."""
    found = []
    for change, command in zip(CHANGES, COMMANDS, strict=True):
        here = Simulation(cosim.load_scenario(scenario, START), overrides=change)
        seen = []
        for given in (command, None):
            here.step(given, ticks=3)
            seen.append(here.measure())
        here.reset()
        here.step(command, ticks=2)
        found.append([*seen, here.measure()])
    return found


def test_runs_are_what_they_are_alone_whatever_happens_to_others(tmp_path: Path) -> None:
    scenario = device_parts.scenario(tmp_path, device_parts.INFLATE)
    expected = alone(scenario)
    with Batch(scenario, 4, workers=2, overrides=START, changes=CHANGES) as batch:
        assert repr(batch) == "Batch of 4 runs of devices in 2 processes"
        first, second = batch.step(COMMANDS, ticks=3), batch.step(ticks=3)
        for k in range(4):
            assert same(first[k], expected[k][0])
            assert same(second[k], expected[k][1])
        for wrong, message in (
            ("x", "step, run 0: command is 'x'; give a cosim.Command"),
            ([None, None, 1.5, None], r"step, run 2: command is 1\.5; give a cosim.Command"),
            ([None], "1 commands were given for 4 runs"),
        ):
            with pytest.raises(InputError, match=message):
                batch.step(wrong)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"step, run 0: ticks is 1\.5; must be a whole number"):
            batch.step(ticks=1.5)  # type: ignore[arg-type]
        with pytest.raises(InputError, match="there is no run 4; there are 0 to 3"):
            batch.reset([4])
        assert not batch.failed
        assert batch.measure()[0] is not None
        assert all(same(here, seen[1]) for here, seen in zip(batch.measure(), expected, strict=True))
        batch.reset()
        impossible = [None, Command(pressure_Pa={"chamber": 1e12}), None, None]
        failing = batch.step([command or COMMANDS[k] for k, command in enumerate(impossible)], ticks=2)
        assert list(batch.failed) == [1]
        assert isinstance(batch.failed[1], SolverError)
        assert failing[1] is None
        assert all(same(failing[k], expected[k][2]) for k in (0, 2, 3))
        (again,) = [seen for seen in batch.reset([1]) if seen is not None]
        assert again.time_s == 0.0
        assert not batch.failed
        os.kill(batch.processes[0], signal.SIGKILL)
        left = batch.step(ticks=1)
        assert [k for k, seen in enumerate(left) if seen is None] == [0, 2]
        assert isinstance(batch.failed[0], WorkerError)
        text = rf"worker 0 \(process {batch.processes[0]}\) has ended by SIGKILL, and with it runs 0, 2"
        with pytest.raises(WorkerError, match=text):
            raise batch.failed[2]
        assert all(seen is not None for seen in batch.step(ticks=1)[1::2])
        batch.reset([2])  # in another process
        assert list(batch.failed) == [0]
        batch.reset([0])
        assert same(batch.step(COMMANDS, ticks=2)[0], expected[0][2])


def test_what_cannot_be_sent_fails_alone() -> None:
    workers = Workers(complex, 2, 1)
    try:
        found = workers.call(complex.__add__, {0: (lambda: 0.0,), 1: (2.0,)})
        assert isinstance(found[0], InputError)
        assert "give values that can be pickled" in str(found[0])
        assert found[1] == 3.0
        assert workers.call(complex.__add__, {0: (1.0,), 1: (1.0,)}) == {0: 1.0, 1: 2.0}
    finally:
        workers.close()


def test_a_process_that_does_not_answer_is_ended_and_replaced() -> None:
    workers = Workers(complex, 2, 2, answer_s=10.0)
    try:
        assert workers.call(complex.__add__, {0: (1.0,), 1: (1.0,)}) == {0: 1.0, 1: 2.0}
        os.kill(workers.processes[0], signal.SIGSTOP)
        os.waitpid(workers.processes[0], os.WUNTRACED)  # it may answer until it has stopped
        found = workers.call(complex.__add__, {0: (1.0,), 1: (1.0,)})
        with pytest.raises(WorkerError, match="did not answer within 10 s and was ended, and with it runs 0"):
            raise found[0]
        assert found[1] == 2.0
        workers.replace([1])
        assert isinstance(workers.call(complex.__add__, {0: (1.0,)})[0], WorkerError)
        workers.replace([0])
        assert workers.call(complex.__add__, {0: (1.0,), 1: (1.0,)}) == {0: 1.0, 1: 2.0}
    finally:
        workers.close()


def test_what_does_not_fit_is_refused_before_a_process_starts(tmp_path: Path) -> None:
    scenario = device_parts.scenario(tmp_path, device_parts.INFLATE)
    with pytest.raises(InputError, match="2 changes were given for 3 runs"):
        Batch(scenario, 3, changes=[None, None])
    with pytest.raises(InputError, match="0 runs in 1 workers"):
        Batch(scenario, 0)
    with pytest.raises(ScenarioError, match=r"clock\.tick_s"):
        Batch(scenario, 2, overrides={"clock.tick_s": 0.0})


def test_a_worker_has_one_thread_before_its_script_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    start, told = SpawnProcess.start, list[list[str | None]]()

    def seen(process: SpawnProcess) -> None:
        told.append([os.environ.get(name) for name in THREADS])
        start(process)

    monkeypatch.setattr(SpawnProcess, "start", seen)
    monkeypatch.setenv(THREADS[0], "2")
    before = dict(os.environ)
    Workers(abs, 1, 1).close()
    assert told == [["1"] * len(THREADS)]
    assert dict(os.environ) == before
