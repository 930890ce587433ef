"""Trains a policy with SAC and hindsight goals of stable-baselines3, and exports it to ONNX.

    pip install 'cosim[learn]'
    python benchmarks/learn_policy.py [--env cosim/TipReach-v0 | cosim/GraspLift-v0] [--steps N] [--out FILE]
                                      [--fidelity section]
    cosim replay TipReach-v0.onnx --fidelity lumped --episodes 100

The replay needs onnxruntime, but neither torch nor stable-baselines3. The network sees two ways in decimetres
besides the observation, from the tip to the achieved goal and on to the desired one: a place within
millimetres is a small part of raw coordinates.

A grasp is learned on the paper's mesh, which takes half the time, or on section fingers (`--fidelity`), and
judged on the drawn mesh. In training an action holds for 0.2 s: by chance it then closes and lifts now and
then. Success rises and falls on the way: of all looks at ten episodes of their own, the policy of the best
one is kept.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from tempfile import TemporaryDirectory
from typing import Any, Final, final

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

import cosim.gym  # registers the environments
from cosim.base.frames import Array
from cosim.gym.policy import Policy, policy_of
from cosim.gym.replay import episodes
from cosim.gym.tasks import task_of


@final
@dataclass(frozen=True)
class Recipe:
    """How a task is learned.

    Args:
        steps: of the environment, 20 ms each.
        hold: steps for which an action holds in training.
        starts: actions by chance before the network learns.
        gradients: gradient steps after each action.
        overrides: values of the scenario in training.
        entropy: first weight of the entropy in SAC, which then adapts it.
        looked: actions between two looks at the success.
    """

    steps: int
    hold: int = 1
    starts: int = 500
    gradients: int = 1
    overrides: Mapping[str, Any] = field(default_factory=dict)
    entropy: float = 1.0
    looked: int = 1500


RECIPES: Final = {
    "cosim/TipReach-v0": Recipe(15_000),
    "cosim/GraspLift-v0": Recipe(12_000, 10, 150, 8, {"model.published": True}, 0.1, 75),
}
_INPUTS: Final = ("observation", "achieved_goal", "desired_goal")
_SAC: Final[dict[str, Any]] = {
    "learning_rate": 1e-3, "gamma": 0.95, "batch_size": 256, "buffer_size": 100_000,
}  # fmt: skip
_NET: Final = (64, 64)
_JUDGED: Final = 10
"""Episodes in a look at the success, with goals of their own."""
_PULL_N: Final = 6.0
_CHECKED: Final = 20
"""Observations at which the exported policy is compared with the trained one."""


class Ways(BaseFeaturesExtractor):  # type: ignore[misc]  # stable-baselines3 is not typed here
    """The features [10 (desired - achieved goal), 10 (achieved goal - tip), observation].

    Args:
        space: of the observations.
    """

    def __init__(self, space: gymnasium.spaces.Dict) -> None:
        super().__init__(space, sum(int(np.prod(space[name].shape or ())) for name in _INPUTS))

    def forward(self, seen: Mapping[str, Any]) -> Any:
        """Return the features (rows, k)."""
        state, here, there = (seen[name] for name in _INPUTS)
        return torch.cat([10.0 * (there - here), 10.0 * (here - state[:, :3]), state], dim=1)


@final
class Hold(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Holds an action for some steps; its reward is their mean.

    Args:
        environment: of a task.
        steps: for which it holds.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any], steps: int) -> None:
        super().__init__(environment)
        self._steps = steps

    def step(self, action: Array) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take the steps, up to the end of the episode."""
        total, ended = 0.0, False
        for _ in range(self._steps):
            seen, reward, terminated, truncated, info = self.env.step(action)
            total, ended = total + float(reward), terminated or truncated
            if ended:
                break
        return seen, total / self._steps, terminated, truncated, info


class Mean(nn.Module):  # type: ignore[misc]  # neither is torch
    """The action that a trained actor takes without noise, from the three parts of an observation.

    Args:
        actor: of SAC.
    """

    def __init__(self, actor: Any) -> None:
        super().__init__()
        self._actor = actor

    def forward(self, *parts: Any) -> Any:
        """Return the action (rows, actions)."""
        return self._actor(dict(zip(_INPUTS, parts, strict=True)), deterministic=True)


def train(env: str, recipe: Recipe, steps: int) -> SAC:
    """Return the best model on the way; prints return and success of the last episodes now and then."""
    held, looks = (Hold(gymnasium.make(env, overrides=recipe.overrides), recipe.hold) for _ in range(2))
    kwargs = {"net_arch": [*_NET], "features_extractor_class": Ways}
    model = SAC(
        "MultiInputPolicy", held, replay_buffer_class=HerReplayBuffer, policy_kwargs=kwargs, seed=0,
        device="cpu", verbose=1, gradient_steps=recipe.gradients, learning_starts=recipe.starts,
        ent_coef=f"auto_{recipe.entropy}", **_SAC,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        look = EvalCallback(
            Monitor(looks), n_eval_episodes=_JUDGED, eval_freq=recipe.looked, best_model_save_path=folder
        )
        model.learn(steps // recipe.hold, look, log_interval=10)
        return SAC.load(f"{folder}/best_model", model.get_env(), device="cpu")


def export(model: SAC, out: str) -> float:
    """Write the policy as ONNX, and return how far its actions are from the trained one's at most."""
    space = model.observation_space
    zeros = tuple(torch.zeros(1, *space[name].shape) for name in _INPUTS)
    mean = Mean(model.policy.actor).eval()
    axes = {name: {0: "rows"} for name in (*_INPUTS, "action")}
    names = {"input_names": [*_INPUTS], "output_names": ["action"], "dynamic_axes": axes}
    torch.onnx.export(mean, zeros, out, dynamo=False, **names)
    replayed, environment = policy_of(out), model.get_env().envs[0]
    environment.reset(seed=0)
    return max(_apart(model, replayed, _after(environment)) for _ in range(_CHECKED))


def _after(environment: Any) -> Mapping[str, Array]:
    seen, _, terminated, truncated, _ = environment.step(environment.action_space.sample())
    found: Mapping[str, Array] = environment.reset()[0] if terminated or truncated else seen
    return found


def _apart(model: SAC, replayed: Callable[[Mapping[str, Array]], Array], seen: Mapping[str, Array]) -> float:
    return float(np.abs(model.predict(seen, deterministic=True)[0] - replayed(seen)).max())


def lift(seen: Mapping[str, Array]) -> Array:
    """Return the action of a script for cosim/GraspLift-v0: pull to 6 N, then rise as the roll is to."""
    tension_N, up_m = seen["observation"][24:30].max(), (seen["desired_goal"] - seen["achieved_goal"])[2]
    return np.array([0.0, 0.0, 1.0] if tension_N < _PULL_N else [np.clip(10.0 * up_m, -1.0, 1.0), 0.0, 0.0])


def told(name: str, policy: Policy, env: str, count: int) -> None:
    """Print the success of a policy at 50 actions a second on the fidelity of the task."""
    fidelity = task_of(cosim.gym.ENVIRONMENTS[env]).fidelity
    began, found = time.process_time(), list(episodes(policy, env, fidelity, count, 1))
    reached, failed = np.mean([one.reached for one in found]), sum(bool(one.failure) for one in found)
    print(
        f"{name}: success in {reached:.0%} of {count} episodes on {fidelity}, {failed} not solved; "
        f"{time.process_time() - began:.0f} s of processor time",
        flush=True,
    )


def main() -> None:
    """Train, export, and print success over some episodes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--env", default=next(iter(RECIPES)), choices=RECIPES)
    parser.add_argument("--steps", type=int, help="of the environment; as the recipe says")
    parser.add_argument("--out", help="NAME.onnx of the environment")
    parser.add_argument("--fidelity", help="to learn on, in place of the recipe's values")
    parser.add_argument("--episodes", type=int, default=100, help="to state the success over")
    parser.add_argument("--untrained", action="store_true", help="success by chance, and of a script")
    options = parser.parse_args()
    env, count = options.env, options.episodes
    if options.untrained:
        random = np.random.default_rng(0)
        size = task_of(cosim.gym.ENVIRONMENTS[env]).actions
        told("chance", lambda _: random.uniform(-1.0, 1.0, len(size)), env, count)
        if env == "cosim/GraspLift-v0":
            told("script", lift, env, count)
        return
    torch.set_num_threads(1)
    recipe, began = RECIPES[env], time.process_time()
    if options.fidelity:
        recipe = replace(recipe, overrides={"fidelity": options.fidelity})
    steps, out = options.steps or recipe.steps, options.out or f"{env.partition('/')[2]}.onnx"
    model = train(env, recipe, steps)
    print(f"{steps} steps, {time.process_time() - began:.0f} s of processor time")
    print(f"{out}: actions within {export(model, out):.1e} of the trained policy", flush=True)
    told(out, policy_of(out), env, count)


if __name__ == "__main__":
    main()
