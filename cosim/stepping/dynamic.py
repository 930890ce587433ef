"""The dynamic mode: carrier and soft body advance by one tick of the lockstep clock at a time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array, Twist
from cosim.coupling.clock import Clock
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.errors import InputError
from cosim.plan.plan import PhasePlan, start_equilibrium
from cosim.plan.ramp import progress
from cosim.soft.body.loads import Loads
from cosim.stepping.batch_stepper import BatchStepper
from cosim.stepping.cursor import Cursor
from cosim.stepping.parts import Parts, TickState
from cosim.stepping.stepped_run import SteppedRun
from cosim.stepping.tick_references import TickReferences
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
        self._references: TickReferences | None = None
        self._batches: BatchStepper | None = None

    @property
    def saves_now(self) -> bool:
        """Whether no step has been taken, or begun, beyond the one shown last."""
        batches = self._batches
        begun = batches is not None and (batches.half_done is not None or batches.broken)
        return super().saves_now and not begun

    def _start(self, began: float) -> Snapshot:
        parts = self._parts
        plan, carrier, soft = parts.plan, parts.carrier, parts.soft
        carrier.set_configuration(plan.joints)
        found = start_equilibrium(soft, carrier.flange_pose, plan.loads)
        soft.settle(found)
        ledger = LedgerEntry(
            found.wrench, 0.0, 0.0, found.residual_N, found.iterations, 0.0, False, slides=found.slides
        )
        still, torque = np.zeros_like(plan.joints), carrier.holding_torque(found.wrench)
        moment = TickState(0, 0.0, 0, plan.joints, plan.loads, carrier.flange_pose, Twist(), still, torque)
        carrier.couple(found.wrench)
        return parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _take(self, planned: PhasePlan, to: Cursor, most: int) -> Sequence[Snapshot] | TickBatch:
        began, carrier = time.perf_counter(), self._parts.carrier
        batches = self._batches
        if batches is not None and batches.half_done is not None:
            return [self._finish_tick(batches, batches.half_done, to, began)]
        if to.done == 1:
            self._begin_phase(planned, carrier.flange_pose)
        if self._references is None or self._references.planned is not planned:
            self._references, self._batches = TickReferences(planned, self.stage.tick_s), None
        lockstep = carrier.lockstep
        if lockstep is None or self._parts.actuation.active:
            return [self._tick(planned, to, began)]
        if self._batches is None:
            tick_s = self.stage.tick_s
            self._batches = BatchStepper(self._parts, lockstep, self._references, self._gas, tick_s)
        batch = self._batches.take(to, most)
        if batch is None:
            return [self._tick(planned, to, began)]
        return batch if len(batch) else self._take(planned, to, most)

    def _tick(self, planned: PhasePlan, to: Cursor, began: float) -> Snapshot:
        """Take one tick."""
        parts, tick_s = self._parts, self.stage.tick_s
        assert self._references is not None, "_take() makes them"
        reference, load_factor = self._references.at(to.done)
        self._gas.advance(parts.soft, tick_s)
        parts.work_devices(planned, self._gas, Clock(tick_s, to.tick).time_s - tick_s, load_factor)
        loads = parts.actuation.loads(self._gas.between(planned.begin, planned.end, load_factor))
        ledger = parts.carrier.tick(reference, loads)
        return self._shown(reference.position, loads, ledger, to, began)

    def _finish_tick(self, batches: BatchStepper, loads: Loads, to: Cursor, began: float) -> Snapshot:
        """Take the soft half of a tick whose rigid half has been taken with a batch."""
        ledger = batches.finish(loads)
        return self._shown(batches.references.at(to.done)[0].position, loads, ledger, to, began)

    def _shown(self, target: Array, loads: Loads, ledger: LedgerEntry, to: Cursor, began: float) -> Snapshot:
        parts, time_s = self._parts, Clock(self.stage.tick_s, to.tick).time_s
        carrier = parts.carrier
        moment = TickState(
            to.tick, time_s, to.phase, target, loads, carrier.flange_pose, carrier.flange_twist,
            carrier.joint_velocity, carrier.joint_torque, carrier.touched,
        )  # fmt: skip
        return parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _step_of(self, planned: PhasePlan, to: Cursor) -> tuple[str, float]:
        time_s, tick_s = Clock(self.stage.tick_s, to.tick).time_s, self.stage.tick_s
        load_factor = progress(planned.phase.ramp, to.done * tick_s, planned.phase.duration_s).value
        return f"tick {to.tick} ({time_s:g} s)", load_factor

    def _save_own(self) -> None:
        return None

    def _restore_own(self, state: object) -> None:
        if state is not None:
            raise InputError("the saved state is of a quasistatic run, this one is dynamic")
        self._batches = None
