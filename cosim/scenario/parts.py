"""The parts of a run that both modes step, and what a snapshot reads off them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.coupling.ledger import LedgerEntry
from cosim.coupling.soft_side import SoftSide
from cosim.frames import Array, Pose, Twist
from cosim.scenario.actuation import Actuation, Instant
from cosim.scenario.carrier import Carrier
from cosim.scenario.chamber_gas import ChamberGas
from cosim.scenario.film_rules import with_film_contacts
from cosim.scenario.later import Later, later
from cosim.scenario.phase_schema import Phase
from cosim.scenario.plan import PhasePlan, Plan
from cosim.scenario.schema import Scenario
from cosim.scenario.snapshot import KeptShape, Snapshot
from cosim.soft.body import Loads


@final
@dataclass(frozen=True)
class Moment:
    """Where a run is: tick and time, phase, and what drives it.

    Args:
        tick: count from 0.
        time_s: simulated time [s].
        phase: index of the phase.
        joint_target: (joints,) [rad], reference of the servos.
        loads: on the soft body.
        flange: world_from_flange.
        twist: of the flange origin, world axes.
    """

    tick: int
    time_s: float
    phase: int
    joint_target: Array
    loads: Loads
    flange: Pose
    twist: Twist


@final
class Parts:
    """Carrier, soft side and plan of one run.

    Args:
        scenario: checked.
        plan: made from it.
        carrier: of the flange.
        soft: soft side.
        actuation: devices.
    """

    def __init__(
        self, scenario: Scenario, plan: Plan, carrier: Carrier, soft: SoftSide, actuation: Actuation
    ) -> None:
        self.scenario, self.plan = scenario, plan
        self.carrier, self.soft, self.actuation = carrier, soft, actuation
        self._reader = soft.shape_reader()

    def ticks(self, phase: Phase) -> int:
        """Return how many ticks of the clock a phase lasts, at least one."""
        return max(1, round((phase.duration_s + phase.settle_s) / self.scenario.clock.tick_s))

    def work_devices(self, planned: PhasePlan, gas: ChamberGas, time_s: float, share: float) -> None:
        """Let devices act for the tick or increment that begins at a time and ends at a share of the ramp."""
        if self.actuation.active:
            instant = Instant(time_s, self.carrier.flange_pose, self.carrier.joint_position)
            self.actuation.act(planned, gas, self.soft, instant, share)

    def snapshot(self, moment: Moment, ledger: LedgerEntry, wall_s: float) -> Snapshot:
        """Return the present state as a snapshot."""
        flange, soft, reader = moment.flange, self.soft, self._reader
        shape = soft.shape_now()
        figures = Later(lambda: reader.figures([shape]))
        places, quaternions = self.carrier.body_poses()
        pressures = soft.pressures_Pa
        devices = self.actuation.report(soft, flange)
        tension = np.array(moment.loads.cable_tension_N) if devices is None else devices.cable_tension_N

        def sag_m() -> float:
            return float(figures.value.sag_m(flange.translation, flange.rotation[:, 2])[0])

        return Snapshot(
            tick=moment.tick,
            time_s=moment.time_s,
            phase=moment.phase,
            joint_position=self.carrier.joint_position,
            joint_target=moment.joint_target,
            body_position=places,
            body_quaternion=quaternions,
            node_position=later(lambda: reader.positions(shape)),
            world_from_flange=flange,
            flange_twist=moment.twist,
            pressure_Pa=pressures[0],
            volume_m3=later(lambda: sum(figures.value.volumes_m3[0].tolist())),
            chamber_pressure_Pa=np.array(pressures),
            chamber_volume_m3=later(lambda: figures.value.volumes_m3[0]),
            cable_tension_N=tension,
            tip_position=later(lambda: figures.value.tip_position[0]),
            tip_direction=later(lambda: figures.value.tip_direction[0]),
            sag_m=later(sag_m),
            tip_target=self.plan.phases[moment.phase].tip_target,
            ledger=with_film_contacts(ledger, soft.touching),
            tick_wall_s=wall_s,
            devices=devices,
            shape=KeptShape(reader, shape),
        )
