"""Contact with the scene in rows of ticks: what a row begins with, and where it leaves the exchange."""

from __future__ import annotations

import sys
from functools import cache
from typing import Final, final

import numpy as np

from cosim.base.frames import SixNumbers
from cosim.base.kernels import address_of, nothing_of
from cosim.coupling.batch.batch_arrays import Ticks
from cosim.coupling.batch.contact_halves import contact_calls
from cosim.coupling.batch.contact_rows import (
    AGE,
    ASKS,
    CONTACT_ROW,
    NEAR,
    POINTS,
    REMEMBERED,
    TOUCHES,
    ContactNumbers,
    ContactRow,
)
from cosim.coupling.contact.body_stiffness import RENEW_ABOVE
from cosim.coupling.contact.contact_arrays import EndRows, MemoryRows, Ties
from cosim.coupling.contact.contact_exchange import BEHIND_M, FEATURE_AREA_M2
from cosim.coupling.contact.contact_memory import ContactMemory
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.momentum_balance import NOTHING, six_numbers
from cosim.soft.contact.obstacle_contact import PlaneRows, TouchedPlanes, add_contacts

_RATIO: Final = 2  # its place in `Ticks.contact`


@cache
def _nothing() -> ContactRow:
    nothing: ContactRow = nothing_of(CONTACT_ROW)
    return nothing


def nothing_there() -> ContactRow:
    """Return what stands for a row in which nothing is touched."""
    return _nothing()._replace(handed=np.zeros(7), speed=np.zeros(1), counts=np.zeros(6, np.int64))


@final
class RowContact:
    """Finds contacts in rows of ticks, for bodies that are fixed or free.

    Args:
        interface: with contact.
    """

    def __init__(self, interface: Interface) -> None:
        contact, mass = interface.contact, interface.body_mass
        assert contact is not None, "asked for where there is contact"
        assert mass is not None, "it comes with contact"
        self._interface, self._exchange, self._mass = interface, contact, mass
        self._row = nothing_there()

    @classmethod
    def of(cls, interface: Interface) -> RowContact | None:
        """Return what finds the contacts of an interface; None where that takes more than a kernel."""
        mass = interface.body_mass
        return None if mass is None or mass.knows_joints else cls(interface)

    def begin(self) -> ContactRow:
        """Return what a row of ticks begins with."""
        exchange, interface, row = self._exchange, self._interface, self._row
        memory, (touching, weighed, age) = exchange.memory, self._mass.begin_row()
        if not (exchange.neighbours.begun or len(memory.key) or len(exchange.bodies.loaded) or weighed.any()):
            row.counts[:] = 0, 0, 0, 0, age, 0
            return row  # the first that is near ends it
        search = exchange.neighbours.search
        room, remembered = len(search.lists.listed) + len(search.lists.features), len(memory.key)
        if row.search is not search or len(row.memory.key) < max(room, remembered):
            row = self._row = self._made(max(room, remembered))
        for name, part in zip(MemoryRows._fields, row.memory, strict=True):
            part[:remembered] = getattr(memory, name)
        row.loaded[:] = 0
        row.loaded[exchange.bodies.loaded] = 1
        row.touching[:], row.weighed[:] = touching, weighed
        handed = interface.handed
        row.handed[:] = *handed.bodies, handed.bodies_size_N
        row.counts[:] = remembered, 0, 0, 0, age, 0
        return row

    def _made(self, room: int) -> ContactRow:
        exchange = self._exchange
        law, bodies, search = exchange.law, exchange.bodies, exchange.neighbours.search
        stiffness, free = law.stiffness_N_m3, bodies.free
        # without a free body there is nothing to weigh
        after = self._mass.renewed_after if len(free) else sys.maxsize
        numbers = ContactNumbers(BEHIND_M, stiffness, stiffness * FEATURE_AREA_M2, RENEW_ABOVE, after)
        widths = np.array([law.smoothing_m, law.stick_m])
        touched = TouchedPlanes(
            address_of(add_contacts), PlaneRows.room(room), widths, np.empty((room, 3)), np.empty(room)
        )
        return nothing_there()._replace(
            there=True, search=search, shapes=exchange.shape_rows, numbers=numbers,
            memory=MemoryRows.room(room), kept=MemoryRows.room(room), touched=touched, ties=Ties.room(room),
            end=EndRows.room(room, bodies.count), applied=bodies.applied, centers=bodies.mass_centers,
            loaded=np.zeros(bodies.count, np.int64), free=free, touching=np.zeros(len(free)),
            weighed=np.zeros(len(free), np.int64), calls=contact_calls(),
        )  # fmt: skip

    @property
    def handed(self) -> tuple[SixNumbers, float]:
        """What the film has handed over to bodies, about the world's origin, and its size [N]."""
        handed = self._row.handed
        return (six_numbers(handed[:6]), float(handed[6])) if self._row.counts[TOUCHES] else (NOTHING, 0.0)

    def end(self, ticks: Ticks, done: int, *, carry: bool, half_done: bool) -> None:
        """Bring exchange and bodies to where a row has stopped, and weigh these where they ask for it.

        Args:
            ticks: of the row; their contact ratio is filled.
            done: how many, at least one.
            carry: whether bodies carry what they are lighter than the film's answer.
            half_done: whether contacts of one more have been looked for.
        """
        row, exchange, interface = self._row, self._exchange, self._interface
        age, asks, remembered = (int(row.counts[place]) for place in (AGE, ASKS, REMEMBERED))
        exchange.bodies.loaded = np.flatnonzero(row.loaded)
        if row.there:  # nothing is remembered otherwise, nor before
            exchange.memory = ContactMemory(*(part[:remembered].copy() for part in row.memory))  # type: ignore[arg-type]
        if not half_done:  # otherwise all else is found anew
            self._take_over()
        self._mass.end_row(age - asks)
        ticks.contact[:done, _RATIO] = interface.contact_ratio
        if asks:
            self._mass.update(carry=carry)
            ticks.contact[done - 1, _RATIO] = interface.contact_ratio

    def _take_over(self) -> None:
        row, exchange = self._row, self._exchange
        exchange.near, exchange.film_speed_m_s = bool(row.counts[NEAR]), float(row.speed[0])
        count = int(row.counts[TOUCHES])
        if not count:
            exchange.planes, self._interface.touched = None, exchange.nothing_settled()
            return
        planes = PlaneRows(*(part[:count].copy() for part in row.touched.planes))  # type: ignore[arg-type]
        ties = Ties(*(part[:count].copy() for part in row.ties))  # type: ignore[arg-type]
        of_points, end = (part[:count].copy() for part in row.end[:2]), row.end[2:]
        left = EndRows(*of_points, *(part.copy() for part in end))  # type: ignore[arg-type]
        self._interface.touched = exchange.go_to(planes, ties, int(row.counts[POINTS]), left)
