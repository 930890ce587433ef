"""States of a run are copied, compared bit for bit, and checked before anything takes them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from cosim.base.frames import Array, IntArray
from cosim.base.state import copied, difference, restore_states, states_of
from cosim.base.state_checks import check_indices, check_state, check_states, resolved
from cosim.errors import InputError


@dataclass(frozen=True)
class Inner:
    """A state whose arrays have as many rows as there are contacts."""

    key: Annotated[IntArray, ("k",)]
    force: Annotated[Array, ("k", 3)]


class Pair(NamedTuple):
    """A named tuple of arrays."""

    first: Annotated[Array, ("k",)]
    second: Annotated[Array, ("k",)]


@dataclass(frozen=True)
class Outer:
    """A state of nodes, with an inner one that may be missing."""

    positions: Annotated[Array, ("nodes", 3)]
    stiffness: Array
    earlier: Annotated[Array, ("nodes", 3)] | None = None
    inner: Inner | None = None
    counts: tuple[int, ...] = ()
    ratio: float = 0.0
    loads: Mapping[str, float] = field(default_factory=dict)
    pair: Pair | None = None


PRESENT = Outer(np.zeros((4, 3)), np.ones(2))
INNER = Inner(np.arange(2), np.zeros((2, 3)))
PAIR = Pair(np.ones(3), np.ones(3))
GOOD = Outer(np.ones((4, 3)), np.zeros(2), np.ones((4, 3)), INNER, (1, 2), 1, {"cable": 2.0}, PAIR)


def test_a_copy_is_the_same_and_shares_no_array() -> None:
    shared = np.arange(3.0)
    tree = {"a": (shared, [shared, "b"], None), "b": GOOD, "c": np.asfortranarray(np.ones((2, 3)))}
    again = copied(tree)
    assert difference(again, tree) is None
    assert again["a"][0] is again["a"][1][0]
    assert again["c"].flags.f_contiguous
    shared[0] = 5.0
    GOOD.positions[0] = 2.0
    assert difference(again, tree) == "state.a[0] differs"
    assert again["b"].positions[0, 0] == 1.0
    GOOD.positions[0] = 1.0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"stiffness": np.array([0.0, -0.0])}, "state.stiffness differs"),
        ({"stiffness": np.zeros(3)}, r"state.stiffness holds float64 \(2,\), the other float64 \(3,\)"),
        ({"inner": None}, "state.inner is a Inner, the other a NoneType"),
        ({"inner": replace(INNER, key=np.arange(1, 3))}, "state.inner.key differs"),
        ({"counts": (1, 3)}, r"state.counts\[1\] is 2, the other 3"),
        ({"counts": (1,)}, r"state.counts has \[0\], \[1\], the other \[0\]"),
        ({"ratio": -0.0}, "state.ratio is 0.0, the other -0.0"),
        ({"loads": {"winch": 2.0}}, "state.loads has .cable, the other .winch"),
    ],
)
def test_two_states_differ_where_one_bit_does(changes: dict[str, Any], text: str) -> None:
    one = replace(GOOD, ratio=0.0)
    nan = replace(one, ratio=float("nan"))
    assert difference(one, one) is None
    assert difference(nan, copied(nan)) is None
    found = difference(one, replace(one, **changes))
    assert found is not None
    assert re.fullmatch(text, found)


def test_parts_are_saved_and_restored_by_name() -> None:
    drives = [SimpleNamespace(state=1), SimpleNamespace(state=2)]
    parts = {"gas": SimpleNamespace(state="sealed"), "drives": drives}
    before = states_of(parts)
    assert before == {"gas": "sealed", "drives": (1, 2)}
    drives[1].state, parts["gas"] = 7, SimpleNamespace(state="open")
    restore_states(parts, before)
    assert states_of(parts) == before


@pytest.mark.parametrize(
    ("found", "text"),
    [
        ({"gas": 1.0}, "state has gas, here it has gas, drives"),
        ({"gas": 1.0, "drives": (1.0,)}, "state.drives has 1 entries, here it has 2"),
        ({"gas": 1.0, "drives": (1.0, 2.0, 3.0)}, "state.drives has 3 entries, here it has 2"),
        (None, "state is a NoneType, not a table of gas, drives"),
        ({"gas": 1.0, "drives": 2.0}, "state.drives is a float, not 2 entries"),
        ({"gas": 1.0, "drives": (1.0, "a")}, r"state.drives\[1\] is a str, not a float"),
    ],
)
def test_states_of_other_parts_are_refused(found: Any, text: str) -> None:
    parts = {"gas": SimpleNamespace(state=0.0), "drives": [SimpleNamespace(state=0.0)] * 2}
    check_states(parts, {"gas": 1.0, "drives": (2.0, 3.0)}, "state", {})
    with pytest.raises(InputError, match=f"^{text}$"):
        check_states(parts, found, "state", {})


def test_a_state_may_hold_more_or_less_than_the_present_one() -> None:
    check_state(GOOD, PRESENT)
    check_state(PRESENT, GOOD)
    check_state(replace(GOOD, inner=Inner(np.arange(5), np.zeros((5, 3)))), GOOD)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"positions": np.ones((2, 3))}, r"state.positions has shape \(2, 3\), not \(4, 3\)"),
        ({"earlier": np.ones((5, 3))}, r"state.earlier has shape \(5, 3\), not \(4, 3\)"),
        ({"stiffness": np.ones(1)}, r"state.stiffness has shape \(1,\), here \(2,\)"),
        ({"stiffness": np.ones(2, np.float32)}, "holds float32, not float64"),
        ({"stiffness": np.ones(2).astype(">f8")}, "holds >f8, not float64"),
        ({"stiffness": np.array([1.0, np.nan])}, "not finite"),
        ({"stiffness": None}, "state.stiffness is a NoneType"),
        ({"positions": np.asfortranarray(np.ones((4, 3)))}, "stored by columns"),
        ({"inner": replace(INNER, force=np.zeros((1, 3)))}, r"inner.force has shape \(1, 3\), not \(2, 3\)"),
        ({"inner": replace(INNER, key=np.zeros(2))}, "inner.key holds float64, not int64"),
        ({"inner": PRESENT}, "state.inner is a Outer"),
        ({"counts": (1, 2.5)}, r"state.counts\[1\] is a float, not a int"),
        ({"counts": (1, 2**70)}, "too large"),
        ({"counts": 3}, "state.counts is a int"),
        ({"ratio": float("inf")}, "state.ratio is inf"),
        ({"ratio": True}, "state.ratio is a bool"),
        ({"ratio": "1"}, "state.ratio is a str"),
        ({"ratio": {"cable": 1.0}}, "state.ratio is a dict"),
        ({"loads": {"cable": True}}, "state.loads.cable is a bool"),
        ({"loads": 1.0}, "state.loads is a float"),
        ({"pair": Pair(np.ones(2), np.ones(3))}, r"state.pair.second has shape \(3,\), not \(2,\)"),
        ({"pair": (np.ones(2), np.ones(2))}, "state.pair is a tuple, not a Pair"),
    ],
)
def test_what_does_not_fit_is_named(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        check_state(replace(GOOD, **changes), PRESENT)


def test_another_class_is_refused() -> None:
    with pytest.raises(InputError, match="state is a Inner, not a Outer"):
        check_state(INNER, PRESENT)


@pytest.mark.parametrize("index", [-1, 4])
def test_indices_name_what_there_is(index: int) -> None:
    check_indices(np.array([0, 3]), 4, "nodes")
    check_indices(np.zeros(0, np.int64), 0, "nodes")
    with pytest.raises(InputError, match=r"names nodes .*; there are 4"):
        check_indices(np.array([0, index]), 4, "nodes")


def test_an_alias_of_arrays_is_an_array() -> None:
    # as NumPy's own `NDArray` is one, from NumPy 2.5 on
    scalar = TypeVar("scalar", bound=np.generic)
    alias = TypeAliasType("alias", np.ndarray[Any, np.dtype[scalar]], type_params=(scalar,))
    hint = alias[np.float64]
    check_state(np.zeros(3), np.ones(3), hint)
    with pytest.raises(InputError, match="holds int64, not float64"):
        check_state(np.zeros(3, np.int64), None, hint)
    assert resolved(NDArray[np.float64]) == resolved(Array)
    assert resolved(int) is int
