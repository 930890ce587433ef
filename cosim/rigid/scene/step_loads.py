"""Adds the loads of attached soft robots to those of a user's loop for one step of MuJoCo, and restores the
loop's loads after it.
"""

from typing import Final, TypeAlias, final
from weakref import WeakValueDictionary

import mujoco
import numpy as np

from cosim.base.frames import Array
from cosim.errors import InputError

Loads: TypeAlias = "tuple[Array, Array]"  # xfrc_applied and qfrc_applied


@final
class StepLoads:
    """Loads of soft robots on one MjData during a step.

    Args:
        data: state of the scene.
    """

    def __init__(self, data: mujoco.MjData) -> None:
        self._data = data
        self._on: dict[object, float] = {}  # when the steps of soft robots began
        self._left: list[Loads] = []  # as the loop has set them, and with the loads of each soft robot

    def put_on(self, robot: object, load: Array, torque: Array) -> None:
        """Add the loads of a soft robot.

        Args:
            robot: key of the soft robot.
            load: (bodies, 6) [N, N m], at centres of mass, world axes.
            torque: (nv,) [N m] or [N].

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
            self._left = [self._copied()]
        self._left.append((data.xfrc_applied + load, data.qfrc_applied + torque))
        self._on[robot] = now
        data.xfrc_applied[:], data.qfrc_applied[:] = self._left[-1]

    def take_off(self, robot: object) -> list[str]:
        """Undo `put_on`; after the last soft robot the loop's loads are restored.

        Returns:
            Names of the arrays that have been written to meanwhile.
        """
        written = self._written()
        self._on.pop(robot, None)
        if not self._on:
            self._data.xfrc_applied[:], self._data.qfrc_applied[:] = self._left[0]
        return written

    def abandon(self, robot: object) -> None:
        """Undo `put_on` for an interrupted step; arrays that have been written to meanwhile are unchanged."""
        if self._on.pop(robot, None) is None or self._on:
            return
        first, *others = self._left
        for applied, of_loop, *put in zip(self._applied(), first, *others, strict=True):
            if any(np.array_equal(applied, each) for each in put):
                applied[:] = of_loop

    def _applied(self) -> Loads:
        return self._data.xfrc_applied, self._data.qfrc_applied

    def _copied(self) -> Loads:
        return self._data.xfrc_applied.copy(), self._data.qfrc_applied.copy()

    def _written(self) -> list[str]:
        names = ("xfrc_applied", "qfrc_applied")
        pairs = zip(names, self._applied(), self._left[-1], strict=True)
        return [name for name, applied, left in pairs if not np.array_equal(applied, left)]


_LOADS: Final[WeakValueDictionary[int, StepLoads]] = WeakValueDictionary()


def loads_of(data: mujoco.MjData) -> StepLoads:
    """Return the loads of soft robots on an MjData, one object for all soft robots on the same MjData."""
    return _LOADS.setdefault(data._address, StepLoads(data))
