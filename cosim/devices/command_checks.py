"""Checks the values of commands from controllers and from `Simulation.step`: names, numbers, bounds."""

import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any, Final, TypeVar

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.devices.controller import Command
from cosim.errors import InputError, InstabilityError

Value = TypeVar("Value")
_LONGEST: Final = 60
_ROTATION: Final = 1e-3
"""Largest entry by which R^T R may differ from 1; a pose that is typed in has few digits."""


def named_values(
    given: Mapping[str, float],
    names: tuple[str, ...],
    who: str,
    key: str,
    *,
    lowest: float = -math.inf,
    above: float = -math.inf,
) -> tuple[float | None, ...]:
    """Return the commanded value of each name in order; None for names that are omitted.

    Args:
        given: values by name.
        names: that exist.
        who: source of the command, for messages.
        key: of the command.
        lowest: smallest allowed value.
        above: value that all must exceed.

    Raises:
        InputError: a name does not exist, or a value is not a number or too low.
        InstabilityError: a value is not finite.
    """
    if type(given) is not dict and not isinstance(given, Mapping):  # the first check is faster
        raise InputError(f"{who}: {key} is {shown(given)}; give numbers by name, such as {{'name': 1.0}}")
    values = {}
    for name, value in given.items():
        if name not in names:
            raise InputError(f"{who}: {key} of {shown(name)}; there are: {', '.join(names) or 'none'}")
        number = value if type(value) is float else _number(value, f"{who}: {key} of '{name}'")
        values[name] = number
        if not math.isfinite(number):
            raise InstabilityError(f"{who}: {key} of '{name}' is {number}")
        if number < lowest:
            raise InputError(f"{who}: {key} of '{name}' is {number:g}; must be at least {lowest:g}")
        if number <= above:
            raise InputError(f"{who}: {key} of '{name}' is {number:g}; must be above {above:g}")
    return tuple(values.get(name) for name in names)


def numbers(
    given: Sequence[float] | Array | None, count: int, who: str, key: str
) -> tuple[float, ...] | None:
    """Return the numbers of a command's list; None for None.

    Args:
        given: numbers.
        count: required number.
        who: source of the command, for messages.
        key: of the command.

    Raises:
        InputError: their number is wrong, or an entry is not a number.
        InstabilityError: one is not finite.
    """
    if given is None:
        return None
    values = row_of_numbers(given, count, f"{who}: {key}")
    if not all(map(math.isfinite, values)):
        raise InstabilityError(f"{who}: {key} is {values}")
    return values


def row_of_numbers(given: Any, count: int, place: str) -> tuple[float, ...]:
    """Return a list or array (count,) as numbers, which may be infinite or NaN.

    Args:
        given: the list or array.
        count: required number.
        place: name of the value, for messages.

    Raises:
        InputError: their number is wrong, or an entry is not a number.
    """
    if isinstance(given, np.ndarray) and given.ndim == 1:
        given = given.tolist()
    if type(given) is not list and (not isinstance(given, Sequence) or isinstance(given, str | bytes)):
        raise InputError(f"{place} is {shown(given)}; must be {count} numbers in a row, shape ({count},)")
    values = tuple([
        value if type(value) is float else _number(value, f"{place}[{k}]") for k, value in enumerate(given)
    ])  # fmt: skip
    if len(values) != count:
        raise InputError(f"{place} has {len(values)} numbers; must be {count}")
    return values


def check_command(command: Command, who: str) -> None:
    """Check the type of a command, and the pose of its flange.

    Raises:
        InputError: one is wrong.
        InstabilityError: a number of the pose is not finite.
    """
    if not isinstance(command, Command):
        raise InputError(f"{who}: command is {shown(command)}; give a cosim.Command")
    if (pose := command.flange) is not None:
        if not isinstance(pose, Pose):
            raise InputError(f"{who}: flange is {shown(pose)}; give a cosim.Pose")
        if not (np.isfinite(pose.rotation).all() and np.isfinite(pose.translation).all()):
            raise InstabilityError(f"{who}: flange holds a number that is not finite")
        off = float(np.abs(pose.rotation.T @ pose.rotation - np.eye(3)).max())
        if not (off <= _ROTATION and np.linalg.det(pose.rotation) > 0.0):
            raise InputError(f"{who}: flange.rotation is no rotation; its rows must be a right-handed triad")


def check_one_order_each(
    tension_N: Sequence[float | None], length_m: Sequence[float | None], cables: Sequence[str], who: str
) -> None:
    """Check that no cable is commanded twice.

    Raises:
        InputError: one is.
    """
    for name, pull, long in zip(cables, tension_N, length_m, strict=True):
        if pull is not None and long is not None:
            raise InputError(f"{who} commands both tension and length of cable '{name}'")


def checked_step(command: Any, ticks: Any, who: str) -> tuple[Command | None, int]:
    """Return the command and the ticks of a step; `step(5)` gives the ticks alone.

    Args:
        command: a `Command`, a number of ticks, or None.
        ticks: of the clock.
        who: name of the step, for messages.

    Raises:
        InputError: a type is wrong, or both are numbers.
    """
    if command is not None and not isinstance(command, Command):
        if whole(ticks) != 1 or (number := whole(command)) is None:
            raise InputError(
                f"{who}: command is {shown(command)}; give a cosim.Command, or a number of ticks alone"
            )
        return None, number
    if (number := whole(ticks)) is None:
        raise InputError(f"{who}: ticks is {shown(ticks)}; must be a whole number")
    return command, number


def whole(value: Any) -> int | None:
    """Return a value as a whole number; None for other values, also for True and 1.0."""
    if isinstance(value, bool | np.bool_):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def over(values: Iterable[Value | None], others: Iterable[Value]) -> list[Value]:
    """Return values with others in place of those that are None."""
    return [other if value is None else value for value, other in zip(values, others, strict=True)]


def shown(value: Any) -> str:
    """Return a value for messages: in one line, cut to a bounded length."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}... ({type(value).__name__})"


def _number(value: Any, place: str) -> float:
    if isinstance(value, np.ndarray) and not value.ndim:
        value = value.item()
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise InputError(f"{place} is {shown(value)}; must be a number")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{place} is beyond the largest number, 1.8e308") from None
