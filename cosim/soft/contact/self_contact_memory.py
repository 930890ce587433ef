"""What contacts between films carry from one state to the next, and report of the last step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector


@final
@dataclass(frozen=True)
class FilmMemory:
    """Pairs of contact point and unit that press on each other.

    Args:
        key: (k,) ascending.
        normal_force: (k,) [N].
        distance: (k,) [m], negative where the point is behind the other film.
        stretch: (k, 3) [m], of the stick springs, world.
    """

    key: Annotated[IntArray, ("k",)]
    normal_force: Annotated[Array, ("k",)]
    distance: Annotated[Array, ("k",)]
    stretch: Annotated[Array, ("k", 3)]

    @property
    def count(self) -> int:
        """Points that press."""
        return len(self.key)

    @property
    def normal_force_N(self) -> float:
        """Sum over the points of either film: with this the two press on each other [N]."""
        return float(self.normal_force.cumsum()[-1]) if self.count else 0.0  # one by one, as kernels do

    @property
    def depth_m(self) -> float:
        """How deep the deepest point is behind the other film [m]; negative while none is."""
        return -float(self.distance.min()) if self.count else 0.0

    def carried(self, motion: Pose) -> FilmMemory:
        """Return the memory moved rigidly by `motion` (world to world)."""
        return FilmMemory(self.key, self.normal_force, self.distance, self.stretch @ motion.rotation.T)


class FilmMemoryRows(NamedTuple):
    """The fields of `FilmMemory`, with room for more."""

    key: Indices
    normal_force: Vector
    distance: Vector
    stretch: Matrix

    @classmethod
    def room(cls, count: int) -> FilmMemoryRows:
        """Return room for so many."""
        return cls(np.zeros(count, np.int64), np.zeros(count), np.zeros(count), np.zeros((count, 3)))

    def first(self, count: int) -> FilmMemory | None:
        """Return copies of the first of them; None for none."""
        key, force, distance, stretch = self.key, self.normal_force, self.distance, self.stretch
        rows = key[:count].copy(), force[:count].copy(), distance[:count].copy(), stretch[:count].copy()
        return FilmMemory(*rows) if count else None


class PairRows(NamedTuple):
    """Points of the film and the triangles they may press on in one step, for kernels.

    Args:
        nodes: (k, 6), three of the point (unused ones have weight 0), three of the triangle.
        weights: (k, 3) of the point.
        stiffness: (k,) [N/m].
        friction: (k,) [N], largest friction force.
        foot: (k, 3) weights of the point's foot on the triangle at the start of the step.
        normal: (k, 3) of the triangle then.
        stretch: (k, 3) [m], of the stick springs then, world.
        widths: (2,) [m], of the law's transitions: pressing, sticking.
        out: (k, 5), filled with normal force [N], distance [m], and the force on the point (3,) [N].
    """

    nodes: IndexTable
    weights: Matrix
    stiffness: Vector
    friction: Vector
    foot: Matrix
    normal: Matrix
    stretch: Matrix
    widths: Vector
    out: Matrix

    @classmethod
    def room(cls, count: int, widths: Array) -> PairRows:
        """Return room for so many pairs, by a law of such widths."""
        numbers = np.empty((count, 3)), np.empty(count), np.empty(count), np.empty((count, 3))
        rest = np.empty((count, 3)), np.empty((count, 3)), widths, np.empty((count, 5))
        return cls(np.empty((count, 6), np.int64), *numbers, *rest)

    def first(self, count: int) -> PairRows:
        """Return copies of the first of the rows, with room for what they answer."""
        return PairRows(
            self.nodes[:count].copy(), self.weights[:count].copy(), self.stiffness[:count].copy(),
            self.friction[:count].copy(), self.foot[:count].copy(), self.normal[:count].copy(),
            self.stretch[:count].copy(), self.widths, np.empty((count, 5)),
        )  # fmt: skip
