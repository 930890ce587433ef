"""Fine ticks: a tick of the clock in which something light is hit or thrown, as several exchanges.

Where the film comes on to a body that can move, or takes one along on the flange, by more than a bound in a
tick, a step of that length has the body fly past what it would meet. Such a tick is taken in as many pieces
as MuJoCo takes steps in it, each an exchange with one step of either side. The film's first step of another
length is one of implicit Euler; after the last piece it looks back over a whole tick again. Each change
shakes the film, and a light body turns back within one tick, slow at its end while its load is largest. So
ticks stay fine until several in a row have been calm.

Servo commands and loads continue within the tick. What is shown of it belongs to its end, but for sums of work and
and iterations, and means of power and of what acts on bodies. What is left at the end of a piece acts through the
next one, or the next whole tick.
"""

import math
from dataclasses import replace
from typing import Final, final

import numpy as np

from cosim.coupling.schemes.algorithmic_mass import CarriedInertia
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.tick import tick
from cosim.coupling.shape_figures import SubstepRecord
from cosim.coupling.ticks import ServoCommand, TickLog
from cosim.soft.body.loads import Loads

_FAR_M: Final = 3e-4  # way in a tick of the clock from which on it is a fine one
_SETTLED: Final = 0.5  # share of it below which a tick is calm
_CALM_TICKS: Final = 10  # of such in a row, after which ticks are whole again
_MEAN: Final = (
    "mounted_load", "body_contact_force", "rigid_power_W", "soft_power_W", "power_size_W", "contact_force_N",
)  # fmt: skip
_SUM: Final = ("newton_iterations", "contact_work_J", "self_contact_work_J", "eyelets_J", "bodies_work_J")
"""Columns of a tick that are the mean or the sum of its pieces; others are those of the last one."""


@final
class Substepping:
    """Takes ticks of the clock in pieces while what the film touches moves far in one.

    Args:
        interface: between the sides.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface, self._left = interface, 0
        scene = interface.scene
        known = interface.contact is not None and scene.substeps > 1 and interface.soft.supports_substeps
        self._fast_m_s = _FAR_M / scene.tick_s if known else math.inf
        """Speed from which on ticks are fine ones; infinite where none are."""

    def look(self) -> None:
        """Decide on the next tick, after one."""
        interface = self._interface
        if self._fast_m_s < math.inf and interface.contact is not None:
            bound = (_SETTLED if self._left else 1.0) * self._fast_m_s
            moves = interface.contact.fastest_m_s(interface.soft.state) > bound
            self._go(_CALM_TICKS if moves else max(0, self._left - 1))

    @property
    def state(self) -> int:
        """How many ticks from the next one on are fine ones at least."""
        return self._left

    @state.setter
    def state(self, left: int) -> None:
        interface, self._left = self._interface, left
        scene = interface.scene
        scene.set_substep(scene.substeps if left else None)
        if interface.light is not None:
            interface.light.begin_ticks_of(scene.tick_s)

    def take(self, carried: CarriedInertia, servos: ServoCommand, loads: Loads, taken: TickLog) -> None:
        """Take one tick of the clock in pieces.

        Args:
            carried: by the joints.
            servos: what they are asked for in it.
            loads: on the soft body at its end.
            taken: its row is filled.
        """
        interface = self._interface
        scene, soft = interface.scene, interface.soft
        count, ticks, begin, before = scene.substeps, interface.state.ticks, soft.loads, soft.state
        fine, shapes = interface.room(count), []
        fine.algorithmic_mass[:] = carried.acts
        for k in range(count):
            scene.set_substep(count - k)
            asked = servos._replace(position=servos.position + k * scene.tick_s * servos.velocity)
            tick(interface, carried, asked, begin.interpolated(loads, (k + 1) / count), fine)
            shapes.append(soft.state.positions)
        taken.pieces[taken.done] = SubstepRecord(np.array(shapes), fine.flange_twist, fine.flange_position)
        self._condense(fine, taken)
        interface.count_as_one(ticks)
        self.look()
        if not self._left:  # the next one looks back over this one
            soft.state = replace(soft.state, earlier=(before.positions, before.velocities))

    def _go(self, left: int) -> None:
        if bool(left) == bool(self._left):
            self._left = left
            return
        self.state = left
        self._interface.soft.restart()

    def _condense(self, fine: TickLog, taken: TickLog) -> None:
        """Fill the row of the tick in progress with what its pieces have left."""
        k = taken.done
        for name, of in fine.arrays.items():
            taken.arrays[name][k] = of.mean(0) if name in _MEAN else of.sum(0) if name in _SUM else of[-1]
        taken.body_touch[k, :, 0] = fine.body_touch[:, :, 0].mean(0)
        taken.momentum_error[k] = fine.momentum_error.max()
        hits = zip(fine.hit_m_s.tolist(), fine.hit_way_m.tolist(), fine.hit_body.tolist(), strict=True)
        worst = max(hits, key=lambda hit: hit[0] / hit[1] if hit[2] >= 0 else 0.0)
        taken.hit_m_s[k], taken.hit_way_m[k], taken.hit_body[k] = worst
        taken.parts.append([self._interface.soft.current_shape()])
        taken.done += 1
