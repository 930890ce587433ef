"""Environments of Gymnasium: they pass its checks, repeat themselves to the bit, and fail by name."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from ctypes.util import find_library
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from pyarrow import parquet

import cosim.gym
from cosim.cli.main import main
from cosim.errors import ConvergenceError, InputError
from cosim.gym.grasp_task import GraspLift
from cosim.gym.policy import LinearPolicy, policy_of
from cosim.gym.recorder import EpisodeRecorder

RIGID: dict[str, Any] = {"fidelity": "rigid", "kept": cosim.KeptParts()}  # brought to rest once
ARMS = ("cosim/TipReach-v0", "cosim/TipFollow-v0")
STEPS = 4


def walk(environment: Any, seed: int, steps: int = STEPS) -> list[tuple[Any, ...]]:
    """Return what some steps in random directions give."""
    random = np.random.default_rng(seed)
    seen, _ = environment.reset(seed=seed)
    found = [tuple(value.tobytes() for value in seen.values())]
    for _ in range(steps):
        seen, reward, *ended, info = environment.step(random.uniform(-1.0, 1.0, 6).astype(np.float32))
        found.append((*(value.tobytes() for value in seen.values()), reward, *ended, info["is_success"]))
    return found


@pytest.mark.parametrize(
    ("name", "given"),
    [*((name, RIGID) for name in ARMS), pytest.param("cosim/GraspLift-v0", {}, marks=pytest.mark.long)],
)
def test_gymnasium_finds_nothing_wrong(name: str, given: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name, **given).unwrapped)


@pytest.mark.parametrize("name", ARMS)
def test_a_seed_repeats_every_bit(name: str) -> None:
    environment = gymnasium.make(name, **RIGID)
    first = walk(environment, 7)
    assert walk(environment, 7) == first
    assert walk(gymnasium.make(name, **RIGID), 7) == first
    assert walk(environment, 8) != first


def test_an_episode_begins_at_a_snapshot_with_changes_and_a_goal() -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    walk(environment, 0)
    saved, tip = environment.save(), environment.measured.tip_position
    walk(environment, 1)
    for away_m in (0.0099, 0.0101):
        goal = tip + np.array([0.0, 0.0, away_m])
        seen, info = environment.reset(options={"start": saved, "goal": goal})
        np.testing.assert_array_equal(seen["achieved_goal"], tip)
        np.testing.assert_array_equal(seen["desired_goal"], goal)
        assert info["is_success"] == (away_m < 0.01)
    seen, _ = environment.reset(options={"changes": {"start.pressure_Pa": 25e3}})
    assert environment.measured.pressure_Pa == (25e3,)
    with pytest.raises(InputError, match="there is no 'begin'; there are: start, changes, goal"):
        environment.reset(options={"begin": saved})


def test_rewards_fall_with_the_distance_and_fit_hindsight() -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    seen, reward, *_ = environment.step(np.zeros(6, np.float32))
    away = np.linalg.norm(seen["desired_goal"] - seen["achieved_goal"])
    assert reward == pytest.approx(-10.0 * away)
    goals = np.stack([seen["desired_goal"], seen["achieved_goal"]])
    again = environment.compute_reward(np.stack([seen["achieved_goal"]] * 2), goals, {})
    np.testing.assert_allclose(again, [reward, 0.0], atol=1e-12)


def test_a_target_to_follow_moves_at_its_speed() -> None:
    environment = gymnasium.make(ARMS[1], **RIGID)
    seen, _ = environment.reset(seed=3)
    np.testing.assert_allclose(seen["desired_goal"], seen["achieved_goal"], atol=1e-12)
    after, *_ = environment.step(np.zeros(6, np.float32))
    assert np.linalg.norm(after["desired_goal"] - seen["desired_goal"]) == pytest.approx(1e-3, rel=1e-3)


def test_what_cannot_be_solved_truncates_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    before, *_ = environment.step(np.zeros(6, np.float32))
    near = before["achieved_goal"] + [0.0, 0.0, 0.005]
    environment.reset(options={"start": environment.save(), "goal": near})

    def fail(*_: Any, **__: Any) -> None:
        raise ConvergenceError("no", 1.0, 1)

    monkeypatch.setattr(environment._simulation, "step", fail)
    seen, reward, terminated, truncated, info = environment.step(np.ones(6, np.float32))
    assert (terminated, truncated, info["failure"]) == (False, True, "ConvergenceError: no")
    assert not info["is_success"]  # though it is within the tolerance
    np.testing.assert_array_equal(seen["achieved_goal"], before["achieved_goal"])
    each = environment.compute_reward(seen["achieved_goal"], seen["desired_goal"], {})
    assert reward == pytest.approx(100 * each)  # as if it stayed there for the rest
    with pytest.raises(InputError, match="must be finite"):
        environment.step(np.full(6, np.nan, np.float32))


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(5), r"action has 5 numbers; must be 6"),
        (np.zeros((6, 1)), r"action is .*; must be 6 numbers in a row, shape \(6,\)"),
        (None, r"action is None; must be 6 numbers in a row, shape \(6,\)"),
        ("up", r"action is 'up'; must be 6 numbers in a row, shape \(6,\)"),
        (["0.1"] * 6, r"action\[0\] is '0\.1'; must be a number"),
        ([0.0] * 5 + [float("inf")], r"action is .*; its 6 numbers must be finite"),
    ],
)
def test_an_action_of_another_kind_is_refused_with_its_shape(action: Any, message: str) -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    before = environment.measured
    with pytest.raises(InputError, match=message):
        environment.step(action)
    assert environment.measured.time_s == before.time_s


def test_a_changed_clock_keeps_the_length_of_a_step() -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    for tick_s in (4e-3, 2e-2):
        environment.reset(options={"changes": {"clock.tick_s": tick_s}})
        before = environment.measured.time_s
        environment.step(np.zeros(6, np.float32))
        assert environment.measured.time_s - before == pytest.approx(0.02)
    before = environment.measured
    for changes in ({"clock.tick_s": 3e-3}, {"clock": {"tick_s": 0.05}}):
        with pytest.raises(
            InputError, match=r"clock\.tick_s is 0\.0.*whole ticks must make a step of 0\.02 s"
        ):
            environment.reset(seed=3, options={"changes": changes})
    # the episode goes on, and chance as it would
    assert environment.measured.time_s == before.time_s
    other: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    (first, _), (second, _) = (one.reset(seed=5) for one in (environment, other))
    np.testing.assert_array_equal(first["desired_goal"], second["desired_goal"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"options": {"goal": [float("nan")] * 3}},
            r"options: goal is \[nan, nan, nan\]; its 3 numbers must be",
        ),
        ({"options": {"goal": [0.1, 0.2]}}, "options: goal has 2 numbers; must be 3"),
        ({"options": {"goal": "far"}}, r"options: goal is 'far'; must be 3 numbers in a row"),
        ({"options": {"changes": 5}}, "changes are 5; give values by key path"),
        ({"options": {"start": 5}}, "5: holds a int, not the state of a simulation"),
        ({"options": [1]}, r"options are \[1\]; give values by name: start, changes, goal"),
        ({"seed": "x"}, "seed is 'x'; must be a whole number from 0 on"),
        ({"seed": -1}, "seed is -1; must be a whole number from 0 on"),
    ],
)
def test_what_a_reset_cannot_take_is_refused_by_name(given: dict[str, Any], message: str) -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    environment.step(np.ones(6, np.float32))
    before = environment.measured
    with pytest.raises(InputError, match=message):
        environment.reset(**given)
    assert environment.measured.time_s == before.time_s > 0.0


@pytest.fixture(scope="module")
def many() -> Iterator[Any]:
    """Two environments in processes."""
    found: Any = gymnasium.make_vec(
        ARMS[0], 2, "vector_entry_point", autoreset_mode="SameStep", fidelity="rigid"
    )
    yield found
    found.close()


def test_environments_in_processes_refuse_before_any_of_them_moves(many: Any) -> None:
    many.reset(seed=5)
    row = [0.1] * 6
    for actions, message in (
        ([row], r"actions are .*; must have the shape \(2, 6\)"),
        ([row, row[:5]], r"actions\[1\] has 5 numbers; must be 6"),
        (np.full((2, 6), np.nan), r"actions\[0\] is .*; its 6 numbers must be finite"),
        (None, r"actions are None; must have the shape \(2, 6\)"),
    ):
        with pytest.raises(InputError, match=message):
            many.step(actions)
    for given, message in (
        ({"seed": [1]}, r"seed is \[1\]; give one, or one for each of 2"),
        ({"options": {"reset_mask": [True]}}, "options: reset_mask is .*; must be 2 times True or False"),
        ({"options": {"goal": [0.1]}}, "options: goal has 1 numbers; must be 3"),
    ):
        with pytest.raises(InputError, match=message):
            many.reset(**given)
    action = np.full((2, 6), 0.5, np.float32)
    stepped, *_ = many.step(action)
    many.reset(seed=5)
    again, *_ = many.step(action)
    assert again["observation"].tobytes() == stepped["observation"].tobytes()


def test_environments_in_processes_are_what_each_is_alone(many: Any) -> None:
    options = {"goal": [0.3, 0.0, 0.55]}
    assert many.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    seen, _ = many.reset(seed=5)
    ones: list[Any] = [gymnasium.make(ARMS[0], **RIGID).unwrapped for _ in range(2)]
    alone = [one.reset(seed=5 + k)[0] for k, one in enumerate(ones)]
    action = np.full((2, 6), 0.5, np.float32)
    stepped, reward, *_ = many.step(action)
    for k, one in enumerate(ones):
        assert seen["observation"][k].tobytes() == alone[k]["observation"].tobytes()
        after, own, *_ = one.step(action[k])
        assert stepped["observation"][k].tobytes() == after["observation"].tobytes()
        assert reward[k] == own
    for _ in range(98):
        many.step(action)
    begun, _, _, truncated, info = many.step(action)  # the last one of the episode
    assert truncated.all()
    assert not np.array_equal(begun["observation"][0], info["final_obs"][0]["observation"])
    assert (
        many.reset(options={**options, "reset_mask": np.array([False, True])})[0]["desired_goal"][1][2]
        == 0.55
    )


def test_an_action_asks_for_the_rates_that_the_task_states() -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    seen = environment.measured
    asked = environment.task.command(np.array([1.0, -0.1, 0.0, 0.5, 1.0, -0.5]), seen)
    # the flange takes up 0.1 m/s at 1 m/s^2; 20 kPa/s and 4 N/s over 20 ms
    np.testing.assert_allclose(asked.flange_twist, [0.02, -0.01, 0.0, 0.0, 0.0, 0.0], atol=1e-6)
    assert asked.pressure_Pa == {"chamber": pytest.approx(seen.pressure_Pa[0] + 200.0)}
    right, left = (seen.cable_tension_N[name] for name in ("right", "left"))
    assert asked.cable_tension_N == pytest.approx({"right": right + 0.08, "left": left - 0.04})


def test_sensors_and_cameras_of_a_scenario_are_what_is_observed() -> None:
    sensor = {"name": "tip", "kind": "tip_position", "noise": 0.05}
    eye = {"name": "eye", "position_m": [1.5, 0.1, 0.4], "direction": [-1.0, 0.0, 0.0], "size": [32, 24]}
    eyes = [eye] if find_library("EGL") or find_library("OSMesa") else []
    given = {"overrides": {"sensor": [sensor], "camera": eyes}, **RIGID}
    environment: Any = gymnasium.make(ARMS[0], **given).unwrapped
    seen, _ = environment.reset(seed=3)
    true, read = environment.measured.tip_position, environment.measured.sensors["tip"]
    assert 0.01 < np.abs(read - true).max() < 0.3
    assert np.array_equal(seen["observation"][:3], read)
    assert np.array_equal(seen["achieved_goal"], read)
    assert np.array_equal(environment.reset(seed=3)[0]["achieved_goal"], read)
    assert not np.array_equal(environment.reset(seed=4)[0]["achieved_goal"], read)
    # the reading is far off, and the success is of the truth
    for off, reached in ((0.0, True), (0.0099, True), (0.0101, False)):
        seen, info = environment.reset(options={"goal": np.add(true, [off, 0.0, 0.0])})
        assert info["is_success"] == reached
        assert np.abs(seen["achieved_goal"] - true).max() > 0.01
    assert environment.observation_space.contains(seen)
    for each in eyes:
        assert seen[each["name"]].shape == (24, 32, 3)
        assert np.ptp(seen[each["name"]]) > 50


def test_recorded_episodes_are_what_was_observed_and_done(tmp_path: Path) -> None:
    recorder = EpisodeRecorder(gymnasium.make(ARMS[0], **RIGID), "reach the place")
    seen, _ = recorder.reset(seed=2)
    kept = []
    for steps in (3, 2):
        for _ in range(steps):
            action = recorder.action_space.sample()
            before = seen
            seen, reward, *_ = recorder.step(action)
            kept.append((before, action, reward))
        if steps == 3:
            seen, _ = recorder.reset()
    recorder.write(tmp_path)
    rows = parquet.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pylist()
    assert [row["episode_index"] for row in rows] == [0, 0, 0, 1, 1]
    for row, (before, action, reward) in zip(rows, kept, strict=True):
        assert row["observation.state"] == pytest.approx(before["observation"].astype(np.float32))
        goals = np.hstack([before["achieved_goal"], before["desired_goal"]])
        assert row["observation.environment_state"] == pytest.approx(goals.astype(np.float32))
        assert row["action"] == pytest.approx(action)
        assert row["next.reward"] == pytest.approx(reward)
        assert (row["next.done"], row["next.success"]) == (False, False)
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert info["fps"] == 50
    assert [row["timestamp"] for row in rows] == pytest.approx([0.0, 0.02, 0.04, 0.0, 0.02])
    assert info["features"]["action"]["names"][0].startswith("flange velocity along x")


def test_a_step_takes_few_calls() -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    action, calls = np.full(6, 0.5, np.float32), 0

    def count(_frame: Any, event: str, _argument: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    for _ in range(3):
        environment.step(action)
    sys.setprofile(count)
    for _ in range(10):
        environment.step(action)
    sys.setprofile(None)
    # some 1610, two of them for each array that is shown, as nobody can write to it, and those of its ticks:
    # what is measured or asked for once too often, body by body or value by value, shows
    assert calls < 10 * 1680


def test_a_grasp_asks_for_all_fingers_alike() -> None:
    task, environment = GraspLift(), gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    seen: Any = environment.measured  # type: ignore[attr-defined]
    command = task.command(np.array([1.0, 0.0, 1.0]), seen)
    assert set(command.pressure_Pa.values()) == {30e3}
    assert set(command.cable_tension_N.values()) == {0.5 + 0.02 * 10.0}


def test_pulling_and_then_rising_lifts_the_roll() -> None:
    environment: Any = gymnasium.make("cosim/GraspLift-v0", overrides={"model.published": True}).unwrapped
    (_, info), truncated = environment.reset(seed=0), False
    while not (truncated or info["is_success"]):
        pulled = environment.measured.cable_tension_N["corner_0"] > 5.9
        *_, truncated, info = environment.step([float(pulled), 0.0, float(not pulled)])
    assert info["is_success"]
    assert environment.measured.contact_force_N["roll"][2] > 0.5


@pytest.mark.parametrize("far", [(0.06, 0.06, 0.04), (-0.06, -0.06, -0.04)])
def test_the_farthest_goals_are_reached_by_going_towards_them(far: tuple[float, ...]) -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    policy, truncated = LinearPolicy(2.0 * np.eye(6, 3), np.zeros(6)), False
    seen, info = environment.reset(options={"goal": environment.measured.tip_position + far})
    while not truncated:
        seen, _, _, truncated, info = environment.step(policy(seen))
    assert info["is_success"]


@pytest.mark.parametrize("away", [(-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_an_arm_that_moves_in_one_direction_for_an_episode_finds_joints(away: tuple[float, ...]) -> None:
    environment: Any = gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    action, info, truncated = np.array([*away, 0.0, 0.0, 0.0], np.float32), {}, False
    while not truncated:
        _, _, _, truncated, info = environment.step(action)
    assert "failure" not in info


def test_policies_are_functions_or_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = LinearPolicy(np.eye(6, 3), np.zeros(6))
    policy.write(tmp_path / "weights.npz")
    seen = {
        "observation": np.zeros(5), "achieved_goal": np.zeros(3), "desired_goal": np.array([0.0, 0.0, 0.1]),
    }  # fmt: skip
    np.testing.assert_allclose(policy_of(str(tmp_path / "weights.npz"))(seen), np.tanh([0, 0, 1, 0, 0, 0]))
    (tmp_path / "still_policy.py").write_text("def still(seen):\n    return [0.0] * 6\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert policy_of("still_policy:still")(seen) == [0.0] * 6
    np.savez(tmp_path / "other.npz", weights=np.zeros(3), bias=np.zeros(3))
    for given, text in (
        ("still_policy:moving", "no attribute 'moving'"), ("still", "give module:function"),
        (str(tmp_path / "none.npz"), "holds no weights"), (str(tmp_path / "other.npz"), "do not fit"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=text):
            policy_of(given)


@pytest.mark.parametrize(
    ("task", "text"),
    [
        ("cosim.gym.no_such:Task", "No module named"), ("cosim.gym.tasks:Tasks", "no attribute 'Tasks'"),
        ("cosim.gym.arm_tasks:np", "no subclass of"), ("", "give module:Class"),
    ],
)  # fmt: skip
def test_a_task_that_is_none_is_refused(task: str, text: str) -> None:
    with pytest.raises(InputError, match=rf"^task '{task}': .*{text}"):
        gymnasium.make(ARMS[0], task=task)


def test_a_replay_says_what_changes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert list(cosim.gym.ENVIRONMENTS) == [*ARMS, "cosim/GraspLift-v0"]
    assert main(["replay", "nothing.npz", "--fidelity", "lumped"]) == 2
    assert "holds no weights" in capsys.readouterr().err
