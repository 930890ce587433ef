"""Records of a solved state: bifurcations, stability and overlaps; apart, so that reports load no kernels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

from cosim.base.frames import Array

WHOLE: Final = 0.2
"""Extent of a motion above which more than a wrinkle moves."""
UNDECIDED: Final = "nothing decides on the side: rounding does"
LEFT: Final = "leaves it all at once: it snaps, or nothing has decided on the side, and rounding does"
IN_TIME: Final = UNDECIDED, LEFT
"""Reasons why a run in time follows a branch."""


@final
@dataclass(frozen=True)
class Branching:
    """A bifurcation or snap: the end of a branch of stable equilibria, and how it was continued.

    Args:
        load_factor: at the end of the branch, relative to the commanded loads; bisected to 1 %.
        pressure_Pa: gauge pressure there, of each chamber.
        cable_tension_N: of each cable there.
        place: node that moves most along the instability, and its ring.
        direction: (x, y, z), unit vector of that motion, world axes; its largest component is positive.
        extent: root mean square of that motion over the nodes, relative to the largest: near 1 if the whole
            body moves, near 0 for a wrinkle.
        ways: independent directions in which the potential falls.
        tip_m: (x, y, z), of the chosen branch; None if not known.
        other_tip_m: of the branch on the other side, under the same loads; None if none was found.
        chosen: why that branch; in a run in time `UNDECIDED` at an unstable equilibrium, `LEFT` on the way
            from one.
        snap: whether no other branch is near, so that the body snaps to a far state; then `place`,
            `direction` and `extent` are of that motion, and `other_tip_m` is at its start.
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
"""Number of natural frequencies in a `StabilityReport`."""
DISTURBED: Final = 1e-6
"""Relative disturbance of the load on each node in a `StabilityReport`."""
_MOVES_m, _NEAR = 1e-3, 0.05


@final
@dataclass(frozen=True)
class StabilityReport:
    """Stability of a soft robot at the end of a phase, as if it was at rest there with its flange held.

    Args:
        lowest_frequency_Hz: natural frequency; None if it is unstable, or has nodes without mass.
        disturbed_tip_m: motion of the tip if the load on each node is off by a millionth of its size, all in
            the direction that moves the tip most; infinite if it is unstable.
        load_margin: relative growth (below 0: decrease) of all loads at which it becomes unstable, if its
            lowest stiffness (for a snap, the square of it) continues to change at the present rate; infinite
            if beyond 1.
        snaps: whether it snaps at that load, as the loads drive the lowest mode; otherwise it bifurcates.
        losses_held: whether loads have no potential, so that the report is for the symmetric part of the
            tangent, with frozen losses along cables.
        unstable: the instability; None if it is stable, or if not known, as loads have no potential.
        rests_at_m: (x, y, z), tip of the stable equilibrium that it slides to, computed if rounding has
            chosen a side; None if not computed, or not found.
        frequencies_Hz: natural frequencies, lowest first, up to `MODES`; without losses.
        losses_per_s: loss rate of the materials for each; the mode decays at half of it.
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
        """Return the verdict in words; if it is not "stable", the state does not depend on the loads alone.

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
    """An overlap of films with one another or with the arm, whose contact is not modelled.

    Args:
        depth_m: of the deepest point behind the other film; overlaps deeper than 5 mm (20 mm for another
            arm's films) are not found. In a link: of the deepest node.
        place: node nearest to it, and its ring.
        link: of the arm that the film is in; None for an overlap of films.
        arm: owner of the other film; None for the same robot.
    """

    depth_m: float
    place: str
    link: str | None = None
    arm: str | None = None


@final
@dataclass(frozen=True)
class LowestMode:
    """The lowest eigenvalue of K v = e W v.

    Args:
        value: e; of weight 1 in N/m.
        mode: (n, 3), v; its largest component is 1.
        place: node that moves most, and its ring, for messages.
        values: (k,), the lowest eigenvalues, this one first.
        shapes: (k, n, 3), their v.
    """

    value: float
    mode: Array
    place: str
    values: tuple[float, ...] = ()
    shapes: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector of the motion of the node that moves most; its largest component is positive."""
        largest_motion = self.mode[int(np.argmax(self.mode.max(axis=1)))]
        x, y, z = (largest_motion / np.linalg.norm(largest_motion)).tolist()
        return x, y, z

    @property
    def extent(self) -> float:
        """Root mean square of the nodes' motion, of the largest component."""
        return math.sqrt(float((self.mode**2).sum(axis=1).mean()))
