"""Trains a policy with SAC and hindsight goals of stable-baselines3, and exports it to ONNX.

    pip install 'cosim[learn]'
    python benchmarks/learn_policy.py [--env cosim/TipReach-v0] [--steps 15000] [--out tip_reach.onnx]
    cosim replay tip_reach.onnx --fidelity lumped --episodes 100

The replay needs onnxruntime, but neither torch nor stable-baselines3. The network sees the way to the goal in
decimetres besides the observation: a place within millimetres is a small part of raw coordinates.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

import cosim.gym  # registers the environments
from cosim.base.frames import Array
from cosim.gym.policy import episodes, policy_of

_INPUTS: Final = ("observation", "achieved_goal", "desired_goal")
_SAC: Final[dict[str, Any]] = {
    "learning_rate": 1e-3, "gamma": 0.95, "batch_size": 256, "learning_starts": 500, "buffer_size": 100_000,
}  # fmt: skip
_NET: Final = (64, 64)
_CHECKED: Final = 20
"""Observations at which the exported policy is compared with the trained one."""


class WayToGoal(BaseFeaturesExtractor):  # type: ignore[misc]  # stable-baselines3 is not typed here
    """The features [10 (desired - achieved goal), observation].

    Args:
        space: of the observations.
    """

    def __init__(self, space: gymnasium.spaces.Dict) -> None:
        sizes = [int(np.prod(space[name].shape or ())) for name in ("desired_goal", "observation")]
        super().__init__(space, sum(sizes))

    def forward(self, seen: Mapping[str, Any]) -> Any:
        """Return the features (rows, k)."""
        away = 10.0 * (seen["desired_goal"] - seen["achieved_goal"])
        return torch.cat([away, seen["observation"]], dim=1)


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


def train(env: str, steps: int) -> SAC:
    """Return a trained model; prints return and success of the last episodes now and then."""
    kwargs = {"net_arch": [*_NET], "features_extractor_class": WayToGoal}
    model = SAC(
        "MultiInputPolicy", gymnasium.make(env), replay_buffer_class=HerReplayBuffer, policy_kwargs=kwargs,
        seed=0, device="cpu", verbose=1, **_SAC,
    )  # fmt: skip
    model.learn(steps, log_interval=10)
    return model


def export(model: SAC, out: str) -> float:
    """Write the policy as ONNX, and return how far its actions are from the trained one's at most."""
    space = model.observation_space
    zeros = tuple(torch.zeros(1, *space[name].shape) for name in _INPUTS)
    mean = Mean(model.policy.actor).eval()
    axes = {name: {0: "rows"} for name in (*_INPUTS, "action")}
    names = {"input_names": [*_INPUTS], "output_names": ["action"], "dynamic_axes": axes}
    torch.onnx.export(mean, zeros, out, dynamo=False, **names)
    replayed, environment = policy_of(out), model.get_env().envs[0]
    seen, _ = environment.reset(seed=0)
    return max(_apart(model, replayed, seen := _after(environment, seen)) for _ in range(_CHECKED))


def _after(environment: Any, seen: Mapping[str, Array]) -> Mapping[str, Array]:
    found: Mapping[str, Array] = environment.step(environment.action_space.sample())[0]
    return found


def _apart(model: SAC, replayed: Callable[[Mapping[str, Array]], Array], seen: Mapping[str, Array]) -> float:
    return float(np.abs(model.predict(seen, deterministic=True)[0] - replayed(seen)).max())


def main() -> None:
    """Train, export, and print success over some episodes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--env", default=next(iter(cosim.gym.ENVIRONMENTS)))
    parser.add_argument("--steps", type=int, default=15_000)
    parser.add_argument("--out", default="tip_reach.onnx")
    parser.add_argument("--episodes", type=int, default=100, help="to state the success over")
    options = parser.parse_args()
    torch.set_num_threads(1)
    began = time.process_time()
    model = train(options.env, options.steps)
    print(f"{options.steps} steps, {time.process_time() - began:.0f} s of processor time")
    print(f"{options.out}: actions within {export(model, options.out):.1e} of the trained policy")
    task = model.get_env().envs[0].unwrapped.task
    found = list(episodes(policy_of(options.out), options.env, task.fidelity, options.episodes, 1))
    reached = np.mean([one.reached for one in found])
    print(f"success in {reached:.0%} of {len(found)} episodes on {task.fidelity}")


if __name__ == "__main__":
    main()
