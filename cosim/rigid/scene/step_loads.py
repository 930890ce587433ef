"""What soft robots do inside of somebody's step of MuJoCo: their loads, and the inertia that mounts carry.

Loads are added to those of the loop ahead of a step, and taken off after it.

Inertia has to be in the mass matrix when MuJoCo solves for accelerations. The only place for it is the
control callback, one pointer for the whole process. While a step with inertia is in progress, it points to
`carry_in_step`. That looks its work up by the address of the MjData in a table. For other data it does
nothing. Then it calls the function that was there before.

It is compiled: it takes no lock, so threads do not wait for one another in it, and no exception can be raised
in it, Ctrl-C included. A step that was interrupted leaves its row until the soft robot is reset, restored or
deleted. Its MjData is kept as long, so that no other gets the address.
"""

from collections import deque
from ctypes import c_void_p
from functools import cache
from threading import Lock
from typing import Final, TypeAlias, final
from weakref import WeakValueDictionary

import mujoco
import numpy as np

from cosim.base.c_callback import c_function, call_c, numbers_at, reals_at
from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.rigid.scene.arm import Mounting
from cosim.rigid.scene.bodies import addresses, mass_places

_ROWS: Final = 64  # of the first table


_TABLE: Final = np.zeros(1, np.int64)
"""Address of the table in use, int64: how many rows; address of MuJoCo's factorisation of the mass matrix;
where the address of the callback is that was there before, 0 for none; then rows: addresses of an MjData and
of what is carried in its step, 0 in a free row."""
_HEAD: Final = 3
_TABLE_AT: Final = int(_TABLE.ctypes.data)


def carry_in_step(model: int, data: int) -> None:
    """Add what mounts carry to a mass matrix that MuJoCo has just computed; its control callback."""
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
    """What one mount carries in steps of one MjData; its row of the table while a step is in progress.

    `in_step` says whether one may be.

    Args:
        model: of the scene.
        data: its state, which is kept.
        mounting: whose degrees of freedom carry it.
        inertia: (dofs, dofs) [kg m^2], which may change between steps.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting, inertia: Array
    ) -> None:
        self.in_step, self.added = False, np.zeros(1, np.int64)
        places = np.ascontiguousarray(mass_places(model, mounting))
        self._kept = data, data.M, places, inertia, self.added  # their addresses are in use
        parts = (data.M, places, inertia, self.added)
        self._mount = np.array([*(part.ctypes.data for part in parts), len(inertia)], np.int64)
        self.row = np.array((data._address, self._mount.ctypes.data))


@final
class StepsInProgress:
    """The table, and MuJoCo's control callback, which is `carry_in_step` while there is something in it.

    Wherever it is interrupted, a row is there whole or not at all, and the next step puts the rest right.
    """

    def __init__(self) -> None:
        self._factorise, callback = addresses(("mj_factorM", "mjcb_control"))
        self._callback = c_void_p.from_address(callback)
        self._function, self._before = c_function(carry_in_step), np.zeros(1, np.int64)
        self._code = int(self._function.address)
        self._lock, self._left = Lock(), deque[CarriedInStep]()
        self._in_rows: dict[int, CarriedInStep] = {}  # kept as long as they are there
        self._tables: list[IntArray] = []  # all: threads may be in an earlier one
        self._extend(_ROWS)

    def enter(self, carried: CarriedInStep) -> None:
        """Add what a mount carries in the next step of its data."""
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
        """Add it no longer."""
        self.leave_later(carried)
        with self._lock:
            self._clear()
        carried.in_step = False

    def leave_later(self, carried: CarriedInStep) -> None:
        """The same in the next step of any mount: where garbage is collected, nothing can wait for a lock."""
        self._left.append(carried)

    def _clear(self) -> None:
        """Clear the rows of what has left, and put back the callback if none is left."""
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
        """Go on with a longer table, with the rows that there are."""
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
    """Return those of this process."""
    return StepsInProgress()


Loads: TypeAlias = "tuple[Array, Array]"  # as MuJoCo has them: on bodies, on degrees of freedom


@final
class StepLoads:
    """What soft robots apply to one MjData for the length of a step.

    Args:
        data: state of the scene.
    """

    def __init__(self, data: mujoco.MjData) -> None:
        self._data = data
        self._on: dict[object, float] = {}  # when the steps of soft robots began
        self._left: list[Loads] = []  # as the loop has set them, and with the loads of each soft robot

    def put_on(self, robot: object, load: Array, torque: Array) -> None:
        """Add what a soft robot applies.

        Args:
            robot: that it is.
            load: (bodies, 6), at centres of mass.
            torque: (nv,).

        Raises:
            InputError: the step of another soft robot on this data has not ended.
        """
        data, now = self._data, float(self._data.time)
        if any(began != now for began in self._on.values()):
            raise InputError(
                "another soft robot on this data was left in the middle of a step; call its "
                "reset(model, data) or restore(saved)"
            )
        if not self._on:
            self._left = [self._here()]
        self._left.append((data.xfrc_applied + load, data.qfrc_applied + torque))
        self._on[robot] = now
        data.xfrc_applied[:], data.qfrc_applied[:] = self._left[-1]

    def take_off(self, robot: object) -> list[str]:
        """Undo `put_on`; what the loop has applied is there again once all have been taken off.

        Returns:
            Names of the arrays that somebody has written to meanwhile.
        """
        written = self._written()
        self._on.pop(robot, None)
        if not self._on:
            self._data.xfrc_applied[:], self._data.qfrc_applied[:] = self._left[0]
        return written

    def abandon(self, robot: object) -> None:
        """The same for a step that was left in the middle: arrays that somebody has written to stay."""
        if self._on.pop(robot, None) is None or self._on:
            return
        first, *others = self._left
        for here, given, *put in zip(self._here_now(), first, *others, strict=True):
            if any(np.array_equal(here, each) for each in put):
                here[:] = given

    def _here_now(self) -> Loads:
        return self._data.xfrc_applied, self._data.qfrc_applied

    def _here(self) -> Loads:
        return self._data.xfrc_applied.copy(), self._data.qfrc_applied.copy()

    def _written(self) -> list[str]:
        names = ("xfrc_applied", "qfrc_applied")
        pairs = zip(names, self._here_now(), self._left[-1], strict=True)
        return [name for name, here, left in pairs if not np.array_equal(here, left)]


_LOADS: Final[WeakValueDictionary[int, StepLoads]] = WeakValueDictionary()


def loads_of(data: mujoco.MjData) -> StepLoads:
    """Return what soft robots apply to a state of a scene; those on the same state share it."""
    return _LOADS.setdefault(data._address, StepLoads(data))
