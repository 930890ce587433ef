"""What the kernel of a film's step is given: arrays of the body, its factorisation, and scratch."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import IntArray, Mask
from cosim.base.kernels import nothing_of
from cosim.soft.film.film_arrays import NODES, FilmArrays, FilmSlots, StepBed
from cosim.soft.film.film_packing import film_arrays, film_slots
from cosim.soft.film.step_arrays import NEW_TANGENTS, NewTangents, StepNumbers, StepWork
from cosim.soft.linear.envelope_cholesky import NODE, EnvelopeArrays, EnvelopeCholesky
from cosim.soft.linear.kept_envelope import KEPT, KeptEnvelope, envelope_calls
from cosim.soft.linear.kept_factor import KeptFactor
from cosim.soft.linear.secant_pairs import SecantPairs
from cosim.soft.solve.film_step import FilmSide, step_calls
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Clamp
from cosim.soft.solve.time_scheme import StepOptions, StepScheme


@final
class FilmSides:
    """Makes what the kernel takes for steps of one body, and takes in how it has left the factorisation.

    Args:
        solver: Newton's method for the body.
        clamp: nodes held by the flange.
        options: how steps are solved.
    """

    def __init__(self, solver: NewtonSolver, clamp: Clamp, options: StepOptions) -> None:
        self._solver, self._clamp, self._options = solver, clamp, options
        self._target = np.empty_like(solver.system.gradient)

    @cached_property
    def _film(self) -> FilmArrays | None:
        """Arrays of the body, once they are needed: statics compiles none of the kernels."""
        solver = self._solver
        return film_arrays(solver.system.body, solver.apart)

    @cached_property
    def slots(self) -> FilmSlots:
        """Where the terms of several parts are in the tangent."""
        assert self._film is not None, "of a body that the kernel knows"
        return film_slots(self._film, self._solver.system.pattern)

    @cached_property
    def _whole(self) -> FilmArrays | None:
        """The same arrays as one part."""
        film = self._film
        return None if film is None else film._replace(parts=np.ascontiguousarray(film.parts[[0, -1]]))

    @cached_property
    def work(self) -> StepWork:
        system = self._solver.system
        parts = 1 if self._film is None else len(self._film.parts) - 1
        segments = 0 if self._film is None else len(self._film.ratio)
        return StepWork(
            step_calls(), system.gradient, np.empty((1, *system.gradient.shape)),
            np.empty((2, *system.gradient.shape)), SecantPairs.room(len(system.gradient)),
            np.empty_like(system.memory), np.empty(segments), np.zeros((parts, 5)),
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

    def of(self, scheme: StepScheme, step_s: float, *, coupled: bool = False) -> FilmSide | None:
        """Return what the kernel takes for steps of a scheme; None where the body is more than it knows.

        Args:
            scheme: of the step.
            step_s: h [s].
            coupled: whether its parts may touch one another.
        """
        film, kept = self._whole if coupled else self._film, self._kept(scheme)
        if film is None or kept is None:
            return None
        bed = StepBed(scheme.inertia, self._target, self._options.closely)
        numbers = self._numbers(scheme, step_s)
        tangents = self._no_tangents if coupled else self._tangents
        return FilmSide(film, bed, kept, tangents, self._clamp.held, numbers, self.work)

    def take_over(self, side: FilmSide, scheme: StepScheme) -> None:
        """Take in which parts of the factorisation the kernel has made anew, or lost, and how others served.

        Args:
            side: as the kernel has left it.
            scheme: of its steps.
        """
        kept, solver = side.kept, self._solver
        counts = kept.made.tolist(), kept.there.tolist(), kept.extra.tolist()  # empty of no factorisation
        for k, (before, made, there, extra) in enumerate(zip(solver.kept, *counts, strict=False)):
            if made:
                solver.system.serving = solver.linear.pattern
            elif not there or before is None or before.extra == extra:
                continue
            solver.keep(KeptFactor(scheme.kind, kept.frame[k].copy(), extra) if there else None, k)
        kept.made[:] = 0

    def _kept(self, scheme: StepScheme) -> KeptEnvelope | None:
        """Return the factorisation in store; None where the kernel does not know its kind."""
        solver, linear = self._solver, self._solver.linear
        parts, free, envelope = solver.kept, solver.free, self._envelope
        there = [kept is not None and kept.kind == scheme.kind for kept in parts]
        if not isinstance(linear, EnvelopeCholesky) or envelope is None:
            return None if any(there) else _nothing_kept(free)
        frames = np.array([np.eye(3) if kept is None else kept.frame for kept in parts])
        counts = np.array(there, np.int64), np.zeros(len(parts), np.int64)
        extra = np.array([0 if kept is None else kept.extra for kept in parts])
        return KeptEnvelope(self._envelope_calls, *counts, envelope, linear.entries, extra, frames, free)

    @cached_property
    def _envelope_calls(self) -> IntArray:
        return envelope_calls()

    @property
    def _tangents(self) -> NewTangents:
        """Where the kernel makes new tangents; nothing where it cannot, or a saved state holds the factor."""
        solver, linear = self._solver, self._solver.linear
        if not isinstance(linear, EnvelopeCholesky) or linear.lent or linear.envelope is None:
            return self._no_tangents
        return self._own_tangents if linear.pattern is solver.system.pattern else self._no_tangents

    @cached_property
    def _own_tangents(self) -> NewTangents:
        assert self._film is not None, "of a body that the kernel knows"
        system, parts = self._solver.system, self._film.parts[:, NODES]
        return NewTangents(self.slots, system.blocks, np.searchsorted(system.pattern.row, parts))

    @cached_property
    def _no_tangents(self) -> NewTangents:
        nothing: NewTangents = nothing_of(NEW_TANGENTS)
        return nothing

    def _numbers(self, scheme: StepScheme, step_s: float) -> StepNumbers:
        options = self._options
        newton = options.newton
        return StepNumbers(
            scheme.two_steps, step_s, scheme.span, scheme.factor, options.gain, options.tolerance_N,
            newton.start_tolerance_N, newton.reuse_rate, newton.step_max_m, newton.halvings_max,
        )  # fmt: skip


def _nothing_kept(free: Mask) -> KeptEnvelope:
    """Return what stands for no factorisation: only a start that is good enough is a step's end then."""
    nothing: KeptEnvelope = nothing_of(KEPT)
    table = np.zeros((2, 4), np.int64)
    table[1, NODE] = len(free)
    factor = nothing.factor._replace(parts=table)
    none = np.zeros(1, np.int64)
    return nothing._replace(there=none, extra=none.copy(), factor=factor, frame=np.eye(3)[None], free=free)
