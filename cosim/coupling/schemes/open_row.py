"""A row of ticks that stays open while somebody else steps the scene: both sides follow once it is closed.

It is the row that kernels take where the scene steps itself, so it has the same bits: what Python does about
a row is done when something of it is read, when it is full, or when a soft half is more than kernels know.
"""

from __future__ import annotations

from typing import Protocol, final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.base.kernels import RecordStore, address_of
from cosim.coupling.film_ticks import FilmCommands, FilmMotion, FilmSteps, advance_film
from cosim.coupling.half_ticks import ALL_DONE, LISTS_LEFT, SOFT_HALF_LEFT, RigidSide, read_rigid_half
from cosim.coupling.open_ticks import OpenTicks, end_open_tick, load_open_tick
from cosim.coupling.ticks import Servos, Ticks
from cosim.coupling.ticks_taken import TicksTaken
from cosim.reduced.sections.assembly import supplied_wrench
from cosim.soft.body.loads import Loads
from cosim.soft.solve.film_step import FilmSide
from cosim.soft.solve.state import StepScheme

_NO_SERVOS = Servos.knowing_no_payload(*[np.zeros((1, 0))] * 3)


class RowsOfFilm(Protocol):
    """What takes ticks of a film in a row; see `FilmHalves`."""

    def commands_room(self, count: int) -> FilmCommands: ...
    def room(self, count: int) -> FilmMotion: ...
    def begin_row(self) -> tuple[tuple[FilmSide, StepScheme], FilmSteps]: ...
    def with_new_lists(self, steps: FilmSteps, x: Array, velocity: Array) -> FilmSteps: ...
    def ends_row(self, steps: FilmSteps) -> bool: ...
    def end_row(
        self,
        begun: tuple[FilmSide, StepScheme],
        way: FilmMotion,
        ticks: Ticks,
        loads: Loads | None,
        ended: tuple[int, int],
    ) -> tuple[int, int]: ...


@final
class OpenRow:
    """Ticks of a film in a row, of which one may be in progress.

    Args:
        halves: which would take them in one call.
        taken: room for them.
        rigid: side, until the flange is weighed again.
        most: ticks until then, for which there is room.
        store: of earlier rows, in which little changes.
    """

    def __init__(
        self, halves: RowsOfFilm, taken: TicksTaken, rigid: RigidSide, most: int, store: RecordStore
    ) -> None:
        self.taken, self.rigid, self._halves, self._store = taken, rigid, halves, store
        self.done, self.in_tick, self._ending = 0, False, ALL_DONE
        self._most = most
        self._begun, steps = halves.begin_row()
        self._loads: Loads | None = None
        rows = halves.commands_room(most), steps, taken.ticks, halves.room(most)
        ticks = OpenTicks(rigid, _NO_SERVOS, *rows)
        self._ticks, self._at, self._call = ticks, store.address(ticks), address_of(advance_film)

    @property
    def full(self) -> bool:
        """Whether it takes no more: there is no room, or something is to be weighed."""
        return self.done >= self._most or self._halves.ends_row(self._ticks.steps)

    @property
    def wrench(self) -> Wrench:
        """What the soft side exerts on the flange at present, at its origin, world axes."""
        return supplied_wrench(self.taken.ticks.figures[self.done].copy())

    @property
    def positions(self) -> Array:
        """(n, 3) [m], a view of the nodes at the end of the last tick."""
        return self._ticks.way.x[self.done + 1]

    def load(self) -> None:
        """Begin a tick."""
        load_open_tick(self._at, self.done)
        self.in_tick = True

    def end(self, loads: Loads) -> bool:
        """End a tick under loads at its end; return whether kernels have taken it.

        Otherwise its rigid half has been read, and the row is to be closed.
        """
        k, row = self.done, self._ticks
        self.in_tick = False
        if not loads.plain:
            read_rigid_half(self.rigid, _NO_SERVOS, row.ticks, k)
            self._ending = SOFT_HALF_LEFT
            return False
        if loads is not self._loads:
            commands, chambers = row.commands, row.commands.pressure.shape[1]
            commands.pressure[k:] = loads.pressures(chambers)
            commands.tension[k:], commands.gravity[k:] = loads.cable_tension_N, loads.gravity
        self._ending = end_open_tick(self._at, self._call, k)
        if self._ending == LISTS_LEFT:
            self._with(self._halves.with_new_lists(row.steps, row.way.x[k + 1], row.way.velocity[k + 1]))
            self._ending = end_open_tick(self._at, self._call, k)
            self._most = k + 1
        if self._ending != ALL_DONE:
            return False
        self._loads, self.done = loads, k + 1
        return True

    def _with(self, steps: FilmSteps) -> None:
        self._ticks = self._ticks._replace(steps=steps)
        self._at = self._store.address(self._ticks)

    def close(self) -> None:
        """Let the soft side go to where the ticks have led it."""
        ending = SOFT_HALF_LEFT if self._ending == LISTS_LEFT else self._ending
        row = self._ticks
        self._halves.end_row(self._begun, row.way, row.ticks, self._loads, (self.done, ending))
