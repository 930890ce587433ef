"""What the materials of a film resist rates of strain with, step by step; formulas: see `rate_kernels`."""

from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import RecordStore, address_of
from cosim.soft.body.body import SoftBody
from cosim.soft.film import rate_kernels, step_arrays
from cosim.soft.film.rate_kernels import add_rates, add_triangle_rates, fill_rates, fill_triangle_rates
from cosim.soft.geometry.surface import dihedral_angle, directed_edges


@final
class StrainRates:
    """What a body's materials resist rates of strain with, in the step that was filled last.

    Attributes: `address`, of its `StepRates`.

    Args:
        body: some film of which has a loss factor.
        film: its arrays.
    """

    def __init__(self, body: SoftBody, film: step_arrays.FilmArrays) -> None:
        self._film, hinges = film, len(film.hinges)
        kernels = fill_rates, add_rates, add_triangle_rates, fill_triangle_rates
        self._arrays = step_arrays.StepRates(
            np.array([address_of(called) for called in kernels]),
            np.array([each.film.loss_time_s for each in body.membranes]), hinge_times(body, film.hinges),
            np.zeros((len(film.drawn), rate_kernels.RATE_ROOM)), np.zeros(hinges), np.zeros(hinges),
        )  # fmt: skip
        self._store = RecordStore(step_arrays.StepRates)
        self.address = self._store.address(self._arrays)

    @classmethod
    def of(cls, body: SoftBody, film: step_arrays.FilmArrays) -> "StrainRates | None":
        """Return them for a body with its arrays; None where none of its films has a loss factor."""
        return cls(body, film) if any(each.film.loss_factor for each in body.membranes) else None

    def fill(self, x: Array, earlier_x: Array | None, memory: Array, span: float) -> None:
        """Let a step begin.

        Args:
            x: (n, 3) [m], where it begins.
            earlier_x: (n, 3) [m], one step before, where it looks back over two; None where over one.
            memory: (values,), of the elements where it begins.
            span: s [s].
        """
        two_steps, before = (False, x) if earlier_x is None else (True, earlier_x)
        fill_rates(self._film, x, before, memory, two_steps, span, self._arrays)

    def begin(self, x: Array, earlier_x: Array | None, span: float) -> None:
        """Let a step begin whose elements' memory is not known; see `fill`."""
        self._memory = memory = np.zeros(self._film.angles[1])
        memory[self._film.angles[0] :] = dihedral_angle(x, self._film.hinges)
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
        film, angles, gradient = self._film, np.empty_like(self._memory), np.zeros_like(x)
        whole = film._replace(parts=np.ascontiguousarray(film.parts[[0, -1]]))
        point = step_arrays.FilmPoint(x, self._memory, angles, gradient, film.no_blocks, np.zeros(0))
        found: float = add_rates(whole, film.no_slots, self._arrays, 0, point)
        return found, gradient


def hinge_times(body: SoftBody, hinges: IntArray) -> Array:
    """Return tau (h,) [s] of each hinge: the mean of the triangles beside it.

    Args:
        body: with the films.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
    """
    number = np.array([body.nodes, 1])
    keys = np.sort(hinges[:, 1:3], axis=1) @ number
    order = np.argsort(keys)
    total, beside = np.zeros(len(hinges)), np.zeros(len(hinges))
    for each in body.membranes if len(hinges) else ():
        edges = np.sort(directed_edges(each.triangles), axis=1) @ number
        hinge = order[np.minimum(np.searchsorted(keys[order], edges), len(order) - 1)]
        own = hinge[keys[hinge] == edges]
        np.add.at(total, own, each.film.loss_time_s)
        np.add.at(beside, own, 1.0)
    return total / np.maximum(beside, 1.0)
