"""Controllers that move the flange besides its plan."""

from __future__ import annotations

from dataclasses import dataclass
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
from cosim.devices.flange_offset import joint_rate
from tests.devices import device_parts

MOVED = (0.02, 0.0, 0.03, 0.0, 0.0, 0.2)
CHANGES: dict[str, Any] = {
    "model.published": True,
    "fidelity": "rigid",
    "clock.tick_s": 0.004,
    "contact.enabled": False,
    "controller": [{"name": "mine", "kind": "python", "period_s": 0.02}],
    "phase": [
        {"name": "stand", "duration_s": 0.1},
        {"name": "move", "duration_s": 0.5, "control": ["mine"]},
        {"name": "stay", "duration_s": 0.4},
    ],
}


@dataclass(frozen=True)
class Drift(cosim.Controller[int]):
    """Moves the flange at a constant twist."""

    twist: tuple[float, ...] | None = MOVED

    def start(self, seen: cosim.Measurement) -> int:
        return 0

    def act(self, state: int, seen: cosim.Measurement) -> tuple[int, cosim.Command]:
        return state + 1, cosim.Command(flange_twist=self.twist)


def standing() -> Scenario:
    return load_scenario("ur5e_hexagon_arm", CHANGES)


def test_the_flange_goes_as_commanded_and_stays_there() -> None:
    plain = cosim.run(standing(), controllers={"mine": Drift(None)})
    moved = cosim.run(standing(), controllers={"mine": Drift()})
    way = moved.flange_position - plain.flange_position
    np.testing.assert_allclose(way[-1], [0.01, 0.0, 0.015], atol=2e-4)
    asked = moved.joint_target - plain.joint_target
    # the reference of the first tick is that of its start: nothing jumps
    first = int(np.flatnonzero(moved.phase == 1)[0])
    assert not asked[: first + 1].any()
    assert np.abs(np.diff(asked, axis=0)).max() < 0.004 * 0.6
    assert np.abs(np.diff(asked[moved.phase == 2], axis=0)).max() < 1e-12
    axis, turned = plain.flange_quaternion[-1], moved.flange_quaternion[-1]
    assert 2.0 * np.arccos(abs(axis @ turned)) == pytest.approx(0.1, abs=2e-3)


def test_the_servos_are_told_the_speed_too() -> None:
    run: Any = build_simulation(standing(), controllers={"mine": Drift()})
    told, asked = run._parts.carrier.servos, []

    def watched(references: Any) -> Any:
        asked.append(references)
        return told(references)

    run._parts.carrier.servos = watched
    list(run.steps(120))
    position = np.concatenate([references.position for references in asked])
    velocity = np.concatenate([references.velocity for references in asked])
    np.testing.assert_allclose(np.diff(position, axis=0), 0.004 * velocity[:-1], atol=1e-12)
    assert np.abs(velocity).max() > 0.01


def test_a_run_saved_on_the_way_goes_on_bit_for_bit(tmp_path: Path) -> None:
    run = build_simulation(standing(), controllers={"mine": Drift()})
    steps = run.steps()
    list(islice(steps, 90))
    save(tmp_path / "state.npz", run.save_state())
    expected = [(snapshot.joint_target, snapshot.joint_position) for snapshot in steps]
    other = build_simulation(standing(), controllers={"mine": Drift()})
    other.restore_state(load(tmp_path / "state.npz"))
    found = [(snapshot.joint_target, snapshot.joint_position) for snapshot in other.steps()]
    assert len(found) > 150
    np.testing.assert_array_equal(found, expected)


def test_contact_counts_as_modelled_where_a_controller_may_go() -> None:
    given = load_scenario("ur5e_hexagon_arm", {**CHANGES, "contact.enabled": True})
    decision = build_simulation(given, controllers={"mine": Drift()}).stage.modelled
    (contact,) = (entry for entry in decision if "scene" in entry.what)
    assert contact.included
    assert "can move the flange" in contact.reason


@pytest.mark.parametrize(
    ("twist", "error", "text"),
    [
        ((0.0, 0.0, 0.1), cosim.InputError, "flange_twist has 3 numbers; must be 6"),
        ((0.0, 0.0, float("nan"), 0.0, 0.0, 0.0), cosim.InstabilityError, "flange_twist is .*nan"),
    ],
)
def test_impossible_twists_are_told(twist: tuple[float, ...], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        cosim.run(standing(), controllers={"mine": Drift(twist)})


def test_an_arm_that_cannot_follow_says_so() -> None:
    jacobian = np.diag([1.0, 1.0, 1e-4, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(
        joint_rate(jacobian, np.array([1.0, 2.0, 0.0, 0.0, 0.0, 3.0])), [1, 2, 0, 0, 0, 3]
    )
    with pytest.raises(cosim.InputError, match=r"commanded to move .* near a singular one"):
        joint_rate(jacobian, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))


def test_without_an_arm_the_flange_cannot_be_moved(tmp_path: Path) -> None:
    parts = device_parts.PYTHON, device_parts.PULL + 'control = ["mine"]\n'
    given = device_parts.scenario(tmp_path, *parts)
    with pytest.raises(cosim.InputError, match="robot = 'none'"):
        cosim.run(given, controllers={"mine": Drift()})
