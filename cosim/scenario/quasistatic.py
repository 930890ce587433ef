"""The quasistatic mode: a chain of equilibria of the soft body and of what carries it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import final

from cosim.coupling.ledger import LedgerEntry
from cosim.errors import ConvergenceError
from cosim.frames import Array, Twist, vector_from_rotation
from cosim.scenario.chamber_gas import ChamberGas
from cosim.scenario.parts import Moment, Parts
from cosim.scenario.plan import start_equilibrium
from cosim.scenario.ramp import Progress
from cosim.scenario.snapshot import Snapshot, Stage
from cosim.soft.body import Loads
from cosim.soft.equilibrium import Equilibrium

_DROOP_ROUNDS_MAX = 20


@final
class QuasistaticSimulation:
    """Solves a planned run increment by increment.

    Args:
        parts: of the run.
        stage: its unchanging description.
    """

    def __init__(self, parts: Parts, stage: Stage) -> None:
        self._parts = parts
        self.stage = stage
        self._earlier: Array | None = None

    def steps(self) -> Iterator[Snapshot]:
        """Yield the equilibrium before the first increment, then that of every increment.

        Raises:
            SolverError: the physics could not be solved; the snapshots so far stand.
        """
        parts, began = self._parts, time.perf_counter()
        plan, carrier = parts.plan, parts.carrier
        carrier.stand(plan.joints)
        here = start_equilibrium(parts.soft, carrier.flange_pose, plan.loads)
        here, spent = self._with_droop(here, plan.joints, here.iterations)
        tick, start_s, gas = 0, 0.0, ChamberGas(parts.scenario.gas)
        moment = Moment(0, 0.0, 0, plan.joints, plan.loads, here.world_from_flange, Twist())
        yield self._snapshot(moment, here, spent, 0.0, began)
        for index, phase in enumerate(plan.phases):
            phase.holding.apply(parts.soft, here.world_from_flange)
            gas.begin(phase.gas, parts.soft)
            self._earlier = None
            span = (phase.phase.duration_s + phase.phase.settle_s) / phase.phase.increments
            for increment in range(1, phase.phase.increments + 1):
                began = time.perf_counter()
                share = increment / phase.phase.increments
                reference = phase.joints.at(Progress(share, 0.0, 0.0))[0]
                gas.pass_time(parts.soft, span)
                loads = gas.between(phase.begin, phase.end, share)
                before = here
                here, spent = self._advance(before, reference, loads)
                tick += 1
                twist, power = _mean_motion(parts, before, here, span)
                moment = Moment(
                    tick, start_s + increment * span, index, reference, loads, here.world_from_flange, twist
                )
                yield self._snapshot(moment, here, spent, power, began)
            start_s += phase.phase.duration_s + phase.phase.settle_s

    def _snapshot(
        self, moment: Moment, here: Equilibrium, spent: int, soft_power_W: float, began: float
    ) -> Snapshot:
        rigid_power = here.wrench.power(moment.twist)
        ledger = LedgerEntry(here.wrench, rigid_power, soft_power_W, here.residual_N, spent, 0.0, False)
        return self._parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _advance(self, here: Equilibrium, reference: Array, loads: Loads) -> tuple[Equilibrium, int]:
        """Return the next equilibrium of carrier and soft body, and the Newton iterations spent."""
        carrier, soft = self._parts.carrier, self._parts.soft
        carrier.bring(reference)
        pose = carrier.flange_pose
        local = here.world_from_flange.inverse().apply(here.state.positions)
        # the shape goes on as it changed in the last increment, seen from the flange
        guess = local if self._earlier is None else 2.0 * local - self._earlier
        self._earlier = local
        try:
            found = soft.solve(here.state, pose, loads, pose.apply(guess))
            spent = found.iterations
        except ConvergenceError as error:
            found = soft.follow(here, pose, loads)
            spent = error.iterations + found.iterations
        return self._with_droop(found, reference, spent)

    def _with_droop(self, found: Equilibrium, reference: Array, spent: int) -> tuple[Equilibrium, int]:
        """Let the carrier give way to the wrench until it and the soft body agree."""
        carrier, soft = self._parts.carrier, self._parts.soft
        for _ in range(_DROOP_ROUNDS_MAX):
            soft.settle(found)
            if not carrier.give_way(reference, found.wrench):
                break
            found = soft.follow(found, carrier.flange_pose, found.loads)
            spent += found.iterations
        return found, spent


def _mean_motion(parts: Parts, before: Equilibrium, after: Equilibrium, span_s: float) -> tuple[Twist, float]:
    """Return the flange's mean twist over an increment, and the power its nodes took in at that rate."""
    old, new = before.world_from_flange, after.world_from_flange
    turn = vector_from_rotation(new.rotation @ old.rotation.T)
    twist = Twist((new.translation - old.translation) / span_s, turn / span_s)
    displacement = after.state.positions - before.state.positions
    return twist, parts.soft.work_taken_in(displacement) / span_s
