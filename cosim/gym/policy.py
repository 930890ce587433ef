"""Policies: what chooses an action, and whether one holds on a finer model.

Whether a policy holds on a finer model: the same episodes on two fidelities.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeAlias, final

import gymnasium
import numpy as np

from cosim.base.frames import Array
from cosim.base.resources import extra_module
from cosim.errors import InputError

Policy: TypeAlias = Callable[[Mapping[str, Array]], Array]
"""From {"observation", "achieved_goal", "desired_goal"} to an action, each number within -1 to 1."""

_PARTS: Final = ("observation", "achieved_goal", "desired_goal")
_NUMBERS: Final = {"tensor(double)": np.float64}


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


@final
class OnnxPolicy:
    """A network in ONNX, run by onnxruntime.

    Its inputs are "observation", "achieved_goal", "desired_goal", or some of them, (1, n) each; its first
    output is the action (1, actions).

    Args:
        path: of the file.

    Raises:
        InputError: it cannot be read, has other inputs, or onnxruntime is not installed.
    """

    def __init__(self, path: Path) -> None:
        runtime = extra_module("onnxruntime", "onnx")
        try:
            self._session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own kinds derive from nothing closer
            raise InputError(f"policy '{path}': cannot be read as ONNX: {error}") from error
        self._kinds = {each.name: _NUMBERS.get(each.type, np.float32) for each in self._session.get_inputs()}
        if self._kinds.keys() - {*_PARTS}:
            raise InputError(
                f"policy '{path}': its inputs are {', '.join(sorted(self._kinds))}; "
                f"there are {', '.join(_PARTS)}"
            )

    def __call__(self, seen: Mapping[str, Array]) -> Array:
        """Return the action for an observation."""
        parts = {name: np.asarray(seen[name], dtype=kind)[None] for name, kind in self._kinds.items()}
        return np.asarray(self._session.run(None, parts)[0])[0]


def policy_of(given: str) -> Policy:
    """Return the policy that a text names.

    Args:
        given: "module:function", of a module that Python finds, also in the present folder; a .npz file with
            `weights` (actions, k) and `bias` (actions,) of a `LinearPolicy`; or a file of `OnnxPolicy`.

    Raises:
        InputError: there is no such policy, or the file holds something else.
    """
    if given.endswith(".npz"):
        return _read(Path(given))
    if given.endswith(".onnx"):
        return OnnxPolicy(Path(given))
    module, colon, name = given.partition(":")
    if not colon:
        raise InputError(f"policy '{given}': give module:function, a .npz file of weights, or an .onnx file")
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


@final
@dataclass(frozen=True)
class Episode:
    """How one episode went.

    Args:
        total: of its rewards.
        reached: whether its last step was a success.
        failure: what could not be solved; empty: nothing.
    """

    total: float
    reached: bool
    failure: str = ""


def episodes(
    policy: Policy, name: str, fidelity: str, count: int, seed: int, **given: Any
) -> Iterator[Episode]:
    """Yield episodes of a policy on a fidelity, with the same goals on any.

    Args:
        policy: see there.
        name: id of the environment.
        fidelity: of the soft robot.
        count: of episodes.
        seed: of the first one's goal; the others follow.
        given: further arguments of the environment.

    Raises:
        InputError: there is no such environment, or the policy's action does not fit it.
    """
    try:
        environment = gymnasium.make(name, fidelity=fidelity, **given)
    except gymnasium.error.UnregisteredEnv as error:
        raise InputError(str(error)) from error
    for k in range(count):
        seen, info = environment.reset(seed=seed + k)
        total, ended = 0.0, False
        while not ended:
            action = np.asarray(policy(seen), dtype=np.float32)
            if action.shape != environment.action_space.shape:
                raise InputError(
                    f"the policy's action has the shape {action.shape}; {name} takes "
                    f"{environment.action_space.shape}"
                )
            seen, reward, terminated, truncated, info = environment.step(action)
            total, ended = total + float(reward), terminated or truncated
        yield Episode(total, bool(info["is_success"]), str(info.get("failure", "")))
    environment.close()


@final
@dataclass(frozen=True)
class Replay:
    """The same episodes on two fidelities.

    Args:
        fidelities: the one that a policy was made for, and the finer one.
        found: episodes of each.
    """

    fidelities: tuple[str, str]
    found: tuple[tuple[Episode, ...], tuple[Episode, ...]]

    def lines(self) -> list[str]:
        """Return what came of it, in words, with how return and success change."""
        told = []
        for fidelity, found in zip(self.fidelities, self.found, strict=True):
            failed = [one.failure for one in found if one.failure]
            told.append(
                f"{fidelity}: return {_return(found):.3g}, success in {_success(found):.0%} of {len(found)}"
                + (f", {len(failed)} not solved: {failed[0]}" if failed else "")
            )
        coarse, fine = self.found
        change, reached = _return(fine) - _return(coarse), _success(fine) - _success(coarse)
        told.append(
            f"from {self.fidelities[0]} to {self.fidelities[1]}: return {change:+.3g}, "
            f"success {100.0 * reached:+.0f} points"
        )
        return told


def replay(
    policy: Policy, name: str, fidelities: tuple[str, str], count: int, seed: int = 0, **given: Any
) -> Replay:
    """Return how a policy does on two fidelities; see `episodes`."""
    first, second = (tuple(episodes(policy, name, one, count, seed, **given)) for one in fidelities)
    return Replay(fidelities, (first, second))


def _return(found: tuple[Episode, ...]) -> float:
    return float(np.mean([one.total for one in found]))


def _success(found: tuple[Episode, ...]) -> float:
    return float(np.mean([one.reached for one in found]))
