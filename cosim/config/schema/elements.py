"""Tables of elements that a soft robot has besides its film, folds, cables and stiffeners: `[[element]]`.

Each kind has a table of its own, a subclass of `ElementTable`, and is known once it is registered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema

from cosim.config.toml.constraints import Name
from cosim.config.toml.core_schemas import forget_schemas
from cosim.config.toml.registered_kinds import any_of, kind_of

_KINDS: dict[str, type[ElementTable]] = {}


@dataclass(frozen=True, kw_only=True)
class ElementTable:
    """Further elements of a soft robot.

    Args:
        kind: of the elements; each kind has further keys of its own.
    """

    kind: Name

    def element(self, body: Any) -> Any:
        """Return the elements (`cosim.soft.elements.element.Element`) for a body (`SoftBody`) without them.

        Raises:
            InputError: the body has no such rings, or what else is asked for.
        """
        raise NotImplementedError

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of one kind, or of any that is registered."""
        return any_of(_KINDS, handler) if cls is ElementTable and _KINDS else handler(source)


def register(table: type[ElementTable]) -> None:
    """Let files have a kind of elements, from the next file on that is read.

    Args:
        table: a frozen dataclass; the default of its `kind` is the name of the kind.
    """
    _KINDS[kind_of(table)] = table
    forget_schemas()
