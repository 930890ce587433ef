"""Whether a policy holds on a finer model: the same episodes on two fidelities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import gymnasium
import numpy as np

from cosim.errors import InputError
from cosim.gym.policy import Policy


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
