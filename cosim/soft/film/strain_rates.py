"""Viscous losses of a body's materials in a step, see `rate_kernels`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.element import Call, Remembered
from cosim.soft.elements.hinge import HingeRows, add_hinges
from cosim.soft.elements.membrane import MembraneRows
from cosim.soft.film.rate_kernels import RATE_ROOM, add_triangle_rates, fill_hinge_rates, fill_triangle_rates
from cosim.soft.geometry.surface import dihedral_angle, directed_edges

_NO_TABLE, _NO_BLOCKS = np.zeros((0, 0), np.int64), np.zeros((0, 3, 3))


@final
@dataclass(frozen=True)
class _LossyFilm:
    """A film with a loss factor.

    Args:
        number: index among the body's films.
        rows: its triangles.
        time_s: tau.
        rates: (groups, RATE_ROOM), of the step.
    """

    number: int
    rows: MembraneRows
    time_s: float
    rates: Array


@final
class StrainRates:
    """Viscous losses of a body's materials in the step that `fill` has prepared.

    Args:
        body: with at least one film with a loss factor.
    """

    def __init__(self, body: SoftBody) -> None:
        self._films = [
            _LossyFilm(
                k,
                membranes.arrays,
                membranes.film.loss_time_s,
                np.zeros((len(membranes.arrays.drawn), RATE_ROOM)),
            )
            for k, membranes in enumerate(body.membranes)
            if membranes.film.loss_factor
        ]
        bent = len(body.hinges.coupled)
        self.hinges = body.hinges.arrays.nodes[:bent]
        """(h, 4) nodes of the hinges with angles in the memory."""
        hinge_slice = body.memory_slices[body.elements.index(body.hinges)]
        self.angles = slice(hinge_slice.start, hinge_slice.start + bent)
        """Slice of these angles in the memory."""
        self._spring_s = hinge_times(body, self.hinges) * body.hinges.stiffness[:bent]
        self._stiffness, self._angle = np.zeros(bent), np.zeros(bent)
        self._springs = HingeRows(self.hinges, self._stiffness, self._angle, 0.0)

    @classmethod
    def of(cls, body: SoftBody) -> "StrainRates | None":
        """Return the losses of a body; None if none of its films has a loss factor."""
        return cls(body) if any(each.film.loss_factor for each in body.membranes) else None

    def fill(self, x: Array, earlier_x: Array | None, memory: Array, span: float) -> None:
        """Prepare a step.

        Args:
            x: (n, 3) [m], at its start.
            earlier_x: (n, 3) [m], one step before, for a two-step scheme; None for a one-step scheme.
            memory: (values,), of the elements at the start.
            span: s [s].
        """
        two_steps, before = (False, x) if earlier_x is None else (True, earlier_x)
        for film in self._films:
            fill_triangle_rates(x, before, two_steps, film.rows, film.time_s / span, film.rates)
        np.divide(self._spring_s, span, out=self._stiffness)
        fill_hinge_rates(before, self.hinges, memory[self.angles], two_steps, self._angle)

    def calls(
        self,
        angles: Remembered,
        triangle_slots: Sequence[IntArray],
        hinge_slots: IntArray,
        gradient: Array,
        blocks: Array,
    ) -> list[Call]:
        """Return the kernel calls that add the losses: their sum is half of the power lost, times s.

        Args:
            angles: of the hinges.
            triangle_slots: (m, 6) of each film; empty for the gradient alone.
            hinge_slots: (h, 10); empty for the gradient alone.
            gradient: (n, 3) [N].
            blocks: (b, 3, 3) [N/m].
        """
        film_calls = [
            Call(add_triangle_rates, (film.rows, film.rates, triangle_slots[film.number], gradient, blocks))
            for film in self._films
        ]
        return [*film_calls, Call(add_hinges, (self._springs, angles, hinge_slots, gradient, blocks))]

    def begin(self, x: Array, earlier_x: Array | None, span: float) -> None:
        """Prepare a step without a known memory of the elements, see `fill`."""
        self._memory = memory = np.zeros(self.angles.stop)
        memory[self.angles] = dihedral_angle(x, self.hinges)
        self.fill(x, earlier_x, memory, span)

    def potential(self, x: Array) -> float:
        """Return the dissipation potential [J] of the step if it ends at x (n, 3) [m]; call `begin` before.

        It is half of the power lost, times s.
        """
        return self._at(x)[0]

    def gradient(self, x: Array) -> Array:
        """Return the gradient (n, 3) [N] of the potential there."""
        return self._at(x)[1]

    def _at(self, x: Array) -> tuple[float, Array]:
        before, gradient = self._memory[self.angles], np.zeros_like(x)
        no_slots = [_NO_TABLE] * (1 + self._films[-1].number)
        angles = Remembered(before, np.empty_like(before))
        calls = self.calls(angles, no_slots, _NO_TABLE, gradient, _NO_BLOCKS)
        return sum(leaf(x, *arguments) for leaf, arguments in calls), gradient


def hinge_times(body: SoftBody, hinges: IntArray) -> Array:
    """Return tau (h,) [s] of each hinge: the mean of its two triangles.

    Args:
        body: with the films.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
    """
    number = np.array([body.nodes, 1])
    keys = np.sort(hinges[:, 1:3], axis=1) @ number
    order = np.argsort(keys)
    total, triangle_count = np.zeros(len(hinges)), np.zeros(len(hinges))
    for membranes in body.membranes if len(hinges) else ():
        edges = np.sort(directed_edges(membranes.triangles), axis=1) @ number
        hinge = order[np.minimum(np.searchsorted(keys[order], edges), len(order) - 1)]
        their_hinges = hinge[keys[hinge] == edges]
        np.add.at(total, their_hinges, membranes.film.loss_time_s)
        np.add.at(triangle_count, their_hinges, 1.0)
    return total / np.maximum(triangle_count, 1.0)
