"""Types of a scenario's values, with their constraints.

`Annotated[float, Interval(gt=0.0)]` reads as "a number above 0"; bounds of numbers and lengths are those of
the package annotated_types, the rest is here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Final, final

from annotated_types import Interval, Len

from cosim.config.toml.key_paths import LONGEST_NAME

LEAST_DIRECTION: Final = 1e-9


@final
@dataclass(frozen=True)
class Rule:
    """What a value must satisfy beyond its type, as pydantic applies it.

    Args:
        problem: returns what is wrong with a value, or None.
    """

    problem: Callable[[Any], str | None]

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema of the type, with the rule after it."""
        from pydantic_core import PydanticCustomError, core_schema  # here: engines import the schema as well

        def checked(value: Any) -> Any:
            if problem := self.problem(value):
                raise PydanticCustomError("rule", "{problem}", {"problem": problem})
            return value

        return core_schema.no_info_after_validator_function(checked, handler(source))


@final
@dataclass(frozen=True)
class Pattern:
    """A text that a regular expression matches; `meaning` says in words what is asked."""

    expression: str
    meaning: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema of a text with this pattern."""
        return {**handler(source), "pattern": self.expression, "metadata": {"meaning": self.meaning}}


@final
class OrByName:
    """A list that a file may also give as a table by names; `resolve` turns it into a list."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema of the list, or of a table with the same entries."""
        from pydantic_core import core_schema  # here: engines import the schema as well

        listed = handler(source)
        named = core_schema.dict_schema(core_schema.str_schema(), listed["items_schema"][0])
        return core_schema.union_schema([listed, named])


def _without_direction(vector: Sequence[float]) -> str | None:
    if sum(component * component for component in vector) <= LEAST_DIRECTION**2:
        return f"{list(vector)} has no direction; must not be zero"
    return None


def _not_increasing(values: Sequence[float]) -> str | None:
    grows = all(first < second for first, second in pairwise(values))
    return None if grows else f"{list(values)} must increase from entry to entry"


Positive = Annotated[float, Interval(gt=0.0)]
NonNegative = Annotated[float, Interval(ge=0.0)]
Fraction = Annotated[float, Interval(gt=0.0, lt=1.0)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Pressure = Annotated[float, Interval(ge=-1e5)]
"""Gauge pressure: not below vacuum."""

Count = Annotated[int, Interval(ge=1, le=1_000_000)]
Vector3 = tuple[float, float, float]
Direction = Annotated[tuple[float, float, float], Rule(_without_direction)]
Quaternion = Annotated[tuple[float, float, float, float], Rule(_without_direction)]
Increasing = Rule(_not_increasing)
Colour = tuple[Share, Share, Share, Share]
Name = Annotated[
    str,
    Len(max_length=LONGEST_NAME),
    Pattern("^[A-Za-z][A-Za-z0-9_-]*$", "a letter followed by letters, digits, '_' or '-'"),
]
Text = Annotated[
    str,
    Pattern(
        r"^[^\u0000-\u0008\u000b-\u001f\u007f-\u009f]*[^\s\u0000-\u0008\u000b-\u001f\u007f-\u009f]"
        r"[^\u0000-\u0008\u000b-\u001f\u007f-\u009f]*$",
        "a text that is not empty, without control characters but tabs and line breaks",
    ),
]
