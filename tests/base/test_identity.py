"""Short names of contents."""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass

import numpy as np
import pytest

from cosim.base.identity import content_name


@dataclass(frozen=True)
class Inner:
    value: float


@dataclass(frozen=True)
class Outer:
    inner: Inner
    numbers: tuple[int, ...]


def test_equal_contents_have_one_name_and_others_another() -> None:
    one = (Outer(Inner(1.0), (1, 2)), np.arange(3.0), {"a": None}, "text", True)
    assert content_name(*one) == content_name(
        Outer(Inner(1.0), (1, 2)), np.arange(6.0)[:3], {"a": None}, "text", True
    )
    assert content_name(((1,), 2)) != content_name(((1, 2),))
    others = [
        (Outer(Inner(1.0 + 1e-15), (1, 2)), *one[1:]),
        (Outer(Inner(1.0), (12,)), *one[1:]),
        (one[0], np.arange(3), *one[2:]),
        (one[0], np.arange(3.0)[None], *one[2:]),
        (*one[:2], {"b": None}, *one[3:]),
        (*one[:3], "texts", True),
        (*one[:4], 1),
        (*one, None),
    ]
    assert len({content_name(*values) for values in (one, *others)}) == 1 + len(others)


def test_a_field_more_and_another_class_change_the_name() -> None:
    plain = make_dataclass("Plain", [("a", float)], frozen=True)
    other = make_dataclass("Other", [("a", float)], frozen=True)
    wider = make_dataclass("Plain", [("a", float), ("b", float, 0.0)], frozen=True)
    assert len({content_name(kind(1.0)) for kind in (plain, other, wider)}) == 3


@pytest.mark.parametrize("value", [object(), lambda: None, np.array([None]), {1.0}], ids=type)
def test_contents_that_are_not_known_are_refused(value: object) -> None:
    with pytest.raises(TypeError, match="not known"):
        content_name(1.0, [value])
