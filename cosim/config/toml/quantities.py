"""Types of the values in files: vectors, names, texts, and numbers with bounds that suit their unit. A number
that must be above 0 has a smallest value of its unit, so that nothing is divided by almost zero.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, Final, Literal, TypeAlias, TypeVar

from annotated_types import Interval, Len
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, GetPydanticSchema, Tag

from cosim.config.toml.keys import LONGEST_NAME, describe
from cosim.config.toml.old_keys import REMEDY, SCHEMA

LEAST_DIRECTION: Final = 1e-9
NAME_PATTERN: Final = "^[A-Za-z][A-Za-z0-9_-]*$"
TEXT_PATTERN: Final = (
    r"^[^\u0000-\u0008\u000b-\u001f\u007f-\u009f]*[^\s\u0000-\u0008\u000b-\u001f\u007f-\u009f]"
    r"[^\u0000-\u0008\u000b-\u001f\u007f-\u009f]*$"
)
PATTERNS: Final = {
    NAME_PATTERN: "a letter followed by letters, digits, '_' or '-'",
    TEXT_PATTERN: "a text that is not empty, without control characters but tabs and line breaks",
}
"""Patterns of texts, each in words for messages."""

Value = TypeVar("Value")
# without a unit
Number = Annotated[float, Interval(ge=-1e12, le=1e12)]
Positive = Annotated[float, Interval(gt=0.0, ge=1e-12, le=1e12)]
NonNegative = Annotated[float, Interval(ge=0.0, le=1e12)]
Fraction = Annotated[float, Interval(gt=0.0, ge=1e-12, lt=1.0)]
UpToOne = Annotated[float, Interval(gt=0.0, ge=1e-12, le=1.0)]
ZeroToOne = Annotated[float, Interval(ge=0.0, le=1.0)]
Count = Annotated[int, Interval(ge=1, le=1_000_000)]
# m
Length = Annotated[float, Interval(ge=-100.0, le=100.0)]
PositiveLength = Annotated[float, Interval(gt=0.0, ge=1e-9, le=100.0)]
NonNegativeLength = Annotated[float, Interval(ge=0.0, le=100.0)]
# s, Hz, 1/s
PositiveTime = Annotated[float, Interval(gt=0.0, ge=1e-6, le=1e9)]
NonNegativeTime = Annotated[float, Interval(ge=0.0, le=1e9)]
PositiveFrequency = Annotated[float, Interval(gt=0.0, ge=1e-6, le=1e4)]
PositiveRate = Annotated[float, Interval(gt=0.0, ge=1e-6, le=1e9)]
NonNegativeRate = Annotated[float, Interval(ge=0.0, le=1e9)]
# rad
Angle = Annotated[float, Interval(ge=-1e4, le=1e4)]
PositiveAngle = Annotated[float, Interval(gt=0.0, ge=1e-9, le=1e4)]
# m/s, rad/s, m/s^2
Speed = Annotated[float, Interval(ge=-1e9, le=1e9)]
PositiveSpeed = Annotated[float, Interval(gt=0.0, ge=1e-6, le=1e9)]
Acceleration = Annotated[float, Interval(ge=-1e4, le=1e4)]
PositiveAcceleration = Annotated[float, Interval(gt=0.0, ge=1e-6, le=1e4)]
# kg, kg/m^3, kg/s, kg/(s Pa), K
PositiveMass = Annotated[float, Interval(gt=0.0, ge=1e-9, le=1e6)]
NonNegativeMass = Annotated[float, Interval(ge=0.0, le=1e6)]
NonNegativeDensity = Annotated[float, Interval(ge=0.0, le=1e6)]
PositiveMassFlow = Annotated[float, Interval(gt=0.0, ge=1e-15, le=1e3)]
PositiveConductance = Annotated[float, Interval(gt=0.0, ge=1e-20, le=1.0)]
NonNegativeConductance = Annotated[float, Interval(ge=0.0, le=1.0)]
PositiveTemperature = Annotated[float, Interval(gt=0.0, ge=1.0, le=1e5)]
# Pa; a gauge pressure is not below vacuum
Pressure = Annotated[float, Interval(ge=-1e5, le=1e13)]
PositivePressure = Annotated[float, Interval(gt=0.0, ge=1e-3, le=1e13)]
NonNegativePressure = Annotated[float, Interval(ge=0.0, le=1e13)]
# N, N m, N m s, N m^2, N m^2 s
Force = Annotated[float, Interval(ge=-1e7, le=1e7)]
PositiveForce = Annotated[float, Interval(gt=0.0, ge=1e-15, le=1e7)]
NonNegativeForce = Annotated[float, Interval(ge=0.0, le=1e7)]
PositiveTorque = Annotated[float, Interval(gt=0.0, ge=1e-12, le=1e7)]
NonNegativeTorque = Annotated[float, Interval(ge=0.0, le=1e7)]
NonNegativeAngularDamping = Annotated[float, Interval(ge=0.0, le=1e7)]
NonNegativeBendingStiffness = Annotated[float, Interval(ge=0.0, le=1e7)]
NonNegativeBendingDamping = Annotated[float, Interval(ge=0.0, le=1e7)]
# N/m, N s/m, N/m^3
PositiveStiffness = Annotated[float, Interval(gt=0.0, ge=1e-9, le=1e12)]
NonNegativeStiffness = Annotated[float, Interval(ge=0.0, le=1e12)]
NonNegativeDamping = Annotated[float, Interval(ge=0.0, le=1e9)]
PositiveContactStiffness = Annotated[float, Interval(gt=0.0, ge=1e-3, le=1e15)]
Vector3 = tuple[Number, Number, Number]
Position = tuple[Length, Length, Length]
Colour = tuple[ZeroToOne, ZeroToOne, ZeroToOne, ZeroToOne]
Name = Annotated[str, Len(max_length=LONGEST_NAME), Field(pattern=NAME_PATTERN)]
Text = Annotated[str, Field(pattern=TEXT_PATTERN)]


def _current(value: Any) -> Any:
    if value == SCHEMA - 1 and not isinstance(value, bool):
        raise ValueError(f"is {value}, that of older files; {REMEDY}")
    if type(value) is not int or value != SCHEMA:
        raise ValueError(f"got {describe(value)}; allowed: {SCHEMA}")
    return value


def _with_direction(vector: Any) -> Any:
    if sum(component * component for component in vector) <= LEAST_DIRECTION**2:
        raise ValueError(f"{list(vector)} has no direction; must not be zero")
    return vector


def _increasing(values: Sequence[float]) -> Sequence[float]:
    if not all(first < second for first, second in pairwise(values)):
        raise ValueError(f"{list(values)} must increase from entry to entry")
    return values


def _shape(value: Any) -> str:
    """Return the tag of a value in a union, as messages call it: "a list", "a table" or "a value"."""
    return (
        "a list"
        if isinstance(value, list | tuple)
        else "a table"
        if isinstance(value, Mapping)
        else "a value"
    )


def _word(value: Any) -> str:
    return "a word" if isinstance(value, str) else "a number"


Direction = Annotated[Vector3, AfterValidator(_with_direction)]
Quaternion = Annotated[tuple[Number, Number, Number, Number], AfterValidator(_with_direction)]
UNTURNED: Final[tuple[float, float, float, float]] = (1.0, 0.0, 0.0, 0.0)
"""The quaternion (w, x, y, z) of no rotation."""
Increasing: Final = AfterValidator(_increasing)
SchemaNumber = Annotated[Literal[2], BeforeValidator(_current)]

OneOrEach: TypeAlias = Annotated[
    Annotated[Value, Tag("a value")] | Annotated[tuple[Value, ...], Tag("a list")], Discriminator(_shape)
]
"""One value for all, or a list with one for each."""
OneOrByName: TypeAlias = Annotated[
    Annotated[Value, Tag("a value")]
    | Annotated[tuple[Value, ...], Tag("a list")]
    | Annotated[Mapping[str, Value], Tag("a table")],
    Discriminator(_shape),
]
"""One value for all, a list with one for each, or a table by name."""
EachOrByName: TypeAlias = Annotated[
    Annotated[tuple[Value, ...], Tag("a list")] | Annotated[Mapping[str, Value], Tag("a table")],
    Discriminator(_shape),
]
"""A list with a value for each, or a table by name."""
CountOrLast: TypeAlias = Annotated[
    Annotated[Count, Tag("a number")] | Annotated[Literal["last"], Tag("a word")], Discriminator(_word)
]
"""A count from 1, or "last"."""
Tensions = Annotated[
    tuple[NonNegativeForce, ...],
    GetPydanticSchema(lambda _, handler: handler(EachOrByName[NonNegativeForce])),
]
"""A list; in a file also a table by name, which is a list once the scenario is resolved."""
