"""Policies: what chooses an action from an observation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import InputError

Policy: TypeAlias = Callable[[Mapping[str, Array]], Array]
"""From {"observation", "achieved_goal", "desired_goal"} to an action, each number within -1 to 1."""


@final
@dataclass(frozen=True)
class LinearPolicy:
    """a = tanh(W f + b) of features f = [10 (desired - achieved goal), observation], as far as W reaches.

    Args:
        weights: (actions, k), W.
        bias: (actions,), b.
    """

    weights: Array
    bias: Array

    def __call__(self, seen: Mapping[str, Array]) -> Array:
        """Return the action for an observation."""
        away = 10.0 * (seen["desired_goal"] - seen["achieved_goal"])
        features = np.concatenate([away, seen["observation"]])[: self.weights.shape[1]]
        return np.asarray(np.tanh(self.weights @ features + self.bias))

    def write(self, path: str | Path) -> None:
        """Write the weights to a file, from which `policy_of` reads them."""
        np.savez(path, weights=self.weights, bias=self.bias)


def policy_of(given: str) -> Policy:
    """Return the policy that a text names.

    Args:
        given: "module:function", of a module that Python finds, also in the present folder; or a .npz file
            with `weights` (actions, k) and `bias` (actions,) of a `LinearPolicy`.

    Raises:
        InputError: there is no such policy, or the file holds something else.
    """
    if given.endswith(".npz"):
        return _read(Path(given))
    module, colon, name = given.partition(":")
    if not colon:
        raise InputError(f"policy '{given}': give module:function, or a .npz file of weights")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        found: Any = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"policy '{given}': {error}") from error
    if not callable(found):
        raise InputError(f"policy '{given}' is a {type(found).__name__}, which nobody can call")
    policy: Policy = found
    return policy


def _read(path: Path) -> LinearPolicy:
    try:
        with np.load(path, allow_pickle=False) as stored:
            weights, bias = (np.array(stored[name], dtype=float) for name in ("weights", "bias"))
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"policy '{path}': holds no weights and bias: {error}") from error
    if weights.ndim != 2 or bias.shape != weights.shape[:1]:
        raise InputError(f"policy '{path}': weights {weights.shape} and bias {bias.shape} do not fit")
    return LinearPolicy(weights, bias)
