"""Tables of elements that a soft robot has besides its film, folds, cables and stiffeners: `[[element]]`.

Each kind has a table of its own, a subclass of `ElementTable`, and is known once it is registered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cosim.config.toml.registered_kinds import KindTable


@dataclass(frozen=True, kw_only=True)
class ElementTable(KindTable):
    """Further elements of a soft robot.

    Args:
        kind: of the elements; each kind has further keys of its own.
    """

    def element(self, body: Any) -> Any:
        """Return the elements (`cosim.soft.elements.element.Element`) for a body (`SoftBody`) without them.

        Raises:
            InputError: the body has no such rings, or what else is asked for.
        """
        raise NotImplementedError
