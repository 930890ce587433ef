"""Constraints that a scenario's values carry in their type annotations.

`Annotated[float, Bounds(above=0.0)]` reads as "a number above 0"; the parser applies every constraint it
finds and reports the text that `violation` returns.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Final, final

LONGEST_SHOWN: Final = 60
LONGEST_NAME: Final = 64


def shown(value: Any) -> str:
    """Return a value as messages show it: texts in quotes, control characters escaped, long ones cut."""
    quoted = repr(value)
    return quoted if len(quoted) <= LONGEST_SHOWN else f"{quoted[: LONGEST_SHOWN - 3]}..."


class Constraint(ABC):
    """What a value must satisfy beyond its type."""

    @abstractmethod
    def violation(self, value: Any) -> str | None:
        """Return what is wrong with `value` and what is allowed, or None."""


@final
@dataclass(frozen=True)
class Bounds(Constraint):
    """Limits of a number: `above` and `below` exclude the limit itself."""

    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None

    def violation(self, value: Any) -> str | None:
        """Return what is wrong with the number, or None."""
        inside = (
            (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.below is None or value < self.below)
            and (self.at_most is None or value <= self.at_most)
        )
        return None if inside else f"{value:g} is out of bounds; must be {self.describe()}"

    def describe(self) -> str:
        """Return the bounds in words."""
        words = (
            ("above", self.above),
            ("at least", self.at_least),
            ("below", self.below),
            ("at most", self.at_most),
        )
        return " and ".join(f"{word} {limit:g}" for word, limit in words if limit is not None)


@final
@dataclass(frozen=True)
class Length(Constraint):
    """Smallest and largest number of entries of a list, or of the characters of a text."""

    at_least: int = 0
    at_most: int | None = None
    of: str = "entries"

    def violation(self, value: Any) -> str | None:
        """Return what is wrong with the list's length, or None."""
        if len(value) < self.at_least:
            return f"has {len(value)} {self.of}; needs at least {self.at_least}"
        if self.at_most is not None and len(value) > self.at_most:
            return f"has {len(value)} {self.of}; at most {self.at_most} are allowed"
        return None


@final
@dataclass(frozen=True)
class NonZero(Constraint):
    """A vector with a length above `smallest`, so that it names a direction."""

    smallest: float = 1e-9

    def violation(self, value: Any) -> str | None:
        """Return what is wrong with the vector, or None."""
        if sum(component * component for component in value) <= self.smallest**2:
            return f"{list(value)} has no direction; must not be zero"
        return None


@final
@dataclass(frozen=True)
class Increasing(Constraint):
    """A list whose entries grow strictly."""

    def violation(self, value: Any) -> str | None:
        """Return what is wrong with the list, or None."""
        grows = all(first < second for first, second in pairwise(value))
        return None if grows else f"{list(value)} must increase from entry to entry"


@final
@dataclass(frozen=True)
class Pattern(Constraint):
    """A text that matches a regular expression from end to end."""

    expression: str
    meaning: str

    def violation(self, value: Any) -> str | None:
        """Return what is wrong with the text, or None."""
        return None if re.fullmatch(self.expression, value) else f"{shown(value)} must be {self.meaning}"


Positive = Annotated[float, Bounds(above=0.0)]
NonNegative = Annotated[float, Bounds(at_least=0.0)]
Fraction = Annotated[float, Bounds(above=0.0, below=1.0)]
Share = Annotated[float, Bounds(at_least=0.0, at_most=1.0)]
Pressure = Annotated[float, Bounds(at_least=-1e5)]
"""Gauge pressure: not below vacuum."""

Count = Annotated[int, Bounds(at_least=1, at_most=1_000_000)]
Vector3 = tuple[float, float, float]
Direction = Annotated[tuple[float, float, float], NonZero()]
Quaternion = Annotated[tuple[float, float, float, float], NonZero()]
Colour = tuple[Share, Share, Share, Share]
Name = Annotated[
    str,
    Pattern(r"[A-Za-z][A-Za-z0-9_-]*", "a letter followed by letters, digits, '_' or '-'"),
    Length(at_most=LONGEST_NAME, of="characters"),
]
Text = Annotated[
    str,
    Pattern(r"(?s).*\S.*", "a text that is not empty"),
    Pattern(r"[^\x00-\x08\x0b-\x1f\x7f-\x9f]*", "without control characters but tabs and line breaks"),
]
