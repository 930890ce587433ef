"""Parts of scenario files with devices that tests put together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario

TICK_s = 0.004
BASE = f"""
schema = 2
title = "Three square units with devices"
robot = "none"
soft_robot = "square_core_cables"
model.published = true
gravity_m_s2 = [0.0, 0.0, 0.0]
clock.tick_s = {TICK_s}
solver.damping_per_s = 20.0
[start]
flange = {{ position_m = [0.0, 0.0, 0.0], direction = [0.0, 0.0, 1.0] }}
"""
INFLATE = """
[[phase]]
name = "inflate"
duration_s = 0.4
increments = 60
pressure_Pa = 20e3
"""
PULL = """
[[phase]]
name = "pull"
duration_s = 0.4
settle_s = 0.4
increments = 20
"""
WINCH = """
[[winch]]
name = "steppers"
cables = ["corner_0", "corner_1"]
step_angle_rad = 0.03
drum_radius_m = 0.01
step_rate_per_s = 1000.0
stall_torque_Nm = 0.1
"""
PUMP = """
[[pump]]
name = "main"
flow_kg_s = 2e-5
band_Pa = 200.0
sensor_delay_s = 0.02
"""
CONTROLLER = """
[[controller]]
name = "bend"
kind = "pi"
period_s = 0.02
cables = ["corner_0"]
proportional_gain = 0.2
integral_gain_per_s = 2.0
output_max = 0.5
"""
SHORTER = "cable_shortening_m = { corner_0 = 0.006 }\n"
PYTHON = '[[controller]]\nname = "mine"\nkind = "python"\nperiod_s = 0.1\n'
STIFFNESS = 1e4


def scenario(tmp_path: Path, *parts: str, overrides: Mapping[str, Any] | None = None) -> Scenario:
    path = tmp_path / "devices.toml"
    path.write_text(BASE + "".join(parts), encoding="utf-8")
    return load_scenario(path, overrides)
