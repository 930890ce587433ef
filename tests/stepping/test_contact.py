"""A soft robot that presses on an object of its scenario; a gripper that lifts one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.app.preparation import build_simulation
from cosim.config.loading import load_scenario
from cosim.errors import InputError
from cosim.telemetry.texts.summary_markdown import summary_markdown

SCENARIO = """
schema = 2
title = "An inflated core is lowered onto a block"
robot = "ur5e"
soft_robot = "square_core"
model.published = true
recording = { frames_per_s = 10.0 }
solver = { damping_per_s = 20.0 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }

[[object]]
name = "block"
shape = "box"
size_m = [0.2, 0.2, 0.1]
position_m = [0.4, 0.0, 0.407]

[[phase]]
name = "inflate"
duration_s = 0.4
pressure_Pa = 10e3

[[phase]]
name = "press"
duration_s = 0.4
settle_s = 0.8
flange_shift_m = [0.0, 0.0, -0.01]
"""


def run(tmp_path: Path, **overrides: Any) -> cosim.RunResult:
    """Return the run of the scenario with changes."""
    path = tmp_path / "press.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return cosim.run(path, overrides=overrides)


HIT = """
schema = 2
title = "A ball falls on an inflated core"
robot = "ur5e"
soft_robot = "square_core"

[start]
flange = { position_m = [0.5, 0.0, 0.5], direction = [1.0, 0.0, 0.0] }
pressure_Pa = 20e3

[[object]]
name = "ball"
shape = "sphere"
size_m = [0.02]
position_m = [0.525, 0.0, 1.5]  # 5 mm clear of the arm's last link
mass_kg = 0.05
friction = 0.0

[[phase]]
name = "fall"
duration_s = 0.504
"""


def hit(tmp_path: Path, **overrides: Any) -> cosim.RunResult:
    """Return the run of a ball that falls on a film."""
    path = tmp_path / "hit.toml"
    path.write_text(HIT, encoding="utf-8")
    return cosim.run(
        path, overrides={name.replace("__", "."): x for name, x in overrides.items()}, error=False
    )


@pytest.mark.parametrize("tick_s", [8e-3, 4e-3])
def test_the_force_of_a_hit_is_the_impulse_that_the_ball_gets_over_the_tick(
    tmp_path: Path, tick_s: float
) -> None:
    result = hit(tmp_path, clock__tick_s=tick_s)
    ball, mass_kg = result.body("ball"), 0.05
    (told,) = result.summary["touched"]
    forces = result.body_contact_force[:, ball]
    assert told["body"] == "ball"
    assert told["impulse_Ns"] == pytest.approx((tick_s * forces[1:].sum(axis=0)).tolist(), abs=1e-12)
    assert told["duration_s"] == pytest.approx(tick_s * np.count_nonzero(forces.any(axis=1)))
    assert told["mean_force_N"] * told["duration_s"] == pytest.approx(np.linalg.norm(told["impulse_Ns"]))
    # its momentum: speed over the last tick, in which MuJoCo's is off by the weight of a tick at most
    speed = (result.body_position[-1, ball, 2] - result.body_position[-2, ball, 2]) / tick_s
    momentum = mass_kg * (speed + 9.81 * result.time_s[-1])
    assert told["impulse_Ns"][2] == pytest.approx(momentum, abs=mass_kg * 9.81 * tick_s)
    # 3013 N at 8 ms and 59 N at 4 ms, of forces at the end of a tick that the ball did not get
    largest = float(np.linalg.norm(forces, axis=1).max())
    assert told["max_force_N"] == pytest.approx(largest)
    # the sum of normal forces, which point apart where the ball is in the film
    assert largest < result.summary["max_contact_force_N"] < 1.3 * largest
    assert (told["max_over_s"], told["hit"]["speed_m_s"]) == (tick_s, pytest.approx(4.2, rel=0.1))
    assert f"over one tick of {1e3 * tick_s:g} ms" in summary_markdown(result.summary)


def test_a_run_says_which_object_shortens_the_steps_of_the_arm(tmp_path: Path) -> None:
    path = tmp_path / "hit.toml"
    path.write_text(HIT, encoding="utf-8")
    for mass_kg, named in ((0.05, ["rigid steps of 1 ms for 'ball'"]), (20.0, [])):
        changes = {"clock.tick_s": 4e-3, "object.ball.mass_kg": mass_kg}
        rows = cosim.Simulation(path, overrides=changes).stage.modelled
        assert [row.what for row in rows if row.what.startswith("rigid steps")] == named


def test_the_tick_that_a_warning_names_resolves_the_hit(tmp_path: Path) -> None:
    near = {"object__ball__position_m": [0.52, 0.0, 0.72], "phase__fall__duration_s": 0.2}
    coarse = hit(tmp_path, clock__tick_s=8e-3, **near)
    (warning,) = [text for text in coarse.summary["warnings"] if "is not resolved" in text]
    (told,) = coarse.summary["touched"]
    named = told["hit"]["resolving_tick_s"]
    assert f"set clock.tick_s = {named:g}" in warning
    assert told["hit"]["way_m"] > 1e-3
    fine = hit(tmp_path, clock__tick_s=named, **near)
    assert not [text for text in fine.summary["warnings"] if "is not resolved" in text]
    assert fine.summary["touched"][0]["hit"] is None


def test_what_is_lost_between_ball_and_film_is_in_the_balance(tmp_path: Path) -> None:
    tick_s, mass_kg = 2e-3, 0.05
    result = hit(tmp_path, clock__tick_s=tick_s)
    weight = np.array([0.0, 0.0, -9.81 * mass_kg])
    gained = np.cumsum(tick_s * (result.body_contact_force[1:, result.body("ball")] + weight), axis=0)
    speed = np.vstack([np.zeros(3), gained]) / mass_kg
    # what the ball has got, less what its weight has done, by the mean speeds of ticks
    taken = 0.5 * mass_kg * float(speed[-1] @ speed[-1]) - tick_s * float(
        (0.5 * (speed[1:] + speed[:-1]) @ weight).sum()
    )
    energy = result.summary["phases"][-1]["energy"]
    assert energy["bodies_J"] == pytest.approx(-taken, rel=0.01)
    assert energy["bodies_J"] > 0.2
    assert energy["contact_loss_J"] == pytest.approx(energy["bodies_J"] - energy["contacts_J"], rel=1e-9)
    assert energy["contact_loss_J"] > 0.05 * energy["bodies_J"]
    assert abs(energy["rest_J"]) < 0.1 * energy["bodies_J"]  # film's forces jump from tick to tick


def test_the_flange_feels_what_the_block_bears(tmp_path: Path) -> None:
    result = run(tmp_path)
    assert result.contacts[0] == 0
    weight = result.summary["soft_weight_N"]
    borne = result.flange_force[-1, 2] + weight
    assert result.contact_force_N[-1] > 1.0
    # friction bears nothing upwards on a level block; what is left moves by less than this
    assert borne == pytest.approx(result.contact_force_N[-1], rel=0.01)
    assert 0.0 < result.contact_depth_m[-1] < 1e-3
    assert result.summary["max_contact_force_N"] == result.contact_force_N.max()
    assert "block" in result.stage.report
    # on a level block the normal forces are all of its load that is upright; no other body bears any
    block = result.body("block")
    # both are of the forces that acted in the tick
    np.testing.assert_allclose(-result.body_contact_force[:, block, 2], result.contact_force_N, atol=1e-9)
    assert not np.delete(result.body_contact_force, block, axis=1).any()
    np.testing.assert_allclose(result.body_position[:, block], [[0.4, 0.0, 0.407]] * len(result.tick))
    with pytest.raises(InputError, match=r"no body 'blok'; there are world, .*, block"):
        result.body("blok")


@pytest.mark.parametrize("scheme", ["staggered", "iterated"])
def test_action_equals_reaction_at_every_tick(tmp_path: Path, scheme: str) -> None:
    changes = {"coupling.scheme": scheme, "phase.press.settle_s": 0.0, "phase.press.duration_s": 0.2}
    changes |= {"coupling.tolerance": 1e-11}  # of all that makes up the load, which may nearly cancel
    result = run(tmp_path, **changes)
    assert result.contacts[-1] > 0
    assert result.summary["max_momentum_error"] < 1e-10
    iterated = scheme == "iterated"
    assert result.summary["iterated_ticks"] == (result.summary["ticks"] if iterated else 0)
    assert (result.summary["max_interface_power_error"] < 1e-8) is iterated
    assert result.summary["max_interface_trials"] <= 8
    assert scheme in result.stage.report


def test_switched_off_the_block_is_not_felt(tmp_path: Path) -> None:
    result = run(tmp_path, **{"contact.enabled": False})
    assert result.contacts.max() == 0
    assert result.flange_force[-1, 2] == pytest.approx(-result.summary["soft_weight_N"], rel=0.01)
    assert "switched off" in result.stage.report


@pytest.mark.parametrize("shape", [{"shape": "box"}, {"shape": "sphere", "size_m": [0.05]}])
def test_the_quasistatic_mode_presses_as_hard_as_the_dynamic_one_does_at_rest(
    tmp_path: Path, shape: dict[str, Any]
) -> None:
    block = {"name": "block", "size_m": [0.2, 0.2, 0.1], "position_m": [0.4, 0.0, 0.407], **shape}
    steps = {"phase.inflate.increments": 4, "phase.press.increments": 4}
    still = run(tmp_path, mode="quasistatic", object=[block], **steps)
    moved = run(tmp_path, object=[block])
    assert still.contacts[0] == 0
    assert still.contact_force_N[-1] == pytest.approx(moved.contact_force_N[-1], rel=5e-3)
    assert still.contact_depth_m[-1] == pytest.approx(moved.contact_depth_m[-1], rel=0.02)
    # without friction the level block bears upwards only, and all that the flange does not
    if shape["shape"] == "box":
        borne = still.flange_force[-1, 2] + still.summary["soft_weight_N"]
        assert borne == pytest.approx(still.contact_force_N[-1], rel=1e-6)
    assert "no friction" in still.stage.report
    pressed = np.linalg.norm(still.body_contact_force[:, still.body("block")], axis=1)
    assert pressed[-1] == pytest.approx(still.contact_force_N[-1], rel=0.02)
    # at rest the servos hold what they hold at the end of the motion; at its start, what they give after it
    np.testing.assert_allclose(still.joint_torque[-1], moved.joint_torque[-1], atol=0.05)
    np.testing.assert_allclose(moved.joint_torque[0], moved.joint_torque[1], atol=0.05)
    assert np.abs(still.joint_torque[-1]).max() > 10.0
    # MuJoCo moves the joints at the speed that they have at the end of the tick
    for result in (still, moved):
        speed = np.diff(result.joint_position, axis=0) / np.diff(result.time_s)[:, None]
        np.testing.assert_allclose(result.joint_velocity[1:], speed, atol=1e-9)
    assert moved.stage.joint_names[0] == "shoulder_pan_joint"
    assert moved.joint_velocity.max() > 0.01


def test_the_quasistatic_mode_leaves_out_what_can_move(tmp_path: Path) -> None:
    block = {"name": "block", "shape": "box", "size_m": [0.2, 0.2, 0.1], "position_m": [0.4, 0.0, 0.407]}
    steps = {"phase.inflate.increments": 2, "phase.press.increments": 2}
    result = run(tmp_path, mode="quasistatic", object=[{**block, "mass_kg": 1.0}], **steps)
    assert result.contacts.max() == 0


def test_a_gripper_lifts_a_roll_and_keeps_it() -> None:
    """100 g: drawn up against the palm, and lifted off its stand."""
    quick = [
        {"name": "inflate", "duration_s": 0.3, "pressure_Pa": 40e3},
        {"name": "lower", "duration_s": 0.3, "flange_shift_m": [0.0, 0.0, -0.142]},
        {"name": "close", "duration_s": 0.4, "cable_tension_N": [6.0] * 6},
        {"name": "lift", "duration_s": 0.3, "flange_shift_m": [0.0, 0.0, 0.05]},
    ]
    simulation = build_simulation(
        load_scenario("gripper_lifts_roll", {"model.published": True, "phase": quick})
    )
    roll = simulation.stage.body_names.index("roll")
    ends: dict[int, float] = {}
    for snapshot in simulation.steps():
        height = snapshot.body_position[roll, 2]
        ends[snapshot.phase] = height - snapshot.world_from_flange.translation[2]
    # the top of the roll, 45 mm above its middle, touches the palm 8 mm below the flange
    assert ends[2] == pytest.approx(-0.053, abs=1e-3)
    assert ends[3] == pytest.approx(ends[2], abs=1e-3)
    assert height > 0.245 + 0.05
    assert snapshot.contact_force_N > 0.1 * 9.81


@pytest.mark.long
def test_a_shake_does_not_pull_the_rim_of_a_roll_through_the_edge_of_a_finger() -> None:
    """Its corner jumped to the film's other face: 12.1 N of normal forces after 0.36 s for a net 10.3 N."""
    simulation, lifted_N, shaken_N = build_simulation(load_scenario("gripper_lifts_roll")), 0.0, []
    names = simulation.stage.phase_names
    for snapshot in simulation.steps():
        if names[snapshot.phase] == "lift":
            lifted_N = snapshot.contact_force_N
        elif names[snapshot.phase] == "shake":
            shaken_N.append(snapshot.contact_force_N)
        if len(shaken_N) == 125:  # half a second
            break
    # the roll, 100 g, is shaken by 0.3 N
    assert max(shaken_N) == pytest.approx(lifted_N, rel=0.03)


@pytest.mark.long
def test_default_fingers_draw_300_g_up_to_the_palm_and_lift_it() -> None:
    """With the palm 6 mm higher they slide off: the roll stays on its stand."""
    simulation = build_simulation(load_scenario("gripper_lifts_roll", {"object.roll.mass_kg": 0.3}))
    roll, names = simulation.stage.body_names.index("roll"), simulation.stage.phase_names
    ends: dict[str, float] = {}
    for snapshot in simulation.steps():
        if names[snapshot.phase] == "shake":
            break
        height = snapshot.body_position[roll, 2]
        ends[names[snapshot.phase]] = height - snapshot.world_from_flange.translation[2]
    assert ends["close"] == pytest.approx(-0.053, abs=1e-3)  # as above
    assert ends["lift"] == pytest.approx(ends["close"], abs=1e-3)
    assert height > 0.245 + 0.19
