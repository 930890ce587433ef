"""Full disks, directories that are gone, screens that are closed: one line, the right code, nothing lost."""

from __future__ import annotations

import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cosim.app import output_directory, preparation, run_files
from cosim.cli.main import main
from tests.cli.interrupted import Command
from tests.cli.test_run import REFERENCE, TICKS, summary_of

ROOT = Path(__file__).resolve().parents[2]
LIST = [sys.executable, "-m", "cosim", "list"]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}


def full(name: str) -> Callable[[Path, str], None]:
    """Return what writes files until the disk is full, which is at one of that name."""

    def write(path: Path, text: str) -> None:
        if path.name == name:
            raise OSError(errno.ENOSPC, "No space left on device")
        path.write_text(text, encoding="utf-8")

    return write


class Closed(io.StringIO):
    """A screen that nobody looks at any more."""

    def write(self, text: str) -> int:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")


def test_a_run_goes_on_when_only_the_screen_is_gone(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", Closed())
    assert command.start() == 0
    assert summary_of(command.directory)["ticks"] == TICKS


def test_a_run_without_standard_streams_runs(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    monkeypatch.setattr(sys, "stdout", None)
    assert command.start() == 0
    sys.stderr.close()
    sys.stdout.close()


def test_a_summary_that_finds_no_room_is_saved_elsewhere(
    command: Command, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(run_files, "write_whole", full("summary.json"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert command.start("--quiet") == 3
    (line,) = capsys.readouterr().err.splitlines()
    (saved,) = tmp_path.glob("cosim-summary-*.json")
    assert line == (
        f"cosim: error: {command.directory / 'summary.json'}: cannot be written: No space left on device; "
        f"the figures are in {saved}"
    )
    assert json.loads(saved.read_text(encoding="utf-8"))["ticks"] == TICKS


def test_a_full_disk_before_the_run_leaves_nothing(
    command: Command, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(output_directory, "write_whole", full("scenario.toml"))
    assert command.start("--quiet") == 2
    assert capsys.readouterr().err == (
        f"cosim: error: --out {command.directory}: cannot be written: No space left on device\n"
    )
    assert not command.directory.exists()


def test_a_directory_that_is_taken_away_gets_the_summary(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    def at_tick(tick: int) -> None:
        if tick == 7:
            shutil.rmtree(command.directory)

    with pytest.warns(RuntimeWarning, match="no checkpoint could be written"):
        assert command.start("--quiet", at_tick=at_tick) == 3  # the recording has gone with it
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("cosim: error:")
    assert "recording.rrd" in line
    assert summary_of(command.directory)["ticks"] == TICKS


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_before_the_loop_has_its_own_code(
    number: signal.Signals, code: int, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def build(scenario: Any, **_given: Any) -> Any:
        os.kill(os.getpid(), number)
        raise AssertionError("the signal should have ended the command")

    monkeypatch.setattr(preparation, "build_simulation", build)
    assert main(["run", REFERENCE, "--quiet", "--out", str(command.directory)]) == code
    assert not command.directory.exists()


def test_a_list_that_nobody_reads_to_its_end_ends_quietly() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as pipe:
        done = subprocess.run(LIST, stdout=pipe, stderr=subprocess.PIPE, env=ENVIRONMENT, check=False)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_list_on_a_full_disk_says_so() -> None:
    with Path("/dev/full").open("wb") as disk:
        done = subprocess.run(LIST, stdout=disk, stderr=subprocess.PIPE, env=ENVIRONMENT, check=False)
    assert done.returncode == 3
    assert done.stderr == b"cosim: error: [Errno 28] No space left on device\n"


_LIMITED = """
import itertools, resource, sys, time
from cosim.cli.main import main
calls = itertools.count()
# a recording is the longer, the more often it is written while a run lasts: that must not depend on the load
time.perf_counter = lambda: 0.05 * next(calls)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
short = ["--no-error", "--set", "phase.inflate.increments=10", "--set", "model.published=true"]
sys.exit(main(["run", "three_unit_inflation", "--quiet", "--out", sys.argv[2], *short]))
"""


def test_a_recording_on_a_full_disk_ends_with_a_line_of_ours(tmp_path: Path) -> None:
    """A limit of each file's length fails as a full disk does: in the middle, and at the file's very end."""

    def ran(most_bytes: int, name: str) -> tuple[int, list[str]]:
        given = [sys.executable, "-W", "ignore", "-c", _LIMITED, str(most_bytes), str(tmp_path / name)]
        done = subprocess.run(
            given, capture_output=True, text=True, env=ENVIRONMENT, timeout=300, check=False
        )
        return done.returncode, done.stderr.splitlines()

    assert ran(10**8, "whole") == (0, [f"completed, no warnings: {tmp_path}/whole"])
    whole = (tmp_path / "whole" / "recording.rrd").stat().st_size
    for most_bytes in (20_000, whole - 10_000):  # its index is longer; from run to run 1 kB varies
        code, (line,) = ran(most_bytes, f"{most_bytes}")
        assert code == 3
        assert line.startswith(f"cosim: error: {tmp_path}/{most_bytes}/")
        assert "cannot be written" in line
        assert summary_of(tmp_path / f"{most_bytes}")["status"] in ("completed", "failed")
