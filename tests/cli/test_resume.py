"""`cosim run --resume`: an interrupted run goes on, and its figures are those of one that was not."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from cosim.app import checkpoint, preparation, resuming
from cosim.app.preparation import build_simulation
from cosim.app.simulation import Simulation as SteppedByHand
from cosim.base.state_file import load
from cosim.cli.main import main
from cosim.config.schema.scenario import Scenario
from cosim.errors import ConvergenceError
from cosim.stepping.stepped_run import SteppedRun
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch
from tests.cli.interrupted import Command, figures, interrupt_at
from tests.cli.test_run import REFERENCE, TICKS, summary_of
from tests.conftest import MadeUpSimulation


@pytest.fixture
def whole(
    monkeypatch: pytest.MonkeyPatch, made_up_build: Callable[..., Any], tmp_path: Path
) -> dict[str, Any]:
    """Return the figures of the run that is not interrupted."""
    other = Command(monkeypatch, made_up_build, tmp_path / "whole")
    assert other.start() == 0
    assert "checkpoint.npz" not in other.names()
    assert summary_of(other.directory)["resumed_at_ticks"] == []
    return figures(other.directory)


def test_what_a_killed_process_left_of_a_checkpoint_is_removed(command: Command) -> None:
    """With the next checkpoint, and where the run ends; other files of such names stay."""
    command.directory.mkdir()
    assert command.start(at_tick=interrupt_at(7)) == 130
    left, other = (command.directory / f"checkpoint.npz.{name}.part" for name in ("12345", "mine"))
    for path in (left, other):
        path.write_bytes(b"half of it")
    assert command.resume(at_tick=interrupt_at(18)) == 130
    assert not left.exists()
    left.write_bytes(b"half of it")
    assert command.resume() == 0
    assert not left.exists()
    assert other.exists()


def test_an_interrupted_run_goes_on(command: Command, whole: dict[str, Any]) -> None:
    began = time.perf_counter()
    assert command.start(at_tick=interrupt_at(7)) == 130
    assert command.names() == ["checkpoint.npz", "recording.rrd", "scenario.toml", "summary.json"]
    assert command.resume(at_tick=interrupt_at(18)) == 130
    assert summary_of(command.directory)["ticks"] == 18
    kept = load(command.directory / "checkpoint.npz")
    assert command.resume() == 0
    assert figures(command.directory) == whole
    after = summary_of(command.directory)
    assert after["resumed_at_ticks"] == [7, 18]
    # the parts add up, to no more than has gone by
    assert time.perf_counter() - began > after["wall_s"] > kept.wall_s > 0.0
    assert after["startup_s"] > kept.startup_s > 0.0
    # every tick is in one recording; all of them belong to one run, and are laid out alike
    ticks = [list(range(8)), list(range(8, 19)), list(range(19, TICKS + 1))]
    assert [recorder.ticks for recorder in command.recorders] == ticks
    assert [recorder.path.name for recorder in command.recorders] == [
        "recording.rrd", "recording-2.rrd", "recording-3.rrd",
    ]  # fmt: skip
    assert len({part.run_id for part in command.parts}) == 1
    before = [part.before and [snapshot.tick for snapshot in part.before] for part in command.parts]
    assert before == [None, [0, 7], [0, 18]]
    assert "checkpoint.npz" not in command.names()


@pytest.mark.parametrize(("tick", "kept"), [(7, 0), (24, 20)])
def test_a_second_signal_leaves_a_state_some_ticks_before(
    tick: int, kept: int, command: Command, whole: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "_SAVE_EVERY_s", 0.0)
    assert command.start(at_tick=interrupt_at(tick, times=2)) == 130
    assert command.resume() == 0
    assert summary_of(command.directory)["resumed_at_ticks"] == [kept]
    assert figures(command.directory) == whole


def test_a_failed_run_can_go_on_from_before_the_failure(command: Command, whole: dict[str, Any]) -> None:
    def at_tick(tick: int) -> None:
        if tick == 12:
            raise ConvergenceError("stalled", residual_N=3.0, iterations=50)

    assert command.start(at_tick=at_tick) == 1
    assert command.resume(at_tick=at_tick) == 1
    assert summary_of(command.directory)["ticks"] == 11
    assert command.resume() == 0
    assert summary_of(command.directory)["resumed_at_ticks"] == [11, 11]
    assert figures(command.directory) == whole


def test_a_killed_run_goes_on_from_its_last_checkpoint(command: Command, whole: dict[str, Any]) -> None:
    def at_tick(tick: int) -> None:
        if tick == 15:
            raise SystemExit  # as good as killed: nothing is closed, no summary is written

    with pytest.raises(SystemExit):
        command.start("--checkpoint-every", "1e-9", at_tick=at_tick)
    assert command.names() == ["checkpoint.npz", "recording.rrd", "scenario.toml"]
    # what was recorded reaches as far as the checkpoint
    assert (command.directory / "recording.rrd").read_text(encoding="utf-8") == "flushed 15"
    assert command.resume() == 0
    assert summary_of(command.directory)["resumed_at_ticks"] == [14]
    assert figures(command.directory) == whole


def test_no_checkpoint_is_written_before_its_time(command: Command) -> None:
    def at_tick(tick: int) -> None:
        if tick == 15:
            raise SystemExit

    with pytest.raises(SystemExit):
        command.start(at_tick=at_tick)
    assert command.names() == ["recording.rrd", "scenario.toml"]


def test_interrupted_after_the_last_tick_nothing_is_left(command: Command, whole: dict[str, Any]) -> None:
    assert command.start(at_tick=interrupt_at(TICKS)) == 130
    assert command.resume() == 0
    assert figures(command.directory) == whole


def test_a_run_without_recording_stays_without(command: Command) -> None:
    command.start("--no-recording", at_tick=interrupt_at(7))
    assert command.resume() == 0
    assert command.names() == ["scenario.toml", "summary.json"]


def test_a_new_run_in_the_directory_replaces_all_of_the_old_one(command: Command) -> None:
    command.start(at_tick=interrupt_at(7))
    command.resume(at_tick=interrupt_at(9))
    assert command.start("--no-recording") == 0
    assert command.names() == ["scenario.toml", "summary.json"]


def test_people_are_told_how_to_go_on(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    command.start(at_tick=interrupt_at(7))
    assert f"resume it: cosim run --resume {command.directory}" in capsys.readouterr().err
    command.resume()
    lines = capsys.readouterr().err
    assert "resumes after tick 7" in lines
    assert f"open it: cosim view {command.directory}" in lines


def test_a_state_that_cannot_be_written_does_not_spoil_the_run(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MadeUpSimulation, "save_state", lambda self: object())
    with pytest.warns(RuntimeWarning, match=r"no checkpoint could be written: state.run is a object"):
        assert command.start(at_tick=interrupt_at(7)) == 130
    assert command.names() == ["recording.rrd", "scenario.toml", "summary.json"]


def test_a_run_that_is_completed_is_refused(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    command.start()
    assert command.resume() == 2
    assert "this run is completed" in capsys.readouterr().err


def test_a_run_without_checkpoint_is_refused(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    command.start(at_tick=interrupt_at(7))
    (command.directory / "checkpoint.npz").unlink()
    assert command.resume() == 2
    assert "has no checkpoint.npz; start it again: cosim run" in capsys.readouterr().err


def test_a_directory_without_a_run_is_refused(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.resume() == 2
    assert "has no run" in capsys.readouterr().err


def test_another_program_is_refused(
    command: Command, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command.start(at_tick=interrupt_at(7))
    here = resuming.code_identity()
    monkeypatch.setattr(resuming, "code_identity", lambda: {**here, "numba": "0.1", "source": "x"})
    names = command.names()
    assert command.resume() == 2
    text = capsys.readouterr().err
    assert f"source {here['source']} (now x), numba {here['numba']} (now 0.1)" in text
    assert "its results would differ; start it again" in text
    assert command.names() == names


def test_a_torn_checkpoint_is_refused(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    command.start(at_tick=interrupt_at(7))
    file = command.directory / "checkpoint.npz"
    file.write_bytes(file.read_bytes()[:-200])
    assert command.resume() == 2
    assert "no saved state that can be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--resume", "x", REFERENCE], "give no SCENARIO"),
        (["--resume", "x", "--set", "clock.tick_s=1"], "no --set"),
        (["--resume", "x", "--out", "y"], "no --out"),
        ([], "no SCENARIO given"),
        ([REFERENCE, "--checkpoint-every", "0"], "must be above 0"),
    ],
)
def test_words_that_do_not_go_together(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *arguments]) == 2
    assert text in capsys.readouterr().err


class Disturbed:
    """A real simulation that is disturbed while a tick is computed."""

    def __init__(self, inner: SteppedRun, tick: int, disturb: Callable[[], None]) -> None:
        self._inner, self._tick, self._disturb = inner, tick, disturb
        self.stage: RunInfo = inner.stage
        self.save_state, self.restore_state = inner.save_state, inner.restore_state
        self.advance = inner.advance
        self.errors = None

    @property
    def saves_now(self) -> bool:
        return self._inner.saves_now

    def steps(self) -> Iterator[Snapshot]:
        for snapshot in self._inner.steps():
            if snapshot.tick == self._tick:
                self._disturb()
            yield snapshot

    def batches(self) -> Iterator[TickBatch]:
        return (TickBatch.of([snapshot]) for snapshot in self.steps())


def send_signal() -> None:
    """Press Ctrl-C."""
    os.kill(os.getpid(), signal.SIGINT)


def fail() -> None:
    """Find no solution."""
    raise ConvergenceError("no", 1.0, 1)


@pytest.mark.parametrize(
    ("mode", "disturb", "code"),
    [("dynamic", send_signal, 130), ("dynamic", fail, 1), ("quasistatic", fail, 1)],
)
def test_a_real_run_goes_on_bit_for_bit(
    mode: str, disturb: Callable[[], None], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["--quiet", "--no-error", "--set", f"mode={mode}", "--set", "phase.1.duration_s=0.1"]
    words += ["--set", "phase.1.increments=20"]
    assert main(["run", "three_unit_inflation", "--out", str(tmp_path / "whole"), *words]) == 0

    def build(scenario: Scenario, **_given: Any) -> SteppedRun:
        return Disturbed(build_simulation(scenario), 13, disturb)

    with monkeypatch.context() as patch:
        patch.setattr(preparation, "build_simulation", build)
        out = tmp_path / "out"
        assert main(["run", "three_unit_inflation", "--out", str(out), *words]) == code
    branch = SteppedByHand(out / "scenario.toml", start=out / "checkpoint.npz")
    assert branch.snapshot.tick == (13 if disturb is send_signal else 12)
    assert main(["run", "--resume", str(out), "--quiet", "--no-error"]) == 0
    # JSON holds every bit of a number
    assert figures(out) == figures(tmp_path / "whole")
    parts = [curve(out / name) for name in ("recording.rrd", "recording-2.rrd")]
    assert np.array_equal(np.concatenate(parts), curve(tmp_path / "whole" / "recording.rrd"))
    branch.step(branch.ticks_left)
    assert branch.snapshot.tip_position.tolist() == summary_of(out)["phases"][-1]["tip_position_m"]


def curve(path: Path) -> np.ndarray[Any, Any]:
    """Return ticks and tip positions (rows, 4) of a recording's curves."""
    chunks = RrdReader(path).stream().filter(content="/plots/tip_position").to_chunks()
    batches = [chunk.to_record_batch() for chunk in chunks]
    rows = [batch for batch in batches if "Scalars:scalars" in batch.schema.names]
    assert rows
    return np.concatenate(
        [
            np.column_stack([batch.column("tick").to_pylist(), batch.column("Scalars:scalars").to_pylist()])
            for batch in rows
        ]
    )
