"""Steps of a film in one kernel call, where that is all they need."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, PlaceArray, Pose
from cosim.soft.body.loads import Loads
from cosim.soft.linear.envelope_cholesky import EnvelopeCholesky
from cosim.soft.solve.film_arrays import FilmArrays, StepBed, film_arrays
from cosim.soft.solve.film_step import (
    FilmSide,
    KeptEnvelope,
    StepMotion,
    StepNumbers,
    StepWork,
    film_step,
    step_calls,
)
from cosim.soft.solve.held_nodes import flange_axes
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonResult, Outcome
from cosim.soft.solve.state import Clamp, SoftState
from cosim.soft.solve.time_scheme import StepOptions, StepScheme


@final
class QuickStepper:
    """Takes steps with the factorisation that is kept, and leaves all others.

    Args:
        solver: Newton's method for the body.
        clamp: nodes held by the flange.
        options: how steps are solved.
    """

    def __init__(self, solver: NewtonSolver, clamp: Clamp, options: StepOptions) -> None:
        self._solver, self._clamp, self._options = solver, clamp, options
        self._chambers = len(solver.system.body.gas_chambers)
        self._target = np.empty_like(solver.system.gradient)

    @cached_property
    def _film(self) -> FilmArrays | None:
        """Arrays of the body, once they are needed: statics compiles none of the kernels."""
        return film_arrays(self._solver.system.body)

    @cached_property
    def _work(self) -> StepWork:
        system = self._solver.system
        segments = 0 if self._film is None else len(self._film.ratio)
        return StepWork(
            step_calls(), system.gradient, np.empty((1, *system.gradient.shape)),
            np.empty_like(system.memory), np.empty(segments),
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
    def _envelope(self) -> tuple[Array, PlaceArray, PlaceArray, Array, IntArray] | None:
        linear = self._solver.linear
        return linear.envelope if isinstance(linear, EnvelopeCholesky) else None

    def side(self, scheme: StepScheme, step_s: float) -> FilmSide | None:
        """Return what the kernel takes for steps of a scheme; None where the body is more than it knows.

        Args:
            scheme: of the step.
            step_s: h [s].
        """
        film, kept = self._film, self._kept(scheme)
        if film is None or kept is None:
            return None
        bed, numbers = StepBed(scheme.inertia, self._target), self._numbers(scheme, step_s)
        return FilmSide(film, bed, kept, self._clamp.held, numbers, self._work)

    def take(
        self, state: SoftState, flange: Pose, loads: Loads, scheme: StepScheme, step_s: float
    ) -> tuple[SoftState, NewtonResult] | None:
        """Return where a step ends, or None where it takes more: `state` is untouched then.

        Args:
            state: at the beginning.
            flange: its pose at the end.
            loads: at the end.
            scheme: of the step.
            step_s: h [s].
        """
        side = self.side(scheme, step_s) if loads.plain else None
        if side is None:
            return None
        here = state.positions, state.velocities
        x, velocities, memory = (np.empty_like(part) for part in (*here, state.memory))
        motion = StepMotion(
            *here, *(state.earlier or here), state.memory, flange_axes(flange), x, velocities, memory
        )
        converged, iterations, residual, energy = film_step(side, loads.arrays(self._chambers), motion)
        if not converged:
            return None
        result = NewtonResult(x, memory, Outcome.CONVERGED, residual, iterations, 0, energy, 0)
        return SoftState(x, velocities, memory, here), result

    def _kept(self, scheme: StepScheme) -> KeptEnvelope | None:
        """Return the factorisation in store; None where the kernel does not know its kind."""
        kept, free = self._solver.kept, self._solver.free
        if kept is None or kept.kind != scheme.kind:
            return _nothing_kept(free)
        envelope = self._envelope
        return None if envelope is None else KeptEnvelope(True, *envelope, _writable(kept.frame), free)

    def _numbers(self, scheme: StepScheme, step_s: float) -> StepNumbers:
        options = self._options
        newton = options.newton
        return StepNumbers(
            scheme.two_steps, step_s, scheme.span, scheme.factor, options.gain, options.tolerance_N,
            newton.start_tolerance_N, newton.reuse_rate, newton.step_max_m, newton.reuse_max,
        )  # fmt: skip


def _nothing_kept(free: Mask) -> KeptEnvelope:
    """Return what stands for no factorisation: only a start that is good enough is a step's end then."""
    none, no_places = np.empty(0), np.empty(0, np.uint64)
    return KeptEnvelope(False, none, no_places, no_places, none, np.empty(0, np.int64), np.eye(3), free)


def _writable(values: Array) -> Array:
    """Return the same array, or a copy that can be written to: kernels are compiled for such ones."""
    return values if values.flags.writeable else values.copy()
