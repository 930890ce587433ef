"""Schema of a scenario file: frozen, SI units in the names of the keys, world frame, z up.

Schema of the exchange between arm and soft robot.

Schema of how a scenario is computed and recorded: clock, solver, plan, contact, gas, recording.

Schema of the devices of a scenario: pumps, winches, controllers. They act in time: dynamic mode only.

What a scenario may name of a soft body that is given from Python in place of a soft robot's file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Final, Literal, TypeAlias, final

from annotated_types import Interval, Len
from pydantic import Discriminator, Tag

from cosim.config.arm_table import BaseTable
from cosim.config.schema import pattern as _pattern  # noqa: F401  # makes its kind of body known
from cosim.config.schema.objects import CameraTable, ObjectTable, SceneTable, SensorTable, WireTable
from cosim.config.schema.phase import HOLD, CommandTable, PhaseTable, StartTable
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml import keys
from cosim.config.toml.quantities import (
    Acceleration,
    Count,
    Name,
    NonNegative,
    NonNegativeConductance,
    NonNegativeLength,
    NonNegativePressure,
    NonNegativeRate,
    NonNegativeTime,
    Number,
    Positive,
    PositiveAngle,
    PositiveConductance,
    PositiveContactStiffness,
    PositiveForce,
    PositiveLength,
    PositiveMassFlow,
    PositivePressure,
    PositiveRate,
    PositiveTemperature,
    PositiveTime,
    PositiveTorque,
    SchemaNumber,
    Text,
)
from cosim.config.toml.rules import Told, rule
from cosim.config.toml.tables import Table


@final
@dataclass(frozen=True)
class CouplingTable(Table):
    """How arm, objects and soft robot exchange their loads in the dynamic mode.

    Args:
        scheme: "staggered": one step of each side a tick, loads act one tick later, algorithmic mass rides
            along where the soft robot is heavy for the bodies that it acts on; "iterated": a tick is repeated
            until the loads agree.
        tolerance: largest difference of the loads over their size, where they agree.
        iterations_max: trials of a tick before the run fails.
    """

    scheme: Literal["staggered", "iterated"] = "staggered"
    tolerance: Annotated[float, Interval(ge=1e-12, le=1e-3)] = 1e-9
    iterations_max: Count = 30


Fidelity: TypeAlias = Literal["rigid", "section", "lumped", "refined"]
"""From the cheapest to the dearest."""


@final
@dataclass(frozen=True)
class ClockTable(Table):
    """The lockstep clock: rigid and soft side advance by one tick at a time.

    Args:
        tick_s: of the lockstep clock: both sides advance by as much.
    """

    tick_s: Annotated[float, Interval(gt=0.0, ge=1e-6, le=0.1)] = 0.002


@final
@dataclass(frozen=True)
class SolverTable(Table):
    """How the soft side is solved.

    Args:
        residual_tolerance_N: largest force component left at an equilibrium or a converged step; all that is
            left adds up to no more than 100 times that, nor does its moment, over the body's size.
        search_iterations_max: bound for all iterations of one search on the film: for the start, for an
            increment or a piece of a planned motion, for the tensions or flange pose of a tip target.
        dynamic_tolerance_N: the same in a tick of the dynamic mode.
        dynamic_newton_iterations: new tangents per tick in the dynamic mode, besides iterations with a
            kept one; a tick that is left far from balance takes more.
        integrator: of the dynamic mode: "bdf2", of second order, or "implicit_euler", of first order, which
            damps all but the slowest swings by itself and takes most of a bounce.
        damping_per_s: losses of the soft robot itself, force = -damping_per_s * m * (v - u). u is the
            velocity with which a node would move along with the flange, which bears the opposite force.
            Every swing decays at half this rate; rigid motion is free of it. Losses of the film's material:
            film.loss_factor of the soft robot's file.
        air_drag_per_s: drag of air at rest, force = -air_drag_per_s * m * v, also where the soft robot
            moves along with the arm: at 0.25 m/s and 2 per s by 0.5 N for each kilogram.
        follow_unstable: whether static solutions stay on equilibria that have become unstable; else they
            leave them for stable ones.
    """

    residual_tolerance_N: PositiveForce = 1e-6
    search_iterations_max: Count = 3000
    dynamic_tolerance_N: PositiveForce = 1e-4
    dynamic_newton_iterations: Count = 1
    integrator: Literal["implicit_euler", "bdf2"] = "bdf2"
    damping_per_s: NonNegativeRate = 0.0
    air_drag_per_s: NonNegativeRate = 0.0
    follow_unstable: bool = False


@final
@dataclass(frozen=True)
class PlanTable(Table):
    """What the planned way of the arm is checked for, before anything runs.

    Links count always; the soft robot, in its drawn shape, where the run does not model its contact.

    Args:
        collision: of a link with another one, or with what no load can move. "refuse": it does not run;
            "warn": it is reported; "off": nobody looks.
        clearance_m: what stands nearer to links than this counts as well.
    """

    collision: Literal["refuse", "warn", "off"] = "warn"
    clearance_m: NonNegativeLength = 0.0


@final
@dataclass(frozen=True)
class FrictionPairTable(Table):
    """Friction between two things, measured for this pair.

    Args:
        between: two of: an object, a wire, "floor", "palm", "film" (the soft robot).
        friction: coefficient of sliding, whatever the rule makes of theirs.
    """

    between: tuple[str, str]
    friction: NonNegative

    @rule
    def _names_what_is_there(self, scenario: Scenario) -> Told:
        palm = () if scenario.soft_robot.palm is None else ("palm",)
        around = [each.name for each in scenario.objects] + [wire.name for wire in scenario.wires]
        names = ("film", "floor", *palm, *around)
        for name in [name for name in self.between if name not in names][:1]:
            yield "between", keys.unknown_name_message("body", name, names)
        if self.between == ("film", "film"):
            yield "between", "of film on film, set contact.self_friction"


@final
@dataclass(frozen=True)
class ContactTable(Table):
    """Contact of the soft robot with the scene and with itself; in the quasistatic mode without friction.

    Args:
        enabled: whether contact with floor and objects is modelled.
        only_in_reach: not where nothing is within the film's reach of the flange's way.
        stiffness_N_m3: pressure per depth.
        smoothing_m: width of the transition; contact begins at half of it before touching.
        stick_m: tangential distance at which the full friction acts.
        self_contact: whether units and fingers touch one another, by the same law: "auto" models that from
            where they come to press, true in every step, false lets them pass through one another.
            With `model.published` "auto" is false. A section model has it in the energy of its sections,
            between neighbouring units and without friction.
        self_friction: coefficient of sliding between films; without meaning in the quasistatic mode.
        film_friction: coefficient of sliding of the film on all else; omitted: that of the touched body.
        pair_friction: how the coefficients of two that touch combine, rigid bodies and film alike: the
            "largest", the "smallest", their "mean", or the "root" of their product.
        pairs: `[[contact.pair]]` in the file.
    """

    enabled: bool = True
    only_in_reach: bool = True
    stiffness_N_m3: PositiveContactStiffness = 3e8
    smoothing_m: PositiveLength = 1e-4
    stick_m: PositiveLength = 1e-4
    self_contact: Literal["auto", True, False] = "auto"
    self_friction: NonNegative = 0.5
    film_friction: NonNegative | None = None
    pair_friction: Literal["largest", "smallest", "mean", "root"] = "largest"
    pairs: tuple[FrictionPairTable, ...] = field(default=(), metadata={"alias": "pair"})


@final
@dataclass(frozen=True)
class ModelTable(Table):
    """What the model is: switches for comparison with the paper.

    Args:
        published: the paper's lumped model, whatever the robot's file says: film law "plain"
            ("edge_strain" if the file says so), uniform hinges, no stiffeners, no finer
            mesh at the holes, no fused necks.
        closed: the end holes carry pressure (caps); otherwise the films only.
        all_hinges: every interior edge carries a hinge; otherwise the published subset.
    """

    published: bool = False
    closed: bool = True
    all_hinges: bool = True


@final
@dataclass(frozen=True)
class OrificeTable(Table):
    """A hole or hose between two chambers; gas flows while both are sealed, dm/dt = conductance (p_1 - p_2).

    Args:
        chambers: names of the two.
        conductance_kg_s_Pa: mass per second and pascal.
    """

    chambers: tuple[str, str]
    conductance_kg_s_Pa: PositiveConductance

    @rule
    def _joins_two_chambers(self, scenario: Scenario) -> Told:
        names = scenario.soft_robot.chamber_names()
        for name in [name for name in self.chambers if name not in names][:1]:
            yield "chambers", keys.unknown_name_message("chamber", name, names)
        if self.chambers[0] == self.chambers[1]:
            yield "chambers", f"joins '{self.chambers[0]}' to itself; name two chambers"


@final
@dataclass(frozen=True)
class GasTable(Table):
    """The gas in the chambers, wherever a phase seals it.

    Args:
        exponent: gamma of p V^gamma, from 1 (slow, isothermal) to 1.4 (fast, adiabatic air).
        ambient_Pa: absolute pressure outside.
        temperature_K: of the gas when it is sealed; only a leak depends on it.
        orifices: `[[gas.orifice]]` in the file.
    """

    exponent: Annotated[float, Interval(ge=1.0, le=2.0)] = 1.4
    ambient_Pa: NonNegativePressure = 101325.0
    temperature_K: PositiveTemperature = 293.15
    orifices: tuple[OrificeTable, ...] = field(default=(), metadata={"alias": "orifice"})


@final
@dataclass(frozen=True)
class RecordingTable(Table):
    """How often the recording holds the scene, in simulated time; curves have a point per tick.

    Args:
        frames_per_s: frames of the film per simulated second; curves have a point for every tick.
    """

    frames_per_s: PositiveRate = 60.0


_NEEDED: Final = {
    "bang_bang": ("increment",), "pi": ("proportional_gain", "integral_gain_per_s"), "python": ()
}  # fmt: skip
_PERIOD_ROUNDING: Final = 1e-6


def unknown_cables(named: Iterable[str], scenario: Scenario, key: str) -> Told:
    """Yield what is wrong with a key that names cables: the first that does not exist."""
    known = scenario.soft_robot.cable_names()
    for name in [name for name in named if name not in known][:1]:
        yield key, keys.unknown_name_message("cable", name, known)


@final
@dataclass(frozen=True)
class PumpTable(Table):
    """A pump with a pressure switch on the gas of a chamber, at work where a phase gives `pump_pressure_Pa`.

    Args:
        name: of the pump; phases set its pressure by it.
        chamber: whose gas; omitted: that of the only chamber.
        flow_kg_s: mass flow without counter-pressure.
        pressure_max_Pa: gauge pressure against which nothing is delivered; omitted: the flow is constant.
        band_Pa: on half of it below the setpoint, off half of it above.
        sensor_delay_s: age of the pressure that the switch sees; rounded to whole ticks.
        vent_above_Pa: above the setpoint, where a valve opens until the setpoint is reached; omitted: none.
        vent_kg_s_Pa: mass flow of the open valve per pascal of gauge pressure.
    """

    name: Name
    flow_kg_s: PositiveMassFlow
    chamber: str | None = None
    pressure_max_Pa: PositivePressure | None = None
    band_Pa: NonNegativePressure = 1e3
    sensor_delay_s: NonNegativeTime = 0.0
    vent_above_Pa: PositivePressure | None = None
    vent_kg_s_Pa: NonNegativeConductance = 0.0

    @rule
    def _vents(self) -> Told:
        if self.vent_above_Pa is not None and self.vent_kg_s_Pa == 0.0:
            yield "vent_kg_s_Pa", "is missing: the valve of vent_above_Pa lets nothing through"

    @rule
    def _is_on_a_chamber(self, scenario: Scenario) -> Told:
        names = scenario.soft_robot.chamber_names()
        if self.chamber is None and len(names) > 1:
            yield "chamber", f"is missing; there are: {keys.listing(names)}"
        if self.chamber is not None and self.chamber not in names:
            yield "chamber", keys.unknown_name_message("chamber", self.chamber, names)


@final
@dataclass(frozen=True)
class WinchTable(Table):
    """Winches of one kind, which go to the cable lengths that phases and controllers command.

    Args:
        name: of the winch.
        cables: names.
        one_motor: one drum winds all of them by the same length, against the sum of their tensions, as one
            motor closes three fingers; otherwise each cable has a motor.
        step_angle_rad: of the motor, per commanded (micro)step.
        gear_ratio: turns of the motor per turn of the drum.
        drum_radius_m: to the middle of the cable.
        step_rate_per_s: highest rate of steps.
        stall_torque_Nm: of the motor, above which steps are lost.
    """

    name: Name
    cables: Annotated[tuple[str, ...], Len(min_length=1)]
    step_angle_rad: PositiveAngle
    drum_radius_m: PositiveLength
    step_rate_per_s: PositiveRate
    stall_torque_Nm: PositiveTorque
    gear_ratio: Positive = 1.0
    one_motor: bool = False

    @property
    def step_m(self) -> float:
        """Length l of cable per step."""
        return self.step_angle_rad * self.drum_radius_m / self.gear_ratio

    @property
    def speed_m_s(self) -> float:
        """Highest speed of the cable."""
        return self.step_rate_per_s * self.step_m

    @property
    def stall_force_N(self) -> float:
        """Tension F, of all cables on a drum, above which steps are lost."""
        return self.stall_torque_Nm * self.gear_ratio / self.drum_radius_m

    @rule
    def _winds_cables(self, scenario: Scenario) -> Told:
        return unknown_cables(self.cables, scenario, "cables")

    @rule
    def _winds_them_alone(self, scenario: Scenario) -> Told:
        wound: dict[str, str] = {}
        for winch in scenario.winches:
            for name in winch.cables:
                if winch is self and name in wound:
                    yield "cables", f"cable '{name}' is wound by winch '{wound[name]}' already"
                    return
                wound[name] = winch.name
            if winch is self:
                return

    @rule
    def _winds_all_alike(self, scenario: Scenario) -> Told:
        if not self.one_motor:
            return
        for phase in scenario.phases:
            given, lengths = phase.cable_shortening_m or {}, phase.cable_length_m or {}
            changes = {given.get(name) for name in self.cables}
            if len(changes) > 1 or not set(self.cables).isdisjoint(lengths):
                yield (
                    "one_motor",
                    f"is true, and phase '{phase.name}' commands its cables differently; give all of "
                    f"{keys.listing(self.cables)} the same cable_shortening_m",
                )
        for entry in scenario.controllers:
            if entry.commands == "cable_shortening_m" and 0 < len({*self.cables} & {*entry.cables}) < len(
                {*self.cables}
            ):
                yield (
                    "one_motor",
                    f"is true, and controller '{entry.name}' moves only some of its cables; give it all of "
                    f"{keys.listing(self.cables)}",
                )


@final
@dataclass(frozen=True)
class ControllerTable(Table):
    """A controller with a fixed rate, which acts in the phases that name it.

    Args:
        name: of the controller; phases give its setpoint by it.
        kind: "bang_bang": raises or lowers its output by `increment` per period; "pi": proportional and
            integral; "python": handed to `cosim.run(..., controllers={name: controller})`.
        period_s: between two samples, a whole number of ticks; the command holds in between.
        measures: the value that it keeps at its setpoint; "tip_position_m": where the `tip_path` or
            `tip_target` of the phase has the tip, with kind "pi" and commands "flange_twist".
        commands: its output; "flange_twist": the flange moves besides its plan, without turning.
        cables: that it moves, all alike.
        sensors: names of those whose readings it sees in place of the truth.
        increment: bang_bang: change of the output per period, in the output's unit.
        band: bang_bang: width about the setpoint in which the output stays, in the measured unit.
        proportional_gain: pi: output per error.
        integral_gain_per_s: pi: output per error and second.
        output_min: lowest output.
        output_max: highest output; omitted: none.
    """

    name: Name
    kind: Literal["bang_bang", "pi", "python"]
    period_s: PositiveTime
    measures: Literal["bending_angle_rad", "tip_height_m", "tip_position_m"] = "bending_angle_rad"
    commands: Literal["cable_tension_N", "cable_shortening_m", "flange_twist"] = "cable_tension_N"
    cables: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    increment: Positive | None = None
    band: NonNegative = 0.0
    proportional_gain: NonNegative | None = None
    integral_gain_per_s: NonNegativeRate | None = None
    output_min: Number = 0.0
    output_max: Number | None = None

    @property
    def follows_tip(self) -> bool:
        """Whether it moves the flange so that the tip is where the phase has it."""
        return self.kind != "python" and self.measures == "tip_position_m"

    @rule
    def _acts_every_few_ticks(self, scenario: Scenario) -> Told:
        tick_s = scenario.clock.tick_s
        ticks = self.period_s / tick_s
        if round(ticks) < 1 or abs(ticks - round(ticks)) > _PERIOD_ROUNDING * ticks:
            yield "period_s", f"{self.period_s:g} must be a whole number of ticks of {tick_s:g} s"

    @rule
    def _follows_a_tip_with_the_flange(self, scenario: Scenario) -> Told:
        if self.follows_tip != (self.commands == "flange_twist"):
            yield "commands", "'flange_twist' and measures = 'tip_position_m' go together"
        elif self.follows_tip and self.kind != "pi":
            yield "kind", f"is '{self.kind}'; measures = 'tip_position_m' needs 'pi'"
        elif self.follows_tip and self.cables:
            yield "cables", "are not moved by 'flange_twist'; leave them out"
        elif self.follows_tip and scenario.robot == NO_ARM:
            yield "commands", "'flange_twist' needs an arm; robot is 'none'"

    @rule
    def _moves_cables(self, scenario: Scenario) -> Told:
        yield from unknown_cables(self.cables, scenario, "cables")
        if not self.cables and self.kind != "python" and not self.follows_tip:
            yield "cables", f"is missing; there are: {keys.listing(scenario.soft_robot.cable_names())}"

    @rule
    def _has_what_its_kind_needs(self) -> Told:
        for key in [key for key in _NEEDED[self.kind] if getattr(self, key) is None]:
            yield key, f"is missing; kind '{self.kind}' needs it"

    @rule
    def _has_a_range(self) -> Told:
        if self.kind == "python":
            return
        if self.output_max is not None and self.output_max <= self.output_min:
            yield "output_max", f"{self.output_max:g} must be above output_min, {self.output_min:g}"
        if self.commands == "cable_tension_N" and self.output_min < 0.0:
            yield "output_min", f"{self.output_min:g} N: a cable cannot push, give 0 or more"


@final
@dataclass(frozen=True)
class GivenBodyTable(Table):
    """A soft body given as arrays. It is written for the record; its shape and film are in no file.

    Args:
        name: of the body.
        arrays: short name of all that it is made of: equal bodies have equal ones.
        triangles: number of film triangles.
        closed: whether its caps carry pressure.
        rings: names of its groups of nodes, "base" and "tip" among them.
        base: those of them that the flange holds from the start.
        cables: their names, in order.
        chambers: names of its gas chambers, in order.
    """

    name: Name
    arrays: Text
    triangles: Count
    closed: bool
    rings: tuple[Text, ...]
    base: tuple[Text, ...]
    cables: tuple[Name, ...]
    chambers: tuple[Text, ...]
    palm: ClassVar[None] = None

    def cable_names(self) -> tuple[str, ...]:
        """Return the names of all cables."""
        return self.cables

    def chamber_names(self) -> tuple[str, ...]:
        """Return the names of all gas chambers."""
        return self.chambers

    def ring_names(self) -> tuple[str, ...]:
        """Return the names of all groups of nodes."""
        return self.rings

    def sides_of(self, _ring: str) -> int:
        """Return how many corners a group has: none."""
        return 0


def _kind_of_body(value: Any) -> str:
    return "given as arrays" if isinstance(value, Mapping) and "arrays" in value else "of a file"


AnySoftRobot: TypeAlias = Annotated[
    Annotated[SoftRobotTable, Tag("of a file")] | Annotated[GivenBodyTable, Tag("given as arrays")],
    Discriminator(_kind_of_body),
]
"""What represents the soft robot in a checked scenario."""


NO_ARM: Final = "none"


@final
@dataclass(frozen=True)
class Scenario(Table):
    """Everything a run depends on.

    Args:
        schema: number of the names of the keys; an older one is refused, `cosim upgrade` rewrites it.
        title: one line for people: on screen, in the recording, in the summary.
        mode: "dynamic": ticks of time, with inertia; "quasistatic": equilibria, increment by increment.
        gravity_m_s2: world axes.
        name: of the scenario; the file's name if omitted.
        robot: rigid arm: a directory of robots/ that holds an arm.toml, or the path of a URDF (.urdf), an
            MJCF (.xml) or an arm.toml, from the folder of the scenario; or "menagerie:MODEL", of MuJoCo
            Menagerie on this machine ("menagerie:MODEL/FILE" where it has several files); "none": the base
            is held where the flange starts, and nothing of an arm is loaded.
        arm_base: where the arm's root link stands, on a table, a wall or below a ceiling; omitted: as its own
            file says.
        soft_robot: in the file a name, a path, or a table `{file = NAME, ...}` of changes to that file.
        fidelity: of the soft robot. "rigid": it keeps the shape it starts in, mass only; "section": a chain
            of rigid frames, one per ring, with the condensed energy of the film between them; "lumped": the
            mesh of its file; "refined": every triangle of that divided into four.
        payload_compensation: the arm's feedforward knows the soft arm's weight.
        objects: `[[object]]` in the file.
        scene: of other things around the arm.
        wires: `[[wire]]` in the file.
        phases: `[[phase]]` in the file; without any, it holds its start for as long as it is stepped, and
            is moved by the commands of `cosim.Simulation.step` alone.
        pumps, winches, controllers: `[[pump]]`, `[[winch]]`, `[[controller]]` in the file.
        sensors, cameras: `[[sensor]]`, `[[camera]]` in the file.
        commands: `[[command]]` in the file, each of which changes what those before it ask for; kinds are
            registered from Python.
    """

    schema: SchemaNumber
    name: Name
    title: Text
    robot: str
    soft_robot: AnySoftRobot
    start: StartTable
    phases: tuple[PhaseTable, ...] = field(default=(), metadata={"alias": "phase"})
    mode: Literal["dynamic", "quasistatic"] = "dynamic"
    fidelity: Fidelity = "lumped"
    arm_base: BaseTable | None = None
    gravity_m_s2: tuple[Acceleration, Acceleration, Acceleration] = (0.0, 0.0, -9.81)
    payload_compensation: bool = True
    clock: ClockTable = ClockTable()
    solver: SolverTable = SolverTable()
    plan: PlanTable = PlanTable()
    contact: ContactTable = ContactTable()
    coupling: CouplingTable = CouplingTable()
    model: ModelTable = ModelTable()
    gas: GasTable = GasTable()
    recording: RecordingTable = RecordingTable()
    objects: tuple[ObjectTable, ...] = field(default=(), metadata={"alias": "object"})
    scene: SceneTable | None = None
    wires: tuple[WireTable, ...] = field(default=(), metadata={"alias": "wire"})
    pumps: tuple[PumpTable, ...] = field(default=(), metadata={"alias": "pump"})
    winches: tuple[WinchTable, ...] = field(default=(), metadata={"alias": "winch"})
    controllers: tuple[ControllerTable, ...] = field(default=(), metadata={"alias": "controller"})
    sensors: tuple[SensorTable, ...] = field(default=(), metadata={"alias": "sensor"})
    cameras: tuple[CameraTable, ...] = field(default=(), metadata={"alias": "camera"})
    commands: tuple[CommandTable, ...] = field(default=(), metadata={"alias": "command"})

    @property
    def touches_itself(self) -> bool:
        """Whether contact of the soft robot's films with one another is modelled, if any can meet."""
        asked = self.contact.self_contact
        return self.fidelity != "rigid" and (asked is True or (asked == "auto" and not self.model.published))

    def ticks(self, phase: PhaseTable) -> int:
        """Return how many ticks of the clock a phase lasts, at least one."""
        return max(1, round((phase.duration_s + phase.settle_s) / self.clock.tick_s))

    @property
    def endless(self) -> bool:
        """Whether it has no phases, and lasts as long as it is stepped."""
        return self.phases in ((), (HOLD,))
