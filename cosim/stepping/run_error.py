"""How far the figures at the ends of a run's phases may be off, by mesh, tick and solver.

Mesh: the state at rest under the loads of the phase's end is found on the run's mesh and on that refined
once; their difference, times a factor that was calibrated (docs/run_error.md). Tensions that a target was
reached with are searched for again on both.

Section models: besides, the difference of the chain at rest to the film that it was condensed from, which
is at rest under the same loads; what follows is of that film, and of no ticks.

Tick: the exact swing of each of the lowest modes under the forces of the run, as below.

Solver: a residual of the tolerance in each component, independent of one another, moves the tip by
tolerance |K^-1 g|, g the tip's gradient.

Near the state at rest at a phase's end the body swings in its lowest modes, each by itself, y its share:
y'' + a y' + w^2 y = f, with damping a, frequency w, and whatever force f there is. How the run has moved says
which force that was: its integrator has solved the same for its share x, with differences in place of
derivatives. The same force, linear within a tick, is answered exactly, from the start of the run on; by how
much the two swings are apart at the end is the error of the mode. A body that is hardly filled yet swings
more slowly than at the end; so the same is done with lower frequencies, and the largest error counts.

Modes: Ritz vectors of the tip's answers to pulls on it, of the answers to their inertia, and so on.
Source: Wilson, Yuan and Dickens, Dynamic analysis by direct superposition of Ritz vectors, Earthquake
Engineering and Structural Dynamics 10 (1982).

Of each tick there is kept what mass times position is along polynomials in the drawn positions: that is
enough to read off the shares of modes that are known only later.
"""

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.coupling.soft_sides.finer_mesh import ITERATIONS_MAX, PATIENCE, FinerMesh, SourceFilm
from cosim.coupling.soft_sides.lumped_arm import SoftArm, SoftArmState
from cosim.coupling.soft_sides.section_arm import SectionArm, SectionArmState
from cosim.errors import ConvergenceError, MeshError, OutOfRangeError, UnreachableError
from cosim.plan.tip_targets import wanted_tip
from cosim.soft.beams.beam_rings import stiffener_strain
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve import branching, stability, tip_target
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState, StepOptions
from cosim.stepping.parts import Parts
from cosim.telemetry.snapshot import RunErrors
from cosim.telemetry.tick_batch import TickBatch

_POWERS: Final = 8  # of the height: of long stacks more see no more of the modes
_ROUNDS: Final = 4  # of three Ritz vectors each
_SLOWER: Final = (1.0, 0.7)  # times the frequencies at the end: half the stiffness
_DAMPED: Final = 0.99  # share of the critical damping that a mode has at most


def tip_pulls(body: SoftBody) -> Array:
    """Return forces (3, n, 3) that pull the tip by 1 N along each axis."""
    pull = np.zeros((3, body.nodes, 3))
    for axis in range(3):
        pull[axis, body.tip, axis] = 1.0 / len(body.tip)
    return pull


@final
@dataclass(frozen=True)
class Modes:
    """Lowest modes of a body at a state at rest.

    Args:
        rest: (n, 3) [m], the nodes there.
        frequency: (k,) [rad/s], circular.
        shape: (k, n, 3), with a mass of 1 kg.
        losses: (k,) [1/s], of materials; see `material_losses`.
    """

    rest: Array
    frequency: Array
    shape: Array
    losses: Array

    @classmethod
    def of(cls, side: SoftArm, rest: Equilibrium) -> "Modes | None":
        """Return those at a state at rest; None where its tangent is not positive definite."""
        solver, body, state = side.equilibrium_solver.solver, side.body, rest.state
        frame = rest.world_from_flange.rotation
        if not solver.factorise(state.positions, state.memory, rest.loads, None, frame):
            return None
        mass, like = np.repeat(body.node_mass, 3), (3, body.nodes, 3)
        answers = solver.linear.solve_all(tip_pulls(body)).reshape(3, -1)
        basis, of_inertia = np.zeros((0, mass.size)), np.zeros((0, mass.size))
        for _ in range(_ROUNDS):
            for answer in answers:
                vector = answer
                for _again in range(2):  # rounding leaves a part of the others
                    vector = vector - (basis * mass @ vector) @ basis
                basis = np.vstack([basis, vector / np.sqrt(mass @ vector**2)])
            answers = solver.linear.solve_all((basis[-3:] * mass).reshape(like)).reshape(3, -1)
            of_inertia = np.vstack([of_inertia, answers])
        flexibility = basis * mass @ of_inertia.T
        values, parts = np.linalg.eigh((flexibility + flexibility.T) / 2.0)
        shapes = (parts.T @ basis).reshape(-1, body.nodes, 3)
        shapes = shapes[values > 0.0]
        losses = np.array(stability.material_losses(solver.film, state.positions, shapes))
        return cls(state.positions, 1.0 / np.sqrt(values[values > 0.0]), shapes, losses)


@final
class Swings:
    """Keeps how a body moves, tick by tick, and compares that with exact swings.

    Args:
        body: that moves.
        tick_s: [s].
        options: of the ticks.
    """

    def __init__(self, body: SoftBody, tick_s: float, options: StepOptions) -> None:
        self._tick_s, self._options = tick_s, options
        low, high = body.positions.min(axis=0), body.positions.max(axis=0)
        x, y, height = (2.0 * (body.positions - low) / np.where(high > low, high - low, 1.0) - 1.0).T
        powers, root = np.polynomial.legendre.legvander(height, _POWERS - 1), np.sqrt(body.node_mass)
        functions = np.concatenate([powers * across[:, None] for across in (np.ones_like(x), x, y)], axis=1)
        self._along = np.linalg.qr(root[:, None] * functions)[0].T * root
        self._moved: list[Array] = []

    def observe(self, shapes: Array) -> None:
        """Take in shapes (k, n, 3) [m], one a tick, in order; the first of all is at rest."""
        self._moved.extend(self._along @ shapes)

    @property
    def ticks(self) -> int:
        """How many were taken in."""
        return len(self._moved)

    def apart(self, modes: Modes, ticks: int) -> Array:
        """Return shapes (k, n, 3) [m]: by how much each mode's swing is off.

        Args:
            modes: of the body.
            ticks: after how many.
        """
        moved = np.stack(self._moved[:ticks]) - self._along @ modes.rest
        share = np.tensordot(moved, self._along @ modes.shape, ((1, 2), (1, 2)))
        away = [self._apart(share, slower * modes.frequency, modes.losses) for slower in _SLOWER]
        return np.asarray(np.max(away, axis=0)[:, None, None] * modes.shape)

    def _apart(self, x: Array, frequency: Array, losses: Array) -> Array:
        """Return how far swings (ticks, k) are off at the end, as amplitudes, at frequencies (k,)."""
        h, declared = self._tick_s, (self._options.damping_per_s + losses) / 2.0
        damping = np.minimum(declared, _DAMPED * frequency)
        speed = self._derivative(np.concatenate([np.repeat(x[:1], 4, axis=0), x]))
        force = self._derivative(speed)[-len(x) :] + 2.0 * damping * speed[-len(x) :] + frequency**2 * x
        turning = np.sqrt(frequency**2 - damping**2)
        root = -damping + 1j * turning  # of swing = y' - conj(root) y, which is swing' = root swing + f
        grown = np.exp(root * h)
        whole, rising = (grown - 1.0) / root, (grown - 1.0 - root * h) / (root**2 * h)
        swing = -root.conj() * x[0]
        for push in whole * force[:-1] + rising * np.diff(force, axis=0):
            swing = grown * swing + push
        return np.asarray(np.abs(swing - speed[-1] + root.conj() * x[-1]) / turning)

    def _derivative(self, x: Array) -> Array:
        """Return the derivative (n - 1 or n - 2, k) of shares (n, k), as the integrator has it."""
        if self._options.integrator == "implicit_euler":
            return np.asarray(np.diff(x, axis=0) / self._tick_s)
        return np.asarray((3.0 * x[2:] - 4.0 * x[1:-1] + x[:-2]) / (2.0 * self._tick_s))


FIGURES: Final = ("tip_m", "sag_m", "length_m", "volume_m3", "cable_tension_N", "peak_strain")
TICK_FACTOR: Final = 2.2
"""By which the error of the swings is multiplied: the frequencies have not always been those of the end."""
_OF_SHAPE: Final = 0.5
"""Share of the differences of tip and volume that sag, length and tensions are off by: theirs may vanish."""


@final
@dataclass(frozen=True)
class Calibration:
    """How the difference of two meshes bounds the error of the coarser one; docs/run_error.md.

    Args:
        factors: by which differences are multiplied, one for each of `FIGURES`.
        of_volume: whether a difference of volumes bounds those of tip, sag and length.
    """

    factors: Mapping[str, float]
    of_volume: bool


GRADED: Final = Calibration(dict(zip(FIGURES, (2.5, 2.3, 2.4, 2.8, 1.5, 1.5), strict=True)), True)
FINGER_SIDES: Final = 4
DRAWN: Final = Calibration(dict(zip(FIGURES, (1.7, 1.7, 1.7, 1.5, 1.5, 1.9), strict=True)), False)
"""Of square units on the drawn mesh with refined holes, as fingers have: it lacks volume, not reach."""


def calibration_of(scenario: Scenario) -> Calibration:
    """Return the calibration that holds for the mesh of a scenario."""
    robot = scenario.soft_robot
    if not isinstance(robot, SoftRobotTable) or robot.stack is None or robot.attachments:
        return GRADED
    stack = robot.stack
    finger_mesh = stack.mesh == "drawn" and stack.refine_holes > 0 and not scenario.model.published
    return DRAWN if finger_mesh and stack.sides == FINGER_SIDES else GRADED


_OF_TENSION: Final = 0.1
"""Of a tension that was found: it is off by at least that much."""
_LEAP: Final = 0.05
"""Of the length: a snap by less does not take the bars of its phase away."""
_ELSEWHERE: Final = 0.6
"""Of the length: farther away, the refined mesh is on another branch."""
_BRANCHES: Final = "the soft robot branches in it, and figures jump there"
_SNAPS: Final = "the soft robot snaps at its end, and figures jump there"
_TOUCHES: Final = "the soft robot touches the scene, and contact with it is not modelled on the refined mesh"
_NOT_AT_REST: Final = "no state at rest was found near its end, on the run's mesh or on the refined one"
_HELD: Final = "rings are held where the run's mesh had them, which on the refined mesh is not known"
_DEAR: Final = "only of the last phase and those it needs, as more would cost over a third of the run"
_TOO_DEAR: Final = "it would cost more than the run; --error works it out all the same"


class TooDearError(Exception):
    """Another state at rest is asked for once all that bars may cost is spent."""


@final
@dataclass(frozen=True)
class PhaseEnd:
    """What there is at the end of a phase.

    Args:
        phase: its index.
        state: of the soft side.
        ticks: how many `Swings` had taken in by then.
        why_not: why no error is worked out; empty where one is.
    """

    phase: int
    state: SoftArmState | SectionArmState
    ticks: int
    why_not: str = ""


@final
@dataclass(frozen=True)
class Pair:
    """States at rest at the end of a phase.

    Args:
        rest: on the run's mesh.
        finer: on the refined mesh.
        clamp: of the refined mesh.
    """

    rest: Equilibrium
    finer: Equilibrium
    clamp: Clamp


def at_rest(side: SoftArm, state: SoftArmState) -> Equilibrium:
    """Return where a body that has stopped at a state of its run comes to rest.

    Raises:
        ConvergenceError: no equilibrium was found near it.
    """
    soft = SoftState.at_rest(state.soft.positions, state.soft.memory, state.soft.touching)
    return side.rest_near(soft, state.flange, state.loads, ITERATIONS_MAX, PATIENCE)


def shape_figures(side: SoftArm, shape: Array, flange: tuple[Array, Array]) -> dict[str, Any]:
    """Return tip (3,) [m], sag, length [m], volume [m^3], largest strain of the stiffeners, None without.

    Args:
        side: whose body it is.
        shape: (n, 3) [m].
        flange: its origin (3,) [m] and z axis (3,).
    """
    found = side.shape_reader().figures([shape])
    strain = stiffener_strain(side.body, shape)
    return {
        "tip_m": found.tip_position[0],
        "sag_m": float(found.sag_m(flange[0][None], flange[1][None])[0]),
        "length_m": float(found.center_line_m[0]),
        "volume_m3": float(found.volumes_m3[0].sum()),
        "peak_strain": None if strain is None else strain.peak,
    }


def differences(one: dict[str, Any], other: dict[str, Any]) -> dict[str, float]:
    """Return how far the figures of two shapes are apart, those that both have."""
    return {
        key: float(np.linalg.norm(np.subtract(value, other[key])))
        for key, value in one.items()
        if value is not None and other[key] is not None
    }


_TANGENT: Final = {"dynamic": 40, "quasistatic": 6}
"""Iterations of the run that one on the refined mesh costs: those of ticks mostly keep a tangent."""
_CHAIN: Final = 1.0 / 40.0
"""Of an iteration of the film, one of a section model."""
_USUAL: Final = 10  # iterations that a state takes on the refined mesh
_SHARE: Final = 1.0 / 3.0  # of the run's cost, that of all phases at most; else it is the last one alone
_MOST: Final = 4.0  # times the run's cost, that of the last phase at most
FILM_NODES_MAX: Final = 2500
"""Of the film of a section model: with more, a phase takes 10 s and longer, a run a second or two."""
_ITERATION_S: Final = 5e-6  # a node
_TOLD_ABOVE_S: Final = 1.0


@final
class ErrorFinder:
    """Follows a run, and works out at its end how far its figures may be off.

    Attribute `ends`: of the phases that have ended.

    Args:
        parts: of the run.
        refined: returns the film on its mesh refined so many times, or says why there is no such mesh.
    """

    def __init__(self, parts: Parts, refined: Callable[[int], SoftArm] | str) -> None:
        self._parts, self._refined = parts, refined
        scenario, phases = parts.scenario, [planned.phase for planned in parts.plan.phases]
        self._statics = scenario.mode == "quasistatic"
        self._counts = [
            phase.increments if self._statics else parts.scenario.ticks(phase) for phase in phases
        ]
        self._ends_at = {tick: phase for phase, tick in enumerate(accumulate(self._counts))}
        self.ends: list[PhaseEnd] = []
        self._pairs: dict[int, Pair] = {}
        self._most = math.inf  # iterations on the refined mesh, failed factorisations included
        self._branched: dict[int, str] = {}
        self._swings: Swings | None = None
        self._films: dict[int, SoftArmState] = {}
        soft = parts.soft
        if not self._statics and isinstance(soft, SoftArm):
            self._swings = Swings(soft.body, scenario.clock.tick_s, soft.dynamics)

    @property
    def _chain(self) -> SectionArm | None:
        """The section model of the run, if it has one."""
        soft = self._parts.soft
        return soft if isinstance(soft, SectionArm) else None

    @cached_property
    def source(self) -> SourceFilm | None:
        """The film that the section model of the run was condensed from; None of a run with a film."""
        chain, refined = self._chain, self._refined
        return SourceFilm(chain, refined(0)) if chain is not None and callable(refined) else None

    @property
    def side(self) -> SoftArm:
        """The soft robot of the run, on its mesh."""
        soft = self._parts.soft if self.source is None else self.source.film
        assert isinstance(soft, SoftArm), "nothing else has a refined mesh"
        return soft

    def observe(self, batch: TickBatch) -> None:
        """Take in ticks; they come in order, and the run is where the last of them has led."""
        phase, side = int(batch.phase[-1]), self._parts.soft
        if isinstance(side, SoftArm | SectionArm) and batch.branchings:
            here: Any = side.shape_now()
            length_m = float(side.shape_reader().figures([here]).center_line_m[0])
            if any(_leaps(each, length_m) for passed in batch.branchings.values() for each in passed):
                self._branched[phase] = _BRANCHES
        if self._swings is not None:
            self._swings.observe(batch.film.node_position())
        if self._ends_at.get(int(batch.tick[-1])) != phase or not isinstance(side, SoftArm | SectionArm):
            return
        state, footing = side.full_state, batch.footing.get(len(batch) - 1)
        why_not = self._branched.get(phase, "")
        if batch.slides[-1]:
            why_not = _SNAPS
        elif batch.contacts[-1]:
            why_not = _TOUCHES
        elif footing is not None and (stands := footing.stability(())) != "stable":
            why_not = f"the soft robot is {stands} at its end, where a small difference may move it far"
        self.ends.append(PhaseEnd(phase, state, self._swings.ticks if self._swings else 0, why_not))

    def find(self, iterations: int, tell: Callable[[str], None], *, everywhere: bool = False) -> RunErrors:
        """Return the errors, at all phase ends, or at the last where they would cost much of the run.

        Args:
            iterations: that the run has taken.
            tell: told in a sentence if it takes more than a second.
            everywhere: at all phase ends, whatever it costs.
        """
        began, refined, chain = time.perf_counter(), self._refined, self._chain
        if isinstance(refined, str) or not self.ends:
            return RunErrors(
                reason=refined if isinstance(refined, str) else "the run ended before a phase did"
            )
        cost = iterations / _TANGENT[self._parts.scenario.mode] * (1.0 if chain is None else _CHAIN)
        if not everywhere and (why := _too_dear(cost, chain)):
            return RunErrors(reason=why)
        self._most = math.inf if everywhere or chain is not None else cost
        side, soft = self.side, self._parts.soft
        saved, found = soft.full_state, dict[int, dict[str, Any]]()
        whole = len(self.ends) == len(self._counts)
        reason = None if whole else "only of the phases that ended since the run was resumed"
        if len(self.ends) * _USUAL * 4 * side.body.nodes * _ITERATION_S > _TOLD_ABOVE_S:
            tell("Working out how far the figures may be off")
        try:
            mesh, dear = FinerMesh(side.body, refined(1)), False
            for place in reversed(range(len(self.ends))):
                if len(found) == 1 and not everywhere:
                    dear = mesh.side.effort.work / max(1, len(self._pairs)) * len(self.ends) > _SHARE * cost
                if dear and place not in self._pairs:  # what the last one has needed is there
                    reason = _DEAR
                    continue
                found[self.ends[place].phase] = self._of(place, mesh)
        except MeshError as error:
            reason = str(error)
        finally:
            soft.full_state = saved
        return RunErrors(found, reason, mesh.iterations, time.perf_counter() - began)

    def _film(self, place: int) -> SoftArmState:
        """Return the film at the end of a phase; that of a section model in the shape of its chain."""
        state = self.ends[place].state
        if isinstance(state, SoftArmState):
            return state
        assert self.source is not None, "only a run with a section model has such states"
        if place not in self._films:
            self._films[place] = self.source.state(state)
        return self._films[place]

    def _of(self, place: int, mesh: FinerMesh) -> dict[str, Any]:
        """Return the bars of a phase's end, of what they are made, and why there is none."""
        none: dict[str, Any] = dict.fromkeys(FIGURES)
        try:
            parts, why_not = self._compared(place, mesh)
        except ConvergenceError:
            parts, why_not = {}, _NOT_AT_REST
        except TooDearError:
            parts, why_not = {}, _TOO_DEAR
        if why_not:
            return none | {"reason": why_not}
        bars = {key: sum(part.get(key, 0.0) for part in parts.values()) for key in parts["of_mesh"]}
        return none | bars | parts | {"reason": None}

    def _pair(self, place: int, mesh: FinerMesh) -> Pair | None:
        """Return the states at rest at the end of a phase; None where it is not known how it is held.

        Raises:
            ConvergenceError: no equilibrium was found near that of the run.
            TooDearError: it is not there yet, and all that it may cost is spent.
        """
        if place not in self._pairs:
            film, side, before = self._film(place), self.side, None
            if not film.clamp.holds_as(Clamp.of_base(side.body)):
                # what is held since then is held where it was
                same = (k for k in range(place, -1, -1) if not self._film(k).clamp.holds_as(film.clamp))
                since = next(same, -1)
                before = self._pair(since, mesh) if since >= 0 and not self.ends[since].why_not else None
                if before is None:
                    return None
            along, clamp = before, mesh.clamp(film.clamp)
            if before is not None:
                clamp = mesh.clamp(film.clamp, (before.clamp, before.finer))
                if not self.ends[place - 1].why_not:
                    along = self._pair(place - 1, mesh)
            if mesh.side.effort.work > self._most:
                raise TooDearError
            rest = self._at_rest(place, mesh)
            try:
                finer = mesh.at_rest(clamp, rest, along and (along.rest, along.finer))
            except ConvergenceError:
                earlier = self._earlier(place, mesh)
                if earlier is None:
                    raise
                finer = mesh.followed(clamp, rest, earlier.finer)
            self._pairs[place] = Pair(rest, finer, clamp)
        return self._pairs[place]

    def _at_rest(self, place: int, mesh: FinerMesh) -> Equilibrium:
        """Return the film at rest at the end of a phase.

        The film that a bent chain draws may have folds that no film has: then it is followed there.

        Raises:
            ConvergenceError: no equilibrium was found near that of the run.
        """
        side, film = self.side, self._film(place)
        side.full_state = film
        try:
            return at_rest(side, film)
        except ConvergenceError:
            earlier = None if self.source is None else self._earlier(place, mesh)
            if earlier is None:
                raise
            side.settle(earlier.rest)
            return side.follow(earlier.rest, film.flange, film.loads)

    def _earlier(self, place: int, mesh: FinerMesh) -> Pair | None:
        """Return the states at rest one phase earlier, if the film was held in the same way."""
        if not place or self.ends[place - 1].why_not:
            return None
        clamps = [self._film(k).clamp for k in (place - 1, place)]
        return self._pair(place - 1, mesh) if clamps[0].holds_as(clamps[1]) else None

    def _compared(self, place: int, mesh: FinerMesh) -> tuple[dict[str, Any], str]:
        """Return the parts of the bars; or why there are none.

        Raises:
            ConvergenceError: there is no state at rest near that of the run.
            TooDearError: all that it may cost is spent before.
        """
        end, side = self.ends[place], self.side
        pair = None if end.why_not else self._pair(place, mesh)
        if pair is None:
            return {}, end.why_not or _HELD
        film = self._film(place)
        side.full_state = film
        mesh.hold(pair.clamp)
        frame = (film.flange.translation, film.flange.rotation[:, 2])
        here = shape_figures(side, pair.rest.state.positions, frame)
        away = differences(here, shape_figures(mesh.side, pair.finer.state.positions, frame))
        if pair.rest.negative_pivots or pair.finer.negative_pivots:
            return {}, "the state at rest near its end is unstable"
        if away["tip_m"] > _ELSEWHERE * here["length_m"]:
            return {}, "the refined mesh comes to rest on another branch, far away"
        wanted = self._wanted(end)
        calibration = calibration_of(self._parts.scenario)
        away = apart(away, here, calibration) | self._of_tension(wanted, pair, mesh, away["tip_m"])
        parts: dict[str, Any] = {}
        if isinstance(end.state, SectionArmState):
            parts["of_section"] = self._of_section(end.state, here, wanted, pair)
        return parts | {
            "of_mesh": {key: calibration.factors[key] * value for key, value in away.items()},
            "of_tick": {} if self._swings is None else self._of_tick(end.ticks, film, pair.rest),
            "of_solver": dict.fromkeys(("tip_m", "sag_m", "length_m"), self._of_solver(side, pair.rest)),
        }, ""

    def _wanted(self, end: PhaseEnd) -> tip_target.TipTarget | None:
        """Return the target that cables bring the tip to in a phase, if there is one."""
        target = self._parts.plan.phases[end.phase].phase.tip_target
        return wanted_tip(target) if target is not None and target.reach_with == "cables" else None

    def _of_tension(
        self, wanted: tip_target.TipTarget | None, pair: Pair, mesh: FinerMesh, tip_m: float
    ) -> dict[str, float]:
        """Return how far the tensions are apart that a phase's target is reached with on both meshes."""
        if wanted is None:
            return {}
        with suppress(UnreachableError, ConvergenceError, OutOfRangeError):
            sides = ((self.side, pair.rest), (mesh.side, pair.finer))
            pulled = [each.find_tensions(at, wanted).loads for each, at in sides]
            slope = self.side.tension_slope(pair.rest, wanted)
            most_N, away_N = max(pulled[0].cable_tension_N), tension_difference(*pulled)
            return {"cable_tension_N": tension_apart(most_N, away_N, slope * tip_m)}
        return {}

    def _of_section(
        self, state: SectionArmState, here: dict[str, Any], wanted: tip_target.TipTarget | None, pair: Pair
    ) -> dict[str, float]:
        """Return how far the chain of a section model is off its film, where both are at rest."""
        source = self.source
        assert source is not None, "of a run with a section model"
        rest = source.chain_at_rest(state)
        frame = (state.flange.translation, state.flange.rotation[:, 2])
        own = shape_figures(self.side, rest.state.positions, frame)
        away = differences(own | {"volume_m3": sum(source.chain.volumes_m3)}, here)
        if wanted is not None:
            with suppress(UnreachableError, ConvergenceError, OutOfRangeError):
                pulled = source.chain.find_tensions(rest, wanted), self.side.find_tensions(pair.rest, wanted)
                away["cable_tension_N"] = tension_difference(*(each.loads for each in pulled))
        return away

    def _of_solver(self, side: SoftArm, rest: Equilibrium) -> float:
        """Return how far what the solver leaves moves the tip [m]."""
        solver = side.equilibrium_solver.solver
        options = self._parts.scenario.solver
        tolerance_N = options.residual_tolerance_N if self._statics else options.dynamic_tolerance_N
        state, frame = rest.state, rest.world_from_flange.rotation
        if not solver.factorise(state.positions, state.memory, rest.loads, None, frame):
            return math.inf
        return tolerance_N * float(np.linalg.norm(solver.linear.solve_all(tip_pulls(side.body))))

    def _of_tick(self, ticks: int, film: SoftArmState, rest: Equilibrium) -> dict[str, float]:
        """Return how far ticks may have brought the figures off, besides those at rest."""
        side, shape, modes, swings = self.side, film.soft.positions, Modes.of(self.side, rest), self._swings
        if modes is None or swings is None:
            return dict.fromkeys(FIGURES, math.inf)
        frame = (film.flange.translation, film.flange.rotation[:, 2])
        now = shape_figures(side, shape, frame)
        off = [differences(now, shape_figures(side, shape + by, frame)) for by in swings.apart(modes, ticks)]
        return {key: TICK_FACTOR * math.hypot(*(each[key] for each in off)) for key in off[0]}


def _too_dear(cost: float, chain: SectionArm | None) -> str:
    """Return why even one phase end is too dear unasked, for a run that cost so much; empty if not."""
    if chain is None:
        return _TOO_DEAR if cost * _MOST < _USUAL else ""
    nodes = chain.body.nodes
    if nodes <= FILM_NODES_MAX:
        return ""
    return f"with a film of {nodes} nodes it takes 10 s and longer; --error works it out all the same"


def _leaps(passed: branching.Branching, length_m: float) -> bool:
    """Return whether more than a wrinkle moves: the body branches, or snaps farther than a bar could tell."""
    before, after = passed.other_tip_m, passed.tip_m
    if passed.extent < branching.WHOLE or not passed.snap or before is None or after is None:
        return passed.extent >= branching.WHOLE
    return math.dist(before, after) >= _LEAP * length_m


def apart(away: dict[str, float], here: dict[str, Any], calibration: Calibration) -> dict[str, float]:
    """Return how far figures are taken to be apart on two meshes.

    A coarse mesh holds too little gas, whichever way that moves the tip. Tip, sag and length are off by at
    least half of max(|tip|, length |dV| / V), or of |tip|.

    Args:
        away: how far they were found apart.
        here: on the run's mesh, its length [m] and volume [m^3].
        calibration: says which.
    """
    counts = calibration.of_volume and here["volume_m3"] > 0.0
    filled = here["length_m"] * away["volume_m3"] / here["volume_m3"] if counts else 0.0
    least = _OF_SHAPE * max(away["tip_m"], filled)
    return away | {key: max(away[key], least) for key in ("tip_m", "sag_m", "length_m")}


def tension_apart(most_N: float, away_N: float, of_tip_N: float) -> float:
    """Return how far the tensions for a target are taken to be apart on two meshes [N].

    Near the free height two meshes may agree by chance, though their tips do not. What each of three asks
    for is added as independent errors are: root of the sum of squares.

    Args:
        most_N: the largest, on the run's mesh.
        away_N: difference of what was found on both.
        of_tip_N: what makes good for the difference of the tips under equal tensions, slope times difference.
    """
    return math.hypot(away_N, _OF_SHAPE * of_tip_N, _OF_TENSION * most_N)


def tension_difference(one: Loads, other: Loads) -> float:
    """Return the largest difference of a cable's tension [N]."""
    return float(np.abs(np.subtract(one.cable_tension_N, other.cable_tension_N)).max())
