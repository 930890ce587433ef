"""The parts of a run that both modes step, and what a snapshot reads off them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose, Twist
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.devices.device_loop import Actuation, RobotState
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.plan import PhasePlan, Plan
from cosim.soft.body.loads import Loads
from cosim.stepping.carrier import Carrier
from cosim.stepping.self_contact_law import with_film_contacts
from cosim.telemetry.film_shape import UnreadFilmShape
from cosim.telemetry.snapshot import Snapshot

_LOOKED_AFTER_S = 1.0 / 30.0


@final
@dataclass(frozen=True)
class TickState:
    """Where a run is: tick and time, phase, and what drives it.

    Args:
        tick: count from 0.
        time_s: simulated time [s].
        phase: index of the phase.
        joint_target: (joints,) [rad], reference of the servos.
        loads: on the soft body.
        flange: world_from_flange.
        twist: of the flange origin, world axes.
        joint_velocity: (joints,) [rad/s].
        joint_torque: (joints,) [N m], of the servos.
        touched: what the soft robot presses on.
    """

    tick: int
    time_s: float
    phase: int
    joint_target: Array
    loads: Loads
    flange: Pose
    twist: Twist
    joint_velocity: Array
    joint_torque: Array
    touched: ContactReport = NOTHING_TOUCHED


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
        self.shape_reader = soft.shape_reader()
        statics = scenario.mode == "quasistatic"
        self._looked_every = 1 if statics else max(1, round(_LOOKED_AFTER_S / scenario.clock.tick_s))

    def ticks(self, phase: PhaseTable) -> int:
        """Return how many ticks of the clock a phase lasts, at least one."""
        return max(1, round((phase.duration_s + phase.settle_s) / self.scenario.clock.tick_s))

    def looks_at_links(self, first: int, count: int) -> range:
        """Return after how many ticks (increments) of `count` from the first one on links are looked at."""
        return range(-first % self._looked_every, count, self._looked_every)

    def work_devices(self, planned: PhasePlan, gas: ChamberGas, time_s: float, load_factor: float) -> None:
        """Let devices act for the tick or increment that begins at a time and ends at a load factor."""
        if self.actuation.active:
            instant = RobotState(time_s, self.carrier.flange_pose, self.carrier.joint_position)
            self.actuation.act(planned, gas, self.soft, instant, load_factor)

    def snapshot(self, moment: TickState, ledger: LedgerEntry, wall_s: float) -> Snapshot:
        """Return the present state as a snapshot."""
        carrier, soft, loads = self.carrier, self.soft, moment.loads
        places, quaternions = carrier.body_poses()
        devices = self.actuation.report(soft, moment.flange)
        return Snapshot(
            tick=moment.tick,
            time_s=moment.time_s,
            phase=moment.phase,
            joint_position=carrier.joint_position,
            joint_velocity=moment.joint_velocity,
            joint_torque=moment.joint_torque,
            joint_target=moment.joint_target,
            body_position=places,
            body_quaternion=quaternions,
            body_contact_force=moment.touched.on_each(len(places)),
            film=UnreadFilmShape(self.shape_reader, soft.shape_now()),
            world_from_flange=moment.flange,
            flange_twist=moment.twist,
            chamber_pressure_Pa=np.array(soft.pressures_Pa),
            cable_tension_N=np.array(loads.cable_tension_N) if devices is None else devices.cable_tension_N,
            tip_target=self.plan.phases[moment.phase].tip_target,
            ledger=with_film_contacts(ledger, soft.touching),
            tick_wall_s=wall_s,
            devices=devices,
            link_contacts=carrier.link_contacts(among_links=bool(self.looks_at_links(moment.tick, 1))),
        )
