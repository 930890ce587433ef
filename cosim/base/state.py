"""State of a run: a tree of dataclasses, tuples and dictionaries of arrays; copied, compared and checked.

A part with a state keeps it in one attribute, `state`: a value whose arrays nobody writes to, so that reading
it saves and setting it restores. Annotations of the dataclasses say how large arrays are, such as
`Annotated[Array, ("k", 3)]`: a letter is one count within an instance, a word such as "nodes" one count
within the whole state, and "*" is any count, which the part itself checks.
"""

import builtins
import math
import sys
import types
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, Union, cast, final, get_args, get_origin, get_type_hints
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from cosim.errors import InputError

Tree = TypeVar("Tree")
_LARGEST = 2**62  # of a whole number


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
        states: as it has returned them, of these parts or of others like them; see `check_state`.
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
    """Return what a tree is made of, by its place in it, such as ".pose" or "[3]"; None for a leaf."""
    if is_record(type(tree)):
        return ((f".{name}", getattr(tree, name)) for name in field_names(type(tree)))
    if isinstance(tree, Mapping):
        return ((f".{key}", value) for key, value in tree.items())
    if isinstance(tree, tuple | list):
        return ((f"[{k}]", value) for k, value in enumerate(tree))
    return None


def copied(tree: Tree) -> Tree:
    """Return a tree with copies of its arrays; one that occurs twice is one array again."""
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


def difference(one: Any, other: Any, place: str = "state") -> str | None:
    """Return in words where two trees first differ, bit for bit; None where they are the same."""
    if type(one) is not type(other):
        return f"{place} is a {type(one).__name__}, the other a {type(other).__name__}"
    if isinstance(one, np.ndarray):
        if (one.dtype, one.shape) != (other.dtype, other.shape):
            return f"{place} holds {one.dtype} {one.shape}, the other {other.dtype} {other.shape}"
        return None if one.tobytes() == other.tobytes() else f"{place} differs"
    first, second = entries(one), entries(other)
    if first is None or second is None:
        return None if _bits(one) == _bits(other) else f"{place} is {one!r}, the other {other!r}"
    own, others = dict(first), dict(second)
    if own.keys() != others.keys():
        return f"{place} has {', '.join(own)}, the other {', '.join(others)}"
    return next(filter(None, (difference(own[key], others[key], place + key) for key in own)), None)


def _bits(value: Any) -> Any:
    return value.hex() if isinstance(value, float) else value


@final
class KnownStates:
    """Which states need no check: those that were saved here, or have been checked before.

    They are known by identity: no array of a state is ever written to.
    """

    def __init__(self) -> None:
        self._known: WeakValueDictionary[int, Any] = WeakValueDictionary()

    def add(self, state: Any) -> None:
        """Let a state be known for as long as somebody keeps it."""
        self._known[id(state)] = state

    def __contains__(self, state: object) -> bool:
        """Return whether a state is known."""
        return self._known.get(id(state)) is state


def check_state(
    found: Any,
    present: Any,
    hint: Any = Any,
    *,
    place: str = "state",
    sizes: dict[str, int] | None = None,
    finite: bool = True,
) -> None:
    """Check a saved state against one of the simulation that is to continue from it.

    Args:
        found: the saved state.
        present: what that simulation would save now; None where it would save nothing comparable.
        hint: annotated type; `Any` for that of `present`.
        place: where it is, for messages.
        sizes: counts by the words of annotations; those that are found are added.
        finite: whether numbers have to be finite where those of `present` are.

    Raises:
        InputError: a part is of another kind or size, or a number is not finite.
    """
    _StatePlace(place, hint, {}, {} if sizes is None else sizes, finite).check(found, present)


def check_states(parts: Any, states: Any, place: str, sizes: dict[str, int]) -> None:
    """Check the saved states of parts against the present ones, before `restore_states`.

    Args:
        parts: as for `states_of`.
        states: saved ones.
        place: where they are, for messages.
        sizes: see `check_state`.

    Raises:
        InputError: they are of other parts, or a state is of another kind or size.
    """
    if isinstance(parts, Mapping):
        if not isinstance(states, Mapping) or states.keys() != parts.keys():
            raise InputError(f"{place} has {', '.join(states)}, here it has {', '.join(parts)}")
        for name, part in parts.items():
            check_states(part, states[name], f"{place}.{name}", sizes)
    elif isinstance(parts, tuple | list):
        if not isinstance(states, tuple) or len(states) != len(parts):
            raise InputError(f"{place} has {len(states)} entries, here it has {len(parts)}")
        for k, part in enumerate(parts):
            check_states(part, states[k], f"{place}[{k}]", sizes)
    else:
        check_state(states, parts.state, place=place, sizes=sizes)


def check_indices(indices: NDArray[Any], count: int, what: str) -> None:
    """Check that all indices are within 0 ... count - 1.

    Raises:
        InputError: one is not.
    """
    if indices.size and not (int(indices.min()) >= 0 and int(indices.max()) < count):
        raise InputError(
            f"the saved state names {what} {int(indices.min())} to {int(indices.max())}; there are {count}"
        )


def resolved(hint: Any) -> Any:
    """Return an annotation in place of an alias of it, such as `NDArray` from NumPy 2.5 on.

    Args:
        hint: any annotation; one that is no alias comes back as it is.
    """
    value = getattr(get_origin(hint), "__value__", None)
    return hint if value is None else value[get_args(hint)]


@final
class _StatePlace:
    """A place in a state, and what its annotation allows there.

    Args:
        name: for messages.
        hint: annotation.
        letters: counts found so far within the instance.
        words: counts found so far within the whole state.
        finite: whether numbers have to be finite.
    """

    def __init__(
        self, name: str, hint: Any, letters: dict[str, int], words: dict[str, int], finite: bool
    ) -> None:
        self._sizes: tuple[int | str, ...] | None = None
        if get_origin(hint) is Annotated:
            hint, self._sizes = get_args(hint)[:2]
        hint = resolved(hint)
        self._hint = Any if getattr(hint, "_is_protocol", False) else hint
        self._name, self._letters, self._words, self._finite = name, letters, words, finite

    def _inner(self, name: str, hint: Any, letters: dict[str, int] | None = None) -> "_StatePlace":
        letters = self._letters if letters is None else letters
        return _StatePlace(self._name + name, hint, letters, self._words, self._finite)

    def check(self, found: Any, present: Any) -> None:
        """Check what a saved state holds here against what the simulation holds."""
        if get_origin(self._hint) in (Union, types.UnionType):
            self._check_union(found, present)
        elif self._hint is Any and isinstance(present, bool | int | float | str):
            self._check_value(found, present)
        elif isinstance(found, np.ndarray):
            self._check_array(found, present if isinstance(present, np.ndarray) else None)
        elif is_dataclass(found) or is_record(type(found)):
            self._check_instance(found, present)
        elif isinstance(found, tuple | list):
            self._check_sequence(found, present)
        elif isinstance(found, Mapping):
            self._check_mapping(found, present)
        else:
            self._check_value(found, present)

    def _unlike(self, found: Any, wanted: Any) -> InputError:
        name = "nothing" if wanted is None else getattr(wanted, "__name__", str(wanted))
        return InputError(f"{self._name} is a {type(found).__name__}, not a {name}")

    def _check_union(self, found: Any, present: Any) -> None:
        failures = []
        for option in get_args(self._hint):
            try:
                return self._inner("", option).check(found, present)
            except InputError as error:
                failures.append(error)
        raise max(failures, key=lambda error: len(str(error).split(" ")[0]))  # the one found deepest

    def _check_value(self, found: Any, present: Any) -> None:
        hint = self._hint
        if hint is Any:
            hint = type(present) if isinstance(present, bool | int | float | str) else type(found)
        if not _is_of(found, hint):
            raise self._unlike(found, hint)
        if isinstance(found, int) and abs(found) >= _LARGEST:
            raise InputError(f"{self._name} is too large a number")
        known = isinstance(present, float) and not math.isfinite(present)
        if self._finite and isinstance(found, float) and not math.isfinite(found) and not known:
            raise InputError(f"{self._name} is {found}")

    def _check_array(self, found: NDArray[Any], known: NDArray[Any] | None) -> None:
        hint, name = self._hint, self._name
        if hint is not Any and get_origin(hint) is not np.ndarray:
            raise self._unlike(found, hint)
        dtypes = [get_args(entry)[0] for entry in get_args(hint)[1:]]
        declared = next((np.dtype(kind) for kind in dtypes if kind is not Any), None)
        wanted = known.dtype if declared is None and known is not None else declared
        if wanted is not None and found.dtype != wanted:
            raise InputError(f"{name} holds {found.dtype}, not {wanted}")
        if self._sizes is not None:
            self._check_sizes(found, known, self._sizes)
        elif known is not None and found.shape != known.shape:
            raise InputError(f"{name} has shape {found.shape}, here {known.shape}")
        elif known is None and wanted is not None:
            raise InputError(f"{name} is an array; this state has no array there")
        if not found.flags.c_contiguous and (known is None or known.flags.c_contiguous):
            raise InputError(f"{name} is stored by columns")
        if self._finite and not _is_finite(found) and (known is None or _is_finite(known)):
            raise InputError(f"{name} holds a number that is not finite")

    def _check_sizes(
        self, found: NDArray[Any], known: NDArray[Any] | None, sizes: tuple[int | str, ...]
    ) -> None:
        shape = found.shape
        if len(shape) != len(sizes):
            raise InputError(f"{self._name} has {len(shape)} axes, not {len(sizes)}")
        here = (None,) * len(shape) if known is None or known.ndim != found.ndim else known.shape
        wanted = tuple(map(self._count, sizes, shape, here))
        if shape != wanted:
            raise InputError(f"{self._name} has shape {shape}, not {wanted}")

    def _count(self, size: int | str, found: int, present: int | None) -> int:
        """Return the count that a size of an annotation stands for."""
        if isinstance(size, int):
            return size
        if size == "*":
            return found
        if len(size) == 1:
            return self._letters.setdefault(size, found)
        return self._words.setdefault(size, found if present is None else present)

    def _check_sequence(self, found: Any, present: Any) -> None:
        hint, kinds = self._hint, get_args(self._hint)
        if hint is not Any and get_origin(hint) not in (tuple, list):
            raise self._unlike(found, hint)
        fixed = get_origin(hint) is tuple and kinds[-1:] != (...,)
        known = present if isinstance(present, tuple | list) else ()
        wanted = len(kinds) if fixed else len(found)
        if hint is Any and known:
            wanted = len(known)
        if self._sizes is not None:
            # before the first phase begins, what has one entry for each chamber has none
            wanted = self._count(self._sizes[0], len(found), len(known) or None)
        if len(found) != wanted:
            raise InputError(f"{self._name} has {len(found)} entries, not {wanted}")
        for k, entry in enumerate(found):
            kind = Any if hint is Any else kinds[k] if fixed else kinds[0]
            self._inner(f"[{k}]", kind).check(entry, known[k] if k < len(known) else None)

    def _check_mapping(self, found: Mapping[str, Any], present: Any) -> None:
        hint = self._hint
        if hint is not Any and get_origin(hint) not in (dict, Mapping):
            raise self._unlike(found, hint)
        known = present if isinstance(present, Mapping) else {}
        kind = get_args(hint)[1] if get_args(hint) else Any
        for key, entry in found.items():
            self._inner(f".{key}", kind, {}).check(entry, known.get(key))

    def _check_instance(self, found: Any, present: Any) -> None:
        hint = self._hint
        if hint is Any and present is None:
            return  # the part knows what it is to be compared with
        wanted = type(present) if hint is Any else hint
        if isinstance(wanted, type) and not isinstance(found, wanted):
            raise self._unlike(found, wanted)
        known = present if type(present) is type(found) else None
        kind: Any = type(found)
        hints, letters = _hints(kind), dict[str, int]()
        for name in field_names(kind):
            entry, here = getattr(found, name), getattr(known, name, None)
            self._inner(f".{name}", hints[name], letters).check(entry, here)


def _is_finite(array: NDArray[Any]) -> bool:
    return array.dtype.kind != "f" or bool(np.isfinite(array).all())


def _is_of(found: Any, hint: Any) -> bool:
    """Return whether a value that is no container is of an annotated kind."""
    if hint is None or hint is type(None):
        return found is None
    if get_origin(hint) is Literal:
        return any(type(found) is type(value) and found == value for value in get_args(hint))
    if hint is float or hint is int:
        return isinstance(found, int | hint) and not isinstance(found, bool)
    return isinstance(hint, type) and isinstance(found, hint)


@final
class _Names(dict[str, Any]):
    """Names of a module; one that is there for type checkers only means anything."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


@cache
def _hints(kind: type) -> dict[str, Any]:
    names = _Names(vars(sys.modules[kind.__module__]))
    return get_type_hints(kind, localns=names, include_extras=True)
