"""Two soft robots on two arms of one scene touch one object: what each gives, and what all have together."""

from __future__ import annotations

import mujoco
import numpy as np

import cosim
from tests.app.test_attach import EXACT

ARMS = """
<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
  <body name="left" pos="-0.0472 0 0"><freejoint/>
    <geom type="box" size="0.02 0.05 0.05" mass="2" contype="0" conaffinity="0"/>
    <site name="left_tool" euler="0 90 0"/></body>
  <body name="right" pos="0.0473 0 0.01"><freejoint/>
    <geom type="box" size="0.02 0.05 0.05" mass="2" contype="0" conaffinity="0"/>
    <site name="right_tool" euler="0 -90 0"/></body>
  <body name="box"><freejoint/><geom type="box" size="0.03 0.05 0.05" mass="0.3"/></body>
</worldbody></mujoco>"""
SPEEDS = {"left": 0.1, "right": -0.06, "box": 0.0}  # towards one another


def test_two_soft_robots_that_press_one_object_conserve_momentum() -> None:
    """That of arms, films and object, and of wrenches and contact forces on their way."""
    called = "left", "right"
    spec, given = mujoco.MjSpec.from_string(ARMS), EXACT | {"start.pressure_Pa": 2e3}
    pair = {name: cosim.attach(spec, f"{name}_tool", "square_core", overrides=given) for name in called}
    model = spec.compile()
    data = mujoco.MjData(model)
    for soft in pair.values():
        soft.reset(model, data)
    bodies = {name: (float(model.body(name).mass[0]), int(model.body(name).dofadr[0])) for name in SPEEDS}
    for name, (_, first) in bodies.items():
        data.qvel[first] = SPEEDS[name]
    h, films = pair["left"].tick_s, {name: soft.film for name, soft in pair.items()}
    momentum, moved, touched = [], 0.0, dict.fromkeys(called, 0)
    for _ in range(22):
        speeds = data.qvel.copy()
        for soft in pair.values():
            soft.before(model, data)
        mujoco.mj_step(model, data)
        for soft in pair.values():
            soft.after(model, data)
        total = np.sum([mass * data.qvel[k : k + 3] for mass, k in bodies.values()], axis=0)
        for name, soft in pair.items():
            film, forces = soft.film, soft.measure().contact_force_N
            total += soft.node_mass_kg @ (film - films[name]) / h + h * soft.wrench.force
            total += h * forces["box"]
            films[name] = film
            assert soft.ledger.momentum_error < 1e-10
            touched[name] += soft.ledger.contacts > 0
        momentum.append(total)
        moved += sum(mass * abs(float(data.qvel[k] - speeds[k])) for mass, k in bodies.values())
    assert min(touched.values()) >= 8
    assert moved > 0.01
    np.testing.assert_allclose(momentum, [momentum[0]] * 22, rtol=0.0, atol=1e-10)
