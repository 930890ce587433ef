"""Quickly made frozen dataclasses are what slowly made ones are."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, dataclass, field, replace

import pytest

from cosim.base.frozen import changed, quickly_made


@quickly_made
@dataclass(frozen=True)
class Quick:
    first: int
    second: float = 2.0
    sum: float = field(init=False, compare=False)

    def __post_init__(self) -> None:
        vars(self)["sum"] = self.first + self.second


def test_arguments_defaults_and_what_follows_are_as_ever() -> None:
    assert (Quick(1).second, Quick(1).sum) == (2.0, 3.0)
    assert Quick(1, 5.0) == Quick(second=5.0, first=1)
    assert replace(Quick(1), first=4).sum == 6.0
    with pytest.raises(FrozenInstanceError):
        Quick(1).first = 2  # type: ignore[misc]


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'first'"):
        Quick()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unexpected keyword argument 'third'"):
        Quick(1, third=3)  # type: ignore[call-arg]


def test_a_default_factory_is_refused() -> None:
    @dataclass(frozen=True)
    class Listed:
        entries: list[int] = field(default_factory=list)

    with pytest.raises(TypeError, match="Listed has a field with a default factory"):
        quickly_made(Listed)


def test_a_changed_copy_leaves_the_original() -> None:
    before = Quick(1)
    assert changed(before, second=7.0) == Quick(1, 7.0)
    assert before == Quick(1)
