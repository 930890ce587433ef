"""Checks a saved state before a simulation continues from it: kinds, array shapes and finite numbers.
Annotations of the dataclasses of a state name the sizes of their arrays, such as `Annotated[Array, ("k",
3)]`. A letter is one count within an instance, a word such as "nodes" is one count within the whole state,
and "*" is any count, which the owner of the state checks.
"""

import builtins
import math
import sys
import types
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, Union, final, get_args, get_origin, get_type_hints
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from cosim.base.state import field_names, is_record
from cosim.errors import InputError

_LARGEST = 2**62  # of a whole number


@final
class KnownStates:
    """The states that need no check, since they were saved in this process, or checked before.

    They are recognised by the identity of their objects, as no array of a state is ever written to.
    """

    def __init__(self) -> None:
        self._known: WeakValueDictionary[int, Any] = WeakValueDictionary()

    def add(self, state: Any) -> None:
        """Mark a state as checked, for as long as the object exists."""
        self._known[id(state)] = state

    def __contains__(self, state: object) -> bool:
        """Return whether a state is marked as checked."""
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
        if not isinstance(states, Mapping):
            raise InputError(f"{place} is a {type(states).__name__}, not a table of {', '.join(parts)}")
        if states.keys() != parts.keys():
            raise InputError(f"{place} has {', '.join(map(str, states))}, here it has {', '.join(parts)}")
        for name, part in parts.items():
            check_states(part, states[name], f"{place}.{name}", sizes)
    elif isinstance(parts, tuple | list):
        if not isinstance(states, tuple):
            raise InputError(f"{place} is a {type(states).__name__}, not {len(parts)} entries")
        if len(states) != len(parts):
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
        """Return the count that a size of an annotation means."""
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
