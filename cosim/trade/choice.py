"""Which members are worth having, and which one to take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from cosim.errors import InputError
from cosim.trade.measuring import Measured

Wish: TypeAlias = tuple[str, float]
"""("budget", least real-time factor) or ("tolerance", largest tip error [m])."""

_LENGTHS_m = {"mm": 1e-3, "um": 1e-6, "cm": 1e-2, "m": 1.0}


def pareto_front(results: Sequence[Measured]) -> list[Measured]:
    """Return those that no other one beats in both tip error and real-time factor, fastest first."""
    ordered = sorted(
        (result for result in results if result.comparable),
        key=lambda result: (-result.real_time_factor, result.tip_error_m),
    )
    front: list[Measured] = []
    for result in ordered:
        if not front or result.tip_error_m < front[-1].tip_error_m:
            front.append(result)
    return front


def pick(results: Sequence[Measured], wish: Wish) -> Measured | None:
    """Return the member that meets a wish best, or None if none meets it.

    Args:
        results: of one group.
        wish: a budget takes the least tip error at that speed; a tolerance the greatest speed within it.
    """
    kind, bound = wish
    front = pareto_front(results)
    if kind == "budget":
        fast = [result for result in front if result.real_time_factor >= bound]
        return fast[-1] if fast else None
    exact = [result for result in front if result.tip_error_m <= bound]
    return exact[0] if exact else None


def parse_budget(text: str) -> Wish:
    """Return the wish of a text such as "1.0x".

    Raises:
        InputError: it is none.
    """
    return "budget", _positive(text.strip().removesuffix("x"), text, "a real-time factor, such as 1.0x")


def parse_tolerance(text: str) -> Wish:
    """Return the wish of a text such as "1mm"; metres if there is no unit.

    Raises:
        InputError: it is none.
    """
    number = text.strip()
    for unit, metres in _LENGTHS_m.items():
        if number.endswith(unit):
            number = number.removesuffix(unit)
            return "tolerance", metres * _positive(number, text, "a length, such as 1mm")
    return "tolerance", _positive(number, text, "a length, such as 1mm")


def _positive(number: str, text: str, wanted: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise InputError(f"'{text}' is not {wanted}")
    return value
