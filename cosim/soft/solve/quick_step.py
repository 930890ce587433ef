"""Steps of a film by a kernel: one call where the factorisation that is kept serves to the end.

Where it does not, Newton's method makes a new tangent where the kernel has left the step, which then goes
on: of each body by itself where several are side by side that nothing couples, such as the fingers of a
gripper. Of one body iterates are those of `NewtonSolver.solve`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask, Pose
from cosim.soft.body.loads import Loads, PlainLoads, Touching, nothing_touching
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.film.film_arrays import FilmArrays, FilmSlots, StepBed
from cosim.soft.film.film_packing import film_arrays, film_slots
from cosim.soft.linear.envelope_cholesky import NODE, EnvelopeArrays, EnvelopeCholesky
from cosim.soft.linear.secant_pairs import SecantPairs
from cosim.soft.solve.film_part import FilmPart
from cosim.soft.solve.film_step import FilmSide, film_step, step_calls
from cosim.soft.solve.held_nodes import flange_axes, place_flight
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonResult, Outcome
from cosim.soft.solve.problem import Point, Problem
from cosim.soft.solve.state import BegunStep, Clamp, SoftState
from cosim.soft.solve.step_arrays import (
    ENERGY,
    LEFT,
    RESIDUAL,
    TO_DO,
    KeptEnvelope,
    StepMotion,
    StepNumbers,
    StepPlace,
    StepWork,
)
from cosim.soft.solve.step_begin import fill_flight
from cosim.soft.solve.time_scheme import StepOptions, StepScheme


@final
@dataclass
class _Spent:
    """What a step has taken: iterations with a kept factorisation, with a new one, attempts, shifted ones.

    Of several parts: of those that took most.
    """

    reused: int = 0
    tangents: int = 0
    factorisations: int = 0
    shifted: int = 0

    def result(self, motion: StepMotion, residual: float, energy: float, *, converged: bool) -> NewtonResult:
        """Return how a step ended at the end of a motion."""
        return NewtonResult(
            motion.new_x, motion.new_memory, Outcome.CONVERGED if converged else Outcome.ITERATION_LIMIT,
            residual, self.reused + self.tangents, self.factorisations, energy, self.shifted,
        )  # fmt: skip


@final
class QuickStepper:
    """Takes steps under plain loads and contact, with the scene and of films with one another.

    Args:
        solver: Newton's method for the body.
        clamp: nodes held by the flange.
        options: how steps are solved.
    """

    def __init__(self, solver: NewtonSolver, clamp: Clamp, options: StepOptions) -> None:
        self._solver, self._clamp, self._options = solver, clamp, options
        self._chambers = len(solver.system.body.gas_chambers)
        self._target = np.empty_like(solver.system.gradient)
        self._untouched = nothing_touching()
        self.begun: BegunStep | None = None
        """A step that was begun elsewhere: the next one, if it is from the same state, goes on with it."""

    @cached_property
    def _film(self) -> FilmArrays | None:
        """Arrays of the body, once they are needed: statics compiles none of the kernels."""
        solver = self._solver
        return film_arrays(solver.system.body, solver.apart)

    @cached_property
    def _slots(self) -> FilmSlots:
        """Where the terms of several parts are in the tangent."""
        assert self._film is not None, "of a body that the kernel knows"
        return film_slots(self._film, self._solver.system.pattern)

    @cached_property
    def _whole(self) -> FilmArrays | None:
        """The same arrays as one part."""
        film = self._film
        return None if film is None else film._replace(parts=np.ascontiguousarray(film.parts[[0, -1]]))

    @cached_property
    def _work(self) -> StepWork:
        system = self._solver.system
        parts = 1 if self._film is None else len(self._film.parts) - 1
        segments = 0 if self._film is None else len(self._film.ratio)
        return StepWork(
            step_calls(), system.gradient, np.empty((1, *system.gradient.shape)),
            np.empty((2, *system.gradient.shape)), SecantPairs.room(len(system.gradient)),
            np.empty_like(system.memory), np.empty(segments), np.zeros((parts, 4)),
        )  # fmt: skip

    @property
    def knows_body(self) -> bool:
        """Whether the kernel knows all that the body is made of."""
        return self._film is not None

    @property
    def knows_factor(self) -> bool:
        """Whether the kernel knows the kind of the factorisation in store."""
        return self._envelope is not None

    @property
    def _envelope(self) -> EnvelopeArrays | None:
        linear = self._solver.linear
        return linear.envelope if isinstance(linear, EnvelopeCholesky) else None

    @property
    def begins(self) -> tuple[Touching, StepPlace]:
        """What the kernel takes for the beginning of a step that touches nothing."""
        return self._untouched, StepPlace(True, self._options.newton.reuse_max)

    def side(self, scheme: StepScheme, step_s: float, *, coupled: bool = False) -> FilmSide | None:
        """Return what the kernel takes for steps of a scheme; None where the body is more than it knows.

        Args:
            scheme: of the step.
            step_s: h [s].
            coupled: whether its parts may touch one another.
        """
        film, kept = self._whole if coupled else self._film, self._kept(scheme)
        if film is None or kept is None:
            return None
        bed, numbers = StepBed(scheme.inertia, self._target), self._numbers(scheme, step_s)
        return FilmSide(film, bed, kept, self._clamp.held, numbers, self._work)

    def knows(self, loads: Loads) -> bool:
        """Whether it takes steps under some loads, of the body as it is factorised."""
        return loads.plain_but_contact and self.knows_body and self.knows_factor

    def has_begun(self, state: SoftState) -> bool:
        """Return whether a step from a state goes on with one that was begun elsewhere."""
        return self.begun is not None and self.begun.state is state

    def take(
        self, state: SoftState, flange: Pose, loads: Loads, scheme: StepScheme, step_s: float
    ) -> tuple[SoftState, NewtonResult] | None:
        """Return where a step ends, or None where its start or a tangent does not serve.

        Args:
            state: at the beginning; it stays as it is.
            flange: its pose at the end.
            loads: at the end; it `knows` them.
            scheme: of the step.
            step_s: h [s].
        """
        here, options, spent = (state.positions, state.velocities), self._options, _Spent()
        begun, self.begun = self.begun if self.has_begun(state) else None, None
        x, velocities, memory = _new_end(state) if begun is None else (begun.x, begun.base, begun.memory)
        motion = StepMotion(
            *here, *(state.earlier or here), state.memory, flange_axes(flange), x, velocities, memory
        )
        plain, (untouched, place) = loads.arrays(self._chambers), self.begins
        # a contact that is half solved would push with a force of its own making
        lenient, most, films = loads.plain, options.newton.iterations_max, loads.self_contact
        touching = untouched if lenient else loads.touching
        first = min(options.iterations, most) if lenient else most
        while True:
            side = self.side(scheme, step_s, coupled=films is not None)
            if side is None:  # films that touch have widened the tangent beyond what the kernel factorises
                return None
            if begun is None:
                converged, reused, residual, energy = film_step(side, plain, touching, motion, place)
            else:
                converged, reused, residual, begun = False, begun.iterations, begun.residual, None
            spent.reused += reused
            if converged:
                break
            if spent.tangents >= first and lenient:
                if residual <= options.residual_bound_N and not self._jumps(motion, step_s):
                    velocities = (x - velocities) / scheme.span
                    break
                lenient, first = False, first + most
                self._work.parts[:, LEFT] = options.newton.reuse_max
            if spent.tangents >= first or not math.isfinite(residual):
                return None
            whole = self._problem(state, loads, scheme, step_s)
            acting = plain, touching
            if not self._with_tangents(side, acting, motion, whole, flange, spent):
                return None
            place = StepPlace(False, place.reuse_max)
        result = spent.result(motion, residual, energy, converged=converged)
        return SoftState(x, velocities, memory, here, None if films is None else films.memory(x)), result

    def _jumps(self, motion: StepMotion, step_s: float) -> bool:
        """Return whether the flange jumps in a step, off free flight."""
        flight, gain = np.empty_like(motion.x), self._options.gain
        fill_flight(motion.x, motion.velocity, motion.earlier_velocity, step_s, gain, flight)
        return place_flight(self._clamp.held, motion.flange, flight)

    def _problem(self, state: SoftState, loads: Loads, scheme: StepScheme, step_s: float) -> Problem:
        """Return what a step minimises, with the target that the kernel has filled."""
        solver = self._solver
        tension = solver.system.segment_tension(state.positions, loads)
        inertia = Inertia(scheme.inertia, self._target, step_s)
        return Problem(solver.system, solver.free, loads, tension, inertia)

    def _with_tangents(
        self,
        side: FilmSide,
        acting: tuple[PlainLoads, Touching],
        motion: StepMotion,
        whole: Problem,
        flange: Pose,
        spent: _Spent,
    ) -> bool:
        """Take each part that has not converged one iteration with a new tangent on; return whether it is.

        Args:
            side: of the step.
            acting: its loads, and what is touched.
            motion: the step's end is moved.
            whole: what the step minimises, of all parts.
            flange: its pose.
            spent: counts them.
        """
        solver, parts, several, attempts = self._solver, side.work.parts, len(side.film.parts) > 2, []
        for k in np.flatnonzero(parts[: len(side.film.parts) - 1, TO_DO]).tolist():
            part = self._part(side, acting, whole, k) if several else whole
            point = Point(motion.new_x, float(parts[k, ENERGY]), float(parts[k, RESIDUAL]))
            given = part, point, motion.new_memory, flange.rotation, self._options.newton
            taken, found = solver.with_tangent(*given, k if several else None)
            attempts.append(taken)
            if found is None:
                break
            motion.new_x[:], motion.new_memory[:] = found.positions, solver.system.memory
            parts[k, RESIDUAL], parts[k, ENERGY] = found.residual, found.energy
        most = max(map(abs, attempts))
        spent.tangents += 1
        spent.factorisations += most
        spent.shifted += most > 1
        return found is not None

    def _part(
        self, side: FilmSide, acting: tuple[PlainLoads, Touching], whole: Problem, number: int
    ) -> FilmPart:
        """Return what a step minimises of one part."""
        return FilmPart(
            whole.system, side.film, self._slots, *acting, side.bed, side.work.pull, whole.free, whole.kind,
            number,
        )  # fmt: skip

    def _kept(self, scheme: StepScheme) -> KeptEnvelope | None:
        """Return the factorisation in store; None where the kernel does not know its kind."""
        parts, free, envelope = self._solver.kept, self._solver.free, self._envelope
        there = [kept is not None and kept.kind == scheme.kind for kept in parts]
        if not any(there):
            return _nothing_kept(free)
        if envelope is None:
            return None
        frames = np.array([np.eye(3) if kept is None else kept.frame for kept in parts])
        return KeptEnvelope(np.array(there, np.int64), envelope, frames, free)

    def _numbers(self, scheme: StepScheme, step_s: float) -> StepNumbers:
        options = self._options
        newton = options.newton
        return StepNumbers(
            scheme.two_steps, step_s, scheme.span, scheme.factor, options.gain, options.tolerance_N,
            newton.start_tolerance_N, newton.reuse_rate, newton.step_max_m,
        )  # fmt: skip


def _new_end(state: SoftState) -> tuple[Array, Array, Array]:
    """Return room for positions, velocities and memory at the end of a step from a state."""
    return np.empty_like(state.positions), np.empty_like(state.velocities), np.empty_like(state.memory)


def _nothing_kept(free: Mask) -> KeptEnvelope:
    """Return what stands for no factorisation: only a start that is good enough is a step's end then."""
    none, no_places, table = np.empty(0), np.empty(0, np.uint64), np.zeros((2, 4), np.int64)
    table[1, NODE] = len(free)
    factor = EnvelopeArrays(none, no_places, no_places, none, np.empty(0, np.int64), table)
    return KeptEnvelope(np.zeros(1, np.int64), factor, np.eye(3)[None], free)
