"""The dynamic mode: carrier and soft body advance by one tick of the lockstep clock at a time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import final

from cosim.coupling.clock import Clock
from cosim.coupling.ledger import LedgerEntry
from cosim.frames import Twist
from cosim.scenario.chamber_gas import ChamberGas
from cosim.scenario.parts import Moment, Parts
from cosim.scenario.plan import start_equilibrium
from cosim.scenario.ramp import progress
from cosim.scenario.snapshot import Snapshot, Stage


@final
class DynamicSimulation:
    """Steps a planned run in lockstep.

    Args:
        parts: of the run.
        stage: its unchanging description.
    """

    def __init__(self, parts: Parts, stage: Stage) -> None:
        self._parts = parts
        self.stage = stage

    def steps(self) -> Iterator[Snapshot]:
        """Yield the state at rest before the first tick, then that after every tick.

        Raises:
            SolverError: the physics could not be solved; the snapshots so far stand.
        """
        parts, began = self._parts, time.perf_counter()
        plan, carrier, soft = parts.plan, parts.carrier, parts.soft
        carrier.stand(plan.joints)
        found = start_equilibrium(soft, carrier.flange_pose, plan.loads)
        soft.settle(found)
        ledger = LedgerEntry(found.wrench, 0.0, 0.0, found.residual_N, found.iterations, 0.0, False)
        moment = Moment(0, 0.0, 0, plan.joints, plan.loads, carrier.flange_pose, Twist())
        yield parts.snapshot(moment, ledger, time.perf_counter() - began)
        carrier.couple(found.wrench)
        clock, gas = Clock(self.stage.tick_s), ChamberGas(parts.scenario.gas)
        for index, planned in enumerate(plan.phases):
            planned.holding.apply(soft, carrier.flange_pose)
            gas.begin(planned.gas, soft)
            phase = planned.phase
            for elapsed in range(1, parts.ticks(phase) + 1):
                began = time.perf_counter()
                clock = clock.advanced()
                now = progress(phase.ramp, (elapsed - 1) * clock.tick_s, phase.duration_s)
                then = progress(phase.ramp, elapsed * clock.tick_s, phase.duration_s)
                gas.pass_time(soft, clock.tick_s)
                loads = gas.between(planned.begin, planned.end, then.value)
                reference, ledger = carrier.tick(planned.joints, now, then, loads)
                moment = Moment(
                    clock.tick, clock.time_s, index, reference, loads,
                    carrier.flange_pose, carrier.flange_twist,
                )  # fmt: skip
                yield parts.snapshot(moment, ledger, time.perf_counter() - began)
