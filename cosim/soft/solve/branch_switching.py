"""Branch switching: stable equilibria in place of unstable ones, with a record of bifurcations and snaps."""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Final, Protocol, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import describe_largest
from cosim.soft.solve import newton_options, search_effort
from cosim.soft.solve.branching import Branching, LowestMode
from cosim.soft.solve.state import Equilibrium, SoftState

_PUSHES = 1e-3, 3e-3, 0.01, 0.02, 0.04, 0.08  # off an unstable equilibrium, in turn, over the body's size
_ALIKE = 0.2  # least ratio of the distances of both sides from it
_SADDLES_MAX = 3  # unstable equilibria on the way to a stable one
_FAR = 0.02  # root mean square of the nodes' motion, over the body's size
_WITHIN, _LEAST = 0.005, 0.05  # accuracy over the loads there; loads over the final ones, at least
_STILL = 1e-4  # motion of the flange that counts as none [m, rad]
SNAPS: Final = "nothing near is in balance beyond"
LOWER: Final = "what is near is stable as well, but has more energy"
_EQUAL = 1e-6  # difference of equal energies, over the fall from the unstable equilibrium
ON_PURPOSE: Final = "it is followed on purpose (solver.follow_unstable)"
NOWHERE: Final = "no stable equilibrium was found beside it"


class BranchFollower(Protocol):
    """Follows equilibria of a body; see `EquilibriumSolver`."""

    options: newton_options.NewtonOptions
    effort: search_effort.SearchEffort

    @property
    def body(self) -> SoftBody:
        """The body, on whose nodes results are given."""

    def lowest_mode(self, equilibrium: Equilibrium) -> LowestMode:
        """Return the lowest eigenvalue of the tangent stiffness at an equilibrium, and its mode."""

    def describe_instability(self, equilibrium: Equilibrium, lowest: LowestMode) -> Branching:
        """Return the description of an unstable equilibrium, with its lowest mode."""

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state without continuation."""

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads."""

    def slide(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Find the equilibrium that a damped body slides to."""


def switch_branch(follower: BranchFollower, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
    """Return a stable equilibrium in place of an unstable one; a stable one is returned unchanged.

    The end of the stable branch is bisected between `begin` and `found`; also if Newton's method met an
    indefinite tangent and ended far away, as rounding may then have chosen the side. From the unstable
    equilibrium there, the body is pushed along the lowest eigenvector of its tangent, to both sides, and
    slides to rest. The equilibrium of lower energy is chosen; of equal ones, the one in the direction whose
    largest component is positive. It is followed to the loads of `found`. A branch that is unstable at
    `begin` is followed as it is.

    Args:
        follower: of the body's equilibria; its options say whether branches are switched.
        begin: equilibrium from which `found` was followed; None for a first one.
        found: result.

    Raises:
        ConvergenceError: the search reached its bound of iterations.
    """
    if begin is not None and begin.negative_pivots:
        return found
    switches = follower.options.switches_branches
    if not found.negative_pivots and not (switches and begin is not None and _jumped(begin, found)):
        return found
    effort, goal = follower.effort, "a stable equilibrium beside an unstable one"
    with effort.search(goal) if found.negative_pivots else effort.search_apart(goal):
        fork = _Fork(1.0, found, found, 0) if begin is None else _fork(follower, begin, found)
        saddle, iterations = fork.saddle, found.iterations + fork.iterations
        if not saddle.negative_pivots:
            return _snapped(follower, fork, replace(found, iterations=iterations))
        lowest = follower.lowest_mode(saddle)
        ends = _sides(follower, saddle, lowest) if switches else []
        reason, *chosen_ends = _choice(saddle, ends) if switches else (ON_PURPOSE,)
        tips = [_tip(follower, end) for end in (*chosen_ends, None, None)]
        branching = replace(
            follower.describe_instability(saddle, lowest),
            load_factor=fork.load_factor,
            tip_m=tips[0],
            other_tip_m=tips[1],
            chosen=reason,
        )
        if not chosen_ends:
            return replace(_solve_again(follower, found), iterations=iterations, branchings=(branching,))
        followed = _follow_to(follower, fork.load_factor, chosen_ends[0], found)
        iterations += followed.iterations + sum(end.iterations for end in ends)
        return replace(followed, iterations=iterations, branchings=(branching, *followed.branchings))


@final
@dataclass(frozen=True)
class _Fork:
    """The end of a stable branch.

    Args:
        load_factor: of the end.
        before: the last stable equilibrium; an unstable one if none is known.
        saddle: the first equilibrium after it, unstable unless the body snaps to it.
        iterations: of the search.
    """

    load_factor: float
    before: Equilibrium
    saddle: Equilibrium
    iterations: int


def _fork(follower: BranchFollower, begin: Equilibrium, end: Equilibrium) -> _Fork:
    """Return the end of the stable branch between a stable equilibrium and another one, by bisection."""
    low, high, iterations = 0.0, 1.0, 0
    first, last, width = begin, end, _load_change(begin, end)
    # accuracy relative to the loads at the end of the branch, not to the final loads
    while (high - low) * width > _WITHIN * max(_LEAST, 1.0 - width * (1.0 - high)) and (
        last.negative_pivots or _jumped(first, last)
    ):
        middle = 0.5 * (low + high)
        pose = begin.world_from_flange.interpolated(end.world_from_flange, middle)
        loads = begin.loads.interpolated(end.loads, middle)
        guesses = [
            equilibrium.state.carried(pose @ equilibrium.world_from_flange.inverse())
            for equilibrium in (first, last)
        ]
        start = (
            0.5 * (guesses[0].positions + guesses[1].positions)
            if last.negative_pivots
            else guesses[0].positions
        )
        try:
            between = _solve_or_slide(follower, guesses[0], pose, loads, start)
        except ConvergenceError:
            break
        iterations += between.iterations
        beyond = not last.negative_pivots and _motion(first, between) > _motion(between, last)
        if between.negative_pivots or beyond:
            high, last = middle, between
        else:
            low, first = middle, between
    return _Fork(high, first, last, iterations)


def _snapped(follower: BranchFollower, fork: _Fork, result: Equilibrium) -> Equilibrium:
    """Return the equilibrium to which the body snaps; a near stable one if that has less energy."""
    before, after, reason = fork.before, fork.saddle, SNAPS
    if not _jumped(before, after):
        return replace(_solve_again(follower, result), iterations=result.iterations)
    state = before.state.carried(after.world_from_flange @ before.world_from_flange.inverse())
    try:
        near_branch = follower.solve(state, after.world_from_flange, after.loads)
    except ConvergenceError:
        near_branch = after
    result = replace(result, iterations=result.iterations + near_branch.iterations)
    if not near_branch.negative_pivots and _motion(near_branch, after) > _FAR * _size(before) > _motion(
        before, near_branch
    ):
        if near_branch.potential_J <= after.potential_J:
            followed = _follow_to(follower, fork.load_factor, near_branch, result)
            return replace(followed, iterations=followed.iterations + result.iterations)
        reason = LOWER
    solved_again, snap = _solve_again(follower, result), _snap(follower, fork, reason)
    return replace(solved_again, iterations=result.iterations, branchings=(snap,))


def _follow_to(
    follower: BranchFollower, load_factor: float, begin: Equilibrium, end: Equilibrium
) -> Equilibrium:
    """Return the equilibrium followed from a load factor to the end; load factors are of the whole way."""
    followed = follower.follow(begin, end.world_from_flange, end.loads)
    branchings = (
        replace(record, load_factor=load_factor + (1.0 - load_factor) * record.load_factor)
        for record in followed.branchings
    )
    return replace(followed, branchings=tuple(branchings))


def _snap(follower: BranchFollower, fork: _Fork, reason: str) -> Branching:
    """Return the record of a snap."""
    before, after = fork.before, fork.saddle
    carried = before.state.carried(after.world_from_flange @ before.world_from_flange.inverse())
    motion = after.state.positions - carried.positions
    farthest_node = int(np.argmax(np.linalg.norm(motion, axis=1)))
    mode = motion / np.abs(motion).max()
    place = describe_largest(follower.body, carried.positions, mode, np.ones(mode.shape, np.bool_))
    described = follower.describe_instability(replace(after, state=carried), LowestMode(0.0, mode, place))
    x, y, z = (motion[farthest_node] / np.linalg.norm(motion[farthest_node])).tolist()
    tips = [_tip(follower, end) for end in (after, before)]
    return replace(
        described, load_factor=fork.load_factor, direction=(x, y, z), tip_m=tips[0], other_tip_m=tips[1],
        chosen=reason, snap=True,
    )  # fmt: skip


def _solve_or_slide(
    follower: BranchFollower, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array
) -> Equilibrium:
    """Return the equilibrium near a state, or the one that it slides to, as beyond a limit point."""
    try:
        return follower.solve(state, world_from_flange, loads, start)
    except ConvergenceError:
        return follower.slide(state, world_from_flange, loads)


def _sides(follower: BranchFollower, saddle: Equilibrium, lowest: LowestMode) -> list[Equilibrium]:
    """Return the stable equilibria on both sides of an unstable one, at most two, that along its mode first.

    A body that is pushed to one side may come to rest on the other, or nearby, if wrinkles snap on the way.
    So larger pushes follow until there is one on either side, about equally far away.
    """
    ends = dict[float, Equilibrium]()
    for push, side in product(_PUSHES, (1.0, -1.0)):
        distances_m = [_motion(saddle, end) for end in ends.values()]
        enough = len(distances_m) == 2 and min(distances_m) > _ALIKE * max(distances_m)
        if (
            enough or 2 * follower.effort.spent > follower.effort.iterations_max
        ):  # the rest is for the continuation
            break
        end = _slide_from(follower, saddle, side * push * _size(saddle) * lowest.mode)
        if end is not None:
            end_side = math.copysign(1.0, _along(lowest.mode, saddle, end))
            ends[end_side] = max(
                ends.get(end_side, end), end, key=lambda candidate: _motion(saddle, candidate)
            )
    return [ends[end_side] for end_side in (1.0, -1.0) if end_side in ends]


def _slide_from(follower: BranchFollower, saddle: Equilibrium, push: Array) -> Equilibrium | None:
    """Return the stable equilibrium to which a pushed body slides; None if none is found.

    Args:
        follower: of equilibria of the body.
        saddle: where it starts.
        push: (n, 3) [m].
    """
    equilibrium, iterations = saddle, 0
    for _ in range(_SADDLES_MAX):
        pushed = SoftState.at_rest(equilibrium.state.positions + push, equilibrium.state.memory)
        try:
            equilibrium = follower.slide(pushed, saddle.world_from_flange, saddle.loads)
        except ConvergenceError:
            return None
        iterations += equilibrium.iterations
        if not equilibrium.negative_pivots:
            return replace(equilibrium, iterations=iterations)
        if _motion(saddle, equilibrium) < math.sqrt(float((push**2).sum(axis=1).mean())):  # it has slid back
            return None
        mode = follower.lowest_mode(equilibrium).mode
        push = math.copysign(float(np.abs(push).max()), _along(mode, saddle, equilibrium)) * mode
    return None


def _choice(saddle: Equilibrium, ends: list[Equilibrium]) -> tuple[str, *tuple[Equilibrium, ...]]:
    """Return the reason of the choice, the chosen equilibrium next to a saddle, and the other one.

    Args:
        saddle: that is left.
        ends: at most two, that in the positive direction first.
    """
    if not ends:
        return (NOWHERE,)
    if len(ends) == 1:
        return "none was found on the other side", ends[0]
    positive, negative = ends
    fall = saddle.potential_J - min(positive.potential_J, negative.potential_J)
    if abs(positive.potential_J - negative.potential_J) <= _EQUAL * fall:
        return "both have the same energy, this is the one in the positive direction", positive, negative
    return "it has the lower energy", *sorted(ends, key=lambda end: end.potential_J)


def _solve_again(follower: BranchFollower, known: Equilibrium) -> Equilibrium:
    """Solve a known equilibrium again, so that the solver holds its forces."""
    with follower.effort.search_apart("an equilibrium that is known"):
        solved_again = follower.solve(known.state, known.world_from_flange, known.loads)
    return replace(solved_again, slides=known.slides)


def _tip(follower: BranchFollower, end: Equilibrium | None) -> tuple[float, float, float] | None:
    body = follower.body
    if end is None or not len(body.tip):
        return None
    x, y, z = body.tip_position(end.state.positions).tolist()
    return x, y, z


def _along(mode: Array, begin: Equilibrium, end: Equilibrium) -> float:
    return float((mode * (end.state.positions - begin.state.positions)).sum())


def _size(equilibrium: Equilibrium) -> float:
    return float(np.ptp(equilibrium.state.positions, axis=0).max())


def _motion(begin: Equilibrium, end: Equilibrium) -> float:
    """Return the root mean square of the nodes' motion between two equilibria [m], seen from the flange."""
    before, after = (
        equilibrium.world_from_flange.inverse().apply(equilibrium.state.positions)
        for equilibrium in (begin, end)
    )
    return math.sqrt(float(((after - before) ** 2).sum(axis=1).mean()))


def _jumped(begin: Equilibrium, end: Equilibrium) -> bool:
    """Return whether Newton's method met an indefinite tangent, or found nothing, and ended far away."""
    return (end.shifted > 0 or end.slides > 0) and _motion(begin, end) > _FAR * _size(begin)


def _load_change(begin: Equilibrium, end: Equilibrium) -> float:
    """Return how large a change of flange and loads is, compared with the loads at its end; at most 1."""
    a, b = begin.loads, end.loads
    values = ((a.pressure_Pa, b.pressure_Pa), (a.cable_tension_N, b.cable_tension_N), (a.gravity, b.gravity))
    ratios = [_relative(np.array(before), np.array(after)) for before, after in values]
    forces = [np.zeros(0) if loads.nodal_force is None else loads.nodal_force.ravel() for loads in (a, b)]
    motion = end.world_from_flange @ begin.world_from_flange.inverse()
    flange_rests = np.abs(motion.rotation - np.eye(3)).max() < _STILL > np.abs(motion.translation).max()
    same_kinds = a.gas == b.gas and a.cable_length_m == b.cable_length_m
    return min(1.0, max(*ratios, _relative(forces[0], forces[1]))) if same_kinds and flange_rests else 1.0


def _relative(before: Array, after: Array) -> float:
    if len(before) != len(after):
        return 1.0
    change, size = np.abs(after - before).max(initial=0.0), np.abs(after).max(initial=0.0)
    return float(change / size) if size else float(change > 0.0)
