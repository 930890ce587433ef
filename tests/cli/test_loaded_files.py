"""A run goes on with what it was loaded from: a file that has been changed since is refused by name."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cosim.app.loaded_files import loaded_digests
from cosim.base.resources import object_mesh_path, scenario_path
from cosim.config.loading import load_scenario
from tests.cli.interrupted import Command, figures, interrupt_at


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, made_up_build: Callable[..., Any], tmp_path: Path
) -> Command:  # fmt: skip
    return Command(monkeypatch, made_up_build, tmp_path / "out")


def test_a_changed_scenario_is_refused(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    command.start(at_tick=interrupt_at(7))
    file = command.directory / "scenario.toml"
    as_it_ran = file.read_text(encoding="utf-8")
    file.write_text(as_it_ran.replace("payload_compensation = true", "payload_compensation = false"))
    assert command.resume() == 2
    text = capsys.readouterr().err
    assert "scenario.toml has been changed since the run began" in text
    assert "cosim.Simulation(" in text
    file.write_text(as_it_ran + "# a remark changes nothing\n", encoding="utf-8")
    assert command.resume() == 0


def test_a_scenario_that_is_changed_while_the_run_lasts_is_refused(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    def at_tick(tick: int) -> None:
        if tick == 7:
            file = command.directory / "scenario.toml"
            file.write_text(file.read_text(encoding="utf-8").replace("30000.0", "20000.0"))
            os.kill(os.getpid(), signal.SIGINT)

    assert command.start(at_tick=at_tick) == 130
    assert command.resume() == 2
    assert "scenario.toml has been changed since the run began" in capsys.readouterr().err


def test_a_changed_mesh_is_refused_by_name(
    command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh, scenario = tmp_path / "spool.obj", tmp_path / "spool.toml"
    mesh.write_bytes(object_mesh_path("spool.obj").read_bytes())
    scenario.write_bytes(scenario_path("gripper_lifts_spool").read_bytes())
    command.scenario = str(scenario)
    assert command.start(at_tick=interrupt_at(7)) == 130
    mesh.write_text(mesh.read_text(encoding="utf-8").replace("0.036", "0.037"), encoding="utf-8")
    assert command.resume() == 2
    assert f"{mesh} has been changed since the run began" in capsys.readouterr().err


def test_a_copy_of_a_run_goes_on(command: Command, tmp_path: Path) -> None:
    assert command.start() == 0
    whole = figures(command.directory)
    command.start(at_tick=interrupt_at(7))
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in command.names():  # the marker is hidden, and left behind
        (copy / name).write_bytes((command.directory / name).read_bytes())
    command.directory = copy
    assert command.resume() == 0
    assert figures(copy) == whole


def test_the_arm_counts_among_what_a_run_was_loaded_from_where_there_is_one() -> None:
    on_arm = loaded_digests(load_scenario("ur5e_hexagon_arm"))
    assert {name.partition("/")[0] for name in on_arm} == {"scenario.toml", "ur5e"}
    assert "absent" not in on_arm.values()
    assert set(loaded_digests(load_scenario("three_unit_inflation"))) == {"scenario.toml"}
