"""What contacts between films carry from one state to the next, and report of the last step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.base.kernels import IndexTable, Matrix, Vector


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
        return float(self.normal_force.sum())

    @property
    def depth_m(self) -> float:
        """How deep the deepest point is behind the other film [m]; negative while none is."""
        return -float(self.distance.min(initial=0.0)) if self.count else 0.0

    def carried(self, motion: Pose) -> FilmMemory:
        """Return the memory moved rigidly by `motion` (world to world)."""
        return FilmMemory(self.key, self.normal_force, self.distance, self.stretch @ motion.rotation.T)

    def recall(self, key: IntArray) -> tuple[Array, Array]:
        """Return normal force (k,) [N] and stretch (k, 3) [m] of pairs by key; zero where there is none."""
        force, stretch = np.zeros(len(key)), np.zeros((len(key), 3))
        at = np.searchsorted(self.key, key)
        inside = np.flatnonzero(at < len(self.key))
        here = inside[self.key[at[inside]] == key[inside]]
        force[here], stretch[here] = self.normal_force[at[here]], self.stretch[at[here]]
        return force, stretch


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

    def of(self, places: IntArray) -> PairRows:
        """Return some of the rows, by their places (j,)."""
        return PairRows(
            self.nodes[places], self.weights[places], self.stiffness[places], self.friction[places],
            self.foot[places], self.normal[places], self.stretch[places], self.widths, self.out[places],
        )  # fmt: skip
