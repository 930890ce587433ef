"""What rows of ticks have in common, whatever model of the soft robot is stepped in them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, Pose, SixNumbers, Wrench
from cosim.coupling.batch.added_inertia import AddedInertiaRow
from cosim.coupling.batch.batch_arrays import Ticks
from cosim.coupling.batch.lockstep import Lockstep, LockstepProgress, Rows
from cosim.coupling.batch.tick_halves import ALL_DONE, RIGID_SIDE_WARNS
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.coupling.schemes.momentum_balance import NOTHING, TransferredLoads, six_numbers
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.reduced.sections.outputs import FIGURES, supplied_wrench
from cosim.rigid.scene.native import NativeScene
from cosim.soft.body.loads import Loads


class RowLockstep(Lockstep):
    """Advances one coupling by rows of ticks, each in one kernel call.

    Args:
        coupling: staggered.
        native: its rigid side.
        mounted: (10,) `inertial_parameters` of a rigid mass on the flange, flange frame.
        most: ticks in a row.
    """

    def __init__(self, coupling: StaggeredCoupling, native: NativeScene, mounted: Array, most: int) -> None:
        self.coupling, self.native, self.mounted, self._most = coupling, native, mounted, most
        self._lost = 0.0

    @final
    def advance(self, commands: Rows, loads: Sequence[Loads]) -> LockstepProgress:
        interface, count = self.coupling.interface, min(len(loads), self._most)
        interface.scene.check()
        ticks, motion = self._empty(count), self._motion(count)
        ratio, carried = np.empty(count), np.zeros(count, dtype=bool)
        done, ending = 0, ALL_DONE
        while done < count and ending == ALL_DONE:
            # in between, the flange is weighed
            most, on_joints = self.coupling.begin_row()
            end = min(done + most, count)
            ratio[done:end], carried[done:end] = interface.ratio, len(on_joints.inertia) > 0
            taken, ending = self._row(
                ticks.from_on(done),
                motion.from_on(done),
                commands.rows(done, end),
                loads[done:end],
                on_joints,
            )
            done += taken
        half_done, broken = ending not in (ALL_DONE, RIGID_SIDE_WARNS), ending == RIGID_SIDE_WARNS
        if broken and not done:
            interface.scene.check()
        shapes, pressure = self._shown(motion, commands, done)
        return LockstepProgress(ticks, shapes, pressure, done, half_done, broken, ratio, carried)

    @final
    def finish_tick(self, loads: Loads) -> LedgerEntry:
        self.coupling.interface.ticks += 1
        return self.coupling.finish_tick(loads, self.coupling.wrench, self._lost)

    @abstractmethod
    def _figures(self) -> Array:
        """Return the figures (FIGURES,) of the soft side now."""

    @abstractmethod
    def _motion(self, count: int) -> Any:
        """Return rows of the soft side for n ticks, with what is there before the first of them."""

    @abstractmethod
    def _row(
        self, ticks: Ticks, motion: Any, commands: Any, loads: Sequence[Loads], carried: AddedInertiaRow
    ) -> tuple[int, int]:
        """Advance in one go; return how many ticks are done, and how that ended."""

    @abstractmethod
    def _shown(self, motion: Any, commands: Any, done: int) -> tuple[Sequence[Any], Array]:
        """Return shapes (done,) and pressures (done, chambers) [Pa] of the ticks taken."""

    def _empty(self, count: int) -> Ticks:
        """Return the rows to fill, with what is there before the first tick."""
        native, interface = self.native, self.coupling.interface
        flange, handed = interface.scene.flange_pose, interface.handed
        joints, bodies = len(native.position), len(native.places)
        ticks = Ticks(
            np.empty((count + 1, FIGURES)), np.empty((count + 1, 3)), np.empty((count + 1, 3, 3)),
            np.empty((count, 6)), np.empty((count + 1, 7)), np.empty((count, joints)),
            np.empty((count, joints)), np.empty((count, joints)), np.empty((count, bodies, 3)),
            np.empty((count, bodies, 4)), np.empty((count, 3)), np.empty(count),
            np.empty(count), np.empty(count, np.int64), np.zeros(count, np.int64), np.zeros((count, 3)),
            np.zeros((count, bodies, 3)),
        )  # fmt: skip
        ticks.figures[0] = self._figures()
        ticks.origin[0], ticks.axes[0] = flange.translation, flange.rotation
        ticks.handed[0] = (*handed.flange, handed.flange_size_N)
        return ticks

    def _take_over(
        self,
        ticks: Ticks,
        done: int,
        on_bodies: tuple[SixNumbers, float] = (NOTHING, 0.0),
        *,
        half_done: bool,
    ) -> None:
        """Bring rigid side and coupling to where the kernel has stopped.

        Args:
            ticks: of the row.
            done: how many.
            on_bodies: what was handed over to them in the last one, and its size [N].
            half_done: whether the rigid half of one more is done.
        """
        flange = self.coupling.interface.scene.flange
        if done:
            size = float(ticks.handed[done, 6])
            handed = TransferredLoads(six_numbers(ticks.handed[done, :6]), on_bodies[0], size, on_bodies[1])
            self.coupling.end_row(done, _wrench(ticks.figures[done]), handed)
        if half_done:
            self._lost = float(ticks.momentum_error[done])
            flange.stepped(pose_of(ticks, done))
        else:
            flange.stepped(pose_of(ticks, done - 1))


def pose_of(ticks: Ticks, row: int) -> Pose:
    """Return the flange's pose before a tick."""
    return Pose.owning(ticks.axes[row].copy(), ticks.origin[row].copy())


def _wrench(figures: Array) -> Wrench:
    return supplied_wrench(figures.copy())
