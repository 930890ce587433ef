"""What a controller sees is what the run shows, also after it has been saved."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.app.preparation import build_simulation
from cosim.base.state_file import load, save
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.measurement import ring_twist
from tests.devices import device_parts

PRESS = """
schema = 2
title = "A core is lowered onto a block under the eyes of a controller"
robot = "ur5e"
soft_robot = "square_core"
model.published = true
clock.tick_s = 0.004
solver.damping_per_s = 20.0
[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 10e3
[[object]]
name = "block"
shape = "box"
size_m = [0.2, 0.2, 0.1]
position_m = [0.4, 0.0, 0.407]
[[controller]]
name = "mine"
kind = "python"
period_s = 0.004
[[phase]]
name = "press"
duration_s = 0.24
control = ["mine"]
flange_shift_m = [0.0, 0.0, -0.02]
"""


@dataclass(frozen=True)
class Listener(cosim.Controller[None]):
    """Commands nothing, and keeps what it sees."""

    heard: list[cosim.Measurement] = field(default_factory=list)

    def start(self, seen: cosim.Measurement) -> None:
        return None

    def act(self, state: None, seen: cosim.Measurement) -> tuple[None, cosim.Command]:
        self.heard.append(seen)
        return None, cosim.Command()


def pressing(tmp_path: Path) -> Scenario:
    path = tmp_path / "press.toml"
    path.write_text(PRESS, encoding="utf-8")
    return load_scenario(path)


def held(tmp_path: Path) -> Scenario:
    pull = device_parts.PULL + 'control = ["mine"]\ncable_tension_N = [1.0, 0.0]\n'
    controller = device_parts.PYTHON.replace("0.1", str(device_parts.TICK_s))
    given = device_parts.scenario(tmp_path, controller, device_parts.INFLATE, pull)
    return load_scenario(given, {"phase.inflate.duration_s": 0.08, "phase.pull.settle_s": 0.0})


def test_a_controller_sees_the_state_that_its_tick_begins_with(tmp_path: Path) -> None:
    mine = Listener()
    result = cosim.run(pressing(tmp_path), controllers={"mine": mine})
    block, rows = result.body("block"), range(len(mine.heard))
    assert len(rows) == len(result.tick) - 1
    assert result.contacts[rows[-1]] > 0
    for k in rows:
        seen = mine.heard[k]
        assert seen.time_s == pytest.approx(result.time_s[k])
        np.testing.assert_array_equal(seen.joint_position, result.joint_position[k])
        np.testing.assert_array_equal(seen.joint_velocity, result.joint_velocity[k])
        np.testing.assert_array_equal(seen.joint_torque, result.joint_torque[k])
        np.testing.assert_array_equal(seen.flange.translation, result.flange_position[k])
        np.testing.assert_array_equal(seen.flange_wrench.force, result.flange_force[k])
        np.testing.assert_array_equal(seen.flange_wrench.torque, result.flange_torque[k])
        # what is found when a tick begins acts in it
        np.testing.assert_array_equal(seen.contact_force_N["block"], result.body_contact_force[k + 1, block])
        np.testing.assert_array_equal(seen.volume_m3, result.chamber_volume_m3[k])
        assert tuple(seen.contact_force_N) == result.stage.body_names


def test_a_base_that_is_held_feels_the_soft_robot(tmp_path: Path) -> None:
    mine = Listener()
    result = cosim.run(held(tmp_path), controllers={"mine": mine})
    first = len(result.tick) - 1 - len(mine.heard)
    forces = [seen.flange_wrench.force for seen in mine.heard]
    np.testing.assert_array_equal(forces, result.flange_force[first:-1])
    assert np.abs(forces[-1]).max() > 1e-3


@pytest.mark.parametrize("scene", [pressing, held])
def test_after_a_saved_state_a_controller_sees_the_same(tmp_path: Path, scene: Any) -> None:
    given, first, second = scene(tmp_path), Listener(), Listener()
    run = build_simulation(given, controllers={"mine": first})
    steps = run.steps()
    list(islice(steps, 50))
    save(tmp_path / "state.npz", run.save_state())
    first.heard.clear()
    list(steps)
    again = build_simulation(given, controllers={"mine": second})
    again.restore_state(load(tmp_path / "state.npz"))
    list(again.steps())
    assert len(first.heard) == len(second.heard) > 5
    with np.printoptions(floatmode="unique"):
        for expected, found in zip(first.heard, second.heard, strict=True):
            for name in (entry.name for entry in fields(cosim.Measurement)):
                assert repr(getattr(found, name)) == repr(getattr(expected, name)), name


@pytest.mark.parametrize("flat", [1.0, 0.0], ids=["a ring", "nodes in a line"])
def test_the_twist_of_a_ring_is_the_nearest_to_how_its_nodes_move(flat: float) -> None:
    random = np.random.default_rng(2)
    positions = random.normal(size=(12, 3)) * (0.03, 0.03 * flat, 1e-3 * flat)
    moving = random.normal(size=(12, 3))
    away = positions - positions.mean(axis=0)
    columns = np.concatenate([np.cross(np.eye(3)[k], away)[..., None] for k in range(3)], axis=-1)
    turning = np.linalg.lstsq(columns.reshape(36, 3), (moving - moving.mean(axis=0)).ravel(), rcond=1e-9)[0]
    found = ring_twist(positions, moving)
    np.testing.assert_allclose(found[:3], moving.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found[3:], turning, rtol=1e-9, atol=1e-9)
