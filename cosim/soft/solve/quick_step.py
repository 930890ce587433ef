"""Steps of a film by a kernel: one call, in most of them, with new tangents where they are needed.

Where a tangent is not positive definite, a saved state holds the factorisation, or films touch one another,
`NewtonSolver` makes the new tangent where the kernel has left the step, which then goes on: of each body by
itself where several are side by side that nothing couples, such as the fingers of a gripper. Of one body
iterates are those of `NewtonSolver.solve`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.soft.body.loads import Loads, PlainLoads, Touching, nothing_touching
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.film.film_arrays import StepBed
from cosim.soft.film.step_arrays import (
    ENERGY,
    LEFT,
    RESIDUAL,
    TANGENTS,
    TO_DO,
    StepMotion,
    StepPlace,
)
from cosim.soft.solve.film_part import FilmPart
from cosim.soft.solve.film_sides import FilmSides
from cosim.soft.solve.film_step import FilmSide, film_step
from cosim.soft.solve.held_nodes import flange_axes, place_flight
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonResult, Outcome
from cosim.soft.solve.problem import Point, Problem
from cosim.soft.solve.state import BegunStep, Clamp, SoftState
from cosim.soft.solve.step_begin import fill_flight
from cosim.soft.solve.time_scheme import StepOptions, StepScheme


@final
@dataclass
class _Spent:
    """What a step has taken: iterations with a kept factorisation, with a new one, shifts, shifted ones.

    Of several parts: of those that took most.
    """

    reused: int = 0
    tangents: int = 0
    shifts: int = 0
    shifted: int = 0

    def result(self, motion: StepMotion, residual: float, energy: float, *, converged: bool) -> NewtonResult:
        """Return how a step ended at the end of a motion."""
        return NewtonResult(
            motion.new_x, motion.new_memory, Outcome.CONVERGED if converged else Outcome.ITERATION_LIMIT,
            residual, self.reused + self.tangents, self.tangents + self.shifts, energy, self.shifted,
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
        self.sides = FilmSides(solver, clamp, options)
        self._untouched = nothing_touching()
        self.begun: BegunStep | None = None
        """A step that was begun elsewhere: the next one, if it is from the same state, goes on with it."""

    @property
    def untouched(self) -> Touching:
        """What stands for nothing touched."""
        return self._untouched

    def begins(self, *, lenient: bool) -> StepPlace:
        """Return what the kernel takes for the beginning of a step.

        Args:
            lenient: whether it may end above its tolerance, which is for those that touch nothing.
        """
        newton = self._options.newton
        first = min(self._options.iterations, newton.iterations_max) if lenient else newton.iterations_max
        return StepPlace(True, newton.reuse_max, first)

    def knows(self, loads: Loads) -> bool:
        """Whether it takes steps under some loads, of the body as it is factorised."""
        return loads.plain_but_contact and self.sides.knows_body and self.sides.knows_factor

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
        plain, parts = loads.arrays(self._chambers), self.sides.work.parts
        # a contact that is half solved would push with a force of its own making
        lenient, most, films = loads.plain, options.newton.iterations_max, loads.self_contact
        touching, place = self._untouched if lenient else loads.touching, self.begins(lenient=lenient)
        while True:
            side = self.sides.of(scheme, step_s, coupled=films is not None)
            if side is None:  # films that touch have widened the tangent beyond what the kernel factorises
                return None
            if begun is None:
                converged, reused, spent.tangents, residual, energy = film_step(
                    side, plain, touching, motion, place
                )
                self.sides.take_over(side, scheme)
            else:
                converged, reused, residual, begun = False, begun.iterations, begun.residual, None
                spent.tangents, energy = int(parts[:, TANGENTS].max()), float(parts[:, ENERGY].sum())
            spent.reused += reused
            if converged:
                break
            if spent.tangents >= place.tangents_max and lenient:
                if residual <= options.residual_bound_N and not self._jumps(motion, step_s):
                    velocities = (x - velocities) / scheme.span
                    break
                lenient, place = False, place._replace(tangents_max=place.tangents_max + most)
                parts[:, LEFT] = options.newton.reuse_max
            if spent.tangents >= place.tangents_max or not math.isfinite(residual):
                return None
            whole = self._problem(state, loads, side.bed, step_s)
            acting = plain, touching
            if not self._with_tangents(side, acting, motion, whole, flange, spent):
                return None
            place = place._replace(begins=False)
        result = spent.result(motion, residual, energy, converged=converged)
        return SoftState(x, velocities, memory, here, None if films is None else films.memory(x)), result

    def _jumps(self, motion: StepMotion, step_s: float) -> bool:
        """Return whether the flange jumps in a step, off free flight."""
        flight, gain = np.empty_like(motion.x), self._options.gain
        fill_flight(motion.x, motion.velocity, motion.earlier_velocity, step_s, gain, flight)
        return place_flight(self._clamp.held, motion.flange, flight)

    def _problem(self, state: SoftState, loads: Loads, bed: StepBed, step_s: float) -> Problem:
        """Return what a step minimises, with the target that the kernel has filled."""
        solver = self._solver
        tension = solver.system.segment_tension(state.positions, loads)
        inertia = Inertia(bed.coefficient, bed.target, step_s, bed.closely)
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
        alone = several or whole.loads.self_contact is None
        for k in np.flatnonzero(parts[: len(side.film.parts) - 1, TO_DO]).tolist():
            part = self._part(side, acting, whole, k) if alone else whole
            point = Point(motion.new_x, float(parts[k, ENERGY]), float(parts[k, RESIDUAL]))
            given = part, point, motion.new_memory, flange.rotation, self._options.newton
            taken, found = solver.with_tangent(*given, k if several else None)
            attempts.append(taken)
            if found is None:
                break
            motion.new_x[:], motion.new_memory[:] = found.positions, solver.system.memory
            parts[k, RESIDUAL], parts[k, ENERGY] = found.residual, found.energy
            parts[k, TANGENTS] += 1
        most = max(map(abs, attempts))
        spent.shifts += most - 1
        spent.shifted += most > 1
        return found is not None

    def _part(
        self, side: FilmSide, acting: tuple[PlainLoads, Touching], whole: Problem, number: int
    ) -> FilmPart:
        """Return what a step minimises of one part."""
        return FilmPart(
            whole.system, side.film, self.sides.slots, *acting, side.bed, side.work.pull, whole.free,
            whole.kind, number,
        )  # fmt: skip


def _new_end(state: SoftState) -> tuple[Array, Array, Array]:
    """Return room for positions, velocities and memory at the end of a step from a state."""
    return np.empty_like(state.positions), np.empty_like(state.velocities), np.empty_like(state.memory)
