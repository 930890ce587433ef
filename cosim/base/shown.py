"""Arrays that are shown to others, who cannot write to them."""

from __future__ import annotations

from typing import Any

import numpy as np


def read_only(array: Any) -> Any:
    """Return a view that nobody can write through; its owner still can, as kernels take no other arrays."""
    view = array.view()
    view.setflags(False)  # by keyword it takes twice as long
    return view


class Shown:
    """A dataclass that is shown to others: nobody can write to the arrays that it holds."""

    def __post_init__(self) -> None:
        held = vars(self)
        for name, value in held.items():
            if type(value) is np.ndarray:
                held[name] = view = value.view()
                view.setflags(False)  # type: ignore[call-arg]  # by keyword it takes twice as long
            elif type(value) is tuple and value and type(value[0]) is np.ndarray:
                held[name] = tuple(map(read_only, value))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take up what was pickled, whose arrays come back writeable."""
        vars(self).update(state)
        self.__post_init__()
