"""Substepping: a tick in which the film hits or throws a light body is divided into several exchanges.

If the film approaches a movable body, or carries one along on the flange, by more than a bound per tick, a
step of that length lets the body pass what it should meet. Such a tick is divided into as many substeps as
MuJoCo takes steps in it, each an exchange with one step of arm and film. The film's first step of a new
length is implicit Euler; after the last substep BDF2 again uses the state one whole tick before. A change of
the step length excites vibration of the film, and a light body may reverse within one tick, so that it is
slow at the end of the tick although its load is largest. Therefore substepping lasts until several ticks in
a row have been calm. Servo commands and loads are interpolated within the tick. The tick's row holds values
at its end, but sums of work and iterations, and means of power and of loads on bodies. The loads at the end
of a substep act during the next substep, or the next whole tick.
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

_FAR_M: Final = 3e-4  # relative motion in a tick of the clock above which it is divided
_SETTLED: Final = 0.5  # fraction of it below which a tick is calm
_CALM_TICKS: Final = 10  # calm ticks in a row after which ticks are whole again
_MEAN: Final = (
    "mounted_load", "body_contact_force", "rigid_power_W", "soft_power_W", "power_size_W", "contact_force_N",
)  # fmt: skip
_SUM: Final = ("newton_iterations", "contact_work_J", "self_contact_work_J", "eyelets_J", "bodies_work_J")
"""Columns of a tick that are the mean or the sum over its substeps; others are those of the last one."""


@final
class Substepping:
    """Divides ticks of the clock into substeps while bodies that the film touches move fast.

    Args:
        interface: between arm and soft robot.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface, self._ticks_left = interface, 0
        scene = interface.scene
        possible = interface.contact is not None and scene.substeps > 1 and interface.soft.supports_substeps
        self._fast_m_s = _FAR_M / scene.tick_s if possible else math.inf
        """Speed above which ticks are divided; infinite if they never are."""

    def update(self) -> None:
        """Decide after a tick whether the next one is divided."""
        interface = self._interface
        if self._fast_m_s < math.inf and interface.contact is not None:
            bound = (_SETTLED if self._ticks_left else 1.0) * self._fast_m_s
            moves = interface.contact.fastest_m_s(interface.soft.state) > bound
            self._switch(_CALM_TICKS if moves else max(0, self._ticks_left - 1))

    @property
    def state(self) -> int:
        """How many ticks, from the next one on, are divided at least."""
        return self._ticks_left

    @state.setter
    def state(self, ticks_left: int) -> None:
        interface, self._ticks_left = self._interface, ticks_left
        scene = interface.scene
        scene.set_substep(scene.substeps if ticks_left else None)
        if interface.light is not None:
            interface.light.set_tick_length(scene.tick_s)

    def step_tick(self, carried: CarriedInertia, servos: ServoCommand, loads: Loads, log: TickLog) -> None:
        """Take one tick of the clock in substeps.

        Args:
            carried: inertia on the arm's joints.
            servos: commands of the tick.
            loads: on the soft robot at the end of the tick.
            log: its next row is filled.
        """
        interface = self._interface
        scene, soft = interface.scene, interface.soft
        count, ticks, begin, before = scene.substeps, interface.state.ticks, soft.loads, soft.state
        substeps, shapes = interface.new_log(count), []
        substeps.algorithmic_mass[:] = carried.acts
        for k in range(count):
            scene.set_substep(count - k)
            command = servos._replace(position=servos.position + k * scene.tick_s * servos.velocity)
            tick(interface, carried, command, begin.interpolated(loads, (k + 1) / count), substeps)
            shapes.append(soft.state.positions)
        motion = substeps.flange_twist, substeps.flange_position
        log.substeps[log.done] = SubstepRecord(np.array(shapes), *motion)
        self._condense(substeps, log)
        interface.count_as_one(ticks)
        self.update()
        if not self._ticks_left:  # the next step, a whole tick, uses the state one whole tick before
            soft.state = replace(soft.state, earlier=(before.positions, before.velocities))

    def _switch(self, ticks_left: int) -> None:
        if bool(ticks_left) == bool(self._ticks_left):
            self._ticks_left = ticks_left
            return
        self.state = ticks_left
        self._interface.soft.restart()

    def _condense(self, substeps: TickLog, log: TickLog) -> None:
        """Fill the present tick's row from the rows of its substeps."""
        k = log.done
        for name, rows in substeps.arrays.items():
            log.arrays[name][k] = rows.mean(0) if name in _MEAN else rows.sum(0) if name in _SUM else rows[-1]
        log.body_touch[k, :, 0] = substeps.body_touch[:, :, 0].mean(0)
        log.momentum_error[k] = substeps.momentum_error.max()
        columns = substeps.hit_m_s, substeps.hit_way_m, substeps.hit_body
        hits = zip(*(column.tolist() for column in columns), strict=True)
        worst = max(hits, key=lambda hit: hit[0] / hit[1] if hit[2] >= 0 else 0.0)
        log.hit_m_s[k], log.hit_way_m[k], log.hit_body[k] = worst
        log.shapes.append(self._interface.soft.current_shape())
        log.done += 1
