"""The dynamic mode: carrier and soft body advance by one tick of the lockstep clock at a time."""

from __future__ import annotations

import time
from typing import final

from cosim.coupling.clock import Clock
from cosim.coupling.ledger import LedgerEntry
from cosim.errors import InputError
from cosim.frames import Twist
from cosim.scenario.parts import Moment, Parts
from cosim.scenario.plan import PhasePlan, start_equilibrium
from cosim.scenario.snapshot import Snapshot, Stage
from cosim.scenario.stepped_run import Cursor, SteppedRun
from cosim.scenario.tick_references import TickReferences


@final
class DynamicSimulation(SteppedRun):
    """Steps a planned run in lockstep.

    Args:
        parts: of the run.
        stage: its unchanging description.
    """

    def __init__(self, parts: Parts, stage: Stage) -> None:
        super().__init__(parts, stage, [parts.ticks(planned.phase) for planned in parts.plan.phases])
        self._references: TickReferences | None = None

    def _start(self, began: float) -> Snapshot:
        parts = self._parts
        plan, carrier, soft = parts.plan, parts.carrier, parts.soft
        carrier.stand(plan.joints)
        found = start_equilibrium(soft, carrier.flange_pose, plan.loads)
        soft.settle(found)
        ledger = LedgerEntry(found.wrench, 0.0, 0.0, found.residual_N, found.iterations, 0.0, False)
        moment = Moment(0, 0.0, 0, plan.joints, plan.loads, carrier.flange_pose, Twist())
        carrier.couple(found.wrench)
        return parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _step(self, planned: PhasePlan, to: Cursor, began: float) -> Snapshot:
        parts, tick_s = self._parts, self.stage.tick_s
        carrier, soft, time_s = parts.carrier, parts.soft, Clock(tick_s, to.tick).time_s
        if to.done == 1:
            self._begin_phase(planned, carrier.flange_pose)
        if self._references is None or self._references.planned is not planned:
            self._references = TickReferences(planned, tick_s)
        reference, share = self._references.at(to.done)
        self._gas.pass_time(soft, tick_s)
        parts.work_devices(planned, self._gas, time_s - tick_s, share)
        loads = parts.actuation.loads(self._gas.between(planned.begin, planned.end, share))
        ledger = carrier.tick(reference, loads)
        flange, twist = carrier.flange_pose, carrier.flange_twist
        moment = Moment(to.tick, time_s, to.phase, reference.position, loads, flange, twist)
        return parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _save_own(self) -> None:
        return None

    def _restore_own(self, state: object) -> None:
        if state is not None:
            raise InputError("the saved state is of a quasistatic run, this one is dynamic")
