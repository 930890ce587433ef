"""`Simulation.step(command)`: what is commanded from outside, step by step, and what is measured then."""

from __future__ import annotations

import pickle
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim import Command
from cosim.errors import InputError, InstabilityError, ScenarioError, UnreachableError
from tests.devices import device_parts

TICK_s = 0.004
HELD = """
[[phase]]
name = "inflate"
duration_s = 0.04
pressure_Pa = 20e3
"""
SEALED = """
[[phase]]
name = "seal"
duration_s = 0.4
gas = "sealed"
"""
ARM: dict[str, Any] = {
    "model.published": True,
    "fidelity": "rigid",
    "clock.tick_s": TICK_s,
    "contact.enabled": False,
    "phase": [],
}


def held(tmp_path: Path, *parts: str) -> cosim.Simulation:
    """Return a simulation of a small film without an arm, inflated."""
    # a film that follows commands within a few ticks; by BDF2 it swings
    changes = {"start.pressure_Pa": 20e3, "solver.integrator": "implicit_euler"}
    here = cosim.Simulation(device_parts.scenario(tmp_path, *parts), overrides=changes)
    here.step(1)
    return here


def standing() -> cosim.Simulation:
    """Return a simulation of an arm with a rigid soft robot, without phases."""
    return cosim.Simulation("ur5e_hexagon_arm", overrides=ARM)


def test_without_phases_it_rests_until_it_is_commanded() -> None:
    here = standing()
    first = here.snapshot
    assert here.step(50).tick == 50
    np.testing.assert_allclose(here.snapshot.tip_position, first.tip_position, atol=1e-4)
    assert repr(here) == "Simulation of ur5e_hexagon_arm, dynamic: tick 50, 0.2 s"
    with pytest.raises(ScenarioError, match=r"phase: is missing: the scenario holds its start"):
        cosim.run("ur5e_hexagon_arm", overrides=ARM)
    with pytest.raises(ScenarioError, match=r"mode: 'quasistatic' follows the increments of phases"):
        cosim.Simulation("ur5e_hexagon_arm", overrides={**ARM, "mode": "quasistatic"})


def test_values_are_reached_evenly_and_held(tmp_path: Path) -> None:
    here = held(tmp_path)
    command = Command(pressure_Pa={"chamber": 16e3}, cable_tension_N={"corner_0": 0.4})
    here.step(command, ticks=4)
    assert here.measure().pressure_Pa == (16e3,)
    assert here.measure().cable_tension_N == {"corner_0": 0.4, "corner_1": 0.0}
    here.step(Command(cable_tension_N={"corner_1": 0.2}), ticks=2)
    halfway = here.step(Command(pressure_Pa={"chamber": 20e3}), ticks=1)
    assert halfway.pressure_Pa == 20e3
    assert here.measure().cable_tension_N == {"corner_0": 0.4, "corner_1": 0.2}
    together, one_by_one = held(tmp_path), held(tmp_path)
    last = together.step(command, ticks=4)
    for k in range(1, 5):
        values = {"chamber": 20e3 - 1e3 * k}, {"corner_0": 0.1 * k}
        each = one_by_one.step(Command(pressure_Pa=values[0], cable_tension_N=values[1]), ticks=1)
    np.testing.assert_allclose(each.node_position, last.node_position, atol=1e-9)  # rounding of the shares
    # so is what is commanded once more
    last = together.step(Command(pressure_Pa={"chamber": 12e3}), ticks=4)
    for k in range(1, 5):
        each = one_by_one.step(Command(pressure_Pa={"chamber": 16e3 - 1e3 * k}), ticks=1)
    np.testing.assert_allclose(each.node_position, last.node_position, atol=1e-9)


def test_lengths_go_through_winches(tmp_path: Path) -> None:
    here = held(tmp_path, device_parts.WINCH, SEALED)
    before = here.measure().cable_unstretched_m["corner_0"]
    here.step(Command(cable_length_m={"corner_0": before - 0.02}), ticks=5)
    after = here.measure()
    # the winch makes at most 1000 steps of 0.3 mm a second, and loses those that pull too hard
    assert before - after.cable_unstretched_m["corner_0"] == pytest.approx(0.02)  # asked for
    assert after.cable_tension_N["corner_0"] > 0.0
    drive = here.snapshot.devices
    assert drive is not None
    wound = before - drive.unstretched_m[0]
    assert 5 * TICK_s * 1000.0 * 3e-4 * (1.0 + 1e-9) >= wound > 1e-3


def test_a_length_is_commanded_where_no_device_is(tmp_path: Path) -> None:
    here = held(tmp_path)
    here.step(Command(cable_tension_N={"corner_1": 0.1}), ticks=2)
    before = here.measure()
    here.step(Command(cable_length_m={"corner_0": before.cable_unstretched_m["corner_0"] - 0.004}), ticks=4)
    after = here.measure()
    assert after.cable_tension_N["corner_0"] > 0.1
    assert after.cable_tension_N["corner_1"] == 0.1
    saved = here.save()
    ahead = here.step(3)
    here.restore(saved)
    np.testing.assert_array_equal(here.step(3).node_position, ahead.node_position)


def test_gas_is_let_in_where_it_is_sealed(tmp_path: Path) -> None:
    here = held(tmp_path, SEALED)
    before = here.measure()
    (amount,) = before.gas_kg
    assert amount is not None
    here.step(Command(gas_kg={"chamber": 1.02 * amount}), ticks=4)
    after = here.measure()
    assert after.gas_kg == pytest.approx((1.02 * amount,))
    assert after.pressure_Pa[0] > before.pressure_Pa[0] + 500.0
    with pytest.raises(InputError, match=r"pressure_Pa of 'chamber', in which gas is sealed; command gas_kg"):
        here.step(Command(pressure_Pa={"chamber": 1e3}), ticks=4)
    with pytest.raises(InputError, match=r"gas_kg of 'chamber' is 1e\+308: .*; the chamber holds"):
        here.step(Command(gas_kg={"chamber": 1e308}))
    with pytest.raises(InputError, match=r"gas_kg of 'chamber', whose pressure is given"):
        held(tmp_path, HELD).step(Command(gas_kg={"chamber": 1e-4}), ticks=4)


def test_the_flange_follows_a_twist_and_then_stops() -> None:
    here = standing()
    start = here.measure().flange.translation
    for _ in range(20):
        here.step(Command(flange_twist=(0.05, 0.0, -0.02, 0.0, 0.0, 0.0)), ticks=5)
    moving = here.measure()
    np.testing.assert_allclose(moving.flange_twist[:3], [0.05, 0.0, -0.02], atol=2e-3)
    np.testing.assert_allclose(moving.tip_twist[:3], [0.05, 0.0, -0.02], atol=5e-3)
    assert moving.limits == ()
    here.step(Command(), ticks=100)
    stands = here.measure()
    np.testing.assert_allclose(stands.flange.translation - start, [0.02, 0.0, -0.008], atol=2e-4)
    np.testing.assert_allclose(stands.flange_twist, np.zeros(6), atol=2e-3)


def test_a_pose_or_joints_are_reached() -> None:
    here = standing()
    pose = here.measure().flange
    wanted = cosim.Pose(pose.rotation, pose.translation + np.array([0.0, 0.03, 0.02]))
    here.step(Command(flange=wanted), ticks=100)
    here.step(100)
    reached = here.measure()
    np.testing.assert_allclose(reached.flange.translation, wanted.translation, atol=2e-4)
    joints = reached.joint_position + 0.05
    here.step(Command(joint_position=joints), ticks=50)
    here.step(100)
    np.testing.assert_allclose(here.measure().joint_position, joints, atol=1e-3)


def test_what_a_joint_cannot_do_is_cut_down_and_named() -> None:
    here = standing()
    bound = float(here.stage.arm.limits.velocity[0]) if here.stage.arm else 0.0
    joints = here.measure().joint_position.copy()
    joints[0] += 1.0
    here.step(Command(joint_position=joints), ticks=5)
    (named, *_) = here.measure().limits
    assert named.startswith("speed of shoulder_pan_joint: a command asks for more than 3.14 rad/s")
    ticks = int(np.ceil(1.0 / bound / TICK_s))
    here.step(ticks)  # it goes on to where it was sent
    assert here.snapshot.joint_target[0] == pytest.approx(joints[0])
    joints[0] = 7.0
    here.step(Command(joint_position=joints), ticks=500)
    assert (
        here.measure().limits[0].startswith("position of shoulder_pan_joint: 7 was asked for, held at 6.28")
    )


@pytest.mark.parametrize(
    ("command", "kind", "text"),
    [
        (Command(pressure_Pa={"bladder": 1.0}), InputError, "pressure_Pa of 'bladder'; there are: chamber"),
        (Command(cable_tension_N={"right": -1.0}), InputError, "'right' is -1; must be at least 0"),
        (Command(flange_twist=(np.nan,) * 6), InstabilityError, "flange_twist is .*nan"),
        (Command(joint_position=[0.0]), InputError, "joint_position has 1 numbers; must be 6"),
        (Command(cable_length_m={"right": 0.1}), InputError, "fidelity = 'rigid' keeps its shape"),
        (Command(flange_twist=[0.0] * 6, joint_position=[0.0] * 6), InputError, "give one"),
        (Command(flange=cosim.Pose(translation=[3.0, 0.0, 0.0])), UnreachableError, "reach"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_has_moved(command: Command, kind: type, text: str) -> None:
    here = standing()
    with pytest.raises(kind, match=text):
        here.step(command, ticks=5)
    assert here.snapshot.tick == 0
    other = standing()
    np.testing.assert_array_equal(here.step(3).joint_position, other.step(3).joint_position)


def test_motion_is_refused_where_contact_was_left_out_by_the_plan() -> None:
    phases = [{"name": "stand", "duration_s": 1.0}]
    here = cosim.Simulation("ur5e_hexagon_arm", overrides={**ARM, "contact.enabled": True, "phase": phases})
    with pytest.raises(InputError, match=r"set contact.only_in_reach = false"):
        here.step(Command(flange_twist=(0.0, 0.0, -0.1, 0.0, 0.0, 0.0)), ticks=5)


def test_a_saved_simulation_continues_as_commanded() -> None:
    here = standing()
    here.step(Command(flange_twist=(0.05, 0.0, 0.0, 0.0, 0.0, 0.0)), ticks=5)
    joints = here.measure().joint_position + 0.3
    here.step(Command(joint_position=joints), ticks=5)  # still on its way
    saved = pickle.loads(pickle.dumps(here.save()))
    seen = here.measure()
    ahead = here.step(20)
    here.restore(saved)
    for name in (entry.name for entry in fields(cosim.Measurement)):
        assert repr(getattr(here.measure(), name)) == repr(getattr(seen, name)), name
    np.testing.assert_array_equal(here.step(20).joint_position, ahead.joint_position)
    branch = cosim.Simulation("ur5e_hexagon_arm", overrides=ARM, start=saved)
    np.testing.assert_array_equal(branch.step(20).joint_position, ahead.joint_position)


def test_what_is_measured_is_what_the_snapshot_shows() -> None:
    here = standing()
    shown = here.step(Command(flange_twist=(0.05, 0.0, 0.0, 0.0, 0.0, 0.1)), ticks=5)
    seen = here.measure()
    assert seen.time_s == shown.time_s
    np.testing.assert_array_equal(seen.joint_position, shown.joint_position)
    np.testing.assert_array_equal(seen.joint_torque, shown.joint_torque)
    np.testing.assert_array_equal(seen.tip_position, shown.tip_position)
    np.testing.assert_array_equal(seen.flange_wrench.force, shown.wrench.force)
    np.testing.assert_array_equal(seen.flange.translation, shown.world_from_flange.translation)
    assert tuple(seen.body_pose) == here.stage.body_names
    k = 3
    pose = seen.body_pose[here.stage.body_names[k]]
    np.testing.assert_array_equal(pose.translation, shown.body_position[k])
    np.testing.assert_allclose(pose.quaternion, shown.body_quaternion[k], atol=1e-12)
    assert repr(seen.body_pose) == repr(dict(pickle.loads(pickle.dumps(seen.body_pose))))
    with pytest.raises(KeyError, match=r"there is no rigid body 'roll'; there are: world, "):
        seen.body_pose["roll"]


def test_a_step_that_fails_in_a_simulation_without_an_end_is_named(tmp_path: Path) -> None:
    """What was computed until then is shown with the error, whatever number of ticks could still come."""
    here = held(tmp_path)
    with pytest.raises(cosim.SolverError):
        here.step(Command(pressure_Pa={"chamber": 1e308}), ticks=1)
