"""Carrier, soft side, plan and commands of a run, for both modes."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from typing import Any, Final, final

import numpy as np

from cosim.base.column import columns_of
from cosim.base.columns import TickColumns
from cosim.base.frames import Array, Pose, read_only
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.ticks import rest_columns, sizes_of
from cosim.devices.command_source import SteeredCommands, StepToTake
from cosim.devices.controller import Measurement, RobotState
from cosim.devices.measurement import BodyPoses
from cosim.plan import tip_errors
from cosim.plan.commands import RobotCommand, SoftCommand, loads_of
from cosim.plan.plan import PhasePlan, Plan
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import describe_node
from cosim.soft.solve import branching
from cosim.soft.solve.state import Equilibrium
from cosim.stepping.carrier import Carrier
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.tick_batch import Snapshot, TickBatch

_LINK_CHECK_s: Final = 1.0 / 30.0
"""Simulated time between two checks of the arm's links."""


def passed_paths(phases: Sequence[PhasePlan], tick_s: float | None) -> dict[int, tip_errors.TipPathInfo]:
    """Return the tip paths of phases with their times, by the index of the phase.

    Args:
        phases: of the plan.
        tick_s: length of a tick; None in statics, in which a path takes the whole phase.
    """

    def length(planned: PhasePlan) -> float:
        both = planned.phase.duration_s + planned.phase.settle_s
        return both if tick_s is None else max(1, round(both / tick_s)) * tick_s

    def path_s(planned: PhasePlan) -> float:
        if tick_s is None:
            return length(planned)
        return max(1, round(planned.phase.duration_s / tick_s)) * tick_s

    ends = list(accumulate(map(length, phases), initial=0.0))
    return {
        index: tip_errors.TipPathInfo(planned.tip_path, ends[index], path_s(planned))
        for index, planned in enumerate(phases)
        if planned.tip_path is not None
    }


@final
class Parts:
    """Carrier, soft side and plan of one run.

    Args:
        scenario: checked.
        plan: made from it.
        carrier: of the flange.
        soft: soft side.
        commands: source of all commands.
        brought_to_rest: brings a new soft side to rest with the flange at a pose, under loads.
    """

    def __init__(
        self,
        scenario: Scenario,
        plan: Plan,
        carrier: Carrier,
        soft: SoftRobot,
        commands: SteeredCommands,
        brought_to_rest: Callable[[Pose, Loads], Equilibrium],
    ) -> None:
        self.scenario, self.plan = scenario, plan
        self.brought_to_rest = brought_to_rest
        self.carrier, self.soft, self.commands = carrier, soft, commands
        self._command, self._loads = plan.command, loads_of(plan.command, plan.gravity)
        self.shape_reader = soft.shape_reader()
        statics = scenario.mode == "quasistatic"
        self.tip_paths = passed_paths(plan.phases, None if statics else scenario.clock.tick_s)
        self._link_check_ticks = 1 if statics else max(1, round(_LINK_CHECK_s / scenario.clock.tick_s))

    def tip_target(self, phase: int, time_s: Array) -> Array | None:
        """Return the tip's target (n, 3) [m] at times (n,) [s] in a phase, free components NaN."""
        if phase in self.tip_paths:
            return self.tip_paths[phase].at(time_s).position
        target = self.plan.phases[phase].tip_target
        return None if target is None else np.full((len(time_s), 3), target)

    def link_check_rows(self, first: int, count: int) -> range:
        """Return the rows of `count` ticks (increments), from the first one on, that check links."""
        return range(-first % self._link_check_ticks, count, self._link_check_ticks)

    def overlaps(self, shape: Any, joints: Array) -> tuple[branching.FilmOverlap, ...]:
        """Return overlaps of films with one another and with links of the arm.

        Args:
            shape: of `SoftRobot.current_shape`.
            joints: (joints,) [rad].
        """
        positions = self.shape_reader.positions(shape)
        films, in_links = self.soft.overlap(positions), self.carrier.film_in_links(positions, joints)
        place = partial(describe_node, self.soft.body, positions)
        links = (branching.FilmOverlap(each.depth_m, place(each.node), each.link) for each in in_links)
        return (*links, *(() if films is None else (films,)))

    def command(self, step: StepToTake) -> RobotCommand:
        """Return the command of the next step."""
        return self.commands.next(step, lambda: self._robot(step.begin_s))

    def measured(self, time_s: float, tension_N: Array, sensors: Sequence[str] = ()) -> Measurement:
        """Return the present measurement, with tensions (cables,) of the last tick; see `SteeredCommands`."""
        return self.commands.measured(self._robot(time_s), tension_N, sensors)

    def _robot(self, time_s: float) -> RobotState:
        """Return the robot's present state, without the soft side."""
        carrier = self.carrier
        names, twist = carrier.body_names, carrier.flange_twist
        return RobotState(
            time_s=time_s,
            flange=carrier.flange_pose,
            flange_twist=np.concatenate([twist.linear, twist.angular]),
            flange_wrench=carrier.flange_wrench,
            flange_jacobian=carrier.flange_jacobian(),
            joint_position=carrier.joint_position,
            joint_velocity=carrier.joint_velocity,
            joint_torque=carrier.joint_torque,
            contact_force_N=dict(zip(names, read_only(carrier.touched.on_each(len(names))), strict=True)),
            body_pose=BodyPoses(names, *carrier.body_poses()),
        )

    def sensed(self, time_s: float, tension_N: Array) -> tuple[Array, Array]:
        """Update the sensors after a tick; see `SteeredCommands`."""
        return self.commands.sensed(lambda: self._robot(time_s), tension_N)

    def seeded(self, last: Snapshot, seed: int) -> Snapshot:
        """Restart the sensors with a seed, and return the last snapshot with their readings."""
        reading, truth = self.commands.sensed(lambda: self._robot(last.time_s), last.cable_tension_N, seed)
        return last.table.changed(sensor_reading=reading[None], sensor_truth=truth[None]).snapshot(0)

    def loads(self, command: SoftCommand) -> Loads:
        """Return the loads of a command to the soft body; the same object for the same command."""
        if command is not self._command:
            self._command, self._loads = command, loads_of(command, self.plan.gravity)
        return self._loads

    def at_rest(
        self, present: Equilibrium, known: Mapping[str, Any], began: float, **by_row: Any
    ) -> TickBatch:
        """Return carrier and soft side in an equilibrium, as a batch of one tick.

        Args:
            present: equilibrium of the soft side.
            known: values of the columns that the mode knows: tick, time, phase, and those of motion.
            began: `time.perf_counter()` at the start of the tick.
            by_row: fields of a batch that few ticks have, see `TickBatch`.
        """
        carrier, soft, flange = self.carrier, self.soft, present.world_from_flange
        (positions, quaternions), mass, films = carrier.body_poses(), soft.mass_properties(), soft.touching
        devices, time_s = self.commands.report(flange), np.array([known["time_s"]])
        target = self.tip_target(known["phase"], time_s)
        tension = np.array(present.loads.cable_tension_N) if devices is None else devices.cable_tension_N
        reading, truth = self.sensed(time_s.item(), tension)
        values = {
            "joint_position": carrier.joint_position,
            "body_position": positions,
            "body_quaternion": quaternions,
            "flange_position": flange.translation,
            "flange_rotation": flange.rotation,
            "mounted_load": carrier.mounted_load,
            "soft_center": mass.center,
            "soft_inertia": mass.inertia,
            "chamber_pressure_Pa": soft.pressures_Pa,
            "cable_tension_N": tension,
            "sensor_reading": reading,
            "sensor_truth": truth,
            **known,
        }
        if target is not None:
            values["tip_target"] = target[0]
        if films is not None:
            values["self_contacts"], values["self_contact_force_N"] = films.count, films.normal_force_N
            values["self_contact_depth_m"] = films.depth_m
        sizes = sizes_of(len(carrier.joint_position), len(positions), len(soft.pressures_Pa))
        columns, kinds = rest_columns(present, sizes), columns_of(TickColumns)
        columns |= {name: np.array([value], type(kinds[name].fill)) for name, value in values.items()}
        checked = bool(self.link_check_rows(known["tick"], 1))
        by_row["link_contacts"] = carrier.link_contacts(among_links=checked)
        columns["tick_wall_s"] = np.array([time.perf_counter() - began])
        film = FilmShapes(self.shape_reader, [soft.current_shape()])
        fields = {name: {0: value} for name, value in by_row.items() if value}
        return TickBatch(columns, film, (devices,), **fields)
