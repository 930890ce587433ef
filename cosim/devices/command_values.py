"""Checks the numbers of a `Command`, and puts what it names in order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from cosim.base.frames import Array
from cosim.devices.controller import Command
from cosim.errors import InputError, InstabilityError


def named_values(
    given: Mapping[str, float], names: tuple[str, ...], who: str, key: str, lowest: float = -math.inf
) -> tuple[float | None, ...]:
    """Return what is commanded of each name in order; None where it is left out.

    Args:
        given: values by name.
        names: that there are.
        who: commands, for messages.
        key: of the command.
        lowest: value that is allowed.

    Raises:
        InputError: there is no such name, or a value is below the lowest.
        InstabilityError: a value is not finite.
    """
    for name, value in given.items():
        if name not in names:
            raise InputError(f"{who}: {key} of '{name}'; there are: {', '.join(names) or 'none'}")
        if not math.isfinite(value):
            raise InstabilityError(f"{who}: {key} of '{name}' is {value}")
        if value < lowest:
            raise InputError(f"{who}: {key} of '{name}' is {value:g}; must be at least {lowest:g}")
    return tuple(float(given[name]) if name in given else None for name in names)


def numbers(
    given: Sequence[float] | Array | None, count: int, who: str, key: str
) -> tuple[float, ...] | None:
    """Return a list of a command; None where it is left out.

    Args:
        given: numbers.
        count: that there have to be.
        who: commands, for messages.
        key: of the command.

    Raises:
        InputError: there are not as many.
        InstabilityError: one is not finite.
    """
    if given is None:
        return None
    values = tuple(float(value) for value in given)
    if len(values) != count:
        raise InputError(f"{who}: {key} has {len(values)} numbers; must be {count}")
    if not all(map(math.isfinite, values)):
        raise InstabilityError(f"{who}: {key} is {values}")
    return values


def check_one_order_each(command: Command, who: str) -> None:
    """Check that no cable is commanded twice.

    Raises:
        InputError: one is.
    """
    for name in set(command.cable_tension_N) & set(command.cable_length_m):
        raise InputError(f"{who} commands both tension and length of cable '{name}'")
