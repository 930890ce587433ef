"""Where results go: nothing that cosim did not write is lost, and two runs do not write to one directory."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.app.output_directory import MARKER, OutputDirectory
from cosim.cli.main import main
from cosim.errors import InputError
from tests.cli.interrupted import Command, interrupt_at
from tests.cli.test_run import REFERENCE

ROOT = Path(__file__).resolve().parents[2]
HOLD = (
    "import sys, time; from pathlib import Path; from cosim.app.run_files import OutputDirectory\n"
    "with OutputDirectory(Path(sys.argv[1])) as directory:\n"
    "    directory.make(); print('held', flush=True); time.sleep(600)\n"
)


def contents(directory: Path) -> dict[str, bytes]:
    """Return the files of a directory."""
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_a_folder_of_the_users_own_is_left_as_it_is(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    command.directory.mkdir()
    for name in ("scenario.toml", "recording-best.rrd", "summary.json"):
        (command.directory / name).write_text("mine", encoding="utf-8")
    before = contents(command.directory)
    assert command.start() == 2
    assert contents(command.directory) == before
    text = capsys.readouterr().err
    assert text.startswith(f"cosim: error: --out {command.directory}: has files that are not known")
    assert "(recording-best.rrd, scenario.toml, summary.json)" in text


def test_what_the_user_puts_beside_a_run_stays(command: Command) -> None:
    assert command.start() == 0
    mine = {"recording-best.rrd": b"1", "recording-07.rrd": b"2", "checkpoint.npz.old.part": b"3"}
    for name, content in mine.items():
        (command.directory / name).write_bytes(content)
    (command.directory / "summary.json.123.part").write_bytes(b"left by a run that was killed")
    assert command.start() == 0
    assert command.names() == sorted(["recording.rrd", "scenario.toml", "summary.json", *mine])
    assert mine.items() <= contents(command.directory).items()


def test_a_recording_put_there_is_not_replaced(command: Command) -> None:
    assert command.start("--no-recording") == 0
    (command.directory / "recording.rrd").write_bytes(b"mine")
    assert command.start() == 0
    assert (command.directory / "recording.rrd").read_bytes() == b"mine"
    assert "recording-2.rrd" in command.names()


def test_a_scenario_edited_in_the_runs_directory_is_not_replaced(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.start() == 0
    file = command.directory / "scenario.toml"
    file.write_text(file.read_text(encoding="utf-8") + "# my remarks\n", encoding="utf-8")
    before = contents(command.directory)
    assert command.start() == 2
    assert f"--out {file}: was changed after it was written" in capsys.readouterr().err
    assert contents(command.directory) == before


def test_a_checkpoint_put_there_is_not_replaced(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    with OutputDirectory(command.directory) as directory:
        directory.make()
    (command.directory / "checkpoint.npz").write_bytes(b"mine")
    assert command.start() == 2
    assert "checkpoint.npz: was not written by cosim" in capsys.readouterr().err
    assert command.names() == ["checkpoint.npz"]


def test_a_second_run_in_the_directory_is_refused_while_the_first_lasts(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    found: list[int] = []

    def at_tick(tick: int) -> None:
        if tick == 7:
            found.append(main(["run", REFERENCE, "--quiet", "--out", str(command.directory)]))
            interrupt_at(7)(tick)

    assert command.start("--quiet", at_tick=at_tick) == 130
    assert found == [2]
    assert "another process is writing there" in capsys.readouterr().err
    assert command.resume() == 0


def test_two_runs_that_begin_at_once_do_not_share_a_new_directory(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path / "a") as first, OutputDirectory(tmp_path / "a") as second:
        first.make()
        with pytest.raises(InputError, match="another process"):
            second.make()


def test_a_directory_made_for_nothing_is_taken_away_again(tmp_path: Path) -> None:
    new, used, given = (tmp_path / name for name in ("new", "used", "given"))
    given.mkdir()
    for path in (new, used, given):
        with OutputDirectory(path) as directory:
            directory.make()
            if path == used:
                (path / "mine").touch()
            directory.discard()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["given", "used"]
    assert [path.name for path in used.iterdir()] == ["mine"]


def test_the_lock_of_a_process_that_was_killed_is_no_trap(command: Command) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(command.directory)],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert holder.stdout is not None
    with holder, holder.stdout:
        assert holder.stdout.readline() == b"held\n"
        assert command.start() == 2
        holder.send_signal(signal.SIGKILL)
        holder.wait()
    assert (command.directory / MARKER).exists()
    assert command.start() == 0
