"""Searches flange poses and cable tensions that bring the tip to a target.

Gauss-Newton on the deformed tip's pose. What follows equilibria and knows how their tip moves is the film
itself, or a model in its place.

A step solves the linear model J change = missing within a bound. It is taken when the equilibrium it leads to
is stable and brings the tip nearer by at least a tenth of what the linear model promised; else it is cut to a
quarter. The bound of the next step follows from how well the model foretold the last one.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 4.1 and 10.3.

Moving the flange by a translation d and a rotation w (world axes, about its origin o) carries the tip p
rigidly and turns gravity by -w seen from the flange:
    dp = d + w x (p - o) + (dp/dgravity) (gravity x w)     (both with w also turned on the direction).
Source: implicit function theorem; DESIGN section 4 for the exact tangent.

Cable tensions, while the flange stays: Gauss-Newton first. Where it ends before the target, the cables are
pulled along straight lines of tension from the present state on, and a height is looked for between any two
states that have it between them.

Between two states that have the wanted height between them it is found by Brent's method, each trial
followed from the first of the two. Where the height jumps instead, the arm snaps.
Source: Brent, Algorithms for Minimization without Derivatives, chapter 4.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix, rotation_from_vector
from cosim.errors import ConvergenceError, OutOfRangeError, UnreachableError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.sensitivity import Sensitivity
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tip_target import TargetOptions, TargetSolution, TipTarget


class TipSensitivity(Protocol):
    """How a tip moves: see `cosim.soft.solve.sensitivity.Sensitivity`."""

    tip: TipFrame

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3); the flange stays."""

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables); the flange stays."""


class Follower(Protocol):
    """What follows equilibria of a body and knows how its tip moves, by whatever model."""

    @property
    def body(self) -> SoftBody:
        """Whose tip it is."""

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads."""

    def sensitivity(self, here: Equilibrium) -> TipSensitivity:
        """Return how the tip moves at an equilibrium.

        Raises:
            ConvergenceError: it is not stable there.
        """


@final
class _FilmFollower:
    """The film itself."""

    def __init__(self, solver: EquilibriumSolver) -> None:
        self.follow = solver.follow
        self._solver = solver.solver

    @property
    def body(self) -> SoftBody:
        """Whose tip it is."""
        return self._solver.film.body

    def sensitivity(self, here: Equilibrium) -> Sensitivity:
        """Return how the tip moves at an equilibrium."""
        return Sensitivity(self._solver, here)


def follower_of(solver: EquilibriumSolver | Follower) -> Follower:
    """Return what follows the equilibria of a solver, or what already does."""
    return _FilmFollower(solver) if isinstance(solver, EquilibriumSolver) else solver


_ACCEPTED = 0.1  # share of the promised gain
_WELL_FORETOLD = 0.75
_CUT = 0.25
_LEAST_PROMISE = 1e-3  # of the distance; what promises less is not worth an equilibrium

_Linear: TypeAlias = tuple[Array, Array]
"""J (m, k) and what is missing (m,) [m], angles times the lever."""


class Unknowns(Protocol):
    """What is changed to bring the tip to its target."""

    def jacobian(self, here: Equilibrium) -> tuple[TipFrame, Array]:
        """Return the tip and d(tip motion)/d(unknowns) (6, k).

        Raises:
            ConvergenceError: the equilibrium is not stable.
        """

    def step(self, here: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        """Return the change (k,) of size `bound` at most that makes matrix change nearest to missing."""

    def size(self, change: Array) -> float:
        """Return the size of a change (k,); 1 for the largest that is ever tried in one step."""

    def moved(self, here: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        """Return pose and loads after a change (k,)."""


@final
@dataclass(frozen=True)
class Ended:
    """Where a search ended.

    Args:
        nearest: the solution, or the nearest to one.
        why_not: what ended the search before the target; empty for a solution.
    """

    nearest: TargetSolution
    why_not: str


@final
class TipSearch:
    """A search for the unknowns that bring the tip to a target.

    Args:
        follower: of equilibria.
        target: of the tip, world.
        options: bounds.
        unknowns: what is changed.
    """

    def __init__(
        self, follower: Follower, target: TipTarget, options: TargetOptions, unknowns: Unknowns
    ) -> None:
        self._follower, self._target = follower, target
        self._options, self._unknowns = options, unknowns

    def run(self, begin: Equilibrium) -> Ended:
        """Search from an equilibrium on.

        Where cables remember which way they have slid, a trial is followed from there: as a run comes to it.
        """
        here, rounds, bound = self.reached(begin, 0), 1, 1.0
        slides = any(cable.remembers for cable in self._follower.body.cables)
        if self._options.met(here):
            return Ended(here, "")
        try:
            matrix, missing = self._linear(begin)
        except ConvergenceError as error:
            return Ended(here, str(error))
        why_not = left = ""
        while True:
            change = self._unknowns.step(here.equilibrium, matrix, missing, bound)
            distance = float(np.linalg.norm(missing))
            promised = distance - float(np.linalg.norm(missing - matrix @ change))
            if not promised > _LEAST_PROMISE * distance:
                return Ended(here, why_not or "no small change brings it nearer")
            try:
                moved = self._unknowns.moved(here.equilibrium, change)
                from_here = begin if slides else here.equilibrium
                there = self.reached(self._follower.follow(from_here, *moved), rounds)
                if self._options.met(there):
                    return Ended(there, "")
                gain = (distance - self._distance(there)) / promised
                if gain >= _ACCEPTED and rounds < self._options.iterations_max:
                    matrix, missing = self._linear(there.equilibrium)
            except ConvergenceError as error:
                why_not, gain = f"beyond it {error}", -np.inf
                if isinstance(error, OutOfRangeError):
                    left = f"; on the way {error.place}; fidelity = 'lumped' has no such end"
            if gain < _ACCEPTED:
                bound = _CUT * min(bound, self._unknowns.size(change))
                continue
            if rounds == self._options.iterations_max:
                return Ended(there, f"the limit of {rounds} iterations was reached{left}")
            here, rounds, why_not = there, rounds + 1, ""
            bound = min(1.0, 2.0 * bound) if gain > _WELL_FORETOLD else bound

    def reached(self, here: Equilibrium, rounds: int) -> TargetSolution:
        """Return how far off an equilibrium's tip is after some rounds of a search."""
        tip = TipFrame.of(self._follower.body, here.state.positions)
        return TargetSolution(here, *self._target.distance(tip), rounds)

    def _distance(self, found: TargetSolution) -> float:
        return float(np.hypot(found.position_error_m, self._options.lever_m * found.angle_error_rad))

    def _linear(self, here: Equilibrium) -> _Linear:
        tip, jacobian = self._unknowns.jacobian(here)
        rows, missing = self._target.error(tip)
        weight = np.where(rows[:, :3].any(axis=1), 1.0, self._options.lever_m)
        return weight[:, None] * (rows @ jacobian), weight * missing


_LARGEST_TURN_RAD = 0.8
_LARGEST_SHIFT_M = 5.0  # a shift hardly bends the law: only a search that is held back feels it


@final
@dataclass(frozen=True)
class _FlangeMotion:
    """A small motion of the flange (6,): translation [m] and rotation [rad], world axes."""

    follower: Follower
    lever_m: float

    def jacobian(self, here: Equilibrium) -> tuple[TipFrame, Array]:
        sensitivity = self.follower.sensitivity(here)
        tip = sensitivity.tip
        gravity = np.array(here.loads.gravity)
        motion = np.eye(6)
        motion[:3, 3:] = -cross_matrix(tip.position - here.world_from_flange.translation)
        motion[:, 3:] += sensitivity.to_gravity() @ cross_matrix(gravity)
        return tip, motion

    def step(self, here: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        scale = np.array([1.0, 1.0, 1.0, *([1.0 / self.lever_m] * 3)])
        change = scale * np.linalg.lstsq(matrix * scale, missing, rcond=1e-9)[0]
        return np.asarray(change * min(1.0, bound / max(self.size(change), 1e-12)))

    def size(self, change: Array) -> float:
        shift, turn = float(np.linalg.norm(change[:3])), float(np.linalg.norm(change[3:]))
        return max(shift / _LARGEST_SHIFT_M, turn / _LARGEST_TURN_RAD)

    def moved(self, here: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        pose = here.world_from_flange
        turned = rotation_from_vector(change[3:]) @ pose.rotation
        return Pose(turned, pose.translation + change[:3]), here.loads


def find_flange_pose(
    solver: EquilibriumSolver | Follower,
    begin: Equilibrium,
    target: TipTarget,
    options: TargetOptions | None = None,
) -> TargetSolution:
    """Find the flange pose for which the deformed tip meets the target; loads stay.

    Args:
        solver: follows equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world.
        options: bounds.

    Raises:
        UnreachableError: not found; `closest` is the best TargetSolution.
    """
    options, follower = options or TargetOptions(), follower_of(solver)
    ended = TipSearch(follower, target, options, _FlangeMotion(follower, options.lever_m)).run(begin)
    if not ended.why_not:
        return ended.nearest
    nearest = ended.nearest
    place = np.round(nearest.equilibrium.world_from_flange.translation, 4).tolist()
    raise UnreachableError(
        f"no flange pose found that brings the tip to the target; the nearest, after {nearest.iterations} "
        f"iterations, is {nearest.off()} off, with the flange at {place} m: {ended.why_not}",
        nearest,
    )


_FIRST_STEP = 0.005  # of the largest tension
_LEAST_STEP = 0.0005
_LARGEST_STEP = 0.05
_FAR = 0.05  # of the length from flange to tip: a step that moves the tip farther is halved
_LITTLE = 0.0125  # the next one is twice as long
_LINE_MAX = 800  # Newton iterations on one line: a limp arm gives way at each step
_NO_INFLUENCE = 1e-3  # of the most influential cable


@final
@dataclass(frozen=True)
class PullLine:
    """Where the tensions go from the present ones.

    Args:
        what: is done to the cables, for messages.
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
        here: the equilibrium.
        tip: (3,) [m], its tip.
    """

    fraction: float
    here: Equilibrium
    tip: Array


def pull_lines(follower: Follower, begin: Equilibrium, tension_max_N: float) -> list[PullLine]:
    """Return the lines worth a sweep: all cables pulled, all released, each cable that moves the tip alone.

    Args:
        follower: of equilibria.
        begin: present equilibrium.
        tension_max_N: largest tension.
    """
    now = np.array(begin.loads.cable_tension_N)
    if not len(now):
        return []
    lines = [PullLine("pulling all cables", now + max(tension_max_N - now.max(), 0.0))]
    if now.any():
        lines.append(PullLine("releasing all cables", np.zeros(len(now))))
    try:
        influence = np.linalg.norm(follower.sensitivity(begin).to_tension()[:3], axis=0)
    except ConvergenceError:
        influence = np.ones(len(now))
    for k in np.flatnonzero(influence > _NO_INFLUENCE * influence.max()) if len(now) > 1 else ():
        end = now.copy()
        end[k] = max(tension_max_N, now[k])
        lines.append(PullLine(f"pulling cable {k + 1} alone", end))
    return lines


@final
class TensionSweep:
    """What a pull along one line gave; `lost` says what ended it before the line's end, empty for nothing.

    Args:
        follower: of equilibria.
        begin: present equilibrium.
        line: of tensions.
        target: of the tip.
    """

    def __init__(self, follower: Follower, begin: Equilibrium, line: PullLine, target: TipTarget) -> None:
        self._follower, self._line, self._target = follower, line, target
        self._first = self._place(0.0, begin)
        self._places = [self._first]
        self.lost = ""
        self._jumps: list[tuple[_SweepPoint, _SweepPoint]] = []

    @property
    def nearest(self) -> Equilibrium:
        """The state whose tip is nearest to the target."""
        return min(self._places, key=self._missing).here

    @property
    def walked(self) -> bool:
        """Whether there is a state beside the present one on the line."""
        return len(self._places) > 1

    @property
    def heights(self) -> tuple[float, float]:
        """The lowest and the highest that the tip had [m]."""
        found = [_height(place) for place in self._places]
        return min(found), max(found)

    def crossings(self, tolerance_m: float) -> Iterator[Equilibrium]:
        """Walk along the line; yield the equilibria on it that have the wanted height."""
        for before, after in self._steps():
            if self._target.height is None:
                continue
            over = [place.tip[2] - self._target.height for place in (before, after)]
            if over[0] * over[1] <= 0.0:
                found = self._between(before, after, 0.5 * tolerance_m)
                if found is not None:
                    yield found

    def told(self) -> str:
        """Return what heights were reached, for a message."""
        low, high = (pick(self._places, key=_height) for pick in (min, max))
        ends = [tensions_text(place.here) for place in (self._first, self._places[-1])]
        text = (
            f"{self._line.what} from {ends[0]} to {ends[1]}: from {_height(low):.4f} m at "
            f"{tensions_text(low.here)} to {_height(high):.4f} m at {tensions_text(high.here)}"
        )
        for before, after in self._jumps:
            heights = f"{_height(before):.4f} to {_height(after):.4f} m"
            text += f", with a snap from {heights} at {tensions_text(after.here)}"
        return text + (f", beyond which {self.lost}" if self.lost else "")

    def _steps(self) -> Iterator[tuple[_SweepPoint, _SweepPoint]]:
        """Yield every two neighbouring states, until the line ends or the equilibrium is lost."""
        length = np.linalg.norm(self._first.tip - self._first.here.world_from_flange.translation)
        here, step, spent = self._first, _FIRST_STEP, 0
        while here.fraction < 1.0:
            if spent > _LINE_MAX:
                self.lost = f"this pull was given up after {spent} Newton iterations (bound {_LINE_MAX})"
                return
            try:
                there = self._followed(here, min(1.0, here.fraction + step))
            except ConvergenceError as error:
                self.lost = str(error)
                return
            spent += there.here.iterations
            moved = float(np.linalg.norm(there.tip - here.tip))
            snapped = there.here.branchings or there.here.slides  # which no shorter step avoids
            if moved > _FAR * length and step > _LEAST_STEP and not snapped:
                step *= 0.5
                continue
            self._places.append(there)
            yield here, there
            here, step = there, min(_LARGEST_STEP, 2.0 * step) if moved < _LITTLE * length else step

    def _between(self, before: _SweepPoint, after: _SweepPoint, tolerance_m: float) -> Equilibrium | None:
        """Return the state between two that has the wanted height; None where it jumps over it."""
        from scipy.optimize import brentq  # here: it takes long to load

        sides = {np.sign(self._over(place)): place for place in (after, before)}

        def over(fraction: float) -> float:
            place = before if fraction == before.fraction else self._followed(before, fraction)
            difference = self._over(place)
            sides[np.sign(difference)] = place
            return 0.0 if abs(difference) <= tolerance_m else difference

        try:
            fraction = brentq(over, before.fraction, after.fraction, xtol=1e-9)
            found = self._followed(before, fraction)
        except ConvergenceError as error:
            self.lost = str(error)
            return None
        if abs(self._over(found)) <= 2.0 * tolerance_m:
            return found.here
        self._jumps.append((sides[np.sign(self._over(before))], sides[np.sign(self._over(after))]))
        return None

    def _followed(self, begin: _SweepPoint, fraction: float) -> _SweepPoint:
        start = np.array(self._first.here.loads.cable_tension_N)
        tension = tuple(((1.0 - fraction) * start + fraction * self._line.end_N).tolist())
        loads = replace(begin.here.loads, cable_tension_N=tension)
        return self._place(fraction, self._follower.follow(begin.here, begin.here.world_from_flange, loads))

    def _place(self, fraction: float, here: Equilibrium) -> _SweepPoint:
        return _SweepPoint(fraction, here, self._follower.body.tip_position(here.state.positions))

    def _over(self, place: _SweepPoint) -> float:
        assert self._target.height is not None
        return float(place.tip[2] - self._target.height)

    def _missing(self, place: _SweepPoint) -> float:
        if self._target.position is None:
            return 0.0 if self._target.height is None else abs(self._over(place))
        return float(np.linalg.norm(place.tip - self._target.position))


def _height(place: _SweepPoint) -> float:
    return float(place.tip[2])


def tensions_text(here: Equilibrium) -> str:
    """Return an equilibrium's cable tensions, for a message."""
    return f"{np.round(here.loads.cable_tension_N, 2).tolist()} N"


_LARGEST_CHANGE_N = 10.0


@final
@dataclass(frozen=True)
class _TensionChange:
    """A change of the cable tensions (cables,) [N] that leaves none negative."""

    follower: Follower
    tension_max_N: float

    def jacobian(self, here: Equilibrium) -> tuple[TipFrame, Array]:
        sensitivity = self.follower.sensitivity(here)
        return sensitivity.tip, sensitivity.to_tension()

    def step(self, here: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        from scipy.optimize import lsq_linear  # here: it takes long to load

        tension = np.array(here.loads.cable_tension_N)
        # a slight preference for the smallest change decides among equivalent tensions
        keep = 1e-6 * np.linalg.norm(matrix) * np.eye(len(tension))
        lower = np.maximum(-tension, -bound * _LARGEST_CHANGE_N)
        upper = np.minimum(np.maximum(self.tension_max_N - tension, 0.0), bound * _LARGEST_CHANGE_N)
        problem = np.concatenate([matrix, keep]), np.concatenate([missing, np.zeros(len(tension))])
        return np.asarray(lsq_linear(*problem, bounds=(lower - 1e-12, upper + 1e-12)).x)

    def size(self, change: Array) -> float:
        return float(np.abs(change).max(initial=0.0)) / _LARGEST_CHANGE_N

    def moved(self, here: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        pulled = np.maximum(np.array(here.loads.cable_tension_N) + change, 0.0)
        return here.world_from_flange, replace(here.loads, cable_tension_N=tuple(pulled.tolist()))


def find_tensions(
    solver: EquilibriumSolver | Follower,
    begin: Equilibrium,
    target: TipTarget,
    options: TargetOptions | None = None,
) -> TargetSolution:
    """Find the cable tensions, none negative, that bring the sagging tip to the target; the flange stays.

    Args:
        solver: follows equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world; a point or only a height.
        options: bounds.

    Raises:
        UnreachableError: not found; `closest` is the best TargetSolution, the message says what was reached.
    """
    options, follower = options or TargetOptions(), follower_of(solver)
    search = TipSearch(follower, target, options, _TensionChange(follower, options.tension_max_N))
    ended = search.run(begin)
    if not ended.why_not:
        return ended.nearest
    sweeps: list[TensionSweep] = []
    for line in pull_lines(follower, begin, options.tension_max_N):
        sweeps.append(TensionSweep(follower, begin, line, target))
        for found in sweeps[-1].crossings(options.position_tolerance_m):
            solution = search.reached(found, ended.nearest.iterations)
            if options.met(solution) and _stable(follower, found):
                return solution
    again = [search.run(sweep.nearest) for sweep in sweeps]
    ended = min([ended, *again], key=lambda each: each.nearest.position_error_m)
    if not ended.why_not:
        return ended.nearest
    raise UnreachableError(_refusal(ended, target, sweeps, options.tension_max_N), ended.nearest)


def tension_slope(solver: EquilibriumSolver | Follower, here: Equilibrium, target: TipTarget) -> float:
    """Return the largest change of a cable's tension that makes good for a tip that is off, J+ [N/m].

    J+ is the pseudoinverse of d(tip)/d(tensions), of what the target asks for, slack cables left out.

    Args:
        solver: of the body.
        here: on the target.
        target: of the tip.

    Raises:
        ConvergenceError: it is not stable there.
    """
    sensitivity = follower_of(solver).sensitivity(here)
    rows, _ = target.error(sensitivity.tip)
    pulled = np.array(here.loads.cable_tension_N) > 0.0
    if not pulled.any():
        return 0.0
    places = rows[rows[:, :3].any(axis=1)]
    back = np.linalg.pinv(places @ sensitivity.to_tension()[:, pulled])
    return float(np.linalg.norm(back, axis=1).max(initial=0.0))


def _stable(follower: Follower, here: Equilibrium) -> bool:
    try:
        follower.sensitivity(here)
    except ConvergenceError:
        return False
    return True


def _refusal(ended: Ended, target: TipTarget, sweeps: list[TensionSweep], tension_max_N: float) -> str:
    nearest = ended.nearest
    goal = "the target" if target.height is None else f"a height of {target.height:g} m"
    message = (
        f"no cable tensions of 0 to {tension_max_N:g} N found that bring the tip to {goal}; the nearest is "
        f"{nearest.off()} off at {tensions_text(nearest.equilibrium)}: {ended.why_not}"
    )
    if target.height is None:
        lost = dict.fromkeys(sweep.lost for sweep in sweeps if sweep.lost not in message)
        return "; ".join([message, *lost])
    walked = [sweep for sweep in sweeps if sweep.walked]
    heights = [height for sweep in walked for height in sweep.heights]
    if heights and not min(heights) <= target.height <= max(heights):
        message += f"; ask for a height that was reached, {min(heights):.4f} to {max(heights):.4f} m"
    return "; ".join([message, *(sweep.told() for sweep in walked)])
