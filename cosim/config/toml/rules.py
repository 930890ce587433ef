"""Faults of a file, collected to be reported together, and the rules that tables have beside their fields."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import cache
from types import TracebackType
from typing import Any, NamedTuple, TypeAlias, TypeVar, final, get_type_hints

from cosim.config.toml.keys import join, key_of
from cosim.errors import InputError, ScenarioError


class Fault(NamedTuple):
    """Path of a key, and what is wrong with it."""

    path: str
    problem: str


@final
class Faults:
    """Collects faults: `with faults:` notes what is raised within, and continues after it."""

    def __init__(self) -> None:
        self._found: dict[Fault, None] = {}
        self.unread: dict[str, str] = {}
        """What cannot be read, by its path; the text is empty where the fault is noted already."""

    def __enter__(self) -> None:
        """Begin something that may raise ScenarioError."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        """Note a ScenarioError."""
        if isinstance(error, ScenarioError):
            for fault in error.faults:
                self.add(*fault)
        return isinstance(error, ScenarioError)

    def add(self, path: str, message: str) -> None:
        """Note what is wrong with a key, once."""
        self._found[Fault(path, message)] = None

    def leaves_out(self, path: str) -> bool:
        """Return whether a key, or what it is in, cannot be read."""
        return any(_within(path, each) for each in self.unread)

    def add_unread(self) -> None:
        """Note what cannot be read, where nothing else is wrong with what it is in."""
        for path, problem in self.unread.items():
            if problem and not any(_within(path, found.path) for found in self._found):
                self.add(path, problem)

    def tell(self) -> None:
        """Raise what was found.

        Raises:
            ScenarioError: with all faults, if there are any.
        """
        if self._found:
            first, *others = self._found
            raise ScenarioError(*first, further=tuple(others))


def _within(path: str, above: str) -> bool:
    return path == above or path.startswith(f"{above}.")


Told: TypeAlias = Iterator[Fault | tuple[str, str]]
"""What a rule yields: for each fault the key within its table; "" is the table itself."""

Rule = TypeVar("Rule", bound=Callable[..., Told])
RuleOn: TypeAlias = tuple[Any, Callable[..., Told]]
"""The class of tables that a rule is on, and the rule."""


def rule(told: Rule) -> Rule:
    """Mark a rule: a method of a table, or a function whose first argument is one.

    A second argument is what the table is in: the scenario, or the soft robot whose file it is part of (the
    tables with a `schema`). Rules are checked once all values are right by themselves.
    """
    told.__dict__["is_rule"] = True
    return told


def rules_of(module: Mapping[str, Any]) -> tuple[RuleOn, ...]:
    """Return the rules that are functions of a module."""
    found = [entry for entry in module.values() if getattr(entry, "is_rule", False)]
    return tuple((next(iter(get_type_hints(entry).values())), entry) for entry in found)


@cache
def _rules_on(kind: Any, rules: tuple[RuleOn, ...]) -> tuple[Callable[..., Told], ...]:
    """Return those of the rules that are on a class of tables, then its own."""
    own = (entry for each in kind.__mro__ for entry in vars(each).values() if hasattr(entry, "is_rule"))
    return (*(told for on, told in rules if issubclass(kind, on)), *own)


def check(table: Any, path: str, around: Any, rules: tuple[RuleOn, ...], faults: Faults) -> None:
    """Check a table by its rules, then all tables in it; names in a list of tables must differ.

    Args:
        table: a dataclass.
        path: of the table.
        around: what it is in.
        rules: further ones, on classes of tables.
        faults: gets the rules that are broken.
    """
    kind: Any = type(table)
    for told in _rules_on(kind, rules):
        with faults:
            for key, problem in told(*(table, around)[: told.__code__.co_argcount]):
                faults.add(".".join(filter(None, (path, key))), problem)
    parts = fields(table)
    inner = table if any(entry.name == "schema" for entry in parts) else around
    for entry in parts:
        value, here = getattr(table, entry.name), join(path, key_of(entry))
        if is_dataclass(value):
            check(value, here, inner, rules, faults)
        elif isinstance(value, tuple) and value and is_dataclass(value[0]):
            seen = set[str]()
            for number, each in enumerate(value, start=1):
                place = join(here, getattr(each, "name", str(number)))
                if place in seen:
                    faults.add(place, "the name is used twice; names must differ")
                seen.add(place)
                check(each, place, inner, rules, faults)


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
