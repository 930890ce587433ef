"""When a run passes the tip paths of its phases."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from cosim.plan.paths.tip_path import TipPathInfo
from cosim.plan.plan import PhasePlan


def passed_paths(phases: Sequence[PhasePlan], tick_s: float | None) -> dict[int, TipPathInfo]:
    """Return when a run passes the paths of its phases, by their index.

    Args:
        phases: of the plan.
        tick_s: of the lockstep clock; None in statics, where a path takes the whole phase.
    """

    def length(planned: PhasePlan) -> float:
        both = planned.phase.duration_s + planned.phase.settle_s
        return both if tick_s is None else max(1, round(both / tick_s)) * tick_s

    def path_s(planned: PhasePlan) -> float:
        if tick_s is None:
            return length(planned)
        return max(1, round(planned.phase.duration_s / tick_s)) * tick_s

    ends = list(accumulate(map(length, phases), initial=0.0))
    return {
        index: TipPathInfo(planned.tip_path, ends[index], path_s(planned))
        for index, planned in enumerate(phases)
        if planned.tip_path is not None
    }
