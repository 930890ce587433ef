"""Tables of what changes the commands of a scenario's phases: `[[command]]`.

Each kind has a table of its own, a subclass of `CommandTable`, and is known once it is registered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cosim.config.toml.registered_kinds import KindTable


@dataclass(frozen=True, kw_only=True)
class CommandTable(KindTable):
    """A source of commands.

    Args:
        kind: of the source; each kind has further keys of its own.
    """

    def source(self, given: Any, scenario: Any) -> Any:
        """Return a source of commands (`cosim.devices.command_source.CommandSource`) in place of another.

        Args:
            given: what would be asked for without it, a `CommandSource`.
            scenario: a checked `Scenario`.

        Raises:
            InputError: there is no such cable, or what else is asked for.
        """
        raise NotImplementedError
