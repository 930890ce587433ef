"""A tray that a soft arm on a palm lifts off two posts: legs on the palm, its plate on the film's tip."""

from __future__ import annotations

TRAY_KG = 0.3
PALM_KG = 0.5
SCENARIO = """
schema = 2
title = "A tray is lifted and put down"
robot = "ur5e"
soft_robot = { file = "square_core", palm = { radius_m = 0.09, thickness_m = 0.01, mass_kg = 0.5 } }
model.published = true

[clock]
tick_s = 0.004

[solver]
damping_per_s = 30.0

[start]
flange = { position_m = [0.4, 0.0, 0.45], direction = [0.0, 0.0, 1.0] }
pressure_Pa = 20e3

[[object]]
name = "left_post"
shape = "box"
size_m = [0.06, 0.02, 0.02]
position_m = [0.4, 0.12, 0.4945]

[[object]]
name = "right_post"
shape = "box"
size_m = [0.06, 0.02, 0.02]
position_m = [0.4, -0.12, 0.4945]

[[object]]
name = "tray"
shape = "box"
size_m = [0.14, 0.28, 0.006]
position_m = [0.4, 0.0, 0.5075]
mass_kg = 0.3
LEGS
[[phase]]
name = "lift"
duration_s = 0.3
pressure_Pa = 20e3
flange_shift_m = [0.0, 0.0, 0.025]

[[phase]]
name = "hold"
duration_s = 0.3
""".replace(
    "LEGS",
    "".join(
        f"[[object.part]]\nshape = 'box'\nsize_m = [0.01, 0.01, 0.033]\nposition_m = [{x}, {y}, -0.0195]\n"
        for x in (0.05, -0.05)
        for y in (0.05, -0.05)
    ),
)
"""The plate's lower side is 33 mm above the palm when the legs stand on it; the tip at rest is 34.9 mm."""
DOWN = """
[[phase]]
name = "lower"
duration_s = 0.3
settle_s = 0.2
flange_shift_m = [0.0, 0.0, -0.03]
"""
