"""Cable lengths, winches, pumps and controllers in a scenario, from the file to the summary."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim import Command, Controller, Measurement
from cosim.app.preparation import build_simulation
from cosim.base.state_file import load, save
from cosim.config.loading import load_scenario, scenario_text
from cosim.telemetry.figures.device_figures import control_figures
from tests.devices.device_parts import (
    CONTROLLER,
    INFLATE,
    PULL,
    PUMP,
    PYTHON,
    SHORTER,
    STIFFNESS,
    WINCH,
    TICK_s,
    scenario,
)

ROOT = Path(__file__).resolve().parents[2]


def last_phase(result: cosim.RunResult) -> dict[str, Any]:
    phase = result.summary["phases"][-1]
    return {**phase, **phase["devices"]}


def test_a_shortened_cable_pulls_alike_in_statics_and_at_rest_in_dynamics(tmp_path: Path) -> None:
    given = scenario(tmp_path, INFLATE, PULL + SHORTER + "control = []\n")
    euler = {"solver.integrator": "implicit_euler"}  # is at rest the sooner
    ends = [
        last_phase(cosim.run(given, overrides={"mode": mode, "phase.pull.settle_s": settle, **euler}))
        for mode, settle in (("quasistatic", 0.4), ("dynamic", 2.0))
    ]
    for end in ends:
        tension, length = end["cable_tension_N"][0], end["cable_length_m"][0]
        assert tension > 0.05
        assert tension == pytest.approx(STIFFNESS * (length - end["cable_unstretched_m"][0]), rel=1e-6)
        assert end["cable_unstretched_m"][1] is None  # its tension is commanded: none
        assert end["cable_off_drum_m"][0] == end["cable_unstretched_m"][0]
        assert end["cable_off_drum_m"][1] == pytest.approx(end["cable_length_m"][1], abs=2e-5)  # slack
        assert end["cable_tension_N"][1] == 0.0
    assert ends[0]["bending_angle_rad"] > 0.05
    assert ends[1]["bending_angle_rad"] == pytest.approx(ends[0]["bending_angle_rad"], rel=0.01)
    assert ends[1]["cable_length_m"] == pytest.approx(ends[0]["cable_length_m"], abs=1e-5)


def test_a_winch_goes_in_steps_and_stalls(tmp_path: Path) -> None:
    between = PULL + SHORTER.replace("0.006", "0.0061")  # a third of a step beyond 20 of them
    ideal = cosim.run(scenario(tmp_path, INFLATE, between))
    wound = cosim.run(scenario(tmp_path, INFLATE, between, WINCH))
    step_m = 0.03 * 0.01
    # half a step of resolution
    off = wound.cable_unstretched_m[-1, 0] - ideal.cable_unstretched_m[-1, 0]
    assert off == pytest.approx(step_m / 3.0, rel=1e-6)
    turned = np.diff(wound.cable_unstretched_m[wound.phase == 1, 0]) / step_m
    assert turned == pytest.approx(np.round(turned), abs=1e-9)
    assert last_phase(wound)["lost_steps"] == [0, 0]
    stall_N = 0.3 * ideal.cable_tension_N[-1, 0]
    changes = {
        "winch.steppers.stall_torque_Nm": stall_N * 0.01,
        "winch.steppers.step_angle_rad": 0.003,
        "soft_robot.cable.corner_0.stiffness_N_m": 200.0,
    }
    weak = cosim.run(scenario(tmp_path, INFLATE, PULL + SHORTER, WINCH), overrides=changes)
    assert last_phase(weak)["lost_steps"][0] > 0
    assert weak.cable_tension_N[-1, 0] <= stall_N * (1.0 + 1e-6)
    assert weak.cable_tension_N[-1, 0] > 0.7 * stall_N


ONE_MOTOR = WINCH.replace('name = "steppers"', 'name = "steppers"\none_motor = true')
BOTH = "cable_shortening_m = { corner_0 = 0.006, corner_1 = 0.006 }\n"


def test_one_motor_winds_its_cables_by_one_length_whatever_each_of_them_pulls(tmp_path: Path) -> None:
    unlike = INFLATE + "cable_tension_N = [0.0, 0.2]\n"
    result = cosim.run(scenario(tmp_path, unlike, PULL + BOTH, ONE_MOTOR))
    wound = result.cable_unstretched_m[result.phase == 1]
    assert wound[0, 1] - wound[0, 0] < -5e-4  # from wherever each of them is
    np.testing.assert_allclose(wound[0] - wound[-1], 0.006, atol=0.03 * 0.01)
    assert np.ptp(np.diff(wound, axis=0), axis=1).max() < 1e-12
    pulls = result.cable_tension_N[-1]
    assert pulls[1] > 1.2 * pulls[0] > 0.05
    # it stalls by the sum: each alone would be wound
    stall_N = 0.7 * float(pulls.sum())
    assert stall_N > pulls.max()
    changes = {
        "winch.steppers.stall_torque_Nm": stall_N * 0.01,
        "winch.steppers.step_angle_rad": 0.003,
        **{f"soft_robot.cable.corner_{k}.stiffness_N_m": 1000.0 for k in range(2)},
    }
    weak = cosim.run(scenario(tmp_path, unlike, PULL + BOTH, ONE_MOTOR), overrides=changes)
    lost = last_phase(weak)["lost_steps"]
    assert lost[0] == lost[1] > 0
    assert 0.6 * stall_N < weak.cable_tension_N[-1].sum() <= stall_N * (1.0 + 1e-6)
    alone = cosim.run(scenario(tmp_path, unlike, PULL + BOTH, WINCH), overrides=changes)
    assert last_phase(alone)["lost_steps"] == [0, 0]


@dataclass(frozen=True)
class Shorten(Controller[float]):
    """Commands one of two cables alone."""

    def start(self, seen: Measurement) -> float:
        return seen.cable_unstretched_m["corner_0"] - 0.002

    def act(self, state: float, seen: Measurement) -> tuple[float, Command]:
        return state, Command(cable_length_m={"corner_0": state})


def test_cables_of_one_motor_that_are_commanded_differently_are_refused(tmp_path: Path) -> None:
    for wrong in (SHORTER, SHORTER.replace(" }", ", corner_1 = 0.005 }"), "cable_length_m.corner_0 = 0.02\n"):
        with pytest.raises(cosim.ScenarioError, match=r"winch\.steppers\.one_motor: .* the same cable_short"):
            scenario(tmp_path, INFLATE, PULL + wrong, ONE_MOTOR)
    feedback = CONTROLLER + 'commands = "cable_shortening_m"\n'
    with pytest.raises(cosim.ScenarioError, match=r"one_motor: .*'bend' moves only some"):
        scenario(
            tmp_path, ONE_MOTOR, feedback, INFLATE, PULL + "control_bending_angle_rad = { bend = 0.1 }\n"
        )
    given = scenario(tmp_path, PYTHON, INFLATE, PULL + 'control = ["mine"]\n', ONE_MOTOR)
    with pytest.raises(cosim.InputError, match=r"one motor winds its 2 cables, which are commanded"):
        cosim.run(given, controllers={"mine": Shorten()})


def test_from_tension_to_length_and_back_nothing_jumps(tmp_path: Path) -> None:
    hold = '[[phase]]\nname = "hold"\nduration_s = 0.2\ncable_shortening_m = { corner_0 = 0.0 }\n'
    let_go = '[[phase]]\nname = "let_go"\nduration_s = 0.2\ncable_tension_N = [0.0, 0.0]\n'
    pull = PULL + "cable_tension_N = [0.3, 0.0]\n"
    result = cosim.run(scenario(tmp_path, INFLATE, pull, hold, let_go))
    tension = result.cable_tension_N[:, 0]
    assert tension[result.phase == 2] == pytest.approx(0.3, abs=0.02)
    assert np.abs(np.diff(tension)).max() < 0.02
    assert tension[-1] == 0.0


def test_a_pump_holds_the_pressure_of_a_leaking_chamber(tmp_path: Path) -> None:
    pumped = (
        '[[phase]]\nname = "pumped"\nduration_s = 1.2\ngas = "sealed"\nleak_kg_s_Pa = 2e-10\n'
        "pump_pressure_Pa = { main = 22e3 }\n"
    )
    result = cosim.run(scenario(tmp_path, PUMP, INFLATE, pumped))
    pressure, time_s = result.pressure_Pa, result.time_s
    filled = pressure[time_s > 1.0]
    # the band, and what pump and leak do within the sensor's delay, at some 5 kPa/s
    assert filled.min() > 21e3
    assert filled.max() < 23e3
    assert np.ptp(filled) > 200.0
    figures = last_phase(result)["pumps"]["main"]
    assert figures["starts"] >= 2
    assert figures["delivered_kg"] == pytest.approx(2e-5 * figures["on_s"])


@dataclass(frozen=True)
class Ramp(Controller[float]):
    """Raises one tension by a fixed amount per sample, and checks what it sees."""

    def start(self, seen: Measurement) -> float:
        return seen.cable_tension_N["corner_1"]

    def act(self, state: float, seen: Measurement) -> tuple[float, Command]:
        assert seen.setpoint is None
        assert seen.cable_length_m.keys() == {"corner_0", "corner_1"}
        return state + 0.05, Command(cable_tension_N={"corner_1": state + 0.05})


def test_a_controller_from_python_and_its_determinism(tmp_path: Path) -> None:
    given = scenario(tmp_path, PYTHON, INFLATE, PULL + 'control = ["mine"]\n')
    first, second = (cosim.run(given, controllers={"mine": Ramp()}) for _ in range(2))
    tension = first.cable_tension_N[first.phase == 1, 1]
    held = round(0.1 / TICK_s)
    # sampled at the start of the phase, held for 25 ticks each
    assert tension[::held] == pytest.approx(0.05 * np.arange(1, 9))
    assert (tension == np.repeat(tension[::held], held)[: len(tension)]).all()
    assert (first.node_position == second.node_position).all()
    with pytest.raises(cosim.ScenarioError, match=r"controller\.mine\.kind: 'python' needs"):
        cosim.run(given)
    with pytest.raises(cosim.InputError, match=r"no .*controller.* 'yours'"):
        cosim.run(given, controllers={"mine": Ramp(), "yours": Ramp()})
    with pytest.raises(cosim.InputError, match="'mine' is a int"):
        cosim.run(given, controllers={"mine": 3})  # type: ignore[dict-item]


@dataclass(frozen=True)
class Inflate(Controller[None]):
    """Asks the pump for one pressure."""

    def start(self, seen: Measurement) -> None:
        assert seen.pressure_Pa[0] == pytest.approx(20e3)

    def act(self, state: None, seen: Measurement) -> tuple[None, Command]:
        return None, Command(pump_pressure_Pa={"main": 21e3})


def test_a_controller_commands_a_pump_that_no_phase_does(tmp_path: Path) -> None:
    sealed = '[[phase]]\nname = "p"\nduration_s = 0.6\ncontrol = ["mine"]\ngas = "sealed"\n'
    mine = {"mine": Inflate()}
    result = cosim.run(scenario(tmp_path, PUMP, PYTHON, INFLATE, sealed), controllers=mine)
    assert result.pressure_Pa[-1] == pytest.approx(21e3, abs=300.0)
    assert last_phase(result)["pumps"]["main"]["setpoint_Pa"] == 21e3
    given = sealed.replace("sealed", "prescribed")
    with pytest.raises(cosim.InputError, match="pump 'main', whose chamber is at a given pressure"):
        cosim.run(scenario(tmp_path, PUMP, PYTHON, INFLATE, given), controllers=mine)


def test_the_controller_of_the_document_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = (ROOT / "docs" / "actuation.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", document, re.DOTALL)
    text = scenario(tmp_path, PYTHON.replace("mine", "pulse"), INFLATE, PULL + 'control = ["pulse"]\n')
    (tmp_path / "mine.toml").write_text(scenario_text(text).replace("corner_0", "a"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(code, {"__name__": "example"})


def test_a_pi_controller_brings_the_angle_to_its_setpoint(tmp_path: Path) -> None:
    bend = PULL + "control_bending_angle_rad = { bend = 0.1 }\n"
    result = cosim.run(scenario(tmp_path, CONTROLLER, INFLATE, bend, overrides={"phase.pull.settle_s": 2.6}))
    figures = last_phase(result)["controllers"]["bend"]
    assert figures["setpoint"] == 0.1
    assert figures["measured"] == pytest.approx(0.1, abs=0.005)
    assert figures["measured"] == pytest.approx(result.bending_angle_rad[-1])
    assert figures["settling_time_s"] < 2.5


def test_a_run_saved_among_devices_goes_on_bit_for_bit(tmp_path: Path) -> None:
    pumped = (
        '[[phase]]\nname = "p"\nduration_s = 0.6\ngas = "sealed"\npump_pressure_Pa = { main = 2.2e4 }\n'
        "control_bending_angle_rad = { bend = 0.1 }\ncable_shortening_m = { corner_1 = 0.002 }\n"
    )
    given = scenario(tmp_path, PUMP, WINCH, CONTROLLER, INFLATE, pumped)
    plain = build_simulation(given)
    steps = plain.steps()
    list(islice(steps, 160))
    state = plain.save_state()
    save(tmp_path / "state.npz", state)
    expected = [(s.node_position.tobytes(), repr(s.devices)) for s in steps]
    fewer = build_simulation(scenario(tmp_path, WINCH, CONTROLLER, INFLATE, PULL))
    with pytest.raises(cosim.InputError, match=r"state\.pumps has 1 entries, here it has 0"):
        fewer.restore_state(state)
    other = build_simulation(given)
    other.restore_state(load(tmp_path / "state.npz"))
    found = [(s.node_position.tobytes(), repr(s.devices)) for s in other.steps()]
    # a branch follows its own scenario from there on
    changed = {
        "phase.p.control_bending_angle_rad.bend": 0.15,
        "phase.p.pump_pressure_Pa.main": 2.3e4,
        "phase.p.cable_shortening_m.corner_1": 0.004,
    }
    branch = build_simulation(load_scenario(given, changed))
    branch.restore_state(state)
    last = list(branch.steps())[-1].devices
    assert last is not None
    assert (last.controls[0].setpoint, last.pumps[0].setpoint_Pa) == (0.15, 2.3e4)
    ended = plain.save_state().parts["cables"][1].wanted
    assert branch.save_state().parts["cables"][1].wanted == pytest.approx(ended - 0.002)
    assert state.parts["pumps"][0].pump.starts > 0
    assert state.parts["cables"][1].winch.commanded > 0
    assert len(found) == len(expected) == 91
    assert found == expected


def test_figures_of_a_controlled_phase() -> None:
    time_s = np.linspace(0.0, 10.0, 10001)
    response = 2.0 - 2.0 * np.exp(-time_s) * np.cos(3.0 * time_s)
    figures = control_figures(time_s, response, 2.0)
    assert figures["overshoot"] == pytest.approx(2.0 * np.exp(-np.pi / 3.0), rel=0.06)
    # the envelope e^-t falls below 0.05 at t = 3.0, the last swing beyond it is at most half a period earlier
    assert 3.0 - np.pi / 3.0 < figures["settling_time_s"] <= 3.0
    assert control_figures(time_s, np.sin(20.0 * time_s) - 0.0, 1.0)["settling_time_s"] is None
    assert control_figures(time_s, np.sin(20.0 * time_s), 1.0)["ripple"] == pytest.approx(1.0, abs=1e-3)


def test_every_key_of_the_devices_is_documented(tmp_path: Path) -> None:
    document = (ROOT / "docs" / "actuation.md").read_text(encoding="utf-8")
    pumped = (
        '[[phase]]\nname = "p"\nduration_s = 0.1\ngas = "sealed"\npump_pressure_Pa = { main = 2e4 }\n'
        "control_bending_angle_rad = { bend = 0.1 }\ncable_shortening_m = { corner_1 = 0.0 }\n"
    )
    devices = last_phase(cosim.run(scenario(tmp_path, PUMP, WINCH, CONTROLLER, INFLATE, pumped)))["devices"]
    for table in (devices, devices["pumps"]["main"], devices["controllers"]["bend"]):
        assert all(f"`{key}`" in document for key in table)


def test_the_resolved_scenario_loads_again(tmp_path: Path) -> None:
    pumped = '[[phase]]\nname = "p"\nduration_s = 1.0\ngas = "sealed"\npump_pressure_Pa = { main = 2e4 }\n'
    given = scenario(tmp_path, PUMP, WINCH, CONTROLLER, INFLATE, PULL + SHORTER, pumped)
    copy = tmp_path / "copy.toml"
    copy.write_text(scenario_text(given), encoding="utf-8")
    assert load_scenario(copy) == given
