"""Reads TOML files that may be anybody's, changes tables by key path, and collects their faults.

All faults of a file, collected so that they are reported together; values that no one can know; and the
rules of tables, which are beside their fields.

Changes to a scenario's tables by key path, as `--set key=value` gives them.
"""

import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy, deepcopy
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, TypeAlias, TypeVar, final, get_type_hints

from cosim.base.files import read_text
from cosim.config.toml.keys import join, key_of
from cosim.errors import InputError, ScenarioError

T = TypeVar("T")


class Fault(NamedTuple):
    """Path of a key, and what is wrong with it."""

    path: str
    problem: str


_LONGEST_EXAMPLE: Final = 200  # characters
_PLAIN: Final = "_plain"
"""Where a guarded class keeps the one that it represents."""


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
    """Collects faults: `with faults:` notes what is raised within, and continues after it."""

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
        self._found[Fault(path, message)] = None

    def tell(self) -> None:
        """Raise what was found.

        Raises:
            ScenarioError: with all faults, if there are any.
        """
        if self._found:
            first, *others = self._found
            raise ScenarioError(*first, further=tuple(others))


Told: TypeAlias = Iterator[Fault | tuple[str, str]]
"""What a rule yields: for each fault the key within its table; "" is the table itself."""

Rule = TypeVar("Rule", bound=Callable[..., Told])
RuleOn: TypeAlias = tuple[Any, Callable[..., Told]]
"""The class of tables that a rule is on, and the rule."""


def rule(told: Rule) -> Rule:
    """Mark a rule: a method of a table, or a function whose first argument is one.

    A second argument is what the table is in: the scenario, or the soft robot whose file it is part of (the
    tables with a `schema`). A rule that needs a value that is wrong by itself ends there; what it has yielded
    before counts.
    """
    told.__dict__["is_rule"] = True
    return told


def rules_of(module: Mapping[str, Any]) -> tuple[RuleOn, ...]:
    """Return the rules that are functions of a module."""
    found = [entry for entry in module.values() if getattr(entry, "is_rule", False)]
    return tuple((next(iter(get_type_hints(entry).values())), entry) for entry in found)


@cache
def _rules_on(kind: type, rules: tuple[RuleOn, ...]) -> tuple[Callable[..., Told], ...]:
    """Return those of the rules that are on a class of tables, then its own."""
    own = (entry for each in kind.__mro__ for entry in vars(each).values() if hasattr(entry, "is_rule"))
    return (*(told for on, told in rules if issubclass(kind, on)), *own)


def check(table: Any, path: str, around: Any, rules: tuple[RuleOn, ...], faults: Faults) -> None:
    """Check a table by its rules, then all tables in it; names in a list of tables must differ.

    Args:
        table: a dataclass; may hold UNKNOWN.
        path: of the table.
        around: what it is in.
        rules: further ones, on classes of tables.
        faults: gets the rules that are broken.
    """
    for told in _rules_on(type(table), rules):  # type: ignore[arg-type]  # classes of dataclasses hash
        with faults:
            for key, problem in told(*(table, around)[: told.__code__.co_argcount]):
                faults.add(".".join(filter(None, (path, key))), problem)
    parts = fields(table)
    inner = table if any(entry.name == "schema" for entry in parts) else around
    for entry in parts:
        with faults:
            value = getattr(table, entry.name)
            if is_dataclass(value):
                check(value, join(path, key_of(entry)), inner, rules, faults)
            elif isinstance(value, tuple) and value and is_dataclass(value[0]):
                _check_entries(value, join(path, key_of(entry)), inner, rules, faults)


def _check_entries(
    entries: tuple[Any, ...], path: str, around: Any, rules: tuple[RuleOn, ...], faults: Faults
) -> None:
    seen = set[str]()
    for number, entry in enumerate(entries, start=1):
        with faults:
            name = getattr(entry, "name", str(number))
            if name in seen:
                faults.add(join(path, name), "the name is used twice; names must differ")
            seen.add(name)
            check(entry, join(path, name), around, rules, faults)


@contextmanager
def blamed_on(path: str) -> Iterator[None]:
    """Turn every refusal within into one that names a key; those that name one already stay.

    Args:
        path: of the key.

    Raises:
        ScenarioError: instead of any other InputError.
    """
    try:
        yield
    except ScenarioError:
        raise
    except InputError as error:
        raise ScenarioError(path, str(error)) from error


DEEPEST: Final = 24
LONGEST_TEXT: Final = 10_000
LONGEST_LIST: Final = 10_000
LARGEST_INTEGER: Final = 2**63 - 1
"""What TOML asks every reader to hold."""


@final
@dataclass(frozen=True, repr=False)
class Unreadable:
    """Stands for a value of a file that cannot be used, whatever its key.

    Args:
        problem: what is wrong with it.
    """

    problem: str

    def __repr__(self) -> str:
        """Return what represents it in a list that is shown."""
        return "..."


def read_table(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file as `only_readable` makes them; a byte order mark is skipped.

    Raises:
        ScenarioError: the file cannot be read, is too large, or is not TOML; `path` is the file's name.
    """
    try:
        table = tomllib.loads(read_text(path).replace("\r\n", "\n"))
    except OSError as error:
        raise ScenarioError(str(path), f"cannot be read: {error.strerror}") from error
    except RecursionError:
        raise ScenarioError(str(path), f"is nested too deeply; at most {DEEPEST} levels are read") from None
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(str(path), f"is not TOML: {error}") from error
    except ValueError as error:
        most = sys.get_int_max_str_digits()
        raise ScenarioError(str(path), f"holds a whole number of more than {most} digits") from error
    readable: dict[str, Any] = only_readable(table)
    return readable


def only_readable(value: Any, depth: int = 0) -> Any:
    """Return a copy in which what is deeper, longer or larger than the program can hold is `Unreadable`.

    Tuples and arrays become lists.

    Args:
        value: as TOML gives it, or Python.
        depth: of the value in the table that is read.
    """
    if value is UNKNOWN or isinstance(value, Unreadable):
        return value
    problem = _problem(value, depth)
    if problem is not None:
        return Unreadable(problem)
    if isinstance(value, Mapping):
        return {str(key): only_readable(item, depth + 1) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return only_readable(value.tolist(), depth)
    if isinstance(value, list | tuple):
        return [only_readable(item, depth + 1) for item in value]
    return value


def _problem(value: Any, depth: int) -> str | None:
    if depth > DEEPEST:
        return f"is nested too deeply; at most {DEEPEST} levels are read"
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"is a text of {len(value)} characters; at most {LONGEST_TEXT} are read"
    if isinstance(value, list) and len(value) > LONGEST_LIST:
        return f"is a list of {len(value)} entries; at most {LONGEST_LIST} are read"
    if isinstance(value, int) and not -LARGEST_INTEGER <= value <= LARGEST_INTEGER:
        return f"is a whole number of {value.bit_length()} bits; at most 63 and a sign are read"
    return None


def parse_assignment(text: str) -> tuple[str, Any]:
    """Return the key path and value of `key=value`; the value is TOML, or else a bare text.

    Raises:
        ScenarioError: there is no "=", or the key path has an empty part.
    """
    path, equals, value = text.partition("=")
    path = path.strip()
    if not equals or not all(path.split(".")):
        raise ScenarioError("", f"'{text}' is not of the form key=value, such as clock.tick_s=0.001")
    return path, _value(value.strip())


def apply_override(table: dict[str, Any], path: str, value: Any) -> None:
    """Set one value in nested tables, in place.

    Lists of tables are entered by the entry's name or by its place, counted from 1:
    `phase.inflate.pressure_Pa` or `phase.2.pressure_Pa`. A table that gets another kind loses its other keys.

    Raises:
        ScenarioError: the path enters something that is neither a table nor a list of tables, or has a place
            in brackets.
    """
    if "[" in path:
        _refuse_brackets(table, path)
    *parents, last = path.split(".")
    holder: Any = None
    here: Any = table
    for depth, part in enumerate(parents):
        holder, here = here, _enter(here, part, ".".join(parents[:depth]))
    if here is UNKNOWN:
        raise NotKnown
    if not isinstance(here, dict):
        kind = "a list; set it as a whole" if isinstance(here, list) else "a single value"
        raise ScenarioError(path, f"cannot be set: {'.'.join(parents)} is {kind}")
    if isinstance(holder, dict) and _other_kind(here, {last: value}):
        here.clear()
    here[last] = only_readable(value)


def _refuse_brackets(table: dict[str, Any], path: str) -> None:
    """Refuse a place in brackets within a path, if there is a list there; say how to write it instead."""
    key, _, rest = path.partition("[")
    place, _, rest = rest.partition("]")
    here: Any = deepcopy(table)  # a table that is not there is entered too
    for depth, part in enumerate(parts := key.split(".")):
        here = _enter(here, part, ".".join(parts[:depth]))
    if not isinstance(here, list) or not here:
        return
    if not all(isinstance(entry, dict) for entry in here):
        such = f", such as {key}={here}" if len(str(here)) <= _LONGEST_EXAMPLE else ""
        raise ScenarioError(path, f"an entry of a list cannot be set alone; set {key} as a whole{such}")
    names = {str(index): entry.get("name", index + 1) for index, entry in enumerate(here)}
    name = place if place in names.values() else names.get(place, next(iter(names.values())))
    problem = f"entries are named, or counted from 1; write {key}.{name}{rest}; there are: "
    raise ScenarioError(path, problem + ", ".join(map(str, names.values())))


def merge(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with `changes` on top; tables of one kind merge key by key, all else is replaced."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, Mapping) and not _other_kind(old, value):
            merged[key] = merge(old, value)
        else:
            merged[key] = value
    return merged


def _other_kind(table: Mapping[str, Any], changes: Mapping[str, Any]) -> bool:
    """Return whether a table gets another kind than the one it says, whose keys may be others."""
    return "kind" in table and "kind" in changes and table["kind"] != changes["kind"]


def _enter(here: Any, part: str, path: str) -> Any:
    if here is UNKNOWN:
        raise NotKnown
    if isinstance(here, dict):
        return here.setdefault(part, {})
    if isinstance(here, list) and all(isinstance(entry, dict) for entry in here):
        for entry in here:
            if entry.get("name") == part:
                return entry
        if part.isdecimal() and 1 <= int(part) <= len(here):
            return here[int(part) - 1]
        names = ", ".join(str(entry.get("name", index)) for index, entry in enumerate(here, start=1))
        raise ScenarioError(f"{path}.{part}", f"no such entry; there are: {names or 'none'}")
    raise ScenarioError(f"{path}.{part}", f"cannot be set: {path} is not a table")


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):  # not TOML, a number of thousands of digits, thousands of brackets
        pass
    try:
        return float(text)
    except ValueError:
        return text
