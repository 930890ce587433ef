"""Many ticks of a phase in one call: what the lockstep is asked for, and what it shows."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.clock import Clock
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.reduced.sections.outputs import CENTER, WRENCH
from cosim.soft.body.loads import Loads
from cosim.stepping.cursor import Cursor
from cosim.stepping.parts import Parts
from cosim.telemetry.film_shape import FilmShapes
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:  # a scene without an arm does not wait for MuJoCo
    from cosim.base.link_contact import LinkContact
    from cosim.coupling.batch.batch_arrays import Ticks
    from cosim.coupling.batch.lockstep import Lockstep, LockstepProgress, Rows


@final
class BatchStepper:
    """Takes ticks of one phase, as many at once as the exchange allows.

    Args:
        parts: of the run.
        lockstep: of its carrier.
        phase: its index.
        tick_s: length of a tick [s].
    """

    def __init__(self, parts: Parts, lockstep: Lockstep, phase: int, tick_s: float) -> None:
        self._parts, self._lockstep, self.phase, self._tick_s = parts, lockstep, phase, tick_s
        self._first = 0
        self._targets: Array = np.zeros((0, 0))
        self._tension: Array = np.zeros((0, 0))
        self._loads: list[Loads] = []
        self._commands: Rows | None = None
        self.half_done: Loads | None = None
        """Loads of a tick of which the soft half is still to be taken; None for none."""
        self.broken = False
        """Whether the rigid side has become unstable in the tick to come."""

    def take(self, to: Cursor, most: int) -> TickBatch | None:
        """Take ticks; return them, or None where a tick needs more than the lockstep does.

        A batch is empty where only the rigid half of a tick could be taken.

        Args:
            to: where the first tick ends.
            most: how many at once, at least one.
        """
        began = time.perf_counter()
        place = to.done - 1 - self._first
        if not 0 <= place < len(self._loads):
            self._work_out(to.done)
            place = 0
        if self._commands is None or not self._lockstep.ready:
            return None
        stop = min(place + most, len(self._loads))
        loads = self._loads[place:stop]
        progress = self._lockstep.advance(self._commands.rows(place, stop), loads)
        self.broken = progress.broken
        if progress.half_done:
            self.half_done = loads[progress.done]
        spent = (time.perf_counter() - began) / max(1, progress.done)
        return self._batch(progress, to, place, spent)

    def finish(self, loads: Loads) -> LedgerEntry:
        """Take the soft half of a tick that is half done; see `Lockstep.finish_tick`."""
        ledger = self._lockstep.finish_tick(loads)
        self.half_done = None
        return ledger

    def _work_out(self, done: int) -> None:
        """Work out what is asked for from a tick on, where that is known."""
        parts, ahead = self._parts, self._parts.commands.ahead(self.phase, done)
        self._first, self._loads, self._commands = done - 1, [], None
        if ahead is None:
            return
        self._loads = [parts.loads(command) for command in ahead.soft]
        servos = parts.carrier.servos(ahead.joints)
        self._targets = servos.position
        self._tension = np.array([asked.cable_tension_N for asked in ahead.soft]).reshape(len(ahead.soft), -1)
        self._commands = self._lockstep.commands(servos, self._loads)

    def target(self, done: int) -> Array:
        """Return what the servos follow (joints,) [rad] in a tick taken last; see `take`."""
        return np.asarray(self._targets[done - 1 - self._first])

    def _link_contacts(self, ticks: Ticks, first: int, count: int) -> dict[int, tuple[LinkContact, ...]]:
        """Return what the arm's links touch in ticks from the first one on, by row."""
        search = self._parts.carrier.link_contacts_in
        looked = self._parts.looks_at_links(first, count)
        found = {k: search(ticks.joints[k], ticks.places[k], ticks.quaternions[k]) for k in looked}
        return {k: contacts for k, contacts in found.items() if contacts}

    def _batch(self, progress: LockstepProgress, to: Cursor, place: int, spent_s: float) -> TickBatch:
        """Return what ticks show whose commands begin at a place."""
        n, ticks = progress.done, progress.ticks
        tick = np.arange(to.tick, to.tick + n)
        time_s = np.array([Clock(self._tick_s, count).time_s for count in tick.tolist()])
        wanted = self._parts.wanted_tip(self.phase, time_s)
        return TickBatch(
            tick=tick,
            time_s=time_s,
            phase=np.full(n, to.phase),
            joint_position=ticks.joints[:n],
            joint_velocity=ticks.joint_speed[:n],
            joint_torque=ticks.servo_torque[:n],
            joint_target=self._targets[place : place + n],
            body_position=ticks.places[:n],
            body_quaternion=ticks.quaternions[:n],
            body_contact_force=ticks.body_force[:n],
            film=FilmShapes(self._parts.shape_reader, progress.shapes),
            flange_position=ticks.origin[1 : n + 1],
            flange_rotation=ticks.axes[1 : n + 1],
            flange_twist=ticks.twist[:n],
            chamber_pressure_Pa=progress.pressure_Pa,
            cable_tension_N=self._tension[place : place + n],
            tip_target=np.full((n, 3), np.nan) if wanted is None else wanted,
            has_tip_target=np.full(n, wanted is not None),
            wrench=ticks.figures[1 : n + 1, WRENCH:CENTER],
            rigid_power_W=ticks.power[:n, 0],
            soft_power_W=ticks.power[:n, 1],
            residual_N=ticks.residual[:n],
            newton_iterations=ticks.iterations[:n],
            stability_ratio=progress.stability_ratio[:n],
            algorithmic_mass=progress.algorithmic_mass[:n],
            power_size_W=ticks.power[:n, 2],
            momentum_error=ticks.momentum_error[:n],
            tick_wall_s=np.full(n, spent_s),
            devices=(None,) * n,
            link_contacts=self._link_contacts(ticks, to.tick, n),
            contacts=ticks.contacts[:n],
            contact_force_N=ticks.contact[:n, 0],
            contact_depth_m=ticks.contact[:n, 1],
            contact_ratio=ticks.contact[:n, 2],
            **_staggered(n),
        )


def _staggered(count: int) -> dict[str, Any]:
    """Return what is the same in all ticks of a staggered exchange of films that do not touch one another."""
    number, none = np.zeros(count), np.zeros(count, np.int64)
    return {
        "self_contacts": none, "self_contact_force_N": number, "self_contact_depth_m": number,
        "scheme": np.full(count, "staggered"), "trials": none + 1, "slides": none,
        "interface_residual": number,
    }  # fmt: skip
