"""Branchings of the soft robot's equilibria over a run, and its stability at the ends of phases."""

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any, Final

from cosim.soft.solve.branching import IN_TIME, LEFT, UNDECIDED, Branching, StabilityReport
from cosim.telemetry.run_info import Decay

_PARALLEL: Final = 0.8
"""Cosine of the angle between two directions above which they are the same."""
_FIGURES: Final = ("lowest_frequency_Hz", "disturbed_tip_m", "load_margin", "losses_held")


def joined_branchings(
    before: list[dict[str, Any]], phase: str, time_s: float, more: Sequence[Branching]
) -> list[dict[str, Any]]:
    """Return the branchings of a run after a further tick.

    Those of a phase in time with the same direction are one.

    Args:
        before: rows of the summary before the tick.
        phase: name of its phase.
        time_s: at its end.
        more: branchings in the tick.
    """
    joined = list(before)
    for each in more:
        row: dict[str, Any] = {"phase": phase, "time_s": time_s, "until_s": time_s} | vars(each)
        same = [k for k, other in enumerate(joined) if other["phase"] == phase and _is_same(other, row)]
        if same:
            undecided = UNDECIDED in (row["chosen"], joined[same[0]]["chosen"])
            chosen = UNDECIDED if undecided else LEFT
            joined[same[0]] = joined[same[0]] | {"until_s": time_s, "chosen": chosen}
        else:
            joined.append(row)
    return joined


def _is_same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    along = sum(a * b for a, b in zip(one["direction"], other["direction"], strict=True))
    return one["chosen"] in IN_TIME and other["chosen"] in IN_TIME and abs(along) > _PARALLEL


def stability_figures(
    stability: StabilityReport | None, branchings: list[dict[str, Any]], decay: Decay | None = None
) -> dict[str, Any]:
    """Return figures of the soft robot's stability at the end of a phase; they are None if it is unknown.

    Args:
        stability: at the end; None: unknown.
        branchings: of the phase.
        decay: of the run, see `RunInfo`.
    """
    if stability is None:
        return {"stability": None, **dict.fromkeys(_FIGURES), "modes": []}
    return {
        "stability": stability.stability([(row["extent"], row["snap"]) for row in branchings]),
        **{name: getattr(stability, name) for name in _FIGURES},
        "modes": [
            _mode(frequency, decay, losses)
            for frequency, losses in zip_longest(
                stability.frequencies_Hz, stability.losses_per_s, fillvalue=0.0
            )
        ],
    }


def _mode(frequency_Hz: float, decay: Decay | None, losses_per_s: float) -> dict[str, Any]:
    declared, numerical = (None, None) if decay is None else decay(frequency_Hz, losses_per_s)
    return {
        "frequency_Hz": frequency_Hz, "declared_decay_per_s": declared, "numerical_decay_per_s": numerical,
    }  # fmt: skip


def with_rest(
    branchings: list[dict[str, Any]], phase: str, stability: StabilityReport | None
) -> list[dict[str, Any]]:
    """Return branchings with the tip at rest after a phase in which rounding errors chose the side.

    Args:
        branchings: of the run so far.
        phase: name of the phase, at its end.
        stability: at the end; None: unknown.
    """
    tip = None if stability is None else stability.rests_at_m
    return [
        row | {"tip_m": tip} if row["phase"] == phase and row["chosen"] in IN_TIME else row
        for row in branchings
    ]
