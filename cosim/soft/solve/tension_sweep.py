"""Sweeps of cable tensions along straight lines, on which Brent's method finds a height of the tip.

Every trial between two states is followed from the first of them. If the height jumps instead of crossing the
target, the arm snaps.
Source: Brent, Algorithms for Minimization without Derivatives, chapter 4.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import ConvergenceError
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tip_search import Follower
from cosim.soft.solve.tip_target import TipTarget

_FIRST_STEP = 0.005  # fraction of the line
_LEAST_STEP = 0.0005
_LARGEST_STEP = 0.05
_FAR = 0.05  # motion of the tip, over the length from flange to tip, above which a step is halved
_LITTLE = 0.0125  # the same, below which the next step is doubled
_LINE_MAX = 800  # Newton iterations on one line: a slack arm may buckle at each step
_NO_INFLUENCE = 1e-3  # influence over that of the most influential cable


@final
@dataclass(frozen=True)
class PullLine:
    """A straight line of tensions from the present ones.

    Args:
        what: description for messages.
        end_N: (cables,) [N], at the line's end.
    """

    what: str
    end_N: Array


@final
@dataclass(frozen=True)
class _SweepPoint:
    """A state of a sweep.

    Args:
        fraction: of the line.
        equilibrium: with these tensions.
        tip: (3,) [m], its tip.
    """

    fraction: float
    equilibrium: Equilibrium
    tip: Array


def pull_lines(follower: Follower, begin: Equilibrium, tension_max_N: float) -> list[PullLine]:
    """Return the lines to sweep: all cables pulled, all released, and each influential cable pulled alone.

    Args:
        follower: of equilibria.
        begin: present equilibrium.
        tension_max_N: largest tension.
    """
    present_N = np.array(begin.loads.cable_tension_N)
    if not len(present_N):
        return []
    lines = [PullLine("pulling all cables", present_N + max(tension_max_N - present_N.max(), 0.0))]
    if present_N.any():
        lines.append(PullLine("releasing all cables", np.zeros(len(present_N))))
    try:
        influence = np.linalg.norm(follower.sensitivity(begin).to_tension()[:3], axis=0)
    except ConvergenceError:
        influence = np.ones(len(present_N))
    for k in np.flatnonzero(influence > _NO_INFLUENCE * influence.max()) if len(present_N) > 1 else ():
        end = present_N.copy()
        end[k] = max(tension_max_N, present_N[k])
        lines.append(PullLine(f"pulling cable {k + 1} alone", end))
    return lines


@final
class TensionSweep:
    """A sweep along one line; `lost` is the error that ended it early, empty for none.

    Args:
        follower: of equilibria.
        begin: present equilibrium.
        line: of tensions.
        target: of the tip.
    """

    def __init__(self, follower: Follower, begin: Equilibrium, line: PullLine, target: TipTarget) -> None:
        self._follower, self._line, self._target = follower, line, target
        self._first = self._point(0.0, begin)
        self._points = [self._first]
        self.lost = ""
        self._jumps: list[tuple[_SweepPoint, _SweepPoint]] = []

    @property
    def nearest(self) -> Equilibrium:
        """The state whose tip is nearest to the target."""
        return min(self._points, key=self._missing).equilibrium

    @property
    def walked(self) -> bool:
        """Whether the sweep has reached another state than the first."""
        return len(self._points) > 1

    @property
    def heights(self) -> tuple[float, float]:
        """The lowest and highest height of the tip [m]."""
        heights = [_height(point) for point in self._points]
        return min(heights), max(heights)

    def crossings(self, tolerance_m: float) -> Iterator[Equilibrium]:
        """Sweep the line; yield the equilibria on it with the target's height."""
        for before, after in self._steps():
            if self._target.height is None:
                continue
            heights_above = [point.tip[2] - self._target.height for point in (before, after)]
            if heights_above[0] * heights_above[1] <= 0.0:
                crossing = self._between(before, after, 0.5 * tolerance_m)
                if crossing is not None:
                    yield crossing

    def describe(self) -> str:
        """Return the heights that were reached, for a message."""
        low, high = (pick(self._points, key=_height) for pick in (min, max))
        ends = [tensions_text(point.equilibrium) for point in (self._first, self._points[-1])]
        text = (
            f"{self._line.what} from {ends[0]} to {ends[1]}: from {_height(low):.4f} m at "
            f"{tensions_text(low.equilibrium)} to {_height(high):.4f} m at {tensions_text(high.equilibrium)}"
        )
        for before, after in self._jumps:
            heights = f"{_height(before):.4f} to {_height(after):.4f} m"
            text += f", with a snap from {heights} at {tensions_text(after.equilibrium)}"
        return text + (f", beyond which {self.lost}" if self.lost else "")

    def _steps(self) -> Iterator[tuple[_SweepPoint, _SweepPoint]]:
        """Yield pairs of neighbouring states, until the line ends or the equilibrium is lost."""
        length = np.linalg.norm(self._first.tip - self._first.equilibrium.world_from_flange.translation)
        point, step, iterations = self._first, _FIRST_STEP, 0
        while point.fraction < 1.0:
            if iterations > _LINE_MAX:
                self.lost = f"this pull was given up after {iterations} Newton iterations (bound {_LINE_MAX})"
                return
            try:
                next_point = self._followed(point, min(1.0, point.fraction + step))
            except ConvergenceError as error:
                self.lost = str(error)
                return
            iterations += next_point.equilibrium.iterations
            motion_m = float(np.linalg.norm(next_point.tip - point.tip))
            snapped = (
                next_point.equilibrium.branchings or next_point.equilibrium.slides
            )  # a shorter step does not avoid it
            if motion_m > _FAR * length and step > _LEAST_STEP and not snapped:
                step *= 0.5
                continue
            self._points.append(next_point)
            yield point, next_point
            point, step = next_point, min(_LARGEST_STEP, 2.0 * step) if motion_m < _LITTLE * length else step

    def _between(self, before: _SweepPoint, after: _SweepPoint, tolerance_m: float) -> Equilibrium | None:
        """Return the state between two with the target's height; None if the height jumps over it."""
        from scipy.optimize import brentq  # imported here because it takes long to load

        by_sign = {np.sign(self._over(point)): point for point in (after, before)}

        def over(fraction: float) -> float:
            point = before if fraction == before.fraction else self._followed(before, fraction)
            difference = self._over(point)
            by_sign[np.sign(difference)] = point
            return 0.0 if abs(difference) <= tolerance_m else difference

        try:
            fraction = brentq(over, before.fraction, after.fraction, xtol=1e-9)
            crossing = self._followed(before, fraction)
        except ConvergenceError as error:
            self.lost = str(error)
            return None
        if abs(self._over(crossing)) <= 2.0 * tolerance_m:
            return crossing.equilibrium
        self._jumps.append((by_sign[np.sign(self._over(before))], by_sign[np.sign(self._over(after))]))
        return None

    def _followed(self, begin: _SweepPoint, fraction: float) -> _SweepPoint:
        start = np.array(self._first.equilibrium.loads.cable_tension_N)
        tension = tuple(((1.0 - fraction) * start + fraction * self._line.end_N).tolist())
        loads = replace(begin.equilibrium.loads, cable_tension_N=tension)
        return self._point(
            fraction, self._follower.follow(begin.equilibrium, begin.equilibrium.world_from_flange, loads)
        )

    def _point(self, fraction: float, equilibrium: Equilibrium) -> _SweepPoint:
        return _SweepPoint(
            fraction, equilibrium, self._follower.body.tip_position(equilibrium.state.positions)
        )

    def _over(self, point: _SweepPoint) -> float:
        assert self._target.height is not None
        return float(point.tip[2] - self._target.height)

    def _missing(self, point: _SweepPoint) -> float:
        if self._target.position is None:
            return 0.0 if self._target.height is None else abs(self._over(point))
        return float(np.linalg.norm(point.tip - self._target.position))


def _height(point: _SweepPoint) -> float:
    return float(point.tip[2])


def tensions_text(equilibrium: Equilibrium) -> str:
    """Return an equilibrium's cable tensions, for a message."""
    return f"{np.round(equilibrium.loads.cable_tension_N, 2).tolist()} N"
