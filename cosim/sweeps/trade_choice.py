"""The choice of a trade: the Pareto front, and the candidate that meets a requirement best."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

from cosim.sweeps.trade_results import FORCE_WINDOW_S, Measured

RESERVE: Final = 0.15
"""Fraction by which a candidate should be faster than a budget, as the speed of a machine varies."""
FORCE_MEAN: Final = f"{1e3 * FORCE_WINDOW_S:g} ms mean"


@final
@dataclass(frozen=True)
class Requirement:
    """Requirement of a candidate; None: no bound.

    Args:
        budget: least real-time factor of a command.
        tolerance_m: largest error of the tip and of movable objects.
        force_N: largest error of the flange force's moving mean.
    """

    budget: float | None = None
    tolerance_m: float | None = None
    force_N: float | None = None

    def met_by(self, result: Measured, reserve: float = 0.0) -> bool:
        """Return whether a candidate meets the requirement, the budget with a reserve, as speeds vary."""
        return (
            (self.budget is None or result.real_time_factor >= (1.0 + reserve) * self.budget)
            and (self.tolerance_m is None or result.position_error_m <= self.tolerance_m)
            and (self.force_N is None or result.force_error_N <= self.force_N)
        )

    @property
    def words(self) -> str:
        """The requirement in words."""
        parts = {
            f"budget real-time factor {self.budget or 0.0:g}": self.budget,
            f"tolerance tip error {1e3 * (self.tolerance_m or 0.0):g} mm": self.tolerance_m,
            f"tolerance flange force ({FORCE_MEAN}) {self.force_N or 0.0:g} N": self.force_N,
        }
        return ", ".join(text for text, given in parts.items() if given is not None)


def pareto_front(results: Sequence[Measured]) -> list[Measured]:
    """Return the results that no other beats in both position error and real-time factor, fastest first."""
    ordered = sorted(
        (result for result in results if result.comparable),
        key=lambda result: (-result.real_time_factor, result.position_error_m),
    )
    front: list[Measured] = []
    for result in ordered:
        if not front or result.position_error_m < front[-1].position_error_m:
            front.append(result)
    return front


def pick(results: Sequence[Measured], requirement: Requirement) -> Measured | None:
    """Return the candidate that meets a requirement best, or None if none meets it.

    With a budget, the least position error is best; without, the greatest speed. If no candidate meets the
    budget with the reserve, the fastest that meets it without the reserve is picked.
    """
    comparable = [result for result in results if result.comparable]
    safe = [result for result in comparable if requirement.met_by(result, RESERVE)]
    if requirement.budget is not None and safe:
        return min(safe, key=lambda result: (result.position_error_m, -result.real_time_factor))
    able = [result for result in comparable if requirement.met_by(result)]
    return max(able, key=lambda result: (result.real_time_factor, -result.position_error_m), default=None)


def choice_line(results: Sequence[Measured], requirement: Requirement) -> str:
    """Return a text with the candidate that meets a requirement, and how to run it."""
    best = pick(results, requirement)
    if best is None:
        return f"No candidate meets {requirement.words}."
    return (
        f"For {requirement.words}: {best.candidate.name} (x{best.real_time_factor:.2f} real time, "
        f"its loop x{best.loop_factor:.2f}, "
        f"{1e3 * best.position_error_m:.3g} mm, force, {FORCE_MEAN}, {best.force_error_N:.3g} N). "
        f"Run it with: {best.candidate.words}"
    )
