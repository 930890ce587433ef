"""The parts of a run that both modes step, and what they show at rest."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from typing import Any, Final, final

import numpy as np

from cosim.base.column import columns_of
from cosim.base.columns import TickColumns
from cosim.base.frames import Array, Pose, read_only
from cosim.base.kept_parts import KeptParts, name_of
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.ticks import rest_columns, sizes_of
from cosim.devices.command_source import SteeredCommands, StepToTake
from cosim.devices.controller import Measurement, RobotState
from cosim.devices.measurement import BodyPoses
from cosim.plan import static_plan, tip_errors
from cosim.plan.commands import RobotCommand, SoftCommand, loads_of
from cosim.plan.plan import PhasePlan, Plan
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import place_of
from cosim.soft.contact import contact_law, self_contact_faces
from cosim.soft.contact.flange_face import FlangeFace
from cosim.soft.solve import branching, self_contact
from cosim.soft.solve.state import Equilibrium
from cosim.stepping.carrier import Carrier
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.tick_batch import Snapshot, TickBatch


def passed_paths(phases: Sequence[PhasePlan], tick_s: float | None) -> dict[int, tip_errors.TipPathInfo]:
    """Return when a run passes the paths of its phases, by their index.

    Args:
        phases: of the plan.
        tick_s: of the lockstep clock; None in statics, where a path takes the whole phase.
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


def film_law(scenario: Scenario) -> self_contact.FilmContactLaw | None:
    """Return the law of contact between films; None where it is not modelled."""
    given = scenario.contact
    if not scenario.touches_itself:
        return None
    law = contact_law.ContactLaw(given.stiffness_N_m3, given.smoothing_m, given.stick_m)
    return self_contact.FilmContactLaw(law, given.self_friction, throughout=given.self_contact is True)


def film_report(scenario: Scenario, body: SoftBody) -> str:
    """Return in words which films may touch one another."""
    given = scenario.contact
    if scenario.fidelity == "rigid":
        return "none: the shape is frozen"
    if not scenario.touches_itself:
        return f"not modelled: {'as in the paper' if given.self_contact else 'switched off'}"
    touched = meetings(body)
    if not touched:
        return "none: the film is one face, which does not touch itself"
    if scenario.fidelity == "section":
        apart = "; copies pass through one another" if body.copies else ""
        return f"between neighbouring units, in the energy of the sections, without friction{apart}"
    friction = "no friction" if scenario.mode == "quasistatic" else f"friction {given.self_friction:g}"
    since = "" if given.self_contact is True else ", from where they come to press"
    return f"{', '.join(touched)}, {friction}{since}"


def meetings(body: SoftBody) -> list[str]:
    """Return in words what a body's films can touch of the body and its flange; nothing where they cannot."""
    faces = self_contact_faces.FilmFaces.of(body)
    points = self_contact_faces.FilmPoints.of(faces, body.positions)
    face = FlangeFace.of(body, faces, points, contact_law.ContactLaw())
    kinds = {
        f"between {faces.units} units": faces.can_meet,
        "between the films of a unit": faces.inside_out.can_meet,
        "on the flange's face": len(face.nodes) > 0,
    }
    return [words for words, found in kinds.items() if found]


_MOST: Final = 4  # a state holds a factorisation, which of a fine mesh takes tens of megabytes


def brought_to_rest(
    kept: KeptParts, model_name: str, soft: SoftRobot, flange: Pose, loads: Loads
) -> Equilibrium:
    """Bring a soft side to its equilibrium before the first phase, and return that.

    Args:
        kept: parts that may be used again.
        model_name: of all that the soft side is made of.
        soft: new.
        flange: where it is.
        loads: that act.

    Raises:
        ConvergenceError: none was found near the drawn shape.
    """

    def hung() -> tuple[Equilibrium | None, Any]:
        with soft.searching("start"):
            found = soft.hang(flange, loads.gravity)
        return found, None if found is None else soft.full_state

    def settled() -> tuple[Equilibrium, Any]:
        # hung up without pressure and tension it is the same for all of them
        begin, state = kept.made("hung up", name_of(model_name, flange, loads.gravity), hung, _MOST)
        if state is not None:
            soft.full_state = state
        found = static_plan.start_equilibrium(soft, flange, loads, begin)
        soft.commit(found)
        return found, soft.full_state

    found, state = kept.made("state at rest", name_of(model_name, flange, loads), settled, _MOST)
    # that of a side which has just found it changes nothing
    soft.full_state = state
    return found


_LOOKED_AFTER_S = 1.0 / 30.0


@final
class Parts:
    """Carrier, soft side and plan of one run.

    Args:
        scenario: checked.
        plan: made from it.
        carrier: of the flange.
        soft: soft side.
        commands: says what is asked of them.
        brought_to_rest: brings the soft side, new as it is, to rest with the flange at a pose, under loads.
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
        self._asked, self._loads = plan.command, loads_of(plan.command, plan.gravity)
        self.shape_reader = soft.shape_reader()
        statics = scenario.mode == "quasistatic"
        self.tip_paths = passed_paths(plan.phases, None if statics else scenario.clock.tick_s)
        self._looked_every = 1 if statics else max(1, round(_LOOKED_AFTER_S / scenario.clock.tick_s))

    def wanted_tip(self, phase: int, time_s: Array) -> Array | None:
        """Return where the tip is to be (n, 3) [m] at instants (n,) [s] in a phase, free components NaN."""
        if phase in self.tip_paths:
            return self.tip_paths[phase].at(time_s).position
        target = self.plan.phases[phase].tip_target
        return None if target is None else np.full((len(time_s), 3), target)

    def looks_at_links(self, first: int, count: int) -> range:
        """Return after how many ticks (increments) of `count` from the first one on links are looked at."""
        return range(-first % self._looked_every, count, self._looked_every)

    def overlaps(self, shape: Any, joints: Array) -> tuple[branching.FilmOverlap, ...]:
        """Return where films are in one another, or in links of the arm.

        Args:
            shape: of `SoftRobot.current_shape`.
            joints: (joints,) [rad].
        """
        positions = self.shape_reader.positions(shape)
        own, inside = self.soft.overlap(positions), self.carrier.film_in_links(positions, joints)
        place = partial(place_of, self.soft.body, positions)
        links = (branching.FilmOverlap(each.depth_m, place(each.node), each.link) for each in inside)
        return (*links, *(() if own is None else (own,)))

    def command(self, step: StepToTake) -> RobotCommand:
        """Return what is asked for in a step that is then taken."""
        return self.commands.next(step, lambda: self._robot(step.begin_s))

    def measured(self, time_s: float, tension_N: Array, sensors: Sequence[str] = ()) -> Measurement:
        """Return what is measured now, with tensions (cables,) of the last tick; see `SteeredCommands`."""
        return self.commands.measured(self._robot(time_s), tension_N, sensors)

    def _robot(self, time_s: float) -> RobotState:
        """Return what is seen of the robot now."""
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
        """Let the sensors read the run after a tick; see `SteeredCommands`."""
        return self.commands.sensed(lambda: self._robot(time_s), tension_N)

    def seeded(self, last: Snapshot, seed: int) -> Snapshot:
        """Let the sensors begin with a seed at a snapshot, and return that with their readings."""
        reading, truth = self.commands.sensed(lambda: self._robot(last.time_s), last.cable_tension_N, seed)
        return last.table.changed(sensor_reading=reading[None], sensor_truth=truth[None]).snapshot(0)

    def loads(self, command: SoftCommand) -> Loads:
        """Return what acts on the soft body that is asked for something; the same object for the same."""
        if command is not self._asked:
            self._asked, self._loads = command, loads_of(command, self.plan.gravity)
        return self._loads

    def at_rest(self, here: Equilibrium, given: Mapping[str, Any], began: float, **rare: Any) -> TickBatch:
        """Return both sides in an equilibrium, as a batch of one tick.

        Args:
            here: of the soft side, with the flange where it is.
            given: columns that the mode knows, each with its value: tick, time, phase, and what moves.
            began: when the work on the tick did.
            rare: what few ticks have, see `TickBatch`.
        """
        carrier, soft, flange = self.carrier, self.soft, here.world_from_flange
        (places, quaternions), mass, films = carrier.body_poses(), soft.mass_properties(), soft.touching
        devices, time_s = self.commands.report(flange), np.array([given["time_s"]])
        wanted = self.wanted_tip(given["phase"], time_s)
        tension = np.array(here.loads.cable_tension_N) if devices is None else devices.cable_tension_N
        reading, truth = self.sensed(time_s.item(), tension)
        values = {
            "joint_position": carrier.joint_position,
            "body_position": places,
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
            **given,
        }
        if wanted is not None:
            values["tip_target"] = wanted[0]
        if films is not None:
            values["self_contacts"], values["self_contact_force_N"] = films.count, films.normal_force_N
            values["self_contact_depth_m"] = films.depth_m
        sizes = sizes_of(len(carrier.joint_position), len(places), len(soft.pressures_Pa))
        columns, kinds = rest_columns(here, sizes), columns_of(TickColumns)
        columns |= {name: np.array([value], type(kinds[name].fill)) for name, value in values.items()}
        looks = bool(self.looks_at_links(given["tick"], 1))
        rare["link_contacts"] = carrier.link_contacts(among_links=looks)
        columns["tick_wall_s"] = np.array([time.perf_counter() - began])
        film, some = FilmShapes(self.shape_reader, [soft.current_shape()]), rare.items()
        return TickBatch(columns, film, (devices,), **{name: {0: found} for name, found in some if found})
