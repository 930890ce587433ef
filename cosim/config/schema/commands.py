"""Tables of what changes the commands of a scenario's phases: `[[command]]`.

Each kind has a table of its own, a subclass of `CommandTable`, and is known once it is registered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema

from cosim.config.toml.constraints import Name
from cosim.config.toml.core_schemas import forget_schemas
from cosim.config.toml.registered_kinds import any_of, kind_of

_KINDS: dict[str, type[CommandTable]] = {}


@dataclass(frozen=True, kw_only=True)
class CommandTable:
    """A source of commands.

    Args:
        kind: of the source; each kind has further keys of its own.
    """

    kind: Name

    def source(self, given: Any, scenario: Any) -> Any:
        """Return a source of commands (`cosim.devices.command_source.CommandSource`) in place of another.

        Args:
            given: what would be asked for without it, a `CommandSource`.
            scenario: a checked `Scenario`.

        Raises:
            InputError: there is no such cable, or what else is asked for.
        """
        raise NotImplementedError

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of one kind, or of any that is registered."""
        return any_of(_KINDS, handler) if cls is CommandTable and _KINDS else handler(source)


def register(table: type[CommandTable]) -> None:
    """Let scenarios have a kind of command sources, from the next file on that is read.

    Args:
        table: a frozen dataclass; the default of its `kind` is the name of the kind.
    """
    _KINDS[kind_of(table)] = table
    forget_schemas()
