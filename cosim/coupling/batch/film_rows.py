"""What the kernel of many ticks of a film is given and what it leaves, as arrays of documented shapes."""

from __future__ import annotations

from typing import NamedTuple

from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDICES, MATRIX, REAL
from cosim.coupling.batch.contact_rows import CONTACT_ROW, ContactRow
from cosim.rigid.distance.shape_bounds import SHAPE_BOUNDS, ShapeBounds
from cosim.soft.body.loads import TOUCHING, Touching
from cosim.soft.film.step_arrays import PLACE, StepPlace
from cosim.soft.solve.film_step import FILM_SIDE, FilmSide


class FilmCommands(NamedTuple):
    """What is asked for in each of n ticks.

    Args:
        position: (n, joints) [rad].
        velocity: (n, joints) [rad/s].
        torque: (n, joints) [N m], feedforward without payload.
        by_payload: (n, joints, 10), its derivative by the payload's `inertial_parameters`; of none: zero.
        pressure: (n, chambers) [Pa].
        tension: (n, cables) [N], at their base ends.
        gravity: (n, 3) [m/s^2].
    """

    position: Array
    velocity: Array
    torque: Array
    by_payload: Array
    pressure: Array
    tension: Array
    gravity: Array

    def rows(self, first: int, end: int) -> FilmCommands:
        """Return what is asked for in some of the ticks."""
        return FilmCommands(*(array[first:end] for array in self))


class FilmMotion(NamedTuple):
    """How a film moves in n ticks.

    Args:
        x: (n + 2, nodes, 3) [m], from the step before the last one on.
        velocity: (n + 2, nodes, 3) [m/s], the same.
        memory: (n + 1, values), what its elements remember.
    """

    x: Array
    velocity: Array
    memory: Array

    def from_on(self, first: int) -> FilmMotion:
        """Return the rows of a tick and all after it."""
        return FilmMotion(self.x[first:], self.velocity[first:], self.memory[first:])


class FilmReach(NamedTuple):
    """What the film may come to touch.

    Args:
        bounds: of what can be touched.
        rest_m: how far a film at rest looks.
        ahead_s: the time for whose way of the fastest node it looks further.
    """

    bounds: ShapeBounds
    rest_m: float
    ahead_s: float


class FilmRow(NamedTuple):
    """What all ticks of a row have in common.

    Args:
        side: of the soft steps.
        untouched: what stands for nothing touched in them.
        place: from which they begin where nothing is touched.
        touching_place: the same where something is.
        reach: of the film.
        calls: (kernels,), see `row_calls`.
        mass: (nodes, 1, 1) [kg].
        total_kg: of the film.
        largest_turn: [rad], of the flange in a tick; beyond it a step is left.
        contact: with the scene.
    """

    side: FilmSide
    untouched: Touching
    place: StepPlace
    touching_place: StepPlace
    reach: FilmReach
    calls: IntArray
    mass: Array
    total_kg: float
    largest_turn: float
    contact: ContactRow


FILM_COMMANDS = types.NamedTuple((MATRIX, MATRIX, MATRIX, BLOCKS, MATRIX, MATRIX, MATRIX), FilmCommands)
FILM_MOTION = types.NamedTuple((BLOCKS, BLOCKS, MATRIX), FilmMotion)
_REACH = types.NamedTuple((SHAPE_BOUNDS, REAL, REAL), FilmReach)
FILM_ROW = types.NamedTuple(
    (FILM_SIDE, TOUCHING, PLACE, PLACE, _REACH, INDICES, BLOCKS, REAL, REAL, CONTACT_ROW), FilmRow
)
