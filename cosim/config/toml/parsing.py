"""Turns tables into frozen dataclasses with pydantic. A fault names path, value and what is allowed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from typing import Any, Final, NamedTuple, TypeVar, get_type_hints

from annotated_types import Interval
from pydantic import ValidationError
from pydantic_core import ErrorDetails, to_json

from cosim.config.toml import keys as words
from cosim.config.toml.old_keys import GONE, REMEDY, RENAMED, SCHEMA
from cosim.config.toml.quantities import PATTERNS
from cosim.config.toml.reading import plain
from cosim.config.toml.rules import Faults
from cosim.config.toml.tables import Table, adapter_of, tables_in

_EXPECTED: Final = {
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "a text in quotes",
    "tuple_type": "a list",
    "dict_type": "a table",
    "dataclass_type": "a table",
    "model_attributes_type": "a table",
}
_BOUNDS: Final = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
_UNKNOWN_KEY: Final = "unexpected_keyword_argument"
Schema = TypeVar("Schema", bound=Table)


class _Place(NamedTuple):
    """The key that a fault is about.

    Args:
        above: path of the table or list that the key is in.
        key: its name, or the name or number of an entry of a list; None: the table itself.
        value: as the file gives it.
        hint: type of the value.
        table: class of the innermost table that the key is in.
    """

    above: str
    key: str | None
    value: Any
    hint: Any
    table: Any

    @property
    def path(self) -> str:
        """Path of the key."""
        return words.join(self.above, self.key) if self.key is not None else self.above


def parse(kind: type[Schema], table: Mapping[str, Any], path: str, faults: Faults) -> Schema:
    """Return the dataclass that a table describes.

    Args:
        kind: a frozen dataclass whose annotations carry the constraints.
        table: as TOML gives it.
        path: of the table itself, for messages.
        faults: found so far; gets all faults of the table.

    Raises:
        ScenarioError: with all faults, if there are any.
    """
    kept, adapter = plain(table, path, faults.unread), adapter_of(kind)  # type: ignore[arg-type]
    try:
        # as JSON, because there a strict schema takes a list for a tuple and a table for a dataclass
        made: Schema = adapter.validate_json(to_json(kept, inf_nan_mode="constants", fallback=str))
    except ValidationError as error:
        _note(kind, kept, path, error.errors(include_url=False, include_input=False), faults)
    faults.add_unread()
    faults.raise_all()
    return made


def _note(kind: type[Table], kept: Any, path: str, errors: Sequence[ErrorDetails], faults: Faults) -> None:
    """Add the errors of pydantic to the faults; entries missing at the end of a list count as one fault."""
    found = {}
    for error in errors:
        short = error["type"] == "missing" and isinstance(error["loc"][-1], int)
        loc = error["loc"][:-1] if short else error["loc"]
        found[loc] = (
            ("too_few", {"needed": error["loc"][-1]}) if short else (error["type"], error.get("ctx", {}))
        )
    for above in [loc[:depth] for loc in found for depth in range(1, len(loc))]:
        found.pop(above, None)  # the list is too short because of its wrong entries
    places = {loc: _place(kind, kept, loc, path) for loc in found}
    meant = {  # a misspelt key, or one with its old name, is not reported as missing as well
        words.join(place.above, key)
        for loc, place in places.items()
        if found[loc][0] == _UNKNOWN_KEY
        for key in _meant_keys(place.table, str(place.key))
    }
    for loc, place in places.items():
        problem, context = found[loc]
        if not faults.is_unread(place.path) and not (problem == "missing" and place.path in meant):
            faults.add(place.path, _text(problem, context, place))


def _place(kind: Any, value: Any, loc: Sequence[str | int], path: str) -> _Place:
    """Return the key of a fault from pydantic's location.

    Args:
        kind: class of the outermost table.
        value: the table, as TOML gives it.
        loc: keys, numbers in lists, and tags of unions.
        path: of the table.
    """
    place = _Place(path, None, value, kind, kind)
    for part in loc:
        holder = place.value
        if isinstance(part, int):
            inner = holder[part]
            place = _Place(place.path, words.label(inner, part + 1), inner, place.hint, place.table)
            continue
        tables = _fitting(place.hint, holder)
        table = next((each for each in tables if part in _hints(each)), None)
        if table is not None:
            place = _Place(place.path, part, holder.get(part), _hints(table)[part], table)
        elif isinstance(holder, Mapping) and part in holder:
            place = _Place(place.path, part, holder[part], place.hint, tables[0] if tables else place.table)
    return place


def _fitting(hint: Any, value: Any) -> list[Any]:
    """Return the classes of tables that a value may belong to; of several kinds, the one that it names."""
    tables: list[Any] = list(tables_in(hint)) if isinstance(value, Mapping) else []
    named = [each for each in tables if getattr(each, "kind", None) == value.get("kind")] if tables else []
    return named or tables


@cache
def _hints(table: Any) -> dict[str, Any]:
    """Return the types of a table's keys."""
    hints = get_type_hints(table, include_extras=True)
    return {words.key_of(entry): hints[entry.name] for entry in fields(table)}


def _meant_keys(table: Any, key: str) -> list[str]:
    """Return the keys of a table that an unknown one resembles, or its new name."""
    new = RENAMED.get(table.__name__, {}).get(key)
    return [new] if new else words.likely_keys(key, tuple(_hints(table)))


def _text(problem: str, context: Mapping[str, Any], place: _Place) -> str:
    """Return the message for a fault: what is wrong with the value, and what is allowed.

    Args:
        problem: pydantic's name of the error.
        context: numbers and words that pydantic gives with it.
        place: key of the fault.
    """
    value, table = place.value, place.table
    if problem == "missing":
        return "is missing; it has no default"
    if problem == _UNKNOWN_KEY:
        key = str(place.key)
        if new := RENAMED.get(table.__name__, {}).get(key):
            return f"is called {new} since schema {SCHEMA}; {REMEDY}"
        return GONE.get(table.__name__, {}).get(key) or words.unknown_key_message(key, tuple(_hints(table)))
    if problem in _EXPECTED:
        return f"expected {_EXPECTED[problem]}, got {words.describe(value)}"
    if problem in _BOUNDS:
        return f"{value:g} is out of bounds; must be {_bounds_text(place.hint, problem, context)}"
    if problem == "finite_number":
        return f"got {value:g}; must be a finite number"
    if problem == "value_error":
        return str(context["error"])
    if problem == "literal_error":
        allowed = context["expected"].replace(" or ", ", ").replace("True", "true").replace("False", "false")
        return f"got {words.describe(value)}; allowed: {allowed}"
    if problem == "string_pattern_mismatch":
        return f"{words.shown(value)} must be {PATTERNS[context['pattern']]}"
    if problem in ("union_tag_invalid", "union_tag_not_found"):
        return _union_text(place, context)
    return _length_text(problem, context, len(value))


def _bounds_text(hint: Any, problem: str, context: Mapping[str, Any]) -> str:
    """Return the bounds of a number in words, from the interval of its type that is violated."""
    key, _ = _BOUNDS[problem]
    bounds = next(each for each in _intervals(hint) if getattr(each, key) == context[key])
    if bounds.ge is not None and bounds.le is not None and bounds.ge == -bounds.le:
        return f"within {bounds.ge:g} and {bounds.le:g}"
    given = ((word, getattr(bounds, each)) for each, word in _BOUNDS.values())
    return ", ".join(f"{word} {bound:g}" for word, bound in given if bound is not None)


def _intervals(hint: Any) -> Iterator[Any]:
    yield from (each for each in getattr(hint, "__metadata__", ()) if isinstance(each, Interval))
    for inner in (getattr(hint, "__origin__", None), *getattr(hint, "__args__", ())):
        yield from () if inner is None else _intervals(inner)


def _union_text(place: _Place, context: Mapping[str, Any]) -> str:
    """Return the message for a value of a wrong kind: the kinds of values, or of tables, that are allowed."""
    value = place.value
    if context["discriminator"] == "'kind'":
        given = words.describe(value["kind"]) if "kind" in value else "missing"
        kinds = (f"'{getattr(each, 'kind', '')}'" for each in tables_in(place.hint))
        return f"kind is {given}; allowed: {', '.join(kinds)}"
    expected = context["expected_tags"].replace("'", "").replace(", ", " or ")
    return f"expected {expected}, got {words.describe(value)}"


def _length_text(problem: str, context: Mapping[str, Any], length: int) -> str:
    of = "characters" if problem.startswith("string") else "entries"
    if problem == "too_few":
        return f"has {length} {of}; must have {context['needed'] + 1}"
    if "min_length" in context:
        return f"has {length} {of}; needs at least {context['min_length']}"
    return f"has {length} {of}; at most {context['max_length']} are allowed"
