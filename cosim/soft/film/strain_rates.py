"""What the materials of a film resist rates of strain with, step by step: see `strain_rate` for triangles.

A hinge of spring constant k between films of times tau resists the rate of its angle with the mean tau,
    dissipation potential = (tau k / s) (theta - theta')^2 / 2,
theta' of the same difference formula as E'. It is that of its spring alone: the barrier of closed folds
represents films that touch.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import Matrix, RecordStore, Vector, address_of, handing_on_views, kernel, small_vector
from cosim.base.numba_insides import caller
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.element import Remembered
from cosim.soft.elements.hinge import ANGLE, LANES, ROOM, HingeRows, add_hinges, differentiate
from cosim.soft.elements.membrane import MembraneRows
from cosim.soft.elements.strain_rate import RATE_ROOM, add_triangle_rates, fill_triangle_rates
from cosim.soft.film.step_arrays import FILMS, HINGES, FilmArrays, FilmPoint, FilmSlots, StepRates
from cosim.soft.geometry.surface import TURN, dihedral_angle, directed_edges

_fill_triangle_rates = caller(fill_triangle_rates)
_add_triangle_rates, _add_hinges = caller(add_triangle_rates), caller(add_hinges)
_TRIANGLES, _FILL_TRIANGLES, _HINGES = 2, 3, 1  # of `StepRates.calls`, and of `FilmArrays.calls`


@handing_on_views
def film_rows(film: Any, k: int) -> MembraneRows:
    """Return the triangles of film k."""
    a, b = film.films[k], film.films[k + 1]
    return MembraneRows(
        film.triangles[a[0] : b[0]], film.shape_gradients[a[0] : b[0]], film.areas[a[0] : b[0]],
        film.drawn[a[1] : b[1]], film.stiffness[k], film.laws[k], film.compression[k],
        film.forces[a[2] : b[2]], film.yarns[k],
    )  # fmt: skip


@kernel
def add_rates(film: FilmArrays, slots: FilmSlots, rates: StepRates, part: int, point: FilmPoint) -> float:
    """Add what resists the rates of a part's triangles and hinges; return the dissipation potential [J].

    It is half of the power lost, times s.

    Args:
        film: see `FilmArrays`.
        slots: see `FilmSlots`.
        rates: of the step.
        part: its number.
        point: see `FilmPoint`.
    """
    energy = 0.0
    for k in range(film.parts[part, FILMS], film.parts[part + 1, FILMS]):
        if rates.film_time[k] > 0.0:
            a, b = film.films[k], film.films[k + 1]
            own, pairs = rates.triangles[a[1] : b[1]], slots.triangles[a[0] : b[0]]
            given = point.x, film_rows(film, k), own, pairs, point.gradient, point.blocks
            energy += _add_triangle_rates(rates.calls[_TRIANGLES], given)
    first, last = film.parts[part, HINGES], film.parts[part + 1, HINGES]
    begin, end = film.angles[0] + first, film.angles[0] + last
    springs = HingeRows(
        film.hinges[first:last], rates.hinge_stiffness[first:last], rates.hinge_angle[first:last], 0.0
    )
    angles = Remembered(point.memory[begin:end], point.tracked[begin:end])
    turning = point.x, springs, angles, slots.hinges[first:last], point.gradient, point.blocks
    return energy + _add_hinges(film.calls[_HINGES], turning)


@kernel
def fill_rates(
    film: FilmArrays,
    x: Matrix,
    earlier_x: Matrix,
    memory: Vector,
    two_steps: bool,
    span: float,
    rates: StepRates,
) -> None:
    """Fill what a step resists rates with.

    Args:
        film: see `FilmArrays`.
        x: (n, 3) [m], where the step begins.
        earlier_x: (n, 3) [m], one step before; of one step alone: anything.
        memory: (values,), of the elements where it begins.
        two_steps: whether it looks back over two.
        span: s [s].
        rates: filled.
    """
    for k in range(film.films.shape[0] - 1):
        if rates.film_time[k] > 0.0:
            own = rates.triangles[film.films[k, 1] : film.films[k + 1, 1]]
            given = x, earlier_x, two_steps, film_rows(film, k), rates.film_time[k] / span, own
            _fill_triangle_rates(rates.calls[_FILL_TRIANGLES], given)
    s, count = small_vector(ROOM), film.hinges.shape[0]
    for first in range(0, count, LANES):
        lanes = min(LANES, count - first)
        if two_steps:
            differentiate(earlier_x, film.hinges, first, lanes, s)
        for lane in range(lanes):
            h = first + lane
            angle = memory[film.angles[0] + h]
            rates.hinge_stiffness[h] = rates.hinge_time[h] / span * film.hinge_stiffness[h]
            if two_steps:
                turned = angle - s[ANGLE + lane]
                turned -= TURN * np.floor(turned / TURN + 0.5)
                angle += turned / 3.0
            rates.hinge_angle[h] = angle


@final
class StrainRates:
    """What a body's materials resist rates of strain with, in the step that was filled last.

    Attributes: `address`, of its `StepRates`.

    Args:
        body: some film of which has a loss factor.
        film: its arrays.
    """

    def __init__(self, body: SoftBody, film: FilmArrays) -> None:
        self._film, hinges = film, len(film.hinges)
        kernels = fill_rates, add_rates, add_triangle_rates, fill_triangle_rates
        self._arrays = StepRates(
            np.array([address_of(called) for called in kernels]),
            np.array([each.film.loss_time_s for each in body.membranes]), hinge_times(body, film.hinges),
            np.zeros((len(film.drawn), RATE_ROOM)), np.zeros(hinges), np.zeros(hinges),
        )  # fmt: skip
        self._store = RecordStore(StepRates)
        self.address = self._store.address(self._arrays)

    @classmethod
    def of(cls, body: SoftBody, film: FilmArrays) -> StrainRates | None:
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
        point = FilmPoint(x, self._memory, angles, gradient, film.no_blocks, np.zeros(0))
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
