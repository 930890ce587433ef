"""What is shown to others, who cannot write to its arrays; among it, what is drawn of a rigid body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.base.frames import Array, IntArray, Remade


def read_only(array: Any) -> Any:
    """Return a view that nobody can write through; its owner still can, as kernels take no other arrays."""
    view = array.view()
    view.setflags(False)  # by keyword it takes twice as long
    return view


class Shown(Remade):
    """A dataclass that is shown to others: nobody can write to the arrays that it holds."""

    def __post_init__(self) -> None:
        held = vars(self)
        for name, value in held.items():
            if type(value) is np.ndarray:
                held[name] = view = value.view()
                view.setflags(False)  # type: ignore[call-arg]  # by keyword it takes twice as long
            elif type(value) is tuple and value and type(value[0]) is np.ndarray:
                held[name] = tuple(map(read_only, value))


@dataclass(frozen=True)
class BodyShape(Shown):
    """A triangle mesh fixed to a rigid body, for drawing only.

    Args:
        body: index into the names of the bodies of its scene.
        vertices: (n, 3) [m], body frame.
        triangles: (m, 3), counter-clockwise seen from outside.
        rgba: colour, components 0 to 1.
    """

    body: int
    vertices: Array
    triangles: IntArray
    rgba: tuple[float, float, float, float]
