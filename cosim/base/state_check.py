"""Checks of a saved state before anything takes it: kinds, sizes and finite numbers.

What a state is made of says what kind each part is of, by its annotations; a state that the same simulation
would save now says how large its arrays are. Where a size varies, or where there is nothing to compare with,
the annotation names the sizes: `Annotated[Array, ("k", 3)]`. A letter is one count within an instance, which
may be any; a word such as "nodes" is one count within the whole state; "*" is checked by whoever takes it.
"""

import builtins
import math
import sys
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, Union, final, get_args, get_origin, get_type_hints
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from cosim.errors import InputError

_LARGEST = 2**62  # of a whole number


def check_state(
    found: Any,
    present: Any,
    hint: Any = Any,
    *,
    place: str = "state",
    sizes: Mapping[str, int] | None = None,
    finite: bool = True,
) -> None:
    """Check a saved state against one of the simulation that is to continue from it.

    Args:
        found: the saved state.
        present: what that simulation would save now; None where it would save nothing comparable.
        hint: annotated type; `Any` for that of `present`.
        place: where it is, for messages.
        sizes: counts by the words of annotations.
        finite: whether numbers have to be finite where those of `present` are.

    Raises:
        InputError: a part is of another kind or size, or a number is not finite.
    """
    _Check(dict(sizes or {}), finite).check(found, present, hint, place, {})


def resolved(hint: Any) -> Any:
    """Return an annotation in place of an alias of it, such as `NDArray` from NumPy 2.5 on.

    Args:
        hint: any annotation; one that is no alias comes back as it is.
    """
    value = getattr(get_origin(hint), "__value__", None)
    return hint if value is None else value[get_args(hint)]


def check_indices(indices: NDArray[Any], count: int, what: str) -> None:
    """Check that all indices are within 0 ... count - 1.

    Raises:
        InputError: one is not.
    """
    if indices.size and not (int(indices.min()) >= 0 and int(indices.max()) < count):
        raise InputError(
            f"the saved state names {what} {int(indices.min())} to {int(indices.max())}; there are {count}"
        )


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


@final
class _Check:
    """One walk through a state; `words` are the counts found so far."""

    def __init__(self, words: dict[str, int], finite: bool) -> None:
        self._words, self._finite = words, finite

    def check(self, found: Any, present: Any, hint: Any, place: str, letters: dict[str, int]) -> None:
        """Check one part; `letters` are the counts found within the instance that it belongs to."""
        sizes: tuple[int | str, ...] | None = None
        if get_origin(hint) is Annotated:
            hint, sizes = get_args(hint)[:2]
        hint = resolved(hint)
        if getattr(hint, "_is_protocol", False):
            hint = Any
        if get_origin(hint) in (Union, types.UnionType):
            self._check_union(found, present, hint, place, letters)
        elif hint is Any and isinstance(present, bool | int | float | str):
            self._check_value(found, present, hint, place)
        elif isinstance(found, np.ndarray):
            self._check_array(found, present, hint, sizes, place, letters)
        elif isinstance(found, tuple | list):
            self._check_sequence(found, present, hint, sizes, place, letters)
        elif isinstance(found, Mapping):
            self._check_mapping(found, present, hint, place)
        elif is_dataclass(found):
            self._check_instance(found, present, hint, place)
        else:
            self._check_value(found, present, hint, place)

    def _check_value(self, found: Any, present: Any, hint: Any, place: str) -> None:
        _check_value(found, present, hint, place)
        known = isinstance(present, float) and not math.isfinite(present)
        if self._finite and isinstance(found, float) and not math.isfinite(found) and not known:
            raise InputError(f"{place} is {found}")

    def _check_union(self, found: Any, present: Any, hint: Any, place: str, letters: dict[str, int]) -> None:
        failures = []
        for option in get_args(hint):
            try:
                return self.check(found, present, option, place, letters)
            except InputError as error:
                failures.append(error)
        raise max(failures, key=lambda error: len(str(error).split(" ")[0]))  # the one found deepest

    def _check_array(
        self,
        found: NDArray[Any],
        present: Any,
        hint: Any,
        sizes: tuple[int | str, ...] | None,
        place: str,
        letters: dict[str, int],
    ) -> None:
        known = present if isinstance(present, np.ndarray) else None
        if hint is not Any and get_origin(hint) is not np.ndarray:
            raise _unlike(place, found, hint)
        dtypes = [get_args(entry)[0] for entry in get_args(hint)[1:]]
        declared = next((np.dtype(kind) for kind in dtypes if kind is not Any), None)
        wanted = known.dtype if declared is None and known is not None else declared
        if wanted is not None and found.dtype != wanted:
            raise InputError(f"{place} holds {found.dtype}, not {wanted}")
        if known is not None and sizes is None and found.shape != known.shape:
            raise InputError(f"{place} has shape {found.shape}, here {known.shape}")
        if sizes is not None:
            self._check_sizes(found, known, sizes, place, letters)
        if known is None and sizes is None and hint is not Any and wanted is not None:
            raise InputError(f"{place} is an array; this state has no array there")
        if not found.flags.c_contiguous and (known is None or known.flags.c_contiguous):
            raise InputError(f"{place} is stored by columns")
        if self._finite and not _is_finite(found) and (known is None or _is_finite(known)):
            raise InputError(f"{place} holds a number that is not finite")

    def _check_sizes(
        self,
        found: NDArray[Any],
        known: NDArray[Any] | None,
        sizes: tuple[int | str, ...],
        place: str,
        letters: dict[str, int],
    ) -> None:
        shape = found.shape
        if len(shape) != len(sizes):
            raise InputError(f"{place} has {len(shape)} axes, not {len(sizes)}")
        here = None if known is None or known.ndim != found.ndim else known.shape
        wanted = tuple(
            self._count(size, shape[axis], None if here is None else here[axis], letters)
            for axis, size in enumerate(sizes)
        )
        if shape != wanted:
            raise InputError(f"{place} has shape {shape}, not {wanted}")

    def _count(self, size: int | str, found: int, present: int | None, letters: dict[str, int]) -> int:
        """Return what a size of an annotation is."""
        if isinstance(size, int):
            return size
        if size == "*":
            return found
        if len(size) == 1:
            return letters.setdefault(size, found)
        return self._words.setdefault(size, found if present is None else present)

    def _check_sequence(
        self,
        found: Any,
        present: Any,
        hint: Any,
        sizes: tuple[int | str, ...] | None,
        place: str,
        letters: dict[str, int],
    ) -> None:
        kinds = get_args(hint)
        if hint is not Any and get_origin(hint) not in (tuple, list):
            raise _unlike(place, found, hint)
        fixed = get_origin(hint) is tuple and kinds[-1:] != (...,)
        known = present if isinstance(present, tuple | list) else ()
        wanted = len(kinds) if fixed else len(found)
        if hint is Any and known:
            wanted = len(known)
        if sizes is not None:
            # before the first phase begins, what has one entry for each chamber has none
            wanted = self._count(sizes[0], len(found), len(known) or None, letters)
        if len(found) != wanted:
            raise InputError(f"{place} has {len(found)} entries, not {wanted}")
        for k, entry in enumerate(found):
            kind = Any if hint is Any else kinds[k] if fixed else kinds[0]
            self.check(entry, known[k] if k < len(known) else None, kind, f"{place}[{k}]", letters)

    def _check_mapping(self, found: Mapping[str, Any], present: Any, hint: Any, place: str) -> None:
        if hint is not Any and get_origin(hint) not in (dict, Mapping):
            raise _unlike(place, found, hint)
        known = present if isinstance(present, Mapping) else {}
        kind = get_args(hint)[1] if get_args(hint) else Any
        for key, entry in found.items():
            self.check(entry, known.get(key), kind, f"{place}.{key}", {})

    def _check_instance(self, found: Any, present: Any, hint: Any, place: str) -> None:
        if hint is not Any and isinstance(hint, type) and not isinstance(found, hint):
            raise _unlike(place, found, hint)
        if hint is Any and present is None:
            return  # whoever takes it knows what it is to be compared with
        if hint is Any and type(present) is not type(found):
            raise _unlike(place, found, type(present))
        known = present if type(present) is type(found) else None
        kind: Any = type(found)
        hints, letters = _hints(kind), dict[str, int]()
        for field in fields(found):
            if field.init:
                entry, here = getattr(found, field.name), getattr(known, field.name, None)
                self.check(entry, here, hints[field.name], f"{place}.{field.name}", letters)


def _is_finite(array: NDArray[Any]) -> bool:
    return array.dtype.kind != "f" or bool(np.isfinite(array).all())


@final
class _Names(dict[str, Any]):
    """Names of a module; one that is there for type checkers only means anything."""

    def __missing__(self, name: str) -> Any:
        if hasattr(builtins, name):
            return getattr(builtins, name)
        return Any


@cache
def _hints(kind: type) -> dict[str, Any]:
    names = _Names(vars(sys.modules[kind.__module__]))
    return get_type_hints(kind, localns=names, include_extras=True)


def _check_value(found: Any, present: Any, hint: Any, place: str) -> None:
    if hint is Any:
        simple = isinstance(present, bool | int | float | str)
        hint = type(present) if simple else type(found)
    if hint is None or hint is type(None):
        fits = found is None
    elif get_origin(hint) is Literal:
        fits = any(type(found) is type(value) and found == value for value in get_args(hint))
    elif hint is float:
        fits = isinstance(found, int | float) and not isinstance(found, bool)
    elif hint is int:
        fits = isinstance(found, int) and not isinstance(found, bool)
    else:
        fits = isinstance(hint, type) and isinstance(found, hint)
    if not fits:
        raise _unlike(place, found, hint)
    if isinstance(found, int) and abs(found) >= _LARGEST:
        raise InputError(f"{place} is too large a number")


def _unlike(place: str, found: Any, wanted: Any) -> InputError:
    name = getattr(wanted, "__name__", str(wanted))
    return InputError(f"{place} is a {type(found).__name__}, not a {'nothing' if wanted is None else name}")
