"""Tables of which a file may have several kinds, known once they are registered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema


def kind_of(table: Any) -> str:
    """Return the name of a kind: the default of the field `kind` of its dataclass."""
    return str(next(entry.default for entry in fields(table) if entry.name == "kind"))


def any_of(kinds: Mapping[str, type], handler: GetCoreSchemaHandler) -> CoreSchema:
    """Return the schema of a table of any of some kinds, told apart by the key `kind`.

    Args:
        kinds: dataclasses by their names, at least one.
        handler: makes the schema of each.
    """
    choices = {kind: handler.generate_schema(table) for kind, table in kinds.items()}
    return core_schema.tagged_union_schema(choices, "kind")
