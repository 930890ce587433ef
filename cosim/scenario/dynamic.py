"""The dynamic mode: arm and soft body advance by one tick of the lockstep clock at a time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import final

from cosim.coupling.clock import Clock
from cosim.coupling.ledger import LedgerEntry
from cosim.coupling.staggered import ServoCommand, StaggeredCoupling
from cosim.frames import Twist
from cosim.scenario.parts import Moment, Parts
from cosim.scenario.plan import PhasePlan, start_equilibrium
from cosim.scenario.ramp import progress
from cosim.scenario.snapshot import Snapshot, Stage
from cosim.soft.body import Loads


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
        plan, scene, soft = parts.plan, parts.scene, parts.soft
        scene.set_joint_state(plan.joints)
        found = start_equilibrium(soft, scene.flange_pose, plan.loads)
        soft.settle(found)
        ledger = LedgerEntry(found.wrench, 0.0, 0.0, found.residual_N, found.iterations, 0.0, False)
        moment = Moment(0, 0.0, 0, plan.joints, plan.loads, scene.flange_pose, Twist())
        yield parts.snapshot(moment, ledger, time.perf_counter() - began)
        coupling = StaggeredCoupling(scene, soft, found.wrench)
        clock = Clock(self.stage.tick_s)
        for index, phase in enumerate(plan.phases):
            parts.clamp(phase, scene.flange_pose)
            for elapsed in range(1, parts.ticks(phase.phase) + 1):
                began = time.perf_counter()
                clock = clock.advanced()
                command, loads = self._drive(phase, elapsed)
                ledger = coupling.tick(command, loads)
                moment = Moment(
                    clock.tick, clock.time_s, index, command.position, loads,
                    scene.flange_pose, scene.flange_twist,
                )  # fmt: skip
                yield parts.snapshot(moment, ledger, time.perf_counter() - began)

    def _drive(self, plan: PhasePlan, elapsed: int) -> tuple[ServoCommand, Loads]:
        """Return the servo command for the tick and the loads at its end."""
        parts, phase, tick_s = self._parts, plan.phase, self.stage.tick_s
        # the servos act on the error at the start of the tick, so they get the reference of that instant
        now = progress(phase.ramp, (elapsed - 1) * tick_s, phase.duration_s)
        then = progress(phase.ramp, elapsed * tick_s, phase.duration_s)
        position, velocity, acceleration = plan.joints.at(now)
        feedforward = parts.arm.inverse_dynamics(
            position, velocity, acceleration, parts.scene.armature, parts.payload(parts.scene.flange_pose)
        )
        return ServoCommand(position, velocity, feedforward), plan.begin.interpolated(plan.end, then.value)
