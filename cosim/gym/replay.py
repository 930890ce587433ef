"""Replays a policy on two fidelities, with the same goals: does it still work on the finer model?"""

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
    """Result of an episode.

    Args:
        total: sum of its rewards.
        reached: whether its last step was a success.
        failure: error of the physics; empty without one.
    """

    total: float
    reached: bool
    failure: str = ""


def episodes(
    policy: Policy, name: str, fidelity: str, count: int, seed: int, **given: Any
) -> Iterator[Episode]:
    """Yield episodes of a policy on a fidelity; goals are the same on each fidelity.

    Args:
        policy: the policy.
        name: id of the environment.
        fidelity: of the soft robot.
        count: number of episodes.
        seed: of the first goal; each further episode has the next number.
        given: further arguments of the environment.

    Raises:
        InputError: there is no such environment, or the policy's action has another shape.
    """
    try:
        environment = gymnasium.make(name, fidelity=fidelity, **given)
    except gymnasium.error.UnregisteredEnv as error:
        raise InputError(str(error)) from error
    with environment:
        for k in range(count):
            seen, info = environment.reset(seed=seed + k)
            total, ended = 0.0, False
            while not ended:
                action = np.asarray(policy(seen), dtype=np.float32)
                if action.shape != environment.action_space.shape:
                    raise InputError(
                        f"the policy's action has the shape {action.shape}; {name} needs "
                        f"{environment.action_space.shape}"
                    )
                seen, reward, terminated, truncated, info = environment.step(action)
                total, ended = total + float(reward), terminated or truncated
            yield Episode(total, bool(info["is_success"]), str(info.get("failure", "")))


@final
@dataclass(frozen=True)
class Replay:
    """The same episodes on two fidelities.

    Args:
        coarse: the fidelity that the policy was trained on.
        fine: the finer fidelity.
        on_coarse: episodes of the first.
        on_fine: episodes of the second.
    """

    coarse: str
    fine: str
    on_coarse: tuple[Episode, ...]
    on_fine: tuple[Episode, ...]

    def lines(self) -> list[str]:
        """Return the result in words: return and success on each fidelity, and their changes."""
        lines = [_line(self.coarse, self.on_coarse), _line(self.fine, self.on_fine)]
        change = _mean_return(self.on_fine) - _mean_return(self.on_coarse)
        success = _success_rate(self.on_fine) - _success_rate(self.on_coarse)
        lines.append(
            f"from {self.coarse} to {self.fine}: return {change:+.3g}, success {100.0 * success:+.0f} points"
        )
        return lines


def replay(policy: Policy, name: str, coarse: str, fine: str, count: int, seed: int = 0) -> Replay:
    """Return the episodes of a policy on two fidelities; see `episodes`."""
    on_coarse, on_fine = (tuple(episodes(policy, name, one, count, seed)) for one in (coarse, fine))
    return Replay(coarse, fine, on_coarse, on_fine)


def _line(fidelity: str, found: tuple[Episode, ...]) -> str:
    failed = [one.failure for one in found if one.failure]
    return (
        f"{fidelity}: return {_mean_return(found):.3g}, success in {_success_rate(found):.0%} of {len(found)}"
        + (f", {len(failed)} not solved: {failed[0]}" if failed else "")
    )


def _mean_return(found: tuple[Episode, ...]) -> float:
    return float(np.mean([one.total for one in found]))


def _success_rate(found: tuple[Episode, ...]) -> float:
    return float(np.mean([one.reached for one in found]))
