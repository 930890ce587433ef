"""Environments of Gymnasium: they pass its checks, repeat themselves to the bit, and fail by name."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import cosim.gym
from cosim.cli.main import main
from cosim.errors import ConvergenceError, InputError
from cosim.gym.grasp_lift import GraspLift
from cosim.gym.policy import LinearPolicy, policy_of

RIGID: dict[str, Any] = {"fidelity": "rigid"}
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


@pytest.mark.parametrize(("name", "given"), [*((name, RIGID) for name in ARMS), ("cosim/GraspLift-v0", {})])
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
    goal = tip + np.array([0.0, 0.0, 0.005])
    seen, info = environment.reset(options={"start": saved, "goal": goal})
    np.testing.assert_array_equal(seen["achieved_goal"], tip)
    np.testing.assert_array_equal(seen["desired_goal"], goal)
    assert info["is_success"]
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

    def fail(*_: Any, **__: Any) -> None:
        raise ConvergenceError("no", 1.0, 1)

    monkeypatch.setattr(environment._simulation, "step", fail)
    seen, reward, terminated, truncated, info = environment.step(np.ones(6, np.float32))
    assert (terminated, truncated, info["failure"]) == (False, True, "ConvergenceError: no")
    np.testing.assert_array_equal(seen["achieved_goal"], before["achieved_goal"])
    each = environment.compute_reward(seen["achieved_goal"], seen["desired_goal"], {})
    assert reward == pytest.approx(99 * each)  # as if it stayed there for the rest
    with pytest.raises(InputError, match="must be finite"):
        environment.step(np.full(6, np.nan, np.float32))


def test_environments_in_processes_are_what_each_is_alone() -> None:
    options = {"goal": [0.3, 0.0, 0.55]}
    many: Any = gymnasium.make_vec(
        ARMS[0], num_envs=2, vectorization_mode="vector_entry_point", autoreset_mode="SameStep", **RIGID
    )
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
    many.close()


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
    # some 1100: what is measured or asked for once too often, body by body or value by value, shows
    assert calls < 10 * 1250


def test_a_grasp_asks_for_all_fingers_alike() -> None:
    task, environment = GraspLift(), gymnasium.make(ARMS[0], **RIGID).unwrapped
    environment.reset(seed=0)
    seen: Any = environment.measured  # type: ignore[attr-defined]
    command = task.command(np.array([1.0, 0.0, 1.0]), seen)
    assert set(command.pressure_Pa.values()) == {30e3}
    assert set(command.cable_tension_N.values()) == {0.5 + 0.02 * 10.0}


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
def test_an_arm_that_goes_one_way_for_a_whole_episode_finds_joints_for_it(away: tuple[float, ...]) -> None:
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


def test_a_replay_says_what_changes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert list(cosim.gym.ENVIRONMENTS) == [*ARMS, "cosim/GraspLift-v0"]
    assert main(["replay", "nothing.npz", "--fidelity", "lumped"]) == 2
    assert "holds no weights" in capsys.readouterr().err
