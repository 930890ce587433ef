"""Ticks of a phase in a row: what the lockstep is asked for, worked out for many ticks, and what it shows."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.clock import Clock
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.plan.chamber_gas import ChamberGas
from cosim.reduced.sections.outputs import CENTER, WRENCH
from cosim.soft.body.loads import Loads
from cosim.stepping.parts import Parts
from cosim.stepping.stepped_run import Cursor
from cosim.stepping.tick_references import TickReferences
from cosim.telemetry.snapshot import Snapshot
from cosim.telemetry.tick_columns import TickColumns

if TYPE_CHECKING:  # a scene without an arm does not wait for MuJoCo
    from cosim.base.link_contact import LinkContact
    from cosim.coupling.batch.batch_kernel import Commands, Ticks
    from cosim.coupling.batch.lockstep import Lockstep, TickBatch


@final
class TickRows:
    """Takes ticks of one phase in rows, as many at once as the exchange allows.

    Args:
        parts: of the run.
        lockstep: of its carrier.
        references: of the phase.
        gas: in the chambers, which nothing but the plan changes.
        tick_s: length of a tick [s].
    """

    def __init__(
        self, parts: Parts, lockstep: Lockstep, references: TickReferences, gas: ChamberGas, tick_s: float
    ) -> None:
        self._parts, self._lockstep, self._gas, self._tick_s = parts, lockstep, gas, tick_s
        self.references = references
        self._first = 0
        self._targets: Array = np.zeros((0, 0))
        self._tension: Array = np.zeros((0, 0))
        self._loads: list[Loads] = []
        self._commands: Commands | None = None
        self.half_done: Loads | None = None
        """Loads of a tick of which the soft half is still to be taken; None for none."""
        self.broken = False
        """Whether the rigid side has become unstable in the tick to come."""

    def take(self, to: Cursor, most: int) -> Sequence[Snapshot] | None:
        """Take ticks; return their snapshots, or None where a tick needs more than the lockstep does.

        Args:
            to: where the first tick ends.
            most: how many at once, at least one.
        """
        began = time.perf_counter()
        place = to.done - 1 - self._first
        if not 0 <= place < len(self._loads):
            self._work_out(to.done)
            place = 0
        if self._commands is None:
            return None
        stop = min(place + most, len(self._loads))
        commands = self._commands.rows(place, stop)
        loads = self._loads[place:stop]
        row = self._lockstep.advance(commands, loads)
        self.broken = row.broken
        if row.half_done:
            self.half_done = loads[row.done]
        if not row.done:
            return ()
        spent = (time.perf_counter() - began) / row.done
        columns = self._columns(row, to, place, spent)
        return [Snapshot.of_row(columns, k) for k in range(row.done)]

    def finish(self, loads: Loads) -> LedgerEntry:
        """Take the soft half of a tick that is half done; see `Lockstep.finish_tick`."""
        ledger = self._lockstep.finish_tick(loads)
        self.half_done = None
        return ledger

    def _work_out(self, done: int) -> None:
        """Work out what is asked for from a tick on."""
        planned = self.references.planned
        joints, shares = self.references.from_on(done)
        self._first = done - 1
        actuation, gas = self._parts.actuation, self._gas
        self._loads = [actuation.loads(gas.between(planned.begin, planned.end, share)) for share in shares]
        servos = self._parts.carrier.servos(joints)
        self._targets = servos.position
        self._tension = np.array([load.cable_tension_N for load in self._loads]).reshape(len(shares), -1)
        self._commands = self._lockstep.commands(servos, self._loads)

    def _link_contacts(self, ticks: Ticks, first: int, count: int) -> dict[int, tuple[LinkContact, ...]]:
        """Return what the arm's links touch in ticks from the first one on, by row."""
        search = self._parts.carrier.link_contacts_in
        looked = self._parts.looks_at_links(first, count)
        found = {k: search(ticks.joints[k], ticks.places[k], ticks.quaternions[k]) for k in looked}
        return {k: contacts for k, contacts in found.items() if contacts}

    def _columns(self, row: TickBatch, to: Cursor, place: int, spent_s: float) -> TickColumns:
        """Return what ticks show whose commands begin at a place."""
        n, ticks = row.done, row.ticks
        tick = np.arange(to.tick, to.tick + n)
        return TickColumns(
            tick=tick,
            time_s=np.array([Clock(self._tick_s, count).time_s for count in tick.tolist()]),
            phase=to.phase,
            joint_position=ticks.joints[:n],
            joint_velocity=ticks.joint_speed[:n],
            joint_torque=ticks.servo_torque[:n],
            joint_target=self._targets[place : place + n],
            body_position=ticks.places[:n],
            body_quaternion=ticks.quaternions[:n],
            shapes=row.shapes,
            flange_position=ticks.origin[1 : n + 1],
            flange_rotation=ticks.axes[1 : n + 1],
            flange_twist=ticks.twist[:n],
            cable_tension_N=self._tension[place : place + n],
            chamber_pressure_Pa=row.pressure_Pa[:, None],
            wrench=ticks.figures[1 : n + 1, WRENCH:CENTER],
            rigid_power_W=ticks.power[:n, 0],
            soft_power_W=ticks.power[:n, 1],
            power_size_W=ticks.power[:n, 2],
            residual_N=ticks.residual[:n],
            momentum_error=ticks.momentum_error[:n],
            newton_iterations=ticks.iterations[:n],
            stability_ratio=row.stability_ratio[:n],
            algorithmic_mass=row.algorithmic_mass[:n],
            tip_target=self.references.planned.tip_target,
            tick_wall_s=spent_s,
            link_contacts=self._link_contacts(ticks, to.tick, n),
        )
