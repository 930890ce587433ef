"""In which direction a soft body gives way most easily: the lowest eigenvector of its tangent stiffness.

At a stable equilibrium the tangent is positive definite. Where it is not, the potential falls along the
eigenvectors of its negative eigenvalues, on both sides: a branch of equilibria forks there, or ends.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Final, Protocol, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import place_of_largest
from cosim.soft.elements.cable import losses_follow
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.linear.linear_solver import ShiftSearch
from cosim.soft.solve import newton_options
from cosim.soft.solve.branching import DISTURBED, MODES, UNDECIDED, Branching, StabilityReport
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Equilibrium, SoftState

_LEAST_SHIFT, _LARGEST_SHIFT = 1e-3, 1e9  # of a weight of 1
_TOLERANCE, _VECTORS = 1e-5, 8  # of the iteration


@final
@dataclass(frozen=True)
class LowestMode:
    """The lowest eigenvalue of K v = e W v.

    Args:
        value: e; of weight 1 in N/m.
        mode: (n, 3), v; its largest component is 1.
        place: node that moves most, and its ring.
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
        most = self.mode[int(np.argmax(self.mode.max(axis=1)))]
        x, y, z = (most / np.linalg.norm(most)).tolist()
        return x, y, z

    @property
    def extent(self) -> float:
        """Root mean square of the nodes' motion, of the largest component."""
        return math.sqrt(float((self.mode**2).sum(axis=1).mean()))


def lowest_mode(
    solver: NewtonSolver,
    state: SoftState,
    loads: Loads,
    frame: Array,
    weight: Array | None = None,
    count: int = 1,
) -> LowestMode:
    """Return the lowest eigenvalue of the static tangent K, and its mode: K v = e W v.

    Inverse Lanczos iteration on K + s W, s the shift that makes it positive definite, with sealed gas and
    commanded lengths. The factorisation in store is lost.

    Args:
        solver: Newton's method for the body with the clamp in force.
        state: where the tangent is taken.
        loads: that act there.
        frame: (3, 3), rotation of the flange.
        weight: (n,), of the nodes, above 0, such as their mass [kg], of which e is the square of an angular
            frequency; None for 1.
        count: of the lowest eigenvalues that are found, as far as there are as many.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh  # imported here because it takes long to load

    x, shift = state.positions, 0.0
    weights = np.ones(len(x)) if weight is None else weight
    root = np.sqrt(weights)[:, None]

    def definite(by: float) -> bool:
        nonlocal shift
        shift = by
        bed = Inertia(by * weights, x) if by else None
        return solver.factorise(x, state.memory, loads, bed, frame)

    def inverse(vector: Array) -> Array:
        return np.asarray(root * solver.linear.solve(root * vector.reshape(-1, 3))).ravel()

    least = _LEAST_SHIFT / float(weights.mean())
    ShiftSearch().factor(definite, least, least * _LARGEST_SHIFT / _LEAST_SHIFT)
    start = np.where(solver.free, np.random.default_rng(0).standard_normal(x.shape), 0.0).ravel()
    operator = LinearOperator((x.size, x.size), matvec=inverse, dtype=np.float64)
    count = min(count, int(np.count_nonzero(solver.free)), x.size - 1)
    room = min(_VECTORS + 2 * (count - 1), x.size)
    found, vectors = eigsh(operator, k=count, which="LA", v0=start, tol=_TOLERANCE, ncv=room)
    solver.keep(None)
    order = np.argsort(-found)
    values = (1.0 / found[order] - shift).tolist()
    shapes = vectors.T[order].reshape(len(order), -1, 3) / root
    mode = shapes[0] / shapes[0].ravel()[np.argmax(np.abs(shapes[0]))]
    place = place_of_largest(solver.film.body, x, mode, solver.free)
    return LowestMode(values[0], mode, place, tuple(values), shapes)


_PUSHES = 1e-3, 3e-3, 0.01, 0.02, 0.04, 0.08  # off an unstable equilibrium, in turn; of the body's size
_ALIKE = 0.2  # how far two sides are apart from it
_SADDLES_MAX = 3  # one after the other, until a stable one is found
_FAR = 0.02  # root mean square of the nodes' motion, of the body's size
_WITHIN, _LEAST = 0.005, 0.05  # of the loads; of what was asked for, at least
_STILL = 1e-4  # a flange that hardly moves or turns [m, rad]
SNAPS: Final = "nothing near is in balance beyond"
LOWER: Final = "what is near is stable as well, but has more energy"
_EQUAL = 1e-6  # energies, of the fall from an unstable equilibrium
ON_PURPOSE: Final = "it is followed on purpose (solver.follow_unstable)"
NOWHERE: Final = "no stable equilibrium was found beside it"


class BranchFollower(Protocol):
    """Follows equilibria of a body; see `EquilibriumSolver`."""

    options: newton_options.NewtonOptions
    effort: newton_options.SearchEffort

    @property
    def body(self) -> SoftBody:
        """Of the film, on whose nodes all is said."""

    def lowest_mode(self, here: Equilibrium) -> LowestMode:
        """Return the lowest eigenvalue of the tangent stiffness at an equilibrium, and its mode."""

    def describe_instability(self, here: Equilibrium, lowest: LowestMode) -> Branching:
        """Return what is known of an equilibrium that gives way along a mode by itself."""

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go."""

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads."""

    def slide(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Find the equilibrium that a damped body slides to."""


def switch_branch(follower: BranchFollower, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
    """Return a stable equilibrium in place of one that is not; one that is stable as it is.

    Where stable equilibria end is looked for between `begin` and `found`; also where Newton's method met an
    indefinite tangent and ended far away, as rounding may have decided on the side. The unstable equilibrium
    there is left along the lowest eigenvector of its tangent, on both sides, from where the body slides down
    to rest. The one of lower energy is taken, of equal ones the one in the direction whose largest component
    is positive, and followed to the loads of `found`. A branch that is unstable at `begin` is followed.

    Args:
        follower: of equilibria of the body; its options say whether unstable ones are left.
        begin: equilibrium before, from where it was followed; None for a first one.
        found: what was found.

    Raises:
        ConvergenceError: the search took all the iterations that it may.
    """
    if begin is not None and begin.negative_pivots:
        return found
    leaves = follower.options.leaves_saddles
    if not found.negative_pivots and not (leaves and begin is not None and _jumped(begin, found)):
        return found
    effort, what = follower.effort, "a stable equilibrium beside an unstable one"
    with effort.search(what) if found.negative_pivots else effort.search_apart(what):
        fork = _Fork(1.0, found, found, 0) if begin is None else _fork(follower, begin, found)
        saddle, spent = fork.saddle, found.iterations + fork.iterations
        if not saddle.negative_pivots:
            return _snapped(follower, fork, replace(found, iterations=spent))
        lowest = follower.lowest_mode(saddle)
        ends = _sides(follower, saddle, lowest) if leaves else []
        why, *taken = _choice(saddle, ends) if leaves else (ON_PURPOSE,)
        tips = [_tip(follower, end) for end in (*taken, None, None)]
        branching = replace(
            follower.describe_instability(saddle, lowest),
            load_factor=fork.share,
            tip_m=tips[0],
            other_tip_m=tips[1],
            chosen=why,
        )
        if not taken:
            return replace(_again(follower, found), iterations=spent, branchings=(branching,))
        here = _onward(follower, fork.share, taken[0], found)
        spent += here.iterations + sum(end.iterations for end in ends)
        return replace(here, iterations=spent, branchings=(branching, *here.branchings))


def find_instability(solver: NewtonSolver, state: SoftState, loads: Loads, frame: Array) -> Branching | None:
    """Return in which direction a body in motion would give way if it was at rest; None where it would not.

    Of open ends nothing is known from a symmetric part that is not positive definite, see `assess_stability`.

    Args:
        solver: Newton's method for the body with the clamp in force, of symmetric parts of tangents; its
            factorisation is lost.
        state: where the body is.
        loads: that act there.
        frame: (3, 3), rotation of the flange.
    """
    if not solver.film.conservative or solver.factorise(state.positions, state.memory, loads, None, frame):
        return None
    ways = solver.negative_pivots(state.positions, state.memory, loads)
    return (
        describe_instability(solver, state, loads, lowest_mode(solver, state, loads, frame), ways)
        if ways
        else None
    )


_GROWTH, _MOVES_m = 1e-3, 1e-5  # of the loads, and of the body with them at most, in a look ahead
_PROBE_m = 1e-7  # half of the step of differences
_DRIVEN = 0.5  # share of the answer to more load that is in the lowest mode, where it snaps


def assess_stability(solver: NewtonSolver, state: SoftState, loads: Loads, frame: Array) -> StabilityReport:
    """Return how firmly a body stands, as if it was at rest.

    All is by the one factorisation that the lowest mode takes: three solutions for a disturbance, one for
    what more load does, and gradients beside it.

    Args:
        solver: Newton's method for the body with the clamp in force, of symmetric parts of tangents; its
            factorisation is lost.
        state: where the body is.
        loads: that act there.
        frame: (3, 3), rotation of the flange.
    """
    film, x = solver.film, state.positions
    held = _losses_held(solver, loads)
    mass = film.body.node_mass
    weight = mass if (mass > 0.0).all() else None
    lowest = lowest_mode(solver, state, loads, frame, weight, MODES)
    if not lowest.value > 0.0:
        if not film.conservative:  # it may be stable all the same
            return StabilityReport(None, math.inf, math.inf, losses_held=held)
        ways = max(1, solver.negative_pivots(x, state.memory, loads))
        return StabilityReport(
            None,
            math.inf,
            0.0,
            losses_held=held,
            unstable=describe_instability(solver, state, loads, lowest, ways),
        )
    growth = _Growth(solver, state, loads)
    force = growth.force
    disturbance = DISTURBED * np.linalg.norm(force, axis=1)[:, None, None] * np.eye(3)
    answers = solver.linear.solve_all(np.ascontiguousarray(disturbance.swapaxes(0, 1))).swapaxes(0, 1)
    moved = tip_motion(film.body.tip, answers)
    margin, snaps = growth.margin(lowest, solver.linear.solve(force), weight)
    modes = () if weight is None else natural_frequencies(lowest.values)
    losses = () if weight is None else material_losses(film, x, lowest.shapes)
    return StabilityReport(
        modes[0] if modes else None, moved, margin, snaps, held, frequencies_Hz=modes, losses_per_s=losses
    )


_RATE_PROBE_m = 1e-6


def material_losses(film: FilmPotential, positions: Array, shapes: Array) -> tuple[float, ...]:
    """Return v.D v / v.M v [1/s] of each mode: its materials' losses let it decay at half of that.

    D is the matrix of resistance to rates of strain at the shape, M that of masses.

    Args:
        film: of the body.
        positions: (n, 3) [m].
        shapes: (k, n, 3), v.
    """
    rates, mass = StrainRates.of(film.body), film.body.node_mass
    if rates is None:
        return (0.0,) * len(shapes)
    rates.begin(positions, None, 1.0)
    found = []
    for shape in shapes:
        step = _RATE_PROBE_m / float(np.abs(shape).max())
        both = (rates.potential(np.ascontiguousarray(positions + way * step * shape)) for way in (1.0, -1.0))
        found.append(sum(both) / step**2 / float(mass @ (shape**2).sum(axis=1)))
    return tuple(found)


def natural_frequencies(values: Sequence[float]) -> tuple[float, ...]:
    """Return frequencies [Hz] of which eigenvalues above 0 are the squares of angular ones."""
    return tuple(math.sqrt(value) / (2.0 * math.pi) for value in values)


def tip_motion(tip: IntArray, answers: Array) -> float:
    """Return how far [m] a tip moves by the worst combination of disturbances; any node if it has none.

    Args:
        tip: (k,) nodes.
        answers: (n, 3, 3) [m], of each node to each of three disturbances.
    """
    moved = answers[tip].mean(axis=0, keepdims=True) if len(tip) else answers
    return float(np.linalg.norm(moved, ord=2, axis=(1, 2)).max())


def driven(product: float, size_of_mode: float, size_of_answer: float) -> bool:
    """Return whether the answer of a body to more load is mostly in its lowest mode: it is driven to snap.

    Args:
        product: of both, weighed by mass.
        size_of_mode: the same of the mode by itself.
        size_of_answer: the same of the answer.
    """
    return product**2 > _DRIVEN * size_of_mode * size_of_answer


def margin_by(stiffness: float, fall: float, *, driven: bool) -> tuple[float, bool]:
    """Return by what share, below 1, loads may grow until a stiffness is zero, and if the body snaps there.

    Args:
        stiffness: now.
        fall: of it, by the share by which loads grow.
        driven: whether the body moves along it. Then it snaps if the stiffness falls as loads grow, and it is
            the square of it that falls straight with them; as loads fall, a body that has branched goes back.
    """
    found = stiffness / fall if fall else math.inf
    snaps = driven and found > 0.0
    margin = 0.5 * found if snaps else found
    return (margin, snaps) if abs(margin) < 1.0 else (math.inf, False)


def nodal_loads(film: FilmPotential, positions: Array, memory: Array, loads: Loads) -> Array:
    """Return what loads exert on each node (n, 3) [N] by gas, cables of given tension, weight and dead loads.

    Args:
        film: of the body.
        positions: (n, 3) [m].
        memory: (values,), what the elements remember there.
        loads: that act.
    """
    share, found = film.losses_at(positions, loads), []
    volumes = tuple(film.gas.enclosed_volumes(positions[None])[0].tolist())
    for part in (-1.0, 0.0):
        film.evaluate(positions, loads.grown(part, volumes), share, memory.copy(), hessian=False)
        found.append(film.gradient.copy())
    return np.asarray(found[0] - found[1])


@final
class _Growth:
    """What a body is under, and what becomes of its lowest stiffness if all loads grow.

    Args:
        solver: Newton's method for the body.
        state: where it is.
        loads: that act there.
    """

    def __init__(self, solver: NewtonSolver, state: SoftState, loads: Loads) -> None:
        self._solver, self._state, self._loads = solver, state, loads
        volumes = solver.film.gas.enclosed_volumes(state.positions[None])[0]
        self._volumes = tuple(volumes.tolist())
        found = nodal_loads(solver.film, state.positions, state.memory, loads)
        self.force = np.where(solver.free, found, 0.0)

    def margin(self, lowest: LowestMode, answer: Array, weight: Array | None) -> tuple[float, bool]:
        """Return by what share the loads may grow until the lowest stiffness is zero, and if they drive it.

        Args:
            lowest: eigenvalue and mode.
            answer: (n, 3) [m], of the body to twice the loads, linear.
            weight: of `lowest_mode`.
        """
        most = float(np.abs(answer).max())
        share = min(_GROWTH, _MOVES_m / most) if most else _GROWTH
        # what grows with the square of a motion, such as stretch where a mode goes on straight, cancels
        less, here, more = (self._stiffness(lowest.mode, way, way * answer) for way in (-share, 0.0, share))
        weights = np.ones(len(answer)) if weight is None else weight
        pushed = driven(
            *(
                float(weights @ (one * other).sum(axis=1))
                for one, other in ((lowest.mode, answer), (lowest.mode, lowest.mode), (answer, answer))
            )
        )
        return margin_by(here, (less - more) / (2.0 * share), driven=pushed)

    def _stiffness(self, mode: Array, share: float, moved: Array) -> float:
        """Return the stiffness along a mode, where the body has moved under loads that have grown."""
        there = [self._gradient(share, moved + side * _PROBE_m * mode) for side in (1.0, -1.0)]
        return float((mode * (there[0] - there[1])).sum()) / (2.0 * _PROBE_m)

    def _gradient(self, share: float, moved: Array | float = 0.0) -> Array:
        film, x = self._solver.film, np.ascontiguousarray(self._state.positions + moved)
        loads = self._loads.grown(share, self._volumes)
        kept = film.losses_at(self._state.positions, loads, self._state.memory)
        film.evaluate(x, loads, kept, self._state.memory, hessian=False)
        return np.where(self._solver.free, film.gradient, 0.0)


def describe_instability(
    solver: NewtonSolver, state: SoftState, loads: Loads, lowest: LowestMode, ways: int
) -> Branching:
    """Return what is known of an unstable equilibrium by itself.

    Args:
        solver: Newton's method for the body with the clamp in force.
        state: where the body is.
        loads: that act there.
        lowest: along which it gives way.
        ways: independent directions in which the potential falls.
    """
    volumes = solver.film.gas.enclosed_volumes(state.positions[None])[0]
    return Branching(
        1.0, loads.pressures_at(tuple(volumes.tolist())), loads.cable_tension_N, lowest.place,
        lowest.direction, lowest.extent, ways, None, None, UNDECIDED, losses_held=_losses_held(solver, loads),
    )  # fmt: skip


def _losses_held(solver: NewtonSolver, loads: Loads) -> bool:
    """Return whether loads have no potential, so that it is one with their losses held that is looked at."""
    cables = solver.film.body.cables
    rubs = any(cable.friction_coefficient for cable in cables)
    return rubs or not solver.film.conservative or losses_follow(cables, loads.cable_length_m)


@final
@dataclass(frozen=True)
class _Fork:
    """Where stable equilibria end on a way.

    Args:
        share: of the way.
        before: the last stable one; an unstable one where none is known.
        saddle: the first one after it, unstable unless it is where the body snaps to.
        iterations: of the search.
    """

    share: float
    before: Equilibrium
    saddle: Equilibrium
    iterations: int


def _fork(follower: BranchFollower, begin: Equilibrium, end: Equilibrium) -> _Fork:
    """Return where stable equilibria end between a stable one and another, bisected."""
    low, high, spent = 0.0, 1.0, 0
    first, last, width = begin, end, _load_change(begin, end)
    # of the loads where stable equilibria end, not of those that were asked for
    while (high - low) * width > _WITHIN * max(_LEAST, 1.0 - width * (1.0 - high)) and (
        last.negative_pivots or _jumped(first, last)
    ):
        middle = 0.5 * (low + high)
        pose = begin.world_from_flange.interpolated(end.world_from_flange, middle)
        loads = begin.loads.interpolated(end.loads, middle)
        ends = [here.state.carried(pose @ here.world_from_flange.inverse()) for here in (first, last)]
        start = 0.5 * (ends[0].positions + ends[1].positions) if last.negative_pivots else ends[0].positions
        try:
            found = _solved(follower, ends[0], pose, loads, start)
        except ConvergenceError:
            break
        spent += found.iterations
        beyond = not last.negative_pivots and _motion(first, found) > _motion(found, last)
        if found.negative_pivots or beyond:
            high, last = middle, found
        else:
            low, first = middle, found
    return _Fork(high, first, last, spent)


def _snapped(follower: BranchFollower, fork: _Fork, found: Equilibrium) -> Equilibrium:
    """Return an equilibrium that may be far from those before; one near them where that has less energy."""
    before, after, chosen = fork.before, fork.saddle, SNAPS
    if not _jumped(before, after):
        return replace(_again(follower, found), iterations=found.iterations)
    state = before.state.carried(after.world_from_flange @ before.world_from_flange.inverse())
    try:
        near = follower.solve(state, after.world_from_flange, after.loads)
    except ConvergenceError:
        near = after
    found = replace(found, iterations=found.iterations + near.iterations)
    if not near.negative_pivots and _motion(near, after) > _FAR * _size(before) > _motion(before, near):
        if near.potential_J <= after.potential_J:
            here = _onward(follower, fork.share, near, found)
            return replace(here, iterations=here.iterations + found.iterations)
        chosen = LOWER
    again, snap = _again(follower, found), _snap(follower, fork, chosen)
    return replace(again, iterations=found.iterations, branchings=(snap,))


def _onward(follower: BranchFollower, share: float, begin: Equilibrium, end: Equilibrium) -> Equilibrium:
    """Return an equilibrium followed from a share of a way to its end; load factors are of the whole way."""
    here = follower.follow(begin, end.world_from_flange, end.loads)
    passed = (replace(each, load_factor=share + (1.0 - share) * each.load_factor) for each in here.branchings)
    return replace(here, branchings=tuple(passed))


def _snap(follower: BranchFollower, fork: _Fork, chosen: str) -> Branching:
    """Return where a body snaps, why, and from where to where."""
    before, after = fork.before, fork.saddle
    carried = before.state.carried(after.world_from_flange @ before.world_from_flange.inverse())
    motion = after.state.positions - carried.positions
    most = int(np.argmax(np.linalg.norm(motion, axis=1)))
    mode = motion / np.abs(motion).max()
    place = place_of_largest(follower.body, carried.positions, mode, np.ones(mode.shape, np.bool_))
    named = follower.describe_instability(replace(after, state=carried), LowestMode(0.0, mode, place))
    x, y, z = (motion[most] / np.linalg.norm(motion[most])).tolist()
    tips = [_tip(follower, end) for end in (after, before)]
    return replace(
        named, load_factor=fork.share, direction=(x, y, z), tip_m=tips[0], other_tip_m=tips[1], chosen=chosen,
        snap=True,
    )  # fmt: skip


def _solved(
    follower: BranchFollower, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array
) -> Equilibrium:
    """Return the equilibrium near a state; where there is none, as beyond a limit point, the next one."""
    try:
        return follower.solve(state, world_from_flange, loads, start)
    except ConvergenceError:
        return follower.slide(state, world_from_flange, loads)


def _sides(follower: BranchFollower, saddle: Equilibrium, lowest: LowestMode) -> list[Equilibrium]:
    """Return the stable equilibria on both sides of an unstable one, that along its mode first; at most two.

    What is pushed off to one side may come to rest on the other, or nearby: wrinkles that snap on the way
    throw it there. So further pushes follow until there is one on either side, about as far away.
    """
    ends = dict[float, Equilibrium]()
    for push, side in product(_PUSHES, (1.0, -1.0)):
        away = [_motion(saddle, end) for end in ends.values()]
        enough = len(away) == 2 and min(away) > _ALIKE * max(away)
        if enough or 2 * follower.effort.spent > follower.effort.most:  # the rest is for the way on
            break
        end = _descended(follower, saddle, side * push * _size(saddle) * lowest.mode)
        if end is not None:
            where = math.copysign(1.0, _along(lowest.mode, saddle, end))
            ends[where] = max(ends.get(where, end), end, key=lambda each: _motion(saddle, each))
    return [ends[where] for where in (1.0, -1.0) if where in ends]


def _descended(follower: BranchFollower, saddle: Equilibrium, push: Array) -> Equilibrium | None:
    """Return a stable equilibrium to which a body slides that is pushed off; None if none is found.

    Args:
        follower: of equilibria of the body.
        saddle: where it starts.
        push: (n, 3) [m].
    """
    here, spent = saddle, 0
    for _ in range(_SADDLES_MAX):
        pushed = SoftState.at_rest(here.state.positions + push, here.state.memory)
        try:
            here = follower.slide(pushed, saddle.world_from_flange, saddle.loads)
        except ConvergenceError:
            return None
        spent += here.iterations
        if not here.negative_pivots:
            return replace(here, iterations=spent)
        if _motion(saddle, here) < math.sqrt(float((push**2).sum(axis=1).mean())):  # back where it was
            return None
        mode = follower.lowest_mode(here).mode
        push = math.copysign(float(np.abs(push).max()), _along(mode, saddle, here)) * mode
    return None


def _choice(saddle: Equilibrium, ends: list[Equilibrium]) -> tuple[str, *tuple[Equilibrium, ...]]:
    """Return why, and which of the equilibria beside a saddle is taken, then the other one.

    Args:
        saddle: that is left.
        ends: at most two, that in the positive direction first.
    """
    if not ends:
        return (NOWHERE,)
    if len(ends) == 1:
        return "none was found on the other side", ends[0]
    one, two = ends
    fall = saddle.potential_J - min(one.potential_J, two.potential_J)
    if abs(one.potential_J - two.potential_J) <= _EQUAL * fall:
        return "both have the same energy, this is the one in the positive direction", one, two
    return "it has the lower energy", *sorted(ends, key=lambda end: end.potential_J)


def _again(follower: BranchFollower, found: Equilibrium) -> Equilibrium:
    """Return what was found, as the last one that was solved: solvers keep its forces."""
    with follower.effort.search_apart("an equilibrium that is known"):
        again = follower.solve(found.state, found.world_from_flange, found.loads)
    return replace(again, slides=found.slides)


def _tip(follower: BranchFollower, end: Equilibrium | None) -> tuple[float, float, float] | None:
    body = follower.body
    if end is None or not len(body.tip):
        return None
    x, y, z = body.tip_position(end.state.positions).tolist()
    return x, y, z


def _along(mode: Array, begin: Equilibrium, end: Equilibrium) -> float:
    return float((mode * (end.state.positions - begin.state.positions)).sum())


def _size(here: Equilibrium) -> float:
    return float(np.ptp(here.state.positions, axis=0).max())


def _motion(begin: Equilibrium, end: Equilibrium) -> float:
    """Return the root mean square of the nodes' motion between two equilibria [m], seen from the flange."""
    before, after = (here.world_from_flange.inverse().apply(here.state.positions) for here in (begin, end))
    return math.sqrt(float(((after - before) ** 2).sum(axis=1).mean()))


def _jumped(begin: Equilibrium, end: Equilibrium) -> bool:
    """Return whether Newton's method met an indefinite tangent, or found nothing, and ended far away."""
    return (end.shifted > 0 or end.slides > 0) and _motion(begin, end) > _FAR * _size(begin)


def _load_change(begin: Equilibrium, end: Equilibrium) -> float:
    """Return how large a change of flange and loads is, compared with the loads at its end; at most 1."""
    a, b = begin.loads, end.loads
    plain = (a.pressure_Pa, b.pressure_Pa), (a.cable_tension_N, b.cable_tension_N), (a.gravity, b.gravity)
    shares = [_relative(np.array(before), np.array(after)) for before, after in plain]
    forces = [np.zeros(0) if each.nodal_force is None else each.nodal_force.ravel() for each in (a, b)]
    moved = end.world_from_flange @ begin.world_from_flange.inverse()
    still = np.abs(moved.rotation - np.eye(3)).max() < _STILL > np.abs(moved.translation).max()
    same = a.gas == b.gas and a.cable_length_m == b.cable_length_m
    return min(1.0, max(*shares, _relative(forces[0], forces[1]))) if same and still else 1.0


def _relative(before: Array, after: Array) -> float:
    if len(before) != len(after):
        return 1.0
    change, size = np.abs(after - before).max(initial=0.0), np.abs(after).max(initial=0.0)
    return float(change / size) if size else float(change > 0.0)
