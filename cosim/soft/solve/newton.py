"""Newton's method with exact Hessians on the potential of a soft body: who gives the kernel what it asks for.

The iterations are those of `film_step`. Here are the factorisation, the shift mu where the tangent is
indefinite, and terms that kernels do not know.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernel_types import nothing_of
from cosim.base.kernels import RecordStore
from cosim.errors import InputError
from cosim.soft.body.loads import Loads
from cosim.soft.contact.self_contact_pairs import pair_calls
from cosim.soft.elements import element, mass_terms
from cosim.soft.elements.open_caps import OpenCapSolver, RimArrays
from cosim.soft.film import step_arrays
from cosim.soft.film.film_terms import FilmActing, film_terms
from cosim.soft.film.step_arrays import ASKS, NODES, TANGENT, NewTangents, StepNumbers, StepWork, WideTangent
from cosim.soft.linear import kept_factor, linear_solver, secant_pairs
from cosim.soft.linear.cholesky import EnvelopeCholesky, cholesky
from cosim.soft.linear.kept_factor import DefiniteTangent, KeptEnvelope, KeptFactor, NewtonState, nothing_kept
from cosim.soft.linear.linear_solver import NODE, EnvelopeArrays, LinearSolver, ShiftSearch, negative_pivots
from cosim.soft.linear.pattern import BlockPattern, check_widened
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.film_step import FilmSide, film_step, step_calls
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome, TickWork, say_nothing
from cosim.soft.solve.state import HeldNodes

_STATICS = (False, 0.0, 0.0, 0.0, 0.0, 0.0)
_NOTHING_HELD = HeldNodes(
    np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), np.bool_), np.zeros(0, np.int64)
)


@final
@dataclass(frozen=True)
class NewtonTask:
    """What is solved.

    Args:
        loads: that act.
        share: (segments, COLUMNS), see `SoftSystem.segment_share`.
        inertia: of an implicit step; None in statics.
        kind: tells apart tangents that cannot replace each other: statics, or the step's inertia.
        numbers: of the iteration.
        held: by the flange.
        apart: whether parts that nothing couples are solved one by one.
    """

    loads: Loads
    share: Array
    inertia: mass_terms.Inertia | None
    kind: float
    numbers: StepNumbers
    held: HeldNodes = _NOTHING_HELD
    apart: bool = False


@final
@dataclass
class NewtonProgress:
    """Where a solution is, and what it has taken so far; of several parts those that took most count.

    Args:
        task: what is solved.
        motion: whose end is moved.
        options: bounds.
        reused: iterations with a kept factorisation.
        tangents: the same with a new one.
        shifts: factorisations beyond one a tangent.
        shifted: tangents that were indefinite.
        residual: [N].
        energy: [J].
    """

    task: NewtonTask
    motion: step_arrays.StepMotion
    options: NewtonOptions
    reused: int = 0
    tangents: int = 0
    shifts: int = 0
    shifted: int = 0
    residual: float = math.inf
    energy: float = math.inf

    def result(self, outcome: Outcome) -> NewtonResult:
        """Return how it has ended."""
        motion, spent = self.motion, self.reused + self.tangents
        return NewtonResult(
            motion.new_x, motion.new_memory, outcome, self.residual, spent, self.tangents + self.shifts,
            self.energy, self.shifted, failed=self.shifts,
        )  # fmt: skip

    @property
    def factorised(self) -> int:
        """Iterations with a new tangent, and further attempts to factorise one."""
        return self.tangents + self.shifts

    @property
    def frame(self) -> Array:
        """Rotation (3, 3) of the flange."""
        return np.ascontiguousarray(self.motion.flange[1:].T)


@final
class NewtonSolver:
    """Newton's method for one body with given clamped nodes or components; owns the factorisation.

    Args:
        system: assembled body.
        clamped: (n,) bool, nodes whose positions are given, or (n, 3) bool, world components that are
            given: a node on a plane of symmetry has one.
        symmetric: whether it takes the symmetric part of a tangent that is not, to see whether it is positive
            definite; solutions take the whole.
        like: one with the same body and clamp, whose order of elimination is taken over.
    """

    def __init__(
        self,
        system: SoftSystem,
        clamped: Mask,
        *,
        symmetric: bool = False,
        like: "NewtonSolver | None" = None,
    ) -> None:
        self.system, self._symmetric = system, symmetric
        self.clamped = clamped
        self.free = np.ascontiguousarray(linear_solver.by_component(~clamped))
        self._narrow: LinearSolver = self._solver_for(system.pattern, None if like is None else like._narrow)
        self.linear: LinearSolver = self._narrow
        self._kept = nothing_kept(self.linear.apart)
        self._shifts = ShiftSearch()
        self._definite: DefiniteTangent | None = None
        self.store = RecordStore(FilmSide)  # where kernels read what this solver gives them
        self._last_wide: tuple[BlockPattern, WideTangent] | None = None
        self.watch: Callable[[int], None] = say_nothing  # told the iterations so far after each round of them
        self.tick_work: TickWork | None = None  # counts the iterations of time steps

    def solve(
        self,
        start: Array,
        memory: Array,
        loads: Loads,
        options: NewtonOptions,
        inertia: mass_terms.Inertia | None = None,
        frame: Array | None = None,
    ) -> NewtonResult:
        """Find the stationary point of the potential near `start`.

        In statics what elements find by themselves is looked at again: a ring of beams on a saddle would stay
        there otherwise; in motion it is left by itself.

        Args:
            start: (n, 3) [m], clamped nodes and components where they shall be.
            memory: (values,), what the elements remember of the last accepted state.
            loads: pressure, tension, gravity.
            options: bounds.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange; a factorisation that is kept turns with it.
        """
        system, x = self.system, np.array(start, order="C")
        moving = inertia is not None and inertia.step_s < math.inf and not inertia.closely
        remembered = memory.copy() if moving else system.fresh(memory)
        flange = np.zeros((4, 3))
        flange[1:] = np.eye(3) if frame is None else frame.T
        motion = step_arrays.StepMotion(x, x, x, x, remembered, flange, x, x, remembered)
        kind = 0.0 if inertia is None else float(inertia.coefficient.sum())
        share = system.segment_share(x, loads, remembered)
        solution = NewtonProgress(
            NewtonTask(loads, share, inertia, kind, self.numbers(options, loads)), motion, options
        )
        outcome = self.go_on(
            solution, step_arrays.StepPlace(step_arrays.BEGINS, options.reuse_max, options.iterations_max)
        )
        if outcome in (Outcome.ITERATION_LIMIT, Outcome.NO_DESCENT):
            reference = motion.new_memory.copy()
            system.evaluate(x, loads, share, reference, inertia=inertia, hessian=False)
            motion.new_memory[:] = system.memory
        found = solution.result(outcome)
        stable = inertia is None and system.conservative and found.converged
        if stable and self._stays_definite(solution, start):
            return replace(found, negative_pivots=0)
        return found

    def _stays_definite(self, solution: NewtonProgress, start: Array) -> bool:
        """Return whether the tangent at the end of a static solution is seen to be positive definite.

        One that was made on the way was so. From there on pivots fall as they fell since the one before it;
        where that is not known, or by too much, the end has to be looked at.

        Args:
            solution: which has converged.
            start: (n, 3) [m], where it began.
        """
        if not all(self._kept):
            return False
        envelope, end = self.linear, self._seen(solution.motion.new_x, solution.frame)
        if not isinstance(envelope, EnvelopeCholesky) or envelope.correction is not None:
            return solution.tangents > 0 and not solution.reused and len(self._kept) == 1
        if not solution.tangents:
            return self._definite is not None and self._definite.reaches(end)
        # the only one was made at the start unless a kept one served before; others somewhere beyond
        at_start = solution.tangents == 1 and solution.reused == self.parts[:, step_arrays.RUN].max()
        begin = self._seen(start, solution.frame)
        last = end if not at_start else begin
        self._definite = made = DefiniteTangent.after(self._definite, envelope.pivots, begin, last)
        return made.reaches(end, begin)

    def _seen(self, positions: Array, frame: Array) -> Array:
        """Return positions (n, 3) [m] as `DefiniteTangent` has them."""
        return np.asarray((positions - positions.mean(axis=0)) @ frame)

    def numbers(
        self,
        options: NewtonOptions,
        loads: Loads,
        step: tuple[bool, float, float, float, float, float] = _STATICS,
    ) -> StepNumbers:
        """Return the numbers of an iteration with some bounds.

        Args:
            options: bounds.
            loads: that act.
            step: the first six of `StepNumbers`.
        """
        return StepNumbers(
            *step, options.tolerance_N, options.start_tolerance_N, options.reuse_rate, options.reuse_below_N,
            options.step_max_m, options.halvings_max, self.system.conservative,
            self.system.complete and loads.extra is None,
        )  # fmt: skip

    def go_on(self, solution: NewtonProgress, place: step_arrays.StepPlace) -> Outcome:
        """Iterate until a solution has converged or cannot continue.

        Args:
            solution: is moved.
            place: where it continues.

        Raises:
            TickWorkError: the tick has taken too many iterations.
        """
        loads = solution.task.loads
        plain, touching = loads.arrays(self.system.gas.count), loads.touching
        counted = solution.factorised
        while True:
            side = self.side(solution.task)
            found = film_step(self.store.address(side), plain, touching, solution.motion, place)
            converged, served, solution.tangents, solution.residual, solution.energy = found
            self.take_over(side.kept, solution.task.kind)
            solution.reused += served
            if converged:
                return Outcome.CONVERGED
            self.watch(solution.tangents + solution.reused)
            if self.tick_work is not None and solution.task.inertia is not None:
                weight = max(1.0, self.linear.multiplications / self._narrow.multiplications)
                self.tick_work.spend(weight * (solution.factorised - counted), solution.residual)
                counted = solution.factorised
            parts = side.work.parts[: len(side.film.parts) - 1]
            asking = np.flatnonzero(parts[:, ASKS])
            finite, asked = math.isfinite(solution.residual), parts[asking, ASKS]
            if not len(asking) or (solution.tangents >= place.tangents_max and (asked == TANGENT).any()):
                return Outcome.ITERATION_LIMIT if finite else Outcome.NOT_FINITE
            if (parts[asking, ASKS] == TANGENT).any() and self._owns_factor_now():
                attempts = [0]  # the kernel makes it
            else:
                attempts = [self._answer(solution, side, k) for k in asking.tolist()]
            most = max(map(abs, attempts))
            solution.shifts += max(most - 1, 0)
            solution.shifted += most > 1
            if min(attempts) < 0:
                solution.shifts += 1
                return Outcome.INDEFINITE
            if (parts[asking, ASKS] == step_arrays.STUCK).any():
                return Outcome.NO_DESCENT
            place = place._replace(begins=step_arrays.GOES_ON)

    def side(self, task: NewtonTask) -> FilmSide:
        """Return what the kernel takes for a task."""
        system = self.system
        _, more, _, bed = system.acting(task.loads, task.share, task.inertia)
        film, at = (system.film, system.at) if task.apart else (system.whole_film, system.whole_at)
        own = task.loads.extra is None and not len(more.coefficients)
        tangents = self._tangents(film) if own else self._no_tangents
        kept, work = self._kept_arrays(task.kind), self._work._replace(film=at, more=more)
        rims = self.linear.rims if isinstance(self.linear, OpenCapSolver) and tangents.first.size else None
        return FilmSide(film, bed, kept, tangents, task.held, task.numbers, work, rims or self._no_rims)

    def _owns_factor_now(self) -> bool:
        """Leave a factorisation that a saved state holds to it; return whether it was held."""
        linear = self.linear
        if isinstance(linear, OpenCapSolver):
            caps = self.system.open_cap_stiffness(self.system.body.positions)
            return linear.leave_lent(tuple(ring for ring, _ in caps))
        return isinstance(linear, EnvelopeCholesky) and linear.leave_lent()

    def _answer(self, solution: NewtonProgress, side: FilmSide, part: int) -> int:
        """Give a part what it asks for; return the attempts to factorise, negative if all have failed."""
        work, motion, task = side.work, solution.motion, solution.task
        state = work.parts[part]
        if state[ASKS] == step_arrays.EVALUATION:
            given = motion.new_x, task.loads, task.share, work.reference
            state[step_arrays.TRIED] = self.system.evaluate(*given, inertia=task.inertia, hessian=False)
            motion.new_memory[:], state[ASKS] = self.system.memory, step_arrays.EVALUATED
        elif state[ASKS] == step_arrays.SOLUTION:
            kept, pairs, known = self._kept[0], work.pairs, int(state[step_arrays.PAIRS_KNOWN])
            assert kept is not None, "the kernel asks for it where there is one"
            load = np.empty_like(work.served[1])
            secant_pairs.bend_load(pairs, known, work.served[1], load)
            # from the rotation of the factorisation to the present one
            step = np.ascontiguousarray(self.linear.solve(load, solution.frame @ kept.frame.T))
            secant_pairs.mend_step(pairs, known, step)
            work.solution[0], state[ASKS] = step, step_arrays.SOLVED
        elif state[ASKS] == TANGENT or (
            state[ASKS] == step_arrays.PATTERN and not self._changes_pattern(solution)
        ):
            return self._with_tangent(solution, side, part)
        elif state[ASKS] == step_arrays.PATTERN:
            state[ASKS] = step_arrays.WIDENED
        return 0

    def _changes_pattern(self, solution: NewtonProgress) -> bool:
        """Take the pattern for the films that touch at present; return whether it is another one."""
        system, before, films = self.system, self.linear.pattern, solution.task.loads.self_contact
        wanted = system.pattern
        if films is not None:
            films.add(solution.motion.new_x, element.Sums(np.zeros_like(system.gradient)), hessian=False)
            if len(films.acting):
                wanted = system.widening.around(films.near, before).pattern
        self._fit(wanted)
        return wanted is not before

    def _with_tangent(self, solution: NewtonProgress, side: FilmSide, part: int) -> int:
        """Make a new tangent of a part, and the step with it; return the attempts, negative if all failed."""
        several, gradient = len(side.film.parts) > 2, self.system.gradient
        self._assemble(solution, side, part)
        attempts = self._factor(solution.motion.new_x, solution.options, part if several else None)
        kept = KeptFactor(solution.task.kind, solution.frame) if attempts == 1 else None
        self.keep(kept, part if several else None)
        if attempts > 0:
            begin, end = side.film.parts[part : part + 2, NODES]
            load = np.zeros_like(gradient)
            load[begin:end] = -gradient[begin:end]
            side.work.solution[0, begin:end] = self.linear.solve(load)[begin:end]
            side.work.parts[part, [ASKS, step_arrays.SEARCHES]] = step_arrays.SOLVED, 1.0
        return attempts

    def _assemble(self, solution: NewtonProgress, side: FilmSide, part: int) -> None:
        """Assemble the tangent of a part where it is."""
        system, work, x = self.system, side.work, solution.motion.new_x
        loads, share, inertia = solution.task.loads, solution.task.share, solution.task.inertia
        system.serving = self.linear.pattern
        if len(side.film.parts) == 2:
            system.evaluate(x, loads, share, work.reference.copy(), inertia=inertia)
            return
        system.take_own_tangent(slice(*side.film.parts[part : part + 2, NODES].tolist()))
        acting: FilmActing = system.acting(loads, share, inertia)
        point = step_arrays.FilmPoint(
            x, work.reference, system.memory, system.gradient, system.blocks, work.pull
        )
        film_terms(side.work.film, system.slots, acting, part, point)

    def negative_pivots(self, positions: Array, memory: Array, loads: Loads) -> int:
        """Return how many negative eigenvalues the tangent of the free components has in statics.

        Sealed gas and commanded lengths count as well; of loads without a potential the symmetric part does.
        The factorisation in store stays.

        Args:
            positions: (n, 3) [m].
            memory: (values,), what the elements remember there.
            loads: that act.
        """
        system = self.system
        gradient, tracked = system.gradient.copy(), system.memory.copy()
        share = system.segment_share(positions, loads, memory)
        system.evaluate(positions, loads, share, memory)
        system.gradient[:], system.memory[:] = gradient, tracked
        system.add_open_caps(positions)
        return negative_pivots(system.tangent_pattern, self.free, system.tangent_blocks, system.low_rank)

    def factorise(
        self, positions: Array, memory: Array, loads: Loads, inertia: mass_terms.Inertia | None, frame: Array
    ) -> bool:
        """Factorise the tangent at a given shape into `linear`; False where it is indefinite.

        Args:
            positions: (n, 3) [m].
            memory: (values,), what the elements remember there.
            loads: that act.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange.
        """
        system = self.system
        gradient, share = system.gradient.copy(), system.segment_share(positions, loads, memory)
        system.serving = self.linear.pattern
        system.evaluate(positions, loads, share, memory, inertia=inertia)
        system.gradient[:] = gradient
        if self._symmetric:
            system.add_open_caps(positions)
        definite = self._fitted_solver(positions).factor(system.tangent_blocks, low_rank=system.low_rank)
        kind = 0.0 if inertia is None else float(inertia.coefficient.sum())
        self.keep(KeptFactor(kind, frame) if definite else None)
        if inertia is None and definite and isinstance(self.linear, EnvelopeCholesky):
            place = self._seen(positions, frame)
            self._definite = DefiniteTangent.after(self._definite, self.linear.pivots, place, place)
        return definite

    @property
    def kept(self) -> tuple[KeptFactor | None, ...]:
        """For what each part of the factorisation in `linear` was made; None where none is kept."""
        return self._kept

    def keep(self, kept: KeptFactor | None, part: int | None = None) -> None:
        """Remember for what the factorisation was made, of a part or of all."""
        self._kept = tuple(kept if part in (None, k) else before for k, before in enumerate(self._kept))

    def save_state(self) -> NewtonState:
        """Return what the next solution depends on besides its arguments."""
        factor = self.linear.save_state() if any(self._kept) else None
        wide = None if self.linear is self._narrow else self.linear.pattern
        return NewtonState(self._kept, factor, self.system.gradient.copy(), wide, self._definite)

    def restore_state(self, state: NewtonState) -> None:
        """Return to a state of `save_state`, of a solver with the same clamp."""
        if state.wide is not None:
            check_widened(self.system.pattern, state.wide)
        if any(state.kept) is (state.factor is None):
            raise InputError("the saved factorisation is not whole")
        self._fit(self.system.pattern if state.wide is None else state.wide)
        if len(state.kept) != len(self._kept):
            raise InputError(f"the saved factorisation has {len(state.kept)} parts, not {len(self._kept)}")
        self._kept = state.kept
        if state.factor is not None:
            self.linear.restore_state(state.factor)
        self.system.gradient[:], self._definite = state.gradient, state.definite

    def take_over(self, kept: KeptEnvelope, kind: float) -> None:
        """Take in which parts of the factorisation the kernel has rebuilt, or lost, and how others served.

        Args:
            kept: as the kernel has left it.
            kind: see `NewtonTask`.
        """
        counts = kept.made.tolist(), kept.there.tolist(), kept.extra.tolist()  # empty of no factorisation
        for k, (before, made, there, extra) in enumerate(zip(self._kept, *counts, strict=False)):
            if made:
                self.system.serving = self.linear.pattern
            elif not there or before is None or before.extra == extra:
                continue
            frame = kept.frame[k].copy() if made or before is None else before.frame
            self.keep(KeptFactor(kind, frame, extra) if there else None, k)
        kept.made[:] = 0

    def _kept_arrays(self, kind: float) -> KeptEnvelope:
        """Return the factorisation in store as the kernel takes it."""
        linear, parts, envelope = self.linear, self._kept, self.envelope
        there = [kept is not None and kept.kind == kind for kept in parts]
        extra = np.array([0 if kept is None else kept.extra for kept in parts])
        if envelope is None:
            # of a kind that the kernel does not know it asks for the solutions; never of a part
            outside = np.array([kept_factor.OUTSIDE if all(there) else 0])
            return self._nothing_kept._replace(there=outside, extra=extra[:1])
        frames = np.array([np.eye(3) if kept is None else kept.frame for kept in parts])
        counts = np.array(there, np.int64), np.zeros(len(parts), np.int64)
        closed = linear.closed if isinstance(linear, OpenCapSolver) else linear
        entries = closed.entries if isinstance(closed, EnvelopeCholesky) else self._nothing_kept.entries
        dense, correction = self._no_dense, linear.correction
        if correction is not None:
            room = np.empty((1, *self.free.shape)), np.empty((1, len(correction.inner)))
            dense = (correction.vectors, correction.inner, *room)
        return KeptEnvelope(
            self._envelope_calls, *counts, envelope, entries, extra, frames, *dense, self.free
        )  # fmt: skip

    @property
    def envelope(self) -> EnvelopeArrays | None:
        """The factorisation in store where the kernel knows its kind."""
        return self.linear.envelope

    @cached_property
    def _envelope_calls(self) -> IntArray:
        return kept_factor.envelope_calls()

    @cached_property
    def _no_dense(self) -> tuple[Array, Array, Array, Array]:
        return np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros((0, 0))

    @cached_property
    def _nothing_kept(self) -> KeptEnvelope:
        """What represents no factorisation."""
        nothing: KeptEnvelope = nothing_of(KeptEnvelope)
        table = np.zeros((2, 4), np.int64)
        table[1, NODE] = len(self.free)
        factor, (there, made, extra) = nothing.factor._replace(parts=table), np.zeros((3, 1), np.int64)
        counts = nothing._replace(there=there, made=made, extra=extra)
        return counts._replace(factor=factor, frame=np.eye(3)[None], free=self.free)

    def _tangents(self, film: step_arrays.FilmArrays) -> NewTangents:
        """Where the kernel makes new tangents; nothing where it cannot, or a saved state holds the factor."""
        linear, system = self.linear, self.system
        closed, known = linear, linear.correction is None
        if isinstance(linear, OpenCapSolver):
            closed, known = linear.closed, linear.rims is not None
        if not isinstance(closed, EnvelopeCholesky) or closed.lent or not known or not system.complete:
            return self._no_tangents
        first = np.searchsorted(system.pattern.row, film.parts[:, NODES])
        return NewTangents(system.slots, system.blocks, first, self._wide)

    @property
    def _wide(self) -> WideTangent:
        """Where the kernel assembles a tangent that is not in the body's own pattern."""
        pattern, last = self.linear.pattern, self._last_wide
        if pattern is self.system.pattern:
            return self._no_tangents.wide
        if last is None or last[0] is not pattern:
            coupled = self.system.widening.known(pattern)
            last = self._last_wide = pattern, WideTangent(
                pair_calls()[1], pattern.rows, coupled.of_body, np.empty((pattern.blocks, 3, 3)),
                np.empty(pattern.blocks, np.int64),
            )  # fmt: skip
        return last[1]

    @cached_property
    def _no_rims(self) -> RimArrays:
        nothing: RimArrays = nothing_of(RimArrays)
        return nothing

    @cached_property
    def _no_tangents(self) -> NewTangents:
        nothing: NewTangents = nothing_of(NewTangents)
        return nothing

    @cached_property
    def _work(self) -> StepWork:
        system = self.system
        return StepWork(
            step_calls(), system.gradient, np.empty((1, *system.gradient.shape)),
            np.empty((2, *system.gradient.shape)), secant_pairs.SecantPairs.room(len(system.gradient)),
            np.empty_like(system.memory), np.empty(len(system.film.segments)),
            step_arrays.room_for_parts(len(system.film.parts) - 1), system.at,
            nothing_of(step_arrays.FilmLoads), self.along,
        )  # fmt: skip

    @cached_property
    def along(self) -> Array:
        """(n, 3) [m/s], how fast nodes would be in the last step if they went along with the flange."""
        return np.zeros_like(self.system.gradient)

    @property
    def parts(self) -> Array:
        """(parts, columns), where the last solution is, see `StepWork`."""
        return self._work.parts

    def _factor(self, positions: Array, options: NewtonOptions, part: int | None) -> int:
        """Factorise, with a shift where need be; return the number of attempts, negative if all failed."""
        system, linear = self.system, self._fitted_solver(positions)

        def definite(shift: float) -> bool:
            if part is None:
                return linear.factor(system.tangent_blocks, shift, system.low_rank)
            return linear.factor_part(part, system.tangent_blocks, shift)

        return self._shifts.factor(definite, options.shift_start_N_m, options.shift_max_N_m)

    def _fitted_solver(self, positions: Array) -> LinearSolver:
        """Return the linear solver, made for the pattern of the present tangent."""
        self._fit(self.system.tangent_pattern)
        if isinstance(self.linear, OpenCapSolver):
            # d(gradient)/dx gains what the missing caps take away
            self.linear.extra = self.system.open_cap_stiffness(positions)
        return self.linear

    def _fit(self, pattern: BlockPattern) -> None:
        if self.linear.pattern is not pattern:
            narrow = pattern is self.system.pattern
            self.linear = self._narrow if narrow else self._solver_for(pattern, self._narrow)
            self._kept = nothing_kept(self.linear.apart)

    def _solver_for(self, pattern: BlockPattern, like: LinearSolver | None) -> LinearSolver:
        if self.system.conservative or self._symmetric:
            return cholesky(pattern, self.free, self.system.eyelets, like)
        return OpenCapSolver(pattern, self.free, self.system.eyelets, like)
