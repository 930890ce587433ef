"""Faults of a file that are collected, so that all are told at once; and values that no one can know."""

from __future__ import annotations

from copy import copy
from dataclasses import is_dataclass
from functools import cache
from types import TracebackType
from typing import Any, Final, TypeAlias, TypeVar, final

from cosim.errors import ScenarioError

T = TypeVar("T")
Fault: TypeAlias = tuple[str, str]
"""Path of a key, and what is wrong with it."""

_PLAIN: Final = "_plain"
"""Where a guarded class keeps the one that it stands for."""


class NotKnown(Exception):  # noqa: N818  # no error of anybody: what a rule needs is wrong itself
    """A rule has met a value that is wrong by itself, so there is nothing that it could say."""


@final
class _Unknown:
    """Stands where the value of a file is wrong."""

    def __repr__(self) -> str:
        return "UNKNOWN"


UNKNOWN: Final = _Unknown()


def guard(value: Any) -> None:
    """Let whoever asks a dataclass for a field that holds UNKNOWN meet NotKnown; within it as well."""
    if isinstance(value, tuple):
        for item in value:
            guard(item)
    elif is_dataclass(value):
        held = vars(value).values()
        for item in held:
            guard(item)
        if any(item is UNKNOWN for item in held):
            object.__setattr__(value, "__class__", _guarded(type(value)))  # type: ignore[arg-type]


def copy_with(instance: T, **changes: Any) -> T:
    """Return a copy of a dataclass with other values in some fields; the others may hold UNKNOWN.

    One in which nothing is UNKNOWN any more is an ordinary one again.
    """
    found = copy(instance)
    for name, value in changes.items():
        object.__setattr__(found, name, value)
    plain = vars(type(found)).get(_PLAIN)
    if plain is not None and not any(value is UNKNOWN for value in vars(found).values()):
        object.__setattr__(found, "__class__", plain)
    return found


@cache
def _guarded(kind: type) -> type:
    def known(self: Any, name: str) -> Any:
        value = object.__getattribute__(self, name)
        if value is UNKNOWN:
            raise NotKnown
        return value

    def compared(self: Any, other: object) -> bool:
        raise NotKnown

    return type(
        kind.__name__,
        (kind,),
        {"__getattribute__": known, "__eq__": compared, "__hash__": None, _PLAIN: kind},
    )


@final
class Faults:
    """Collects faults: `with faults:` notes what is raised within, and goes on after it."""

    def __init__(self) -> None:
        self._found: dict[Fault, None] = {}

    def __enter__(self) -> None:
        """Begin something that may raise ScenarioError."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        """Note a ScenarioError; pass over what could not be known."""
        if isinstance(error, ScenarioError):
            for fault in error.faults:
                self.add(*fault)
        return isinstance(error, ScenarioError | NotKnown)

    def add(self, path: str, message: str) -> None:
        """Note what is wrong with a key, once."""
        self._found[path, message] = None

    def tell(self) -> None:
        """Raise what was found.

        Raises:
            ScenarioError: with all faults, if there are any.
        """
        if self._found:
            first, *others = self._found
            raise ScenarioError(*first, further=tuple(others))
