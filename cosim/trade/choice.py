"""Which candidates are worth having, and which one to take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from cosim.errors import InputError
from cosim.trade.measured import FORCE_MEAN, Measured

RESERVE = 0.15
"""Share of a budget by which a candidate is to be faster, as the speed of a machine varies."""

_LENGTHS_m = {"mm": 1e-3, "um": 1e-6, "cm": 1e-2, "m": 1.0}


@final
@dataclass(frozen=True)
class Requirement:
    """What a candidate shall meet; None: anything will do.

    Args:
        budget: least real-time factor.
        tolerance_m: largest error of the tip, and of objects that can move.
        force_N: largest error of the flange force's moving mean.
    """

    budget: float | None = None
    tolerance_m: float | None = None
    force_N: float | None = None

    def met_by(self, result: Measured, reserve: float = 0.0) -> bool:
        """Whether a candidate meets all of it, the budget with a reserve: speeds vary from run to run."""
        return (
            (self.budget is None or result.real_time_factor >= (1.0 + reserve) * self.budget)
            and (self.tolerance_m is None or result.position_error_m <= self.tolerance_m)
            and (self.force_N is None or result.force_error_N <= self.force_N)
        )

    @property
    def words(self) -> str:
        """The requirement in words."""
        parts = []
        if self.budget is not None:
            parts.append(f"budget real-time factor {self.budget:g}")
        if self.tolerance_m is not None:
            parts.append(f"tolerance tip error {1e3 * self.tolerance_m:g} mm")
        if self.force_N is not None:
            parts.append(f"tolerance flange force ({FORCE_MEAN}) {self.force_N:g} N")
        return ", ".join(parts) or "no requirement"


def pareto_front(results: Sequence[Measured]) -> list[Measured]:
    """Return those that no other one beats in both position error and real-time factor, fastest first."""
    ordered = sorted(
        (result for result in results if result.comparable),
        key=lambda result: (-result.real_time_factor, result.position_error_m),
    )
    front: list[Measured] = []
    for result in ordered:
        if not front or result.position_error_m < front[-1].position_error_m:
            front.append(result)
    return front


def eligible(results: Sequence[Measured]) -> list[Measured]:
    """Return the candidates of the table that a choice is made from: the first one."""
    group = results[0].candidate.group if results else "time"
    return [result for result in results if result.candidate.group == group]


def pick(results: Sequence[Measured], requirement: Requirement) -> Measured | None:
    """Return the candidate that meets a requirement best, or None if none meets it.

    Where none meets a budget with the reserve, the fastest of those that meet it without is taken.

    Args:
        results: of one group.
        requirement: with a budget, the least position error is best; without, the greatest speed.
    """
    comparable = [result for result in results if result.comparable]
    safe = [result for result in comparable if requirement.met_by(result, RESERVE)]
    if requirement.budget is not None and safe:
        return min(safe, key=lambda result: (result.position_error_m, -result.real_time_factor))
    able = [result for result in comparable if requirement.met_by(result)]
    return max(able, key=lambda result: (result.real_time_factor, -result.position_error_m), default=None)


def parse_budget(text: str) -> float:
    """Return the real-time factor of a text such as "1.0x".

    Raises:
        InputError: it is none.
    """
    return _positive(text.strip().removesuffix("x"), text, "a real-time factor, such as 1.0x")


def parse_tolerance(text: str) -> float:
    """Return the length [m] of a text such as "1mm"; metres if there is no unit.

    Raises:
        InputError: it is none.
    """
    number = text.strip()
    for unit, metres in _LENGTHS_m.items():
        if number.endswith(unit):
            return metres * _positive(number.removesuffix(unit), text, "a length, such as 1mm")
    return _positive(number, text, "a length, such as 1mm")


def parse_force(text: str) -> float:
    """Return the force [N] of a text such as "0.1N".

    Raises:
        InputError: it is none.
    """
    return _positive(text.strip().removesuffix("N"), text, "a force, such as 0.1N")


def _positive(number: str, text: str, wanted: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise InputError(f"'{text}' is not {wanted}")
    return value
