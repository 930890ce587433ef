"""What a run finds wrong with a state that solves its equations: unstable, or with films in one another.

In a file by itself, as who reports on it loads no kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

WHOLE: Final = 0.2
"""Extent of a motion from which on more than a wrinkle moves."""
UNDECIDED: Final = "nothing decides on the side: rounding does"


@final
@dataclass(frozen=True)
class Branching:
    """Where a branch of stable equilibria ends in an unstable one, and how it was gone on.

    Args:
        load_factor: share of the way to the loads that were asked for, at which it lies; bisected to 1 %.
        pressure_Pa: gauge pressure there, of each chamber.
        cable_tension_N: of each cable there.
        place: node that moves most as the unstable one is left, and its ring.
        direction: (x, y, z), unit vector of that motion, world axes; its largest component is positive.
        extent: root mean square of that motion over the nodes, of the largest: towards 1 where the whole body
            moves, towards 0 in a wrinkle.
        ways: independent directions in which the potential falls.
        tip_m: (x, y, z), of the branch that was taken; None where none is known.
        other_tip_m: of the branch on the other side, under the same loads; None where none was found.
        chosen: why that branch; `UNDECIDED` in a run in time that is at an unstable equilibrium.
    """

    load_factor: float
    pressure_Pa: tuple[float, ...]
    cable_tension_N: tuple[float, ...]
    place: str
    direction: tuple[float, float, float]
    extent: float
    ways: int
    tip_m: tuple[float, float, float] | None
    other_tip_m: tuple[float, float, float] | None
    chosen: str


@final
@dataclass(frozen=True)
class FilmOverlap:
    """Where films whose contact is not modelled have passed through one another, or into the arm.

    Args:
        depth_m: of the deepest point behind the other film; what is deeper than 5 mm is not found. In a
            link: of the deepest node.
        place: node nearest to it, and its ring.
        link: of the arm that the film is in; None where films are in one another.
    """

    depth_m: float
    place: str
    link: str | None = None
