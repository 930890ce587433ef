"""A source of commands that the package does not have reaches scenario files by one file and one line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import cosim
from cosim.app.preparation import build_simulation
from cosim.base.state_file import load, save
from cosim.config.json_schema import json_schema
from cosim.config.loading import load_scenario, scenario_text
from cosim.config.schema.phase import CommandTable
from cosim.config.toml.tables import adapter_of
from cosim.devices.command_source import ChangedCommands, CommandSource, StepToTake
from cosim.devices.controller import RobotState
from cosim.plan.commands import RobotCommand
from tests.devices import device_parts, sine_commands
from tests.devices.sine_commands import SineTable
from tests.pages import page

SINE = """
[[command]]
kind = "sine"
cable = "corner_1"
amplitude_N = 0.4
frequency_Hz = 2.5
"""
HOLD = """
[[phase]]
name = "hold"
duration_s = 0.2
increments = 8
cable_tension_N = [0.1, 0.2]
"""


class Lean(ChangedCommands):
    """Asks the first joint for more, where the arm feels the soft robot's weight."""

    def changed(self, command: RobotCommand, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        position = command.joints.position.copy()
        position[0] += 0.01 * float(see().flange_wrench.force[2] < 0.0)
        return replace(command, joints=replace(command.joints, position=position))


@dataclass(frozen=True, kw_only=True)
class LeanTable(CommandTable):
    """An arm that leans."""

    kind: Literal["lean"] = "lean"

    def source(self, given: CommandSource, scenario: Any) -> Lean:
        return Lean(given)


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(CommandTable, "kinds", {})
    for table in (SineTable, LeanTable):
        cosim.register_kind(table)
    yield
    adapter_of.cache_clear()


def swing(time_s: Any) -> Any:
    """Return what SINE adds to the tension [N]."""
    return 0.4 * np.sin(np.pi * 2.5 * np.asarray(time_s)) ** 2


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_a_run_is_asked_for_a_sine(tmp_path: Path, mode: str) -> None:
    given = device_parts.scenario(tmp_path, SINE, HOLD)
    result = cosim.run(given, overrides={"mode": mode})
    plain = cosim.run(replace(given, commands=()), overrides={"mode": mode})
    more = result.cable_tension_N[1:] - plain.cable_tension_N[1:]
    np.testing.assert_allclose(more[:, 1], swing(result.time_s[1:]), atol=1e-14)
    assert not more[:, 0].any()
    assert np.abs(result.tip_position[-1] - plain.tip_position[-1]).max() > 1e-6  # it is felt
    again = tmp_path / "again.toml"
    again.write_text(scenario_text(given), encoding="utf-8")
    assert load_scenario(again) == given


@pytest.mark.usefixtures("known")
def test_sources_change_what_those_before_them_ask_for(tmp_path: Path) -> None:
    result = cosim.run(device_parts.scenario(tmp_path, SINE, SINE.replace("0.4", "0.6"), HOLD))
    last = result.cable_tension_N[-1, 1]
    assert last == pytest.approx(0.2 + 2.5 * float(swing(result.time_s[-1])))


@pytest.mark.usefixtures("known")
def test_a_run_goes_on_from_a_saved_state_bit_for_bit(tmp_path: Path) -> None:
    given = device_parts.scenario(tmp_path, SINE, HOLD, HOLD.replace("hold", "again"))
    run = build_simulation(given)
    steps = run.steps()
    list(islice(steps, 30))
    save(tmp_path / "state.npz", run.save_state())
    expected = [snapshot.node_position for snapshot in steps]
    other = build_simulation(given)
    other.restore_state(load(tmp_path / "state.npz"))
    np.testing.assert_array_equal([snapshot.node_position for snapshot in other.steps()], expected)


@pytest.mark.usefixtures("known")
def test_a_source_sees_the_robot_and_moves_its_joints() -> None:
    phase = {"name": "stand", "duration_s": 0.1}
    changes = {"model.published": True, "fidelity": "rigid", "clock.tick_s": 0.004, "phase": [phase]}
    plain = cosim.run("ur5e_hexagon_arm", overrides=changes)
    leaning = cosim.run("ur5e_hexagon_arm", overrides={**changes, "command": [{"kind": "lean"}]})
    asked = leaning.joint_target[1:] - plain.joint_target[1:]
    np.testing.assert_allclose(asked, [[0.01, 0.0, 0.0, 0.0, 0.0, 0.0]] * len(asked), atol=1e-12)
    assert leaning.joint_position[-1, 0] > plain.joint_position[-1, 0] + 0.003  # the servo is on its way
    (contact,) = (entry for entry in leaning.summary["modelled"] if "scene" in entry["what"])
    assert contact["included"], contact  # what comes within reach is not known beforehand


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize(
    ("parts", "text"),
    [
        ((SINE.replace("0.4", "-1.0"), HOLD), r"command\.1\.amplitude_N: -1 is out of bounds"),
        ((SINE, SINE.replace("sine", "cosine"), HOLD), r"command\.2: kind is the text 'cosine'"),
        ((SINE, device_parts.PUMP, HOLD), r"command\.1: cannot be combined with pumps"),
        ((SINE, device_parts.PULL + device_parts.SHORTER), r"command\.1: cannot .* cable lengths"),
        (
            (SINE, HOLD + "tip_target.height_m = 0.2\ntip_target.reach_with = 'flange'\n"),
            r"command\.1: .*tip",
        ),
    ],
)
def test_what_it_cannot_be_or_stand_beside_is_told(tmp_path: Path, parts: tuple[str, ...], text: str) -> None:
    with pytest.raises(cosim.ScenarioError, match=text):
        device_parts.scenario(tmp_path, *parts)


@pytest.mark.usefixtures("known")
def test_a_cable_that_is_not_there_is_told(tmp_path: Path) -> None:
    given = device_parts.scenario(tmp_path, SINE.replace("corner_1", "corner_9"), HOLD)
    with pytest.raises(cosim.InputError, match="cable 'corner_9'; there are: corner_0, corner_1"):
        build_simulation(given)


def test_a_kind_that_is_not_registered_is_refused(tmp_path: Path) -> None:
    with pytest.raises(cosim.ScenarioError, match="kind 'sine' is not known; there are: none; register it"):
        device_parts.scenario(tmp_path, '[[command]]\nkind = "sine"\n', HOLD)


@pytest.mark.usefixtures("known")
def test_editors_are_told_of_it() -> None:
    table = json_schema("scenario")["$defs"]["SineTable"]
    assert table["properties"]["frequency_Hz"]["x-unit"] == "Hz"
    assert set(table["required"]) == {"cable", "amplitude_N", "frequency_Hz"}


def test_the_page_on_extending_shows_the_file() -> None:
    file = Path(sine_commands.__file__ or "").read_text(encoding="utf-8")
    shown = page("extending")
    assert f"```python\n{file}```" in shown
    assert SINE.strip() in shown
