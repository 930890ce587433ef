"""Wrong devices are refused with the path of the key, before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

import cosim
from cosim.config.loading import load_scenario
from tests.devices.device_parts import BASE, CONTROLLER, INFLATE, PULL, PUMP, SHORTER, WINCH

FOLLOWER = """
[[controller]]
name = "bend"
kind = "pi"
period_s = 0.02
measures = "tip_position_m"
commands = "flange_twist"
proportional_gain = 0.0
integral_gain_per_s = 3.0
"""


@pytest.mark.parametrize(
    ("parts", "text"),
    [
        ((PULL + 'cable_length_m = { corner_9 = 0.1 }\n',), r"phase\.pull\.cable_length_m: .*corner_0"),
        ((PULL + "cable_length_m = { corner_0 = 0.0 }\n",), r"cable_length_m\.corner_0: .*above 0"),
        ((PULL + "cable_length_m = 0.1\n",), r"cable_length_m: expected a table"),
        ((PULL + SHORTER + "cable_tension_N = [0.0, 0.0]\n",), r"cable_shortening_m: .*cable_tension_N"),
        ((PULL + SHORTER + "cable_length_m = { corner_0 = 0.1 }\n",), "of the same cable"),
        ((WINCH, WINCH.replace("steppers", "more"), PULL), r"winch\.more\.cables: .*'steppers' already"),
        ((WINCH, WINCH, PULL), r"winch\.steppers: .*used twice"),
        ((WINCH.replace("corner_1", "x"), PULL), r"winch\.steppers\.cables"),
        (("fidelity='rigid'\n", PULL + SHORTER), r"pull\.cable_shortening_m: .*'rigid' keeps its shape"),
        (("mode='quasistatic'\n", WINCH, PULL), r"winch\.steppers: .*dynamic"),
        ((PUMP, PULL + "pump_pressure_Pa = { main = 1e3 }\n"), r"pump_pressure_Pa\.main: needs gas"),
        ((PULL + 'gas = "sealed"\npump_pressure_Pa = { main = 1e3 }\n',), r"pump_pressure_Pa\.main: .*pump"),
        ((PUMP + 'chamber = "left"\n', PULL), r"pump\.main\.chamber: .*left"),
        ((PUMP + "vent_above_Pa = 1e3\n", PULL), r"pump\.main\.vent_kg_s_Pa: .*nothing through"),
        ((CONTROLLER.replace("0.02", "0.021"), PULL), r"controller\.bend\.period_s: .*whole number of ticks"),
        ((CONTROLLER.replace("integral", "proporti"), PULL), r"controller\.bend\.proporti"),
        ((CONTROLLER.replace('"pi"', '"bang_bang"'), PULL), r"controller\.bend\.increment: is missing"),
        ((CONTROLLER + "output_min = -1.0\n", PULL), r"controller\.bend\.output_min: .*push"),
        ((CONTROLLER + "output_min = 0.5\n", PULL), r"controller\.bend\.output_max: .*above output_min"),
        ((CONTROLLER.replace("corner_0", "x"), PULL), r"controller\.bend\.cables"),
        ((CONTROLLER, PULL + "control_tip_height_m = { bend = 0.1 }\n"), "measures bending_angle_rad"),
        ((CONTROLLER, PULL + 'control = ["bend"]\n'), r"phase\.pull\.control: 'bend' needs a setpoint"),
        ((CONTROLLER, PULL + "control_bending_angle_rad = { x = 0.1 }\n"), r"control_bending_angle_rad\.x"),
        ((CONTROLLER + 'commands = "flange_twist"\n', PULL), r"controller\.bend\.commands: .*go together"),
        ((FOLLOWER, PULL), r"controller\.bend\.commands: .*needs an arm"),
        ((FOLLOWER + 'cables = ["corner_0"]\n', PULL), r"controller\.bend\.cables: .*leave them out"),
        (
            (CONTROLLER, PULL + SHORTER + "control_bending_angle_rad = { bend = 0.1 }\n"),
            r"control_bending_angle_rad\.bend: moves cable 'corner_0'",
        ),
        (
            (CONTROLLER, PULL + "cable_tension_N = [0, 0]\ncontrol_bending_angle_rad = { bend = 0.1 }\n"),
            "cable_tension_N commands in the same phase",
        ),
        (
            (INFLATE, PULL + SHORTER + 'tip_target = { height_m = 0.04, reach_with = "cables" }\n'),
            r"phase\.pull\.tip_target: .*commanded cable length",
        ),
    ],
)  # fmt: skip
def test_wrong_devices_are_refused(tmp_path: Path, parts: tuple[str, ...], text: str) -> None:
    front = "".join(part for part in parts if part.startswith(("mode", "fidelity")))
    path = tmp_path / "wrong.toml"
    path.write_text(front + BASE + "".join(part for part in parts if part != front), encoding="utf-8")
    with pytest.raises(cosim.ScenarioError, match=text):
        load_scenario(path)
