"""A run resumes with the files that it was loaded from; a file that was changed later is refused by name."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from cosim.app.preparation import build_simulation
from cosim.base.files import ABSENT, changed_file, files_read
from cosim.base.kept_parts import KeptParts
from cosim.base.resources import object_mesh_path, scenario_path
from cosim.config.loading import load_scenario
from tests.cli.interrupted import Command, figures, interrupt_at


def test_a_changed_scenario_is_refused(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    command.start(at_tick=interrupt_at(7))
    file = command.directory / "scenario.toml"
    as_it_ran = file.read_text(encoding="utf-8")
    file.write_text(as_it_ran.replace("payload_compensation = true", "payload_compensation = false"))
    assert command.resume() == 2
    text = capsys.readouterr().err
    assert "scenario.toml was changed after the run began" in text
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
    assert "scenario.toml was changed after the run began" in capsys.readouterr().err


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


def test_the_arm_and_meshes_count_among_what_a_run_was_built_from(tmp_path: Path) -> None:
    mesh, scenario = tmp_path / "spool.obj", tmp_path / "spool.toml"
    mesh.write_bytes(object_mesh_path("spool.obj").read_bytes())
    scenario.write_bytes(scenario_path("gripper_lifts_spool").read_bytes())
    kept = KeptParts()
    for _ in range(2):  # of parts that are taken, as of those that are made
        with files_read() as found:
            build_simulation(load_scenario(scenario), kept=kept)
        assert str(mesh) in found
        assert "cosim/robots/ur5e/arm.toml" in found
        assert any(name.endswith(".urdf") for name in found)
        assert ABSENT not in found.values()
    mesh.write_text(mesh.read_text(encoding="utf-8").replace("0.036", "0.037"), encoding="utf-8")
    assert changed_file(found) == str(mesh)
