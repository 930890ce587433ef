"""Policies, which return an action for an observation: linear ones, networks in ONNX, and functions."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeAlias, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.resources import extra_module
from cosim.errors import InputError

Policy: TypeAlias = Callable[[Mapping[str, Array]], Array]
"""Returns an action, each number within -1 to 1, for {"observation", "achieved_goal", "desired_goal"}."""

_PARTS: Final = ("observation", "achieved_goal", "desired_goal")
_NUMBERS: Final = {"tensor(double)": np.float64}


@final
@dataclass(frozen=True)
class LinearPolicy:
    """a = tanh(W f + b) of the first k features f = [10 (desired - achieved goal), observation].

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


@final
class OnnxPolicy:
    """A network in ONNX, run by onnxruntime.

    Its inputs are some or all of "observation", "achieved_goal", "desired_goal", (1, n) each; its first
    output is the action (1, actions).

    Args:
        path: of the file.

    Raises:
        InputError: the file cannot be read, the network has other inputs, or onnxruntime is not installed.
    """

    def __init__(self, path: Path) -> None:
        runtime = extra_module("onnxruntime", "onnx")
        try:
            self._session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's errors have no closer base class
            raise InputError(f"policy '{path}': cannot be read as ONNX: {error}") from error
        self._kinds = {each.name: _NUMBERS.get(each.type, np.float32) for each in self._session.get_inputs()}
        if self._kinds.keys() - {*_PARTS}:
            raise InputError(
                f"policy '{path}': its inputs are {', '.join(sorted(self._kinds))}; "
                f"an environment has {', '.join(_PARTS)}"
            )

    def __call__(self, seen: Mapping[str, Array]) -> Array:
        """Return the action for an observation."""
        parts = {name: np.asarray(seen[name], dtype=kind)[None] for name, kind in self._kinds.items()}
        return np.asarray(self._session.run(None, parts)[0])[0]


def policy_of(text: str) -> Policy:
    """Return the policy with a name or file.

    Args:
        text: "module:function", of a module that Python finds, also in the present folder; a .npz file with
            `weights` (actions, k) and `bias` (actions,) of a `LinearPolicy`; or an .onnx file.

    Raises:
        InputError: there is no such policy, or the file has another content.
    """
    if text.endswith(".npz"):
        return _read(Path(text))
    if text.endswith(".onnx"):
        return OnnxPolicy(Path(text))
    module, colon, name = text.partition(":")
    if not colon:
        raise InputError(f"policy '{text}': give module:function, a .npz file of weights, or an .onnx file")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        policy: Any = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"policy '{text}': {error}") from error
    if not callable(policy):
        raise InputError(f"policy '{text}' is a {type(policy).__name__}; give a function")
    checked: Policy = policy
    return checked


def _read(path: Path) -> LinearPolicy:
    try:
        with np.load(path, allow_pickle=False) as stored:
            weights, bias = (np.array(stored[name], dtype=float) for name in ("weights", "bias"))
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"policy '{path}': holds no weights and bias: {error}") from error
    if weights.ndim != 2 or bias.shape != weights.shape[:1]:
        raise InputError(f"policy '{path}': weights {weights.shape} and bias {bias.shape} do not fit")
    return LinearPolicy(weights, bias)
