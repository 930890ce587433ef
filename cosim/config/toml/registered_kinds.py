"""Tables of which files may have several kinds, each a class of its own, known once it is registered.

A family of kinds, such as that of `[[element]]`, is a direct subclass of `KindTable`, and its kinds are
subclasses of the family.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from cosim.config.toml.constraints import Name
from cosim.config.toml.core_schemas import forget_schemas
from cosim.config.toml.suggestions import listing
from cosim.errors import InputError, ScenarioError


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
        raise InputError(f"{_place(table)} names no kind; give its field 'kind' a default")
    known = table.kinds.get(name, table)
    if _place(known) != _place(table):
        raise InputError(f"kind '{name}' is that of {_place(known)}; {_place(table)} needs another name")
    table.kinds[name] = table
    forget_schemas()


def check_registered(entry: KindTable, path: str) -> None:
    """Check that a table read from a file is of a kind that is known.

    Raises:
        ScenarioError: it is not.
    """
    if name_of(type(entry)) is None:
        known = listing(tuple(entry.kinds))
        raise ScenarioError(
            path,
            f"kind '{entry.kind}' is not known; there are: {known}; make it known by --import MODULE, or "
            "from Python by cosim.register_kind",
        )


def _place(table: type) -> str:
    return f"{table.__module__}.{table.__qualname__}"
