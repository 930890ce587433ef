"""Values of a snapshot that are made when somebody first asks for them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar, cast, final

T = TypeVar("T")


@final
class Later(Generic[T]):
    """Stands for a value until it is asked for.

    Args:
        make: returns the value, the same one whenever it is called.
    """

    def __init__(self, make: Callable[[], T]) -> None:
        self._make = make

    @cached_property
    def value(self) -> T:
        """The value, made once."""
        return self._make()


def later(make: Callable[[], T] | Later[T]) -> T:
    """Return what stands for a value in the arguments of a class that keeps such values, see `put_off`.

    Args:
        make: returns the value; it must not look at anything that changes meanwhile.
    """
    return cast(T, make if isinstance(make, Later) else Later(make))


def put_off(owner: object) -> None:
    """Take the attributes that are `later` out of an object, so that asking for them fails over to `made`."""
    held = vars(owner)
    waiting = {name: value for name, value in held.items() if type(value) is Later}
    for name in waiting:
        del held[name]
    held["_waiting"] = waiting


def made(owner: object, name: str) -> Any:
    """Return an attribute that was put off, and keep it.

    Raises:
        AttributeError: there is none of that name.
    """
    held = vars(owner)
    waiting = held.get("_waiting", {}).get(name)
    if waiting is None:
        raise AttributeError(f"{type(owner).__name__!r} object has no attribute {name!r}")
    held[name] = value = waiting.value
    return value
