"""`cosim run` on a made-up simulation: files, exit codes, interruption, failure."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cosim.app import driver, preparation
from cosim.app.output_directory import MARKER
from cosim.app.progress import clock
from cosim.base.resources import list_soft_robots
from cosim.cli.main import main
from cosim.cli.running import TerminalLine
from cosim.config.loading import load_scenario
from cosim.errors import ConvergenceError, UnreachableError
from cosim.recording.recorder import Recorder
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch

REFERENCE = "ur5e_hexagon_arm"
TICKS = 25


class NotingRecorder(Recorder):
    """Notes what it was given in a text file instead of a recording."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ticks: list[int] = []

    def open(self, stage: RunInfo) -> None:
        self.path.write_text("open", encoding="utf-8")

    def record(self, batch: TickBatch) -> None:
        self.ticks += batch.tick.tolist()

    def flush(self) -> None:
        self.path.write_text(f"flushed {len(self.ticks)}", encoding="utf-8")

    def close(self, summary_markdown: str, status: str) -> None:
        self.path.write_text(f"{status} {len(self.ticks)}\n{summary_markdown}", encoding="utf-8")


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, made_up_build: Callable[..., Any]
) -> Callable[..., tuple[int, Path]]:
    """Return a function that runs the reference scenario made up; `at_tick` may raise or signal."""

    def command(
        *arguments: str, at_tick: Callable[[int], None] = lambda tick: None, out: Path = tmp_path / "out"
    ) -> tuple[int, Path]:
        monkeypatch.setattr(preparation, "build_simulation", made_up_build(at_tick))
        monkeypatch.setattr(driver, "rerun_recorder", lambda path, settings, part: NotingRecorder(path))
        return main(["run", REFERENCE, "--out", str(out), *arguments]), out

    return command


def files_in(directory: Path) -> list[str]:
    """Return the names of the files in a directory, but for the marker and the files of arrays."""
    found = (path for path in directory.iterdir() if path.name != MARKER)
    return sorted(path.name for path in found if path.suffix != ".parquet")


def summary_of(directory: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    return summary


def test_a_run_leaves_scenario_summary_and_recording(run: Callable[..., tuple[int, Path]]) -> None:
    code, out = run("--set", "clock.tick_s=0.004")
    assert code == 0
    assert files_in(out) == ["recording.rrd", "scenario.toml", "summary.json"]
    assert load_scenario(out / "scenario.toml") == load_scenario(REFERENCE, {"clock.tick_s": 0.004})
    summary = summary_of(out)
    assert summary["status"] == "completed"
    assert summary["ticks"] == TICKS
    assert summary["simulated_s"] == pytest.approx(TICKS * 0.004)
    # the first snapshot and every tick, in order, once
    assert (out / "recording.rrd").read_text(encoding="utf-8").startswith(f"completed {TICKS + 1}\n")


def test_no_recording_means_none(run: Callable[..., tuple[int, Path]]) -> None:
    run()  # leaves a recording, which the next run must not leave standing beside its own summary
    code, out = run("--no-recording")
    assert code == 0
    assert files_in(out) == ["scenario.toml", "summary.json"]


def test_quiet_says_one_line(
    run: Callable[..., tuple[int, Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out = run("--quiet")
    assert code == 0
    assert capsys.readouterr() == ("", f"completed, no warnings: {out}\n")


def test_a_run_says_which_limits_of_its_arm_are_assumed(
    run: Callable[..., tuple[int, Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    run()
    shown = capsys.readouterr()
    assert "ur5e: assumed limits, not from a data sheet: acceleration" in shown.out + shown.err


def test_a_run_ends_with_what_it_found_how_sure_that_is_and_its_files(
    run: Callable[..., tuple[int, Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = run()
    lines = capsys.readouterr().err.splitlines()[-9:]
    heads = ["tip", "target", "films", "error", "stability", "modelled", "warnings", "time", "files"]
    assert [line.split(":")[0] for line in lines] == heads
    assert lines[6].split() == ["warnings:", "none"]
    assert lines[7].split()[:2] == ["time:", "completed,"]
    assert lines[8].endswith(f"{out}: summary.json, recording.rrd; open it: cosim view {out}")


def test_a_run_says_where_its_files_are(
    run: Callable[..., tuple[int, Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = run()
    captured = capsys.readouterr()
    assert captured.out == ""
    assert f"cosim view {out}" in captured.err
    # not a terminal: one line per phase
    for name in ("hang", "inflate", "turn", "lift", "reach"):
        assert sum(f" {name} " in line for line in captured.err.splitlines()) == 1


@pytest.fixture
def terminal() -> Iterator[None]:
    """Heed SIGHUP, also where the tests run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("terminal")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_ends_the_run_in_good_order(
    run: Callable[..., tuple[int, Path]], number: signal.Signals, code: int
) -> None:
    before = signal.getsignal(number)

    def at_tick(tick: int) -> None:
        if tick == 7:
            os.kill(os.getpid(), number)

    assert run("--quiet", at_tick=at_tick)[0] == code
    assert signal.getsignal(number) is before


@pytest.mark.usefixtures("terminal")
def test_a_closed_terminal_ends_the_run_in_good_order(run: Callable[..., tuple[int, Path]]) -> None:
    def at_tick(tick: int) -> None:
        if tick == 7:
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGHUP)  # of the terminal and of the shell

    code, out = run("--quiet", at_tick=at_tick)
    summary = summary_of(out)
    assert (code, summary["status"], summary["reason"], summary["ticks"]) == (129, "interrupted", "SIGHUP", 7)
    assert (out / "checkpoint.npz").is_file()


def test_a_run_under_nohup_goes_on(run: Callable[..., tuple[int, Path]]) -> None:
    def at_tick(tick: int) -> None:
        if tick == 7:
            os.kill(os.getpid(), signal.SIGHUP)

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        code, out = run("--quiet", at_tick=at_tick)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert (code, summary_of(out)["status"]) == (0, "completed")


def test_an_interrupted_summary_says_so(run: Callable[..., tuple[int, Path]]) -> None:
    def at_tick(tick: int) -> None:
        if tick == 7:
            os.kill(os.getpid(), signal.SIGINT)

    code, out = run(at_tick=at_tick)
    summary = summary_of(out)
    assert code == 130
    assert (summary["status"], summary["reason"], summary["ticks"]) == ("interrupted", "SIGINT", 7)
    assert [(phase["name"], phase["complete"]) for phase in summary["phases"]] == [
        ("hang", True),
        ("inflate", False),
    ]
    assert (out / "recording.rrd").read_text(encoding="utf-8").startswith("interrupted 8\n")


def test_a_second_signal_does_not_wait_for_the_tick(run: Callable[..., tuple[int, Path]]) -> None:
    def at_tick(tick: int) -> None:
        if tick == 7:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)
            raise AssertionError("the second signal should have ended the tick")

    code, out = run(at_tick=at_tick)
    assert code == 130
    assert summary_of(out)["status"] == "interrupted"
    assert summary_of(out)["ticks"] == 6


def test_a_failure_leaves_what_was_simulated(
    run: Callable[..., tuple[int, Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    def at_tick(tick: int) -> None:
        if tick == 12:
            raise ConvergenceError("stalled at 3 N", residual_N=3.0, iterations=50)

    code, out = run(at_tick=at_tick)
    summary = summary_of(out)
    assert code == 1
    assert (summary["status"], summary["ticks"]) == ("failed", 11)
    assert summary["reason"] == "ConvergenceError: stalled at 3 N"
    assert (out / "recording.rrd").read_text(encoding="utf-8").startswith("failed 12\n")
    assert "cosim: not solved: stalled at 3 N" in capsys.readouterr().err


def test_a_failure_before_the_first_snapshot_leaves_a_summary(run: Callable[..., tuple[int, Path]]) -> None:
    def at_tick(tick: int) -> None:
        raise ConvergenceError("no equilibrium to start from", residual_N=3.0, iterations=50)

    code, out = run(at_tick=at_tick)
    assert code == 1
    assert summary_of(out)["status"] == "failed"
    assert summary_of(out)["phases"] == []


def test_wrong_input_found_while_building_writes_nothing(run: Callable[..., tuple[int, Path]]) -> None:
    def at_tick(tick: int) -> None:
        raise UnreachableError("start.flange: out of reach")

    code, out = run(at_tick=at_tick)
    assert code == 2
    assert not out.exists()


def test_a_fault_of_the_program_is_not_hidden(run: Callable[..., tuple[int, Path]], tmp_path: Path) -> None:
    def at_tick(tick: int) -> None:
        if tick == 3:
            raise ZeroDivisionError("a fault")

    with pytest.raises(ZeroDivisionError):
        run(at_tick=at_tick)
    assert summary_of(tmp_path / "out")["reason"] == "ZeroDivisionError: a fault"


def test_the_default_directory_is_new_each_time(
    run: Callable[..., tuple[int, Path]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run()
    monkeypatch.chdir(tmp_path)
    assert main(["run", REFERENCE, "--quiet"]) == 0
    assert main(["run", REFERENCE, "--quiet"]) == 0
    assert len(list((tmp_path / "runs").glob(f"{REFERENCE}-*/summary.json"))) == 2


def test_warming_up_compiles_what_a_run_calls() -> None:
    code = (
        "from cosim.cli.main import main; assert main(['warm-up', 'two_arms_hold_box', 'none_such']) == 2; "
        "from cosim.coupling import payload; from cosim.coupling.contact import contact_kernels; "
        "all_ = payload.fill_payload, contact_kernels.predict_poses; "
        "print(*(kernel.cache.is_there(kernel.fixed_signature) for kernel in all_))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["True", "True"]
    assert "two_arms_hold_box: ready to run" in ran.stderr
    assert "no scenario 'none_such'" in ran.stderr


def test_list_names_every_scenario_with_its_question(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith(REFERENCE) and line.endswith("?") for line in lines)


def test_list_says_what_each_soft_robot_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "soft_robots"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(list_soft_robots())
    texts = {line.partition("  ")[2].strip() for line in lines}
    assert len(texts) == len(lines)
    assert all(text.endswith(".") for text in texts)


def test_view_without_recording_says_how_to_make_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(tmp_path)]) == 2
    assert "cosim run" in capsys.readouterr().err


def test_the_progress_line_renews_itself_on_a_terminal(made_up_build: Callable[..., Any]) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    progress = TerminalLine(stream)
    simulation = made_up_build()(load_scenario(REFERENCE))
    progress.open(simulation.stage)
    for batch in simulation.batches():
        progress.observe(batch)
    progress.close()
    drawn = stream.getvalue()
    assert drawn.count("\n") == 1
    assert drawn.startswith("\r")
    assert "100 %" in drawn.splitlines()[-1]


def test_the_last_progress_line_leaves_out_what_followed_the_run(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    monkeypatch.setattr("cosim.app.progress.time.perf_counter", lambda: now_s)
    stream = io.StringIO()
    progress = TerminalLine(stream)
    simulation = made_up_build()(load_scenario(REFERENCE))
    progress.open(simulation.stage)
    for batch in simulation.batches():
        now_s = max(now_s, 2.0 * batch.snapshot(-1).time_s)
        progress.observe(batch)
    now_s += 1000.0  # error bars are worked out
    progress.close()
    assert stream.getvalue().splitlines()[-1].endswith("x0.50 real time  done")


def test_the_progress_line_counts_from_the_start_of_the_command(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    monkeypatch.setattr("cosim.app.progress.time.perf_counter", lambda: now_s)
    stream, simulation = io.StringIO(), made_up_build()(load_scenario(REFERENCE))
    progress = TerminalLine(stream, started=now_s)
    duration_s = now_s = simulation.stage.duration_s  # for loading, building and planning
    progress.open(simulation.stage)
    for batch in simulation.batches():
        now_s = max(now_s, duration_s + batch.snapshot(-1).time_s)
        progress.observe(batch)
    progress.close()
    assert stream.getvalue().splitlines()[-1].endswith("x0.50 real time  done")


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0:00"), (61.0, "1:01"), (3725.0, "1:02:05")])
def test_durations_are_shown_as_clocks(seconds: float, text: str) -> None:
    assert clock(seconds) == text
