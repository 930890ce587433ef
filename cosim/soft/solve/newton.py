"""Newton's method with exact Hessians on the potential of a soft body.

Each iteration solves (K + mu 1) d = -gradient. mu is zero while K is positive definite and grows until
the factor exists otherwise (inertia correction); the step is then halved until the potential falls
(or, for loads without a potential, the work of the out-of-balance force along the step).
The factor of an earlier step or increment may serve for a while, turned with the flange and corrected by what
its steps have shown (`secant_pairs`): an iteration with it costs a tenth, undone when the residual does not
fall. Once those beyond one a solution have cost as much as a new one, it is dropped.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 3.4 and 3.5.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import InputError
from cosim.soft.body.loads import Loads
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.linear.kept_factor import KeptFactor, NewtonState, kept_of_all, nothing_kept, served
from cosim.soft.linear.linear_solver import LinearSolver, by_component
from cosim.soft.linear.multifrontal_cholesky import cholesky
from cosim.soft.linear.pattern import BlockPattern, check_widened
from cosim.soft.linear.secant_pairs import FAR, SecantPairs, bend_load, keep_pair, mend_step
from cosim.soft.linear.shift_search import ShiftSearch
from cosim.soft.published.open_caps import OpenCapSolver
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome, say_nothing
from cosim.soft.solve.problem import MUCH_LESS, Point, Potential, Problem, falls_enough


@final
class NewtonSolver:
    """Newton's method for one body with given clamped nodes or components; owns the factorisation.

    Args:
        system: assembled body.
        clamped: (n,) bool, nodes whose positions are given, or (n, 3) bool, world components that are
            given: a node on a plane of symmetry has one.
    """

    def __init__(self, system: SoftSystem, clamped: Mask) -> None:
        self.system = system
        self.clamped = clamped
        self.free = np.ascontiguousarray(by_component(~clamped))
        self._narrow = self._solver_for(system.pattern, None)
        self.linear: LinearSolver = self._narrow
        self._kept = nothing_kept(self.linear.apart)
        self._shifts = ShiftSearch()
        self.watch: Callable[[int], None] = say_nothing  # told the iterations so far after each new tangent
        self._pairs, self._count = SecantPairs.room(system.body.nodes), 0

    def solve(
        self,
        start: Array,
        memory: Array,
        loads: Loads,
        options: NewtonOptions,
        inertia: Inertia | None = None,
        frame: Array | None = None,
    ) -> NewtonResult:
        """Find the stationary point of the potential near `start`.

        Args:
            start: (n, 3) [m], clamped nodes and components where they shall be.
            memory: (values,), what the elements remember of the last accepted state.
            loads: pressure, tension, gravity.
            options: bounds.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange; a factorisation that is kept turns with it.
        """
        system = self.system
        problem = Problem(system, self.free, loads, system.segment_tension(start, loads), inertia)
        turned, self._count = np.eye(3) if frame is None else frame, 0
        point = problem.begin(np.ascontiguousarray(start), memory)
        memory = system.memory.copy()
        tangents = factorisations = shifted = reused = earlier = 0
        while True:
            outcome = self._verdict(point, tangents, reused, options)
            if outcome not in (None, Outcome.ITERATION_LIMIT):
                break
            if reused < options.reuse_max and point.residual < options.reuse_below_N:
                found = self._reuse(problem, point, memory, turned, options)
                if found is not None:
                    point, reused, memory = found, reused + 1, system.memory.copy()
                    continue
            if outcome is not None:
                point = problem.at(point.positions, memory)
                break
            attempts, found = self.with_tangent(problem, point, memory, turned, options)
            factorisations, shifted = factorisations + abs(attempts), shifted + (abs(attempts) > 1)
            if attempts < 0:
                outcome = Outcome.INDEFINITE
                break
            tangents, earlier = tangents + 1, reused
            if found is None:
                point, outcome = problem.at(point.positions, memory), Outcome.NO_DESCENT
                break
            point, memory = found, system.memory.copy()
            self.watch(tangents + reused)
        self._kept = tuple(served(kept, reused - earlier) for kept in self._kept)
        return NewtonResult(
            point.positions, system.memory.copy(), outcome, point.residual, tangents + reused,
            factorisations, point.energy, shifted,
        )  # fmt: skip

    def with_tangent(
        self,
        problem: Potential,
        point: Point,
        memory: Array,
        frame: Array,
        options: NewtonOptions,
        part: int | None = None,
    ) -> tuple[int, Point | None]:
        """Take one iteration with a new tangent.

        Args:
            problem: of the solution.
            point: where the iteration begins.
            memory: (values,), what the elements remember there.
            frame: (3, 3), rotation of the flange.
            options: bounds.
            part: number of that which the problem is of, see `LinearSolver.apart`; None for all.

        Returns:
            The attempts to factorise, negative if all have failed; the point that is accepted, None for none.
        """
        self.system.serving = self.linear.pattern
        problem.at(point.positions, memory, hessian=True)
        attempts, self._count = self._factor(options, part), 0
        self.keep(KeptFactor(problem.kind, frame) if attempts == 1 else None, part)
        if attempts < 0:
            return attempts, None
        load = -self.system.gradient
        if part is not None:
            begin, end = self.linear.apart[part : part + 2]
            load[:begin], load[end:] = 0.0, 0.0
        step = self.linear.solve(load)
        return attempts, self._search(problem, point, step, memory, options)

    def factorise(
        self, positions: Array, memory: Array, loads: Loads, inertia: Inertia | None, frame: Array
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
        gradient = system.gradient.copy()
        problem = Problem(system, self.free, loads, system.segment_tension(positions, loads), inertia)
        system.serving = self.linear.pattern
        problem.at(positions, memory, hessian=True)
        system.gradient[:] = gradient
        definite = self._fitted_solver().factor(system.tangent_blocks, low_rank=system.low_rank)
        self.keep(KeptFactor(problem.kind, frame) if definite else None)
        return definite

    @property
    def kept(self) -> tuple[KeptFactor | None, ...]:
        """For what each part of the factorisation in `linear` was made; None where none is kept."""
        return self._kept

    @property
    def apart(self) -> IntArray:
        """Where the nodes of parts begin that nothing couples, and their number; see `LinearSolver.apart`."""
        return self._narrow.apart

    def keep(self, kept: KeptFactor | None, part: int | None = None) -> None:
        """Remember for what the factorisation was made, of a part or of all."""
        self._kept = tuple(kept if part in (None, k) else before for k, before in enumerate(self._kept))

    def save_state(self) -> NewtonState:
        """Return what the next solution depends on besides its arguments."""
        factor = self.linear.save_state() if any(self._kept) else None
        wide = None if self.linear is self._narrow else self.linear.pattern
        return NewtonState(self._kept, factor, self.system.gradient.copy(), wide)

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
        self.system.gradient[:] = state.gradient

    @staticmethod
    def _verdict(point: Point, tangents: int, reused: int, options: NewtonOptions) -> Outcome | None:
        if not (math.isfinite(point.residual) and math.isfinite(point.energy)):
            return Outcome.NOT_FINITE
        # many small forces of one sign add up: a start is accepted by the stricter bound only
        moved = tangents + reused > 0
        if point.residual < (options.tolerance_N if moved else options.start_tolerance_N):
            return Outcome.CONVERGED
        return Outcome.ITERATION_LIMIT if tangents >= options.iterations_max else None

    def _reuse(
        self, problem: Problem, point: Point, memory: Array, frame: Array, options: NewtonOptions
    ) -> Point | None:
        """Return the point one step on with the factorisation in store, or None where it does not serve.

        Then the system's gradient may be that of a point that was tried.
        """
        kept, gradient = kept_of_all(self._kept, problem.kind), self.system.gradient.copy()
        if kept is None:
            return None
        turn = frame @ kept.frame.T  # from the rotation of the factorisation to the present one
        for _ in range(2):  # once more from there, by what the step has shown
            step = self._corrected(gradient, turn)
            if not np.abs(step).max() <= options.step_max_m:
                break
            trial, known = problem.at(point.positions + step, memory), self._count
            finite = math.isfinite(trial.energy) and math.isfinite(trial.residual)
            if finite and trial.residual <= FAR * point.residual and self.system.conservative:
                ends = step, gradient, self.system.gradient, self.free
                self._count = keep_pair(self._pairs, known, *ends)
            if finite and trial.residual <= options.reuse_rate * point.residual:
                return trial
            if self._count == known:
                break
        self.keep(None)
        return None

    def _corrected(self, gradient: Array, turn: Array) -> Array:
        """Return the step (n, 3) [m] under minus a gradient, of the corrected kept inverse."""
        load = np.empty_like(gradient)
        bend_load(self._pairs, self._count, gradient, load)
        step = np.ascontiguousarray(self.linear.solve(load, turn))
        mend_step(self._pairs, self._count, step)
        return step

    def _factor(self, options: NewtonOptions, part: int | None) -> int:
        """Factorise, with a shift where need be; return the number of attempts, negative if all failed."""
        system, linear = self.system, self._fitted_solver()

        def definite(shift: float) -> bool:
            if part is None:
                return linear.factor(system.tangent_blocks, shift, system.low_rank)
            return linear.factor_part(part, system.tangent_blocks, shift)

        return self._shifts.factor(definite, options.shift_start_N_m, options.shift_max_N_m)

    def _fitted_solver(self) -> LinearSolver:
        """Return the linear solver, made for the pattern of the present tangent."""
        self._fit(self.system.tangent_pattern)
        if isinstance(self.linear, OpenCapSolver):
            # d(gradient)/dx gains what the missing caps take away
            self.linear.extra = self.system.open_cap_stiffness
        return self.linear

    def _fit(self, pattern: BlockPattern) -> None:
        if self.linear.pattern is not pattern:
            narrow = pattern is self.system.pattern
            self.linear = self._narrow if narrow else self._solver_for(pattern, self._narrow)
            self._kept = nothing_kept(self.linear.apart)

    def _solver_for(self, pattern: BlockPattern, like: LinearSolver | None) -> LinearSolver:
        if self.system.conservative:
            return cholesky(pattern, self.free, self.system.eyelets, like)
        return OpenCapSolver(pattern, self.free, self.system.eyelets, like)

    def _search(
        self, problem: Potential, point: Point, step: Array, memory: Array, options: NewtonOptions
    ) -> Point | None:
        """Return the accepted point along the step, or None."""
        system = self.system
        longest = float(np.abs(step).max())
        slope = float(np.einsum("nr,nr->", system.gradient, step))
        factor = min(1.0, options.step_max_m / longest) if longest > 0.0 else 1.0
        for _ in range(options.halvings_max):
            trial = problem.at(point.positions + factor * step, memory)
            if system.conservative:
                ends = trial.energy, point.energy, factor * slope, trial.residual, point.residual
                enough = falls_enough(*ends)
            else:
                # work of the out-of-balance force along the step (Crisfield's line search), of which a short
                # step takes little away
                work = float(np.einsum("nr,nr->", system.gradient, step))
                enough = abs(work) <= (1.0 - 0.1 * factor) * abs(slope)
                enough = enough or trial.residual < MUCH_LESS * point.residual
                enough = enough and math.isfinite(trial.energy)
            if enough:
                return trial
            factor *= 0.5
        return None
