"""What a run finds of a state that solves its equations: how firmly it stands, or films in one another.

In a file by itself, as who reports on it loads no kernels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

WHOLE: Final = 0.2
"""Extent of a motion from which on more than a wrinkle moves."""
UNDECIDED: Final = "nothing decides on the side: rounding does"
LEFT: Final = "leaves it all at once: it snaps, or nothing has decided on the side, and rounding does"
IN_TIME: Final = UNDECIDED, LEFT
"""Why a run in time takes a branch."""


@final
@dataclass(frozen=True)
class Branching:
    """Where a branch of stable equilibria ends in an unstable one, and how it was continued.

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
        chosen: why that branch; in a run in time `UNDECIDED` if it is at an unstable equilibrium,
            `LEFT` if it is seen on its way from one.
        snap: whether the branch ends without another one beside it, so that the body snaps to a far state;
            `place`, `direction` and `extent` are of that motion, `other_tip_m` is from where.
        losses_held: see `StabilityReport`.
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
    snap: bool = False
    losses_held: bool = False


MODES: Final = 4
"""How many natural frequencies a look finds."""
DISTURBED: Final = 1e-6
"""Of the load on each node, by how much it may be off in a `StabilityReport`."""
_MOVES_m, _NEAR = 1e-3, 0.05


@final
@dataclass(frozen=True)
class StabilityReport:
    """How firmly a soft robot stands at the end of a phase, as if it was at rest there with its flange held.

    Args:
        lowest_frequency_Hz: natural frequency; None where it is unstable, or has nodes without mass.
        disturbed_tip_m: how far the tip moves if the load on each node is off by a millionth of its size, all
            of them in the one direction that moves it most; infinite where it is unstable.
        load_margin: by what share all loads may grow, or fall (below 0), until it is no longer stable, if its
            lowest stiffness (where it snaps, the square of that) continues to change as it does; infinite
            where that is not within 1.
        snaps: whether it is the loads that move it there: it snaps. Else it branches.
        losses_held: whether loads have no potential, so that this is of the symmetric part of its tangent,
            with the losses along cables held.
        unstable: in which direction it would give way; None where it is stable, or where that is not
            known, as loads have no potential.
        rests_at_m: (x, y, z), tip of the stable equilibrium that it slides to from there, looked for where
            rounding has decided on a side; None: not looked for, or none was found.
        frequencies_Hz: natural frequencies, lowest first, up to `MODES`; without losses.
        losses_per_s: of each, the rate of which its materials' losses let it decay at half.
    """

    lowest_frequency_Hz: float | None
    disturbed_tip_m: float
    load_margin: float
    snaps: bool = False
    losses_held: bool = False
    unstable: Branching | None = None
    rests_at_m: tuple[float, float, float] | None = None
    frequencies_Hz: tuple[float, ...] = ()
    losses_per_s: tuple[float, ...] = ()

    def stability(self, passed: Sequence[tuple[float, bool]]) -> str:
        """Return it in words: which figures of the state are no matter of its loads alone.

        Args:
            passed: extent of each branching of the phase, and whether it is a snap.
        """
        large = [snap for extent, snap in passed if extent >= WHOLE]
        if self.unstable is not None:
            return "unstable"
        if not math.isfinite(self.disturbed_tip_m):
            return "undetermined"
        if self.disturbed_tip_m >= _MOVES_m:
            return "near neutral"
        if abs(self.load_margin) < _NEAR:
            return "near a snap" if self.snaps else "near a branching"
        return ("after a snap" if large[-1] else "after a branching") if large else "stable"


@final
@dataclass(frozen=True)
class FilmOverlap:
    """Where films whose contact is not modelled have passed through one another, or into the arm.

    Args:
        depth_m: of the deepest point behind the other film; what is deeper than 5 mm is not found, in films
            of another arm than 20 mm. In a link: of the deepest node.
        place: node nearest to it, and its ring.
        link: of the arm that the film is in; None where films are in one another.
        arm: whose films the film is in; None where they are its own.
    """

    depth_m: float
    place: str
    link: str | None = None
    arm: str | None = None
