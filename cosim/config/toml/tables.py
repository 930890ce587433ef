"""Base classes of all tables: strict frozen dataclasses that pydantic reads, and tables of several kinds. A
family of kinds, such as that of `[[element]]`, is a direct subclass of `KindTable`. Its kinds are its
subclasses; files may use them once they are registered.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, ClassVar

from pydantic import ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from cosim.base.names import texts_of
from cosim.config.toml import keys
from cosim.config.toml.quantities import Name
from cosim.errors import InputError


class Table:
    """A table of a file: a frozen dataclass. Values are not converted, and unknown keys are faults."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the JSON Schema, with descriptions from the docstring and units from the keys."""
        reference = handler(core)
        table = handler.resolve_ref_schema(reference)
        if "properties" not in table:  # a family of kinds
            return reference
        text, arguments = texts_of(cls)
        table.pop("title", None)
        table |= {"description": text, "additionalProperties": False}
        for entry in fields(cls):  # type: ignore[arg-type]  # all subclasses are dataclasses
            key = keys.key_of(entry)
            node, unit = table["properties"][key], keys.unit_text(keys.unit_of(key))
            node.pop("title", None)
            if node.get("default", 0) is None or isinstance(node.get("default"), dict):
                del node["default"]  # left out, or said by the table itself
            said = [arguments.get(entry.name, ""), f"Unit: {unit}." if unit else ""]
            node |= {"description": " ".join(filter(None, said))} if any(said) else {}
            node |= {"x-unit": unit} if unit else {}
        return reference


@cache
def adapter_of(kind: Any) -> TypeAdapter[Any]:
    """Return the pydantic adapter that turns a table into a dataclass."""
    return TypeAdapter(kind)


@dataclass(frozen=True, kw_only=True)
class KindTable(Table):
    """A table of one of several kinds.

    Args:
        kind: name of the kind; a subclass gives it as the default of this field.
    """

    kinds: ClassVar[dict[str, type["KindTable"]]]

    kind: Name

    def __init_subclass__(cls) -> None:
        if KindTable in cls.__bases__:
            cls.kinds = {}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a kind; of a family, a union of its registered kinds with `kind` as tag."""
        if KindTable not in cls.__bases__:
            return handler(source)
        if not cls.kinds:
            return core_schema.no_info_before_validator_function(_unknown_kind, handler(source))
        choices = {kind: handler.generate_schema(table) for kind, table in cls.kinds.items()}
        return core_schema.tagged_union_schema(choices, "kind")


def _unknown_kind(value: Any) -> Any:
    if isinstance(value, Mapping) and "kind" in value:
        raise ValueError(
            f"kind {keys.shown(value['kind'])} is not known; there are: none; register it with --import "
            "MODULE, or from Python with cosim.register_kind"
        )
    return value


def name_of(table: type[KindTable]) -> str | None:
    """Return the name of a kind of tables; None for a family of kinds."""
    default = next(entry.default for entry in fields(table) if entry.name == "kind")
    return default if isinstance(default, str) else None


def register_kind(table: type[KindTable]) -> None:
    """Register a kind of tables, so that files which are read afterwards may use it.

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
    adapter_of.cache_clear()


def _kind_place(table: type) -> str:
    return f"{table.__module__}.{table.__qualname__}"


def tables_in(hint: Any) -> Iterator[type[Table]]:
    """Yield the classes of tables in a type annotation; of a family, all its kinds."""
    if isinstance(hint, type) and issubclass(hint, Table):
        family = KindTable in hint.__bases__
        yield from getattr(hint, "kinds", {}).values() or [hint] if family else [hint]
    for inner in getattr(hint, "__args__", ()):
        yield from tables_in(inner)
