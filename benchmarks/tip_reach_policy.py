"""Finds a policy for cosim/TipReach-v0 on the section model by the cross-entropy method, within minutes.

    python benchmarks/tip_reach_policy.py [--rounds 12] [--out tip_reach.npz]
    cosim replay tip_reach.npz --fidelity lumped

A policy is linear in the way to the goal: mean and spread of 24 weights and biases are fitted to the best
fifth of those that were tried, round by round. Goals are drawn anew in every round, the same for all.
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
_TRIED, _KEPT, _GOALS = 25, 5, 2


def policy_of(numbers: Array) -> LinearPolicy:
    """Return the policy of (24,) numbers."""
    weights = numbers.reshape(_ACTIONS, _FEATURES + 1)
    return LinearPolicy(weights[:, :_FEATURES], weights[:, _FEATURES])


def total(environment: gymnasium.Env[dict[str, Array], Array], policy: LinearPolicy, seed: int) -> float:
    """Return the sum of rewards of an episode."""
    seen, _ = environment.reset(seed=seed)
    found, ended = 0.0, False
    while not ended:
        seen, reward, terminated, truncated, _ = environment.step(policy(seen).astype(np.float32))
        found, ended = found + float(reward), terminated or truncated
    return found


def main() -> None:
    """Search, print every round, and write the mean of the last one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--out", default="tip_reach.npz")
    options = parser.parse_args()
    environment = gymnasium.make("cosim/TipReach-v0")
    random, began = np.random.default_rng(0), time.process_time()
    size = _ACTIONS * (_FEATURES + 1)
    mean, spread = np.zeros(size), np.full(size, 2.0)
    for turn in range(options.rounds):
        tried = mean + spread * random.standard_normal((_TRIED, size))
        seeds = [1000 + _GOALS * turn + k for k in range(_GOALS)]
        totals = [np.mean([total(environment, policy_of(one), k) for k in seeds]) for one in tried]
        best = tried[np.argsort(totals)[-_KEPT:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.2 * 0.8**turn
        spent = time.process_time() - began
        print(f"round {turn}: best {max(totals):.2f}, mean {np.mean(totals):.2f}, {spent:.0f} s", flush=True)
    policy_of(mean).write(options.out)
    print(f"{next(iter(cosim.gym.ENVIRONMENTS))}: written to {options.out}")


if __name__ == "__main__":
    main()
