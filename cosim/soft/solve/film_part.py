"""What a time step minimises of one part of a film: a body among others that nothing couples it with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array, Mask
from cosim.soft.body.loads import PlainLoads, Touching
from cosim.soft.film.film_arrays import NODES, FilmArrays, FilmSlots, StepBed
from cosim.soft.film.film_terms import film_terms
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.problem import Point, largest_residual


@final
@dataclass(frozen=True)
class FilmPart:
    """The potential of a part in a step; the rows of `system.gradient` belong to the newest point of it.

    Args:
        system: of the whole body.
        film: its terms.
        slots: where they are in the body's own pattern.
        loads: that act.
        touching: what the film may touch in the scene.
        bed: that inertia is.
        pull: (segments,), scratch.
        free: (n, 3) bool, components that move.
        kind: of the step, see `Problem.kind`.
        number: of the part.
    """

    system: SoftSystem
    film: FilmArrays
    slots: FilmSlots
    loads: PlainLoads
    touching: Touching
    bed: StepBed
    pull: Array
    free: Mask
    kind: float
    number: int

    def at(self, positions: Array, memory: Array, *, hessian: bool = False) -> Point:
        """Return the point at positions (n, 3) [m]; elements remember (values,) the last accepted one."""
        system, film = self.system, self.film
        begin, end = film.parts[self.number : self.number + 2, NODES].tolist()
        if hessian:
            system.take_own_tangent(slice(begin, end))
        system.memory[:] = memory
        slots, blocks = (self.slots, system.blocks) if hessian else (film.no_slots, film.no_blocks)
        acting = self.loads, self.touching, self.bed, self.number
        filled = self.pull, system.memory, system.gradient, blocks
        energy = film_terms(film, slots, *acting, positions, memory, *filled)
        own = positions[begin:end], system.gradient[begin:end], self.free[begin:end]
        return Point(positions, energy, largest_residual(*own))
