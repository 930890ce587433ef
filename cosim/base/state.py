"""The state of a run is a tree of dataclasses, tuples and dictionaries, with arrays as leaves. An object with
a state has it in one attribute, `state`, whose arrays nobody writes to. So reading the attribute saves the
state, and setting the attribute restores it. This module reads, sets, copies and compares such trees.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Tree = TypeVar("Tree")


def states_of(parts: Any) -> Any:
    """Return the states of parts: of each in a dictionary or a sequence, or of one that has a `state`."""
    if isinstance(parts, Mapping):
        return {name: states_of(part) for name, part in parts.items()}
    if isinstance(parts, tuple | list):
        return tuple(states_of(part) for part in parts)
    return parts.state


def restore_states(parts: Any, states: Any) -> None:
    """Set the states of parts, one after the other.

    Args:
        parts: as for `states_of`.
        states: of `states_of`, of these parts or of equally built ones, see `state_checks.check_states`.
    """
    if not isinstance(parts, Mapping | tuple | list):
        parts.state = states
        return
    for key, part in parts.items() if isinstance(parts, Mapping) else enumerate(parts):
        restore_states(part, states[key])


def is_record(kind: type) -> bool:
    """Return whether a class is a frozen dataclass or a named tuple."""
    if issubclass(kind, tuple):
        return hasattr(kind, "_fields")
    parameters = getattr(kind, "__dataclass_params__", None)
    return is_dataclass(kind) and parameters is not None and bool(parameters.frozen)


def field_names(kind: Any) -> tuple[str, ...]:
    """Return the fields that make an instance of a dataclass or named tuple."""
    if issubclass(kind, tuple):
        return tuple(kind._fields)
    return tuple(field.name for field in fields(kind) if field.init)


def entries(tree: Any) -> Iterator[tuple[str, Any]] | None:
    """Return the entries of a tree by their paths, such as ".pose" or "[3]"; None for a leaf."""
    if is_record(type(tree)):
        return ((f".{name}", getattr(tree, name)) for name in field_names(type(tree)))
    if isinstance(tree, Mapping):
        return ((f".{key}", value) for key, value in tree.items())
    if isinstance(tree, tuple | list):
        return ((f"[{k}]", value) for k, value in enumerate(tree))
    return None


def copied(tree: Tree) -> Tree:
    """Return a tree with copies of its arrays; an array that occurs twice becomes one copy."""
    return cast(Tree, _copied(tree, {}))


def _copied(tree: Any, arrays: dict[int, NDArray[Any]]) -> Any:
    if isinstance(tree, np.ndarray):
        return arrays.setdefault(id(tree), tree.copy(order="K"))
    inner = entries(tree)
    if inner is None:
        return tree
    values = [_copied(value, arrays) for _, value in inner]
    if isinstance(tree, Mapping):
        return dict(zip(tree, values, strict=True))
    if is_record(type(tree)):
        return type(tree)(**dict(zip(field_names(type(tree)), values, strict=True)))
    return type(tree)(values)


def difference(one: Any, other: Any, path: str = "state") -> str | None:
    """Describe the first difference of two trees, compared bit for bit; None if both are equal."""
    if type(one) is not type(other):
        return f"{path} is a {type(one).__name__}, the other a {type(other).__name__}"
    if isinstance(one, np.ndarray):
        if (one.dtype, one.shape) != (other.dtype, other.shape):
            return f"{path} holds {one.dtype} {one.shape}, the other {other.dtype} {other.shape}"
        return None if one.tobytes() == other.tobytes() else f"{path} differs"
    entries_of_one, entries_of_other = entries(one), entries(other)
    if entries_of_one is None or entries_of_other is None:
        return None if _bits(one) == _bits(other) else f"{path} is {one!r}, the other {other!r}"
    first, second = dict(entries_of_one), dict(entries_of_other)
    if first.keys() != second.keys():
        return f"{path} has {', '.join(first)}, the other {', '.join(second)}"
    return next(filter(None, (difference(first[key], second[key], path + key) for key in first)), None)


def _bits(value: Any) -> Any:
    return value.hex() if isinstance(value, float) else value
