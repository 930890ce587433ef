"""Turns tables (nested dicts, as TOML gives them) into frozen dataclasses, strictly.

Schemas of tables as pydantic makes them of dataclasses, made strict and bounded by units.

Tables of which files may have several kinds, each its own class, known once it is registered.

A family of kinds, such as that of `[[element]]`, is a direct subclass of `KindTable`, and its kinds are
subclasses of the family.

Keys of the schema number before, and what they are called now.

What to say about a value that does not fit its schema.

pydantic checks types, keys and bounds; every fault is reported with the path of its key, the value, and
what is allowed. What is wrong in a table does not keep rules from being checked on the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, ClassVar, Final, NamedTuple, TypeAlias, TypeVar

from pydantic import GetCoreSchemaHandler, TypeAdapter
from pydantic_core import CoreSchema, SchemaValidator, ValidationError, core_schema

from cosim.config.toml import keys as words
from cosim.config.toml.keys import Name
from cosim.config.toml.reading import UNKNOWN, Fault, Faults, Told, Unreadable, guard, only_readable, rule
from cosim.errors import InputError

Node: TypeAlias = Mapping[str, Any]
"""A node of a pydantic core schema."""

_SCALARS: Final = ("bool", "int", "float", "str")
_KINDS: Final = {"tuple": "list", "dict": "table", "literal": "word"}


@cache
def bounded_schema(kind: type) -> Node:
    """Return the schema of a dataclass, its numbers within the magnitudes of their keys' units."""
    made: Node = _bounded(TypeAdapter(kind).core_schema, "")
    return made


@cache
def file_schema(kind: type) -> Node:
    """Return the same for tables as files give them: nothing is converted, and no key is passed over.

    A field whose value is `UNKNOWN` is left so.
    """
    made: Node = _strict(bounded_schema(kind))
    return made


@cache
def validator_of(kind: type) -> SchemaValidator:
    """Return what makes a dataclass of a table."""
    return SchemaValidator(file_schema(kind))


def forget_schemas() -> None:
    """Rebuild schemas when they are next asked for: the tables that they may hold have changed."""
    for kept in (bounded_schema, file_schema, validator_of):
        kept.cache_clear()


def definitions_of(schema: Node) -> dict[str, Node]:
    """Return the nodes of a schema that others refer to, by their references."""
    return {entry["ref"]: entry for entry in schema.get("definitions", ())}


def inner_node(node: Node, definitions: Mapping[str, Node]) -> Node:
    """Return a node without what is only wrapped about it: defaults, checks, references."""
    while True:
        if node["type"] == "definition-ref":
            node = definitions[node["schema_ref"]]
        elif "schema" in node:
            node = node["schema"]
        elif "steps" in node:
            node = node["steps"][-1]
        else:
            return node


def _bounded(node: Any, key: str) -> Any:
    if isinstance(node, list):
        return [_bounded(item, key) for item in node]
    if not isinstance(node, dict):
        return node
    kind = node.get("type")
    if kind == "nullable":  # TOML has no null: who leaves a value out leaves its key out
        return _bounded(node["schema"], key)
    if kind == "dataclass-field":
        key = str(node.get("validation_alias", node["name"]))
    made = {name: value if name == "default" else _bounded(value, key) for name, value in node.items()}
    if kind == "float":
        magnitude = words.magnitude_of(key)
        if not {"le", "lt"} & made.keys():
            made["le"] = magnitude.largest
        if not {"ge", "gt"} & made.keys():
            made["ge"] = -magnitude.largest
        if made.get("gt") == 0.0:
            made["ge"] = magnitude.smallest
        made["allow_inf_nan"] = False
    return made


def _strict(node: Any) -> Any:
    if isinstance(node, list):
        return [_strict(item) for item in node]
    if not isinstance(node, dict):
        return node
    kind = node.get("type")
    made = {name: value if name == "default" else _strict(value) for name, value in node.items()}
    if kind in _SCALARS:
        made["strict"] = True
    elif kind == "literal" and isinstance(made["expected"][0], int):  # to Python, 1 == 1.0 == True
        return core_schema.chain_schema([core_schema.int_schema(strict=True), node])
    elif kind == "union":
        choices = {_KINDS.get(choice["type"], "one"): choice for choice in made["choices"]}
        return core_schema.tagged_union_schema(choices, _worded if "word" in choices else _fitting)
    elif kind == "dataclass-args":
        made["extra_behavior"] = "forbid"
    elif kind == "dataclass-field":
        made["schema"] = _knowing(made["schema"])
    return made


def _worded(value: Any) -> str:
    """Return for which of several kinds of values one is meant, where one of them is a word."""
    return "word" if isinstance(value, str) else _fitting(value)


def _fitting(value: Any) -> str:
    """Return for which of several kinds of values one is meant."""
    return "list" if isinstance(value, list) else "table" if isinstance(value, Mapping) else "one"


def _knowing(schema: Any) -> Any:
    def known(value: Any, validate: Any) -> Any:
        return value if value is UNKNOWN else validate(value)

    if schema["type"] == "default":
        return {**schema, "schema": _knowing(schema["schema"])}
    return core_schema.no_info_wrap_validator_function(known, schema)


@dataclass(frozen=True, kw_only=True)
class KindTable:
    """A table of one of several kinds.

    Args:
        kind: its name; the default of the field is that of the kind.
    """

    kinds: ClassVar[dict[str, type[KindTable]]]

    kind: Name

    def __init_subclass__(cls) -> None:
        if KindTable in cls.__bases__:
            cls.kinds = {}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of one kind, or of any that is registered, told apart by the key `kind`."""
        if KindTable not in cls.__bases__ or not cls.kinds:
            return handler(source)
        choices = {kind: handler.generate_schema(table) for kind, table in cls.kinds.items()}
        return core_schema.tagged_union_schema(choices, "kind")

    @rule
    def _known(self) -> Told:
        if name_of(type(self)) is None:
            yield Fault(
                "",
                f"kind '{self.kind}' is not known; there are: {words.listing(tuple(self.kinds))}; make it "
                "known by --import MODULE, or from Python by cosim.register_kind",
            )


def name_of(table: type[KindTable]) -> str | None:
    """Return the name of a kind; None for a family of kinds."""
    default = next(entry.default for entry in fields(table) if entry.name == "kind")
    return default if isinstance(default, str) else None


def register_kind(table: type[KindTable]) -> None:
    """Let files have a kind of tables, from the next file on that is read.

    Args:
        table: a frozen dataclass; the default of its `kind` is the name of the kind.

    Raises:
        InputError: it names no kind, or one that another class has.
    """
    name = name_of(table)
    if name is None:
        raise InputError(f"{_kind_place(table)} names no kind; give its field 'kind' a default")
    known = table.kinds.get(name, table)
    if _kind_place(known) != _kind_place(table):
        raise InputError(
            f"kind '{name}' is that of {_kind_place(known)}; {_kind_place(table)} needs another name"
        )
    table.kinds[name] = table
    forget_schemas()


def _kind_place(table: type) -> str:
    return f"{table.__module__}.{table.__qualname__}"


SCHEMA: Final = 2
"""Schema number of scenario and robot files."""

_WRINKLING: Final = 'is no more; drop it: film.law = "wrinkling" makes a coarse mesh answer like the film'

_AUTO: Final = "is no more; drop it: cosim trade SCENARIO --tolerance or --budget says what to set"
_HANDOVER: Final = "is no more; drop it: where a section model ends, fidelity = 'lumped' goes on"

RENAMED: Final = {
    "Scenario": {"chamber": "model"},
    "SoftRobotTable": {"chamber": "stack", "frame": "stiffener"},
}
"""By the class of a table: its old keys, and what they are called since this schema number."""

GONE: Final = {
    "FilmTable": {"compressive_fraction": _WRINKLING},
    "SoftRobotTable": {"calibration": _WRINKLING},
    "Scenario": {"auto": _AUTO},
    "ModelTable": {"calibrated": _WRINKLING, "handover": _HANDOVER},
    "SolverTable": {
        "substep_error_m": "is no more; drop it, and shorten clock.tick_s where a tick's error is too large",
        "newton_iterations_max": "is no more; drop it: search_iterations_max bounds a search",
    },
}
"""By the class of a table: keys that there are no more, and what to do."""

DROPPED: Final = {("model", "handover"), *(("solver", key) for key in GONE["SolverTable"])}
"""Keys of scenarios that upgrading drops."""

REMEDY: Final = "rewrite the file: cosim upgrade FILE"


UNKNOWN_KEY: Final = "unexpected_keyword_argument"
_EXPECTED: Final = {
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "str": "a text in quotes",
    "tuple": "a list",
    "dict": "a table",
    "dataclass-args": "a table",
}
_FITTING: Final[Mapping[str, Any]] = {
    "int": int, "float": int | float, "str": str, "tuple": list, "dict": Mapping, "dataclass-args": Mapping
}  # fmt: skip


def fault_text(error: Mapping[str, Any], node: Node, value: Any) -> str:
    """Return what is wrong with a value and what is allowed.

    Args:
        error: of pydantic.
        node: of the schema, where the value is; where a key is missing or unknown, that of its table.
        value: as the file gives it.
    """
    kind = error["type"]
    if kind == "missing":
        return "is missing; it has no default"
    if kind == UNKNOWN_KEY:
        key = error["loc"][-1]
        if new := _renamed(node, key):
            return f"is called {new} since schema {SCHEMA}; {REMEDY}"
        gone = GONE.get(node["dataclass_name"], {}).get(key)
        return gone or words.unknown_key_message(key, tuple(keys_of(node)))
    if isinstance(value, Unreadable):
        return value.problem
    if kind == "rule":
        return str(error["ctx"]["problem"])
    if error["loc"][-1] == "schema" and value == SCHEMA - 1 and not isinstance(value, bool):
        return f"is {value}, that of older files; {REMEDY}"
    if node["type"] == "literal":
        return f"got {words.describe(value)}; allowed: {_expected(node)}"
    if node["type"] == "tagged-union" and isinstance(node["discriminator"], str):
        key, allowed = node["discriminator"], ", ".join(f"'{tag}'" for tag in node["choices"])
        if not isinstance(value, Mapping):
            return f"expected a table, got {words.describe(value)}"
        given = words.describe(value[key]) if key in value else "missing"
        return f"{key} is {given}; allowed: {allowed}"
    if node["type"] == "tagged-union":
        expected = " or ".join(map(_expected, node["choices"].values()))
        return f"expected {expected}, got {words.describe(value)}"
    if isinstance(value, bool) or not isinstance(value, _FITTING.get(node["type"], ())):
        return f"expected {_EXPECTED[node['type']]}, got {words.describe(value)}"
    if node["type"] == "tuple":
        return _length_text(node, len(value), "entries")
    if node["type"] == "str":
        if kind == "string_too_long":
            return _length_text(node, len(value), "characters")
        meaning = node.get("metadata", {}).get("meaning", "a text of Unicode's characters")
        return f"{words.shown(value)} must be {meaning}"
    if isinstance(value, float) and not math.isfinite(value):
        return f"got {value:g}; must be a finite number"
    return f"{value:g} is out of bounds; must be {bounds_text(node)}"


def _expected(node: Node) -> str:
    if node["type"] != "literal":
        return _EXPECTED[node["type"]]
    return ", ".join(f"'{one}'" if isinstance(one, str) else str(one).lower() for one in node["expected"])


def meant_keys(node: Node, key: str) -> list[str]:
    """Return which keys of a table may be meant by one that does not exist; `node` is the table's."""
    new = _renamed(node, key)
    return [new] if new else words.likely_keys(key, tuple(keys_of(node)))


def _renamed(node: Node, key: str) -> str | None:
    return RENAMED.get(node["dataclass_name"], {}).get(key)


def keys_of(node: Node) -> dict[str, Node]:
    """Return the nodes of a table's keys."""
    return {entry.get("validation_alias", entry["name"]): entry["schema"] for entry in node["fields"]}


def bounds_text(node: Node) -> str:
    """Return the bounds of a number in words."""
    if node.get("ge") is not None and node["ge"] == -node.get("le", math.inf):
        return f"within {node['ge']:g} and {node['le']:g}"
    words = (("above", "gt"), ("at least", "ge"), ("below", "lt"), ("at most", "le"))
    return ", ".join(f"{word} {node[key]:g}" for word, key in words if node.get(key) is not None)


def _length_text(node: Node, length: int, of: str) -> str:
    least, most = node.get("min_length"), node.get("max_length")
    if "variadic_item_index" not in node and node["type"] == "tuple":
        return f"has {length} {of}; must have {len(node['items_schema'])}"
    if least is not None and length < least:
        return f"has {length} {of}; needs at least {least}"
    return f"has {length} {of}; at most {most} are allowed"


Schema = TypeVar("Schema")


class _Place(NamedTuple):
    """Where a fault is: its path, the schema's node, the value, and the table and key that hold it."""

    path: str
    node: Node
    value: Any
    table: dict[str, Any]
    key: str


def parse(kind: type[Schema], table: Mapping[str, Any], path: str, faults: Faults) -> Schema:
    """Return the dataclass that a table describes; a field whose value is wrong holds UNKNOWN.

    Args:
        kind: a frozen dataclass whose annotations carry the constraints.
        table: as TOML gives it.
        path: of the table itself, for messages.
        faults: gets all faults of the table.
    """
    kept, validator = only_readable(table), validator_of(kind)  # type: ignore[arg-type]
    for last in (False, False, True):  # a list that is too short shows once all is right within it
        try:
            made: Schema = validator.validate_python(kept)
            break
        except ValidationError as error:
            if last:
                raise
            _mark(file_schema(kind), kept, path, _without_gaps(error), faults)  # type: ignore[arg-type]
    guard(made)
    return made


def _mark(schema: Node, kept: dict[str, Any], path: str, found: list[dict[str, Any]], faults: Faults) -> None:
    """Tell the faults that pydantic has found, and put UNKNOWN in the place of each."""
    pairs = [(item, _place(schema, kept, path, item)) for item in found]
    for item, place in pairs:
        if item["type"] == UNKNOWN_KEY:
            del place.table[place.key]
            for key in meant_keys(place.node, place.key):
                place.table.setdefault(key, UNKNOWN)
    for item, place in pairs:
        if item["type"] == "missing" and place.key in place.table:
            continue  # it is there, but misspelt or by its old name
        if item["type"] != UNKNOWN_KEY:
            place.table[place.key] = UNKNOWN
        faults.add(place.path, fault_text(item, place.node, place.value))


def with_unknown(kind: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table in which all that is not given is UNKNOWN, within its tables as well."""
    schema = file_schema(kind)
    definitions = definitions_of(schema)

    def filled(node: Node, table: Mapping[str, Any]) -> dict[str, Any]:
        keys = keys_of(node)
        made: dict[str, Any] = dict.fromkeys(keys, UNKNOWN)
        for key, value in table.items():
            inner = inner_node(keys[key], definitions) if key in keys else node
            deeper = inner["type"] == node["type"] and inner is not node and isinstance(value, dict)
            made[key] = filled(inner, value) if deeper else value
        return made

    return filled(inner_node(schema, definitions), given)


def _without_gaps(error: ValidationError) -> list[dict[str, Any]]:
    """Return what pydantic found; entries missing at the end of a list are one fault, that of the list.

    Nothing is said of a list that has a wrong entry.
    """
    found: dict[tuple[str | int, ...], dict[str, Any]] = {}
    for item in error.errors(include_url=False, include_input=False):
        place = item["loc"]
        if item["type"] == "missing" and isinstance(place[-1], int):
            place = place[:-1]
            found[place] = {"type": "too_short", "loc": place}
        else:
            found[place] = dict(item)
    for above in [place[:depth] for place in found for depth in range(1, len(place))]:
        found.pop(above, None)  # too short without the wrong entries: that follows from them
    return list(found.values())


def _place(schema: Node, kept: dict[str, Any], path: str, found: Mapping[str, Any]) -> _Place:
    """Return where a fault is; the table and key are the innermost ones that a dataclass has a field for."""
    definitions = definitions_of(schema)
    node, value = inner_node(schema, definitions), kept
    table, key = kept, ""
    for part in found["loc"]:
        if node["type"] == "tagged-union":
            node = inner_node(node["choices"][part], definitions)
            continue
        within, value = value, _item(value, part)
        path = words.join(path, words.label(value, part + 1) if isinstance(part, int) else part)
        if node["type"] == "dataclass-args":
            table, key = within, str(part)
            if found["type"] == UNKNOWN_KEY and part not in keys_of(node):
                break
            inner = keys_of(node)[key]
        elif node["type"] == "dict":
            inner = node["values_schema"]
        else:
            items = node["items_schema"]
            inner = items[int(part) if "variadic_item_index" not in node else 0]
        node = inner_node(inner, definitions)
    return _Place(path, node, value, table, key)


def _item(value: Any, part: str | int) -> Any:
    try:
        return value[part]
    except LookupError:  # a missing key
        return None
