"""Collects the faults of a file so that they are reported together, and checks the rules of tables."""

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
    """Collects faults: `with faults:` adds those of a ScenarioError raised within, and suppresses it."""

    def __init__(self) -> None:
        self._found: dict[Fault, None] = {}
        self.unread: dict[str, str] = {}
        """Path of an unreadable value -> reason; the reason is empty if the fault is already in the list."""

    def __enter__(self) -> None:
        """Enter a block that may raise ScenarioError."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        """Add the faults of a ScenarioError, and suppress it."""
        if isinstance(error, ScenarioError):
            for fault in error.faults:
                self.add(*fault)
        return isinstance(error, ScenarioError)

    def add(self, path: str, message: str) -> None:
        """Add a fault; the same fault is added once.

        Args:
            path: of the key.
            message: what is wrong with it.
        """
        self._found[Fault(path, message)] = None

    def is_unread(self, path: str) -> bool:
        """Return whether a key, or a table that it is in, could not be read."""
        return any(_within(path, each) for each in self.unread)

    def add_unread(self) -> None:
        """Add a fault for each unreadable value whose table has no other fault."""
        for path, problem in self.unread.items():
            if problem and not any(_within(path, found.path) for found in self._found):
                self.add(path, problem)

    def raise_all(self) -> None:
        """Raise the faults that were found, as one error.

        Raises:
            ScenarioError: with all faults, if there are any.
        """
        if self._found:
            first, *others = self._found
            raise ScenarioError(*first, further=tuple(others))


def _within(path: str, above: str) -> bool:
    return path == above or path.startswith(f"{above}.")


Violations: TypeAlias = Iterator[Fault | tuple[str, str]]
"""Faults that a rule yields: the key within its table ("" for the table itself), and what is wrong."""

Rule = TypeVar("Rule", bound=Callable[..., Violations])
RuleOn: TypeAlias = tuple[Any, Callable[..., Violations]]
"""The class of tables that a rule is on, and the rule."""


def rule(check_rule: Rule) -> Rule:
    """Mark a rule: a method of a table, or a function whose first argument is a table.

    If the rule has a second argument, that is the table with a `schema` that contains the first: the
    scenario, or the soft robot. Rules are checked after all values have passed their types and bounds.
    """
    check_rule.__dict__["is_rule"] = True
    return check_rule


def rules_of(module: Mapping[str, Any]) -> tuple[RuleOn, ...]:
    """Return the rules that are functions of a module."""
    found = [entry for entry in module.values() if getattr(entry, "is_rule", False)]
    return tuple((next(iter(get_type_hints(entry).values())), entry) for entry in found)


@cache
def _rules_on(kind: Any, rules: tuple[RuleOn, ...]) -> tuple[Callable[..., Violations], ...]:
    """Return the given rules that apply to a class of tables, then the rules that are its methods."""
    methods = (entry for each in kind.__mro__ for entry in vars(each).values() if hasattr(entry, "is_rule"))
    return (*(check_rule for on, check_rule in rules if issubclass(kind, on)), *methods)


def check(table: Any, path: str, around: Any, rules: tuple[RuleOn, ...], faults: Faults) -> None:
    """Check a table by its rules, then all tables in it; names in a list of tables must differ.

    Args:
        table: a dataclass.
        path: of the table.
        around: the scenario or soft robot that contains the table; None for the outermost.
        rules: that are not methods of tables.
        faults: gets the broken rules.
    """
    kind: Any = type(table)
    for check_rule in _rules_on(kind, rules):
        with faults:
            for key, problem in check_rule(*(table, around)[: check_rule.__code__.co_argcount]):
                faults.add(".".join(filter(None, (path, key))), problem)
    parts = fields(table)
    inner = table if any(entry.name == "schema" for entry in parts) else around
    for entry in parts:
        value, inner_path = getattr(table, entry.name), join(path, key_of(entry))
        if is_dataclass(value):
            check(value, inner_path, inner, rules, faults)
        elif isinstance(value, tuple) and value and is_dataclass(value[0]):
            seen = set[str]()
            for number, each in enumerate(value, start=1):
                entry_path = join(inner_path, getattr(each, "name", str(number)))
                if entry_path in seen:
                    faults.add(entry_path, "the name is used twice; names must differ")
                seen.add(entry_path)
                check(each, entry_path, inner, rules, faults)


@contextmanager
def errors_at(path: str) -> Iterator[None]:
    """Turn an InputError raised within into a ScenarioError of a key; a ScenarioError passes unchanged.

    Args:
        path: of the key.

    Raises:
        ScenarioError: in place of an InputError.
    """
    try:
        yield
    except ScenarioError:
        raise
    except InputError as error:
        raise ScenarioError(path, str(error)) from error
