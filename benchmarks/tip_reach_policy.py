"""Finds a policy for cosim/TipReach-v0 on the section model by the cross-entropy method, within minutes.

    python benchmarks/tip_reach_policy.py [--rounds 12] [--out tip_reach.npz]
    cosim replay tip_reach.npz --fidelity lumped

A policy is linear in the way to the goal, without bias, so that it comes to rest at the goal: mean and spread
of 18 weights are fitted to the best fifth of those that were tried, round by round. Goals are drawn anew in
every round, the same for all.
"""

from __future__ import annotations

import argparse
import time

import gymnasium
import numpy as np

import cosim.gym  # registers the environments
from cosim.base.frames import Array
from cosim.gym.policy import LinearPolicy

_ACTIONS, _FEATURES = 6, 3
_TRIED, _KEPT, _GOALS = 25, 5, 3


def policy_of(numbers: Array) -> LinearPolicy:
    """Return the policy of (18,) weights."""
    return LinearPolicy(numbers.reshape(_ACTIONS, _FEATURES), np.zeros(_ACTIONS))


def episode(
    environment: gymnasium.Env[dict[str, Array], Array], policy: LinearPolicy, seed: int
) -> tuple[float, bool]:
    """Return the sum of rewards of an episode, and whether its last step was a success."""
    seen, info = environment.reset(seed=seed)
    found, ended = 0.0, False
    while not ended:
        seen, reward, terminated, truncated, info = environment.step(policy(seen).astype(np.float32))
        found, ended = found + float(reward), terminated or truncated
    return found, bool(info["is_success"])


def main() -> None:
    """Search, print every round, and write the mean of the last one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--out", default="tip_reach.npz")
    options = parser.parse_args()
    environment = gymnasium.make("cosim/TipReach-v0")
    random, began = np.random.default_rng(0), time.process_time()
    size = _ACTIONS * _FEATURES
    mean, spread = np.zeros(size), np.full(size, 2.0)
    for turn in range(options.rounds):
        tried = mean + spread * random.standard_normal((_TRIED, size))
        seeds = [1000 + _GOALS * turn + k for k in range(_GOALS)]
        found = [np.mean([episode(environment, policy_of(one), k) for k in seeds], axis=0) for one in tried]
        totals, reached = np.transpose(found)
        best = tried[np.argsort(totals)[-_KEPT:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.2 * 0.8**turn
        spent = time.process_time() - began
        print(
            f"round {turn}: return {totals.max():.2f} at best, {totals.mean():.2f} in the mean; "
            f"success {reached.mean():.0%}; {spent:.0f} s",
            flush=True,
        )
    policy_of(mean).write(options.out)
    print(f"{next(iter(cosim.gym.ENVIRONMENTS))}: written to {options.out}")


if __name__ == "__main__":
    main()
