"""The dynamic mode: carrier and soft body advance by one tick of the lockstep clock at a time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array, Twist
from cosim.coupling.clock import Clock
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.devices.command_source import StepToTake
from cosim.errors import InputError, SolverError
from cosim.soft.body.loads import Loads
from cosim.stepping.batch_stepper import BatchStepper
from cosim.stepping.cursor import Cursor
from cosim.stepping.parts import Parts, TickState
from cosim.stepping.stepped_run import SteppedRun
from cosim.telemetry.snapshot import RunInfo, Snapshot
from cosim.telemetry.tick_batch import TickBatch


@final
class DynamicSimulation(SteppedRun):
    """Steps a planned run in lockstep.

    Args:
        parts: of the run.
        stage: its unchanging description.
    """

    def __init__(self, parts: Parts, stage: RunInfo) -> None:
        super().__init__(parts, stage, [parts.ticks(planned.phase) for planned in parts.plan.phases])
        self._batches: BatchStepper | None = None

    @property
    def saves_now(self) -> bool:
        """Whether no step has been taken, or begun, beyond the one shown last."""
        batches = self._batches
        begun = batches is not None and (batches.half_done is not None or batches.broken)
        return super().saves_now and not begun

    def _forget_ahead(self) -> None:
        self._batches = None

    def _start(self, began: float) -> Snapshot:
        parts = self._parts
        plan, carrier = parts.plan, parts.carrier
        carrier.set_configuration(plan.joints)
        loads = parts.loads(plan.command)
        found = parts.brought_to_rest(carrier.flange_pose, loads)
        ledger = LedgerEntry(
            found.wrench, 0.0, 0.0, found.residual_N, found.iterations, 0.0, False, slides=found.slides
        )
        still, torque = np.zeros_like(plan.joints), carrier.holding_torque(found.wrench)
        moment = TickState(0, 0.0, 0, plan.joints, loads, carrier.flange_pose, Twist(), still, torque)
        carrier.couple(found.wrench)
        return parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _take(self, to: Cursor, most: int) -> Sequence[Snapshot] | TickBatch:
        try:
            return self._ticks(to, most)
        except SolverError as error:
            raise self._parts.carrier.with_links(error) from error.__cause__

    def _ticks(self, to: Cursor, most: int) -> Sequence[Snapshot] | TickBatch:
        """Take ticks as `_take` does; an error does not say what links stand in."""
        began, carrier = time.perf_counter(), self._parts.carrier
        batches = self._batches
        if batches is not None and batches.half_done is not None:
            return [self._finish_tick(batches, batches.half_done, to, began)]
        if to.done == 1:
            self._begin_phase(to.phase, carrier.flange_pose)
        lockstep = carrier.lockstep
        if lockstep is None:
            return [self._tick(to, began)]
        if batches is None or batches.phase != to.phase:
            batches = self._batches = BatchStepper(self._parts, lockstep, to.phase, self.stage.tick_s)
        batch = batches.take(to, most)
        if batch is None:
            return [self._tick(to, began)]
        return batch if len(batch) else self._ticks(to, most)

    def _tick(self, to: Cursor, began: float) -> Snapshot:
        """Take one tick."""
        parts, tick_s = self._parts, self.stage.tick_s
        begin_s = Clock(tick_s, to.tick).time_s - tick_s
        command = parts.command(StepToTake(to.phase, to.done, begin_s, tick_s))
        loads = parts.loads(command.soft)
        parts.carrier.drive_cell(to.phase, to.done * tick_s)
        ledger = parts.carrier.tick(command.joints, loads)
        return self._shown(command.joints.position, loads, ledger, to, began)

    def _finish_tick(self, batches: BatchStepper, loads: Loads, to: Cursor, began: float) -> Snapshot:
        """Take the soft half of a tick whose rigid half has been taken with a batch."""
        ledger = batches.finish(loads)
        return self._shown(batches.target(to.done), loads, ledger, to, began)

    def _shown(self, target: Array, loads: Loads, ledger: LedgerEntry, to: Cursor, began: float) -> Snapshot:
        parts, time_s = self._parts, Clock(self.stage.tick_s, to.tick).time_s
        carrier = parts.carrier
        moment = TickState(
            to.tick, time_s, to.phase, target, loads, carrier.flange_pose, carrier.flange_twist,
            carrier.joint_velocity, carrier.joint_torque, carrier.touched,
        )  # fmt: skip
        return parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _step_of(self, to: Cursor) -> str:
        return f"tick {to.tick} ({Clock(self.stage.tick_s, to.tick).time_s:g} s)"

    def _save_own(self) -> None:
        return None

    def _restore_own(self, state: object) -> None:
        if state is not None:
            raise InputError("the saved state is of a quasistatic run, this one is dynamic")
        self._batches = None
