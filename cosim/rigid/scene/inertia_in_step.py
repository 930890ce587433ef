"""Adds the inertia that mounts carry to the mass matrix within a step of MuJoCo that a user's loop takes. The
inertia has to be in the matrix when MuJoCo solves for accelerations. The only hook at that point is the
control callback, one pointer for the whole process. While a step with added inertia is in progress, the
pointer is set to the compiled function `carry_in_step`. It looks up the address of the MjData in a table,
does nothing for other data, and then calls the previous callback. It takes no lock, so threads do not wait
for one another in it, and it raises no exception, Ctrl-C included. An interrupted step leaves its row until
the soft robot is reset, restored or deleted; its MjData is referenced until then, so that no other gets the
address.
"""

import ctypes
from collections import deque
from ctypes import c_void_p
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.c_callback import c_function, call_c, numbers_at, reals_at
from cosim.base.frames import Array, IntArray
from cosim.errors import SceneError
from cosim.rigid.scene.added_inertia import mass_places
from cosim.rigid.scene.arm_layout import Mounting

_ROWS: Final = 64  # of the first table
_TABLE: Final = np.zeros(1, np.int64)
"""Address of the table in use. It has int64 entries: the number of rows; the address of mj_factorM; the
address of the variable with the previous callback (0: none); then rows with the addresses of an MjData and of
its mount's data (0 in a free row)."""
_HEAD: Final = 3
_TABLE_AT: Final = int(_TABLE.ctypes.data)


@cache
def addresses(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the addresses of functions of MuJoCo's library.

    Raises:
        SceneError: MuJoCo's library cannot be found.
    """
    folder = Path(mujoco.__file__).parent
    for path in sorted(folder.glob("*mujoco*")):
        if path.suffix in (".dll", ".dylib") or ".so." in path.name:
            library = ctypes.CDLL(str(path))  # it is loaded already: this finds it
            return tuple(ctypes.cast(library[name], ctypes.c_void_p).value or 0 for name in names)
    raise SceneError(f"MuJoCo's library is not in {folder}: install its package (`pip install mujoco`)", None)


def carry_in_step(model: int, data: int) -> None:
    """MuJoCo's control callback: add the inertia of mounts to the newly computed mass matrix."""
    table, carries = numbers_at(numbers_at(_TABLE_AT)[0]), False
    for k in range(table[0]):
        if table[_HEAD + 2 * k] == data:
            mount = numbers_at(table[_HEAD + 2 * k + 1])
            mass, places, inertia = reals_at(mount[0]), numbers_at(mount[1]), reals_at(mount[2])
            dofs, added = mount[4], numbers_at(mount[3])
            for i in range(dofs):
                for j in range(i + 1):
                    mass[places[i * dofs + j]] += inertia[i * dofs + j]
            added[0] += 1
            carries = True
    if carries:
        call_c(table[1], model, data)
    before = numbers_at(table[2])[0]
    if before != 0:
        call_c(before, model, data)


@final
class CarriedInStep:
    """Inertia that is added to one mount in steps of one MjData, and its row of the table.

    `in_step` is whether a step may be in progress.

    Args:
        model: of the scene.
        data: its state, to which this object keeps a reference.
        mounting: mount, to whose degrees of freedom the inertia is added.
        inertia: (dofs, dofs) [kg m^2], which may change between steps.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting, inertia: Array
    ) -> None:
        self.in_step, self.added = False, np.zeros(1, np.int64)
        places = np.ascontiguousarray(mass_places(model, mounting))
        self._referenced = data, data.M, places, inertia, self.added  # C uses their addresses
        parts = (data.M, places, inertia, self.added)
        self._mount = np.array([*(part.ctypes.data for part in parts), len(inertia)], np.int64)
        self.row = np.array((data._address, self._mount.ctypes.data))


@final
class StepsInProgress:
    """The table of steps in progress; while it has rows, MuJoCo's control callback is `carry_in_step`.

    If a method is interrupted, a row is complete or absent, and the next step repairs the rest.
    """

    def __init__(self) -> None:
        self._factorise, callback = addresses(("mj_factorM", "mjcb_control"))
        self._callback = c_void_p.from_address(callback)
        self._function, self._before = c_function(carry_in_step), np.zeros(1, np.int64)
        self._code = int(self._function.address)
        self._lock, self._left = Lock(), deque[CarriedInStep]()
        self._in_rows: dict[int, CarriedInStep] = {}  # referenced while they are in the table
        self._tables: list[IntArray] = []  # all: threads may be in an earlier one
        self._extend(_ROWS)

    def enter(self, carried: CarriedInStep) -> None:
        """Add a mount's inertia in the next step of its data."""
        carried.added[0], carried.in_step = 0, True
        with self._lock:
            self._clear()
            rows = self._rows
            if rows[:, 0].all():
                self._extend(2 * len(rows))
                rows = self._rows
            free = int(np.flatnonzero(rows[:, 0] == 0)[0])
            self._in_rows[free] = carried
            rows[free] = carried.row
            _TABLE[0] = self._tables[-1].ctypes.data
            if self._callback.value != self._code:
                self._before[0] = self._callback.value or 0
                self._callback.value = self._code

    def leave(self, carried: CarriedInStep) -> None:
        """Stop adding a mount's inertia."""
        self.leave_later(carried)
        with self._lock:
            self._clear()
        carried.in_step = False

    def leave_later(self, carried: CarriedInStep) -> None:
        """Stop adding a mount's inertia at the next step of any mount; takes no lock, for finalizers."""
        self._left.append(carried)

    def _clear(self) -> None:
        """Clear the rows of mounts that have left, and restore the previous callback if no row remains."""
        rows = self._rows
        while self._left:
            row = self._left[0].row
            for k in np.flatnonzero((rows == row).all(axis=1)).tolist():
                rows[k] = 0
                self._in_rows.pop(k, None)
            self._left.popleft()
        if not rows.any() and self._callback.value == self._code:
            self._callback.value = int(self._before[0]) or None

    def _extend(self, count: int) -> None:
        """Replace the table by a longer one with the same rows."""
        table = np.zeros(_HEAD + 2 * count, np.int64)
        table[:_HEAD] = count, self._factorise, self._before.ctypes.data
        if self._tables:
            before = self._tables[-1][_HEAD:]
            table[_HEAD : _HEAD + len(before)] = before
        self._tables.append(table)

    @property
    def _rows(self) -> IntArray:
        """(n, 2), a view of the rows of the table in use."""
        return self._tables[-1][_HEAD:].reshape(-1, 2)


@cache
def steps_in_progress() -> StepsInProgress:
    """Return the table of this process."""
    return StepsInProgress()
