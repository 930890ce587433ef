"""A mobile base brakes: the tip swings on, by a rail of a scenario, and in a model that is built by hand."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

import cosim
from cosim.base.frames import Array

LED = """
<mujoco><option timestep="0.004"/><worldbody>
  <body name="flange" mocap="true" pos="{0} {1} {2}" quat="{3} {4} {5} {6}"/>
</worldbody></mujoco>"""
CART = """
<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody>
  <body name="cart" pos="0 0 1"><joint name="rail" type="slide" axis="1 0 0"/>
    <geom type="box" size="0.1 0.1 0.05" mass="20"/><site name="mount" euler="180 0 0"/></body>
</worldbody><actuator><velocity joint="rail" kv="4000"/></actuator></mujoco>"""
GIVEN: dict[str, Any] = {"solver.damping_per_s": 2.0, "start.pressure_Pa": 3e3}
ROBOT = "square_core"


def led(way: list[tuple[Array, Array]]) -> tuple[Array, cosim.Attached]:
    """Return the tip (ticks, 3) of a soft robot on a base that goes a way of positions and quaternions."""
    spec = mujoco.MjSpec.from_string(LED.format(*way[0][0], *way[0][1]))
    soft = cosim.attach(spec, "flange", ROBOT, overrides=GIVEN)
    model = spec.compile()
    data = mujoco.MjData(model)
    soft.reset(model, data)
    tips = []
    for position, quaternion in way[1:]:
        data.mocap_pos[0], data.mocap_quat[0] = position, quaternion
        soft.step(model, data)
        tips.append(soft.tip_position)
    return np.array(tips), soft


def test_an_arm_on_a_rail_that_brakes_swings_as_one_whose_flange_is_led() -> None:
    """Both engines of the exchange go the same way: the arm that gives way a little, and the led flange."""
    rail = [{"axis": [1.0, 0.0, 0.0], "range_m": [-1.0, 1.0], "speed_m_s": 1.0, "acceleration_m_s2": 10.0}]
    phases = [{"name": "brake", "duration_s": 0.2, "settle_s": 0.2, "ramp": "linear"}]
    phases[0]["joint_shift_m"] = {"rail": 0.06}
    phases[0]["flange_shift_m"] = [0.06, 0.0, 0.0]
    changes = {
        "soft_robot": ROBOT, "start.cable_tension_N": [], "arm_base": {"rail": rail}, "clock.tick_s": 0.004,
        "start.joint_shift_m": {"rail": 0.0}, "phase": phases, "contact.enabled": False, **GIVEN,
    }  # fmt: skip
    simulation = cosim.Simulation("ur5e_hexagon_arm", overrides=changes)
    start = simulation.snapshot
    snapshots = [start, *(simulation.step() for _ in range(100))]
    way = []
    for seen in snapshots:
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, seen.world_from_flange.rotation.ravel())
        way.append((seen.world_from_flange.translation, quaternion))
    tips, _ = led(way)
    expected = np.array([seen.tip_position for seen in snapshots[1:]])
    np.testing.assert_allclose(tips, expected, rtol=0.0, atol=1e-9)
    swing = expected[:, 0] - np.array([place[0] for place, _ in way[1:]])
    assert np.ptp(swing[50:]) > 1e-3  # it swings on after the brake
    assert np.abs(np.diff([seen.joint_position[0] for seen in snapshots])).max() > 1e-3


def test_a_cart_that_brakes_swings_its_tip_as_a_base_that_is_led_like_it() -> None:
    """The film pulls on the cart's servo; led the same way, it swings the same."""
    spec = mujoco.MjSpec.from_string(CART)
    soft = cosim.attach(spec, "mount", ROBOT, overrides=GIVEN)
    model = spec.compile()
    data = mujoco.MjData(model)
    soft.reset(model, data)
    way, tips = [], []

    def keep() -> None:
        mujoco.mju_mat2Quat(quaternion := np.empty(4), data.site_xmat[0])
        way.append((data.site_xpos[0].copy(), quaternion))

    keep()
    for step in range(100):
        data.ctrl[0] = 0.3 * min(step / 10, 1.0, max(0.0, (60 - step) / 10))
        soft.step(model, data)
        keep()
        tips.append(soft.tip_position)
    found, other = led(way)
    np.testing.assert_allclose(found, tips, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(other.wrench.force, soft.wrench.force, rtol=0.0, atol=1e-7)
    swing = found[:, 0] - np.array([place[0] for place, _ in way[1:]])
    assert np.ptp(swing[65:]) > 1e-3
