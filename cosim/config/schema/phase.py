"""Schema of the start and the phases of a scenario: where the flange goes, what is loaded and held.

Names that mean several things: groups ("gripper" for "gripper/...") and patterns ("copy_*/tip").

Values that a scenario gives for the gas chambers: one for all, a list, or a table by name.

A name in a table is that of a chamber ("gripper/copy_2"), of a group of chambers ("gripper" for all whose
names begin with "gripper/"), or a pattern ("gripper/copy_*").

Tables of what changes the commands of a scenario's phases: `[[command]]`.

Each kind has its own table, a subclass of `CommandTable`, and is known once it is registered.

A rigid target is a pose of the flange. `direction` is the flange's z axis, out of the flange. At
`roll_rad = 0` the flange is turned the shortest way from hanging straight down with its x axis along the
world's x axis; pointing straight up it is turned half a turn about the world's y axis instead.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar, final

from annotated_types import Interval, Len

from cosim.config.toml.keys import listing, matching, unknown_name_message
from cosim.config.toml.quantities import (
    Angle,
    Count,
    Direction,
    Force,
    Length,
    Name,
    NonNegativeConductance,
    NonNegativeTime,
    OneOrByName,
    Position,
    PositiveFrequency,
    PositiveLength,
    PositiveSpeed,
    PositiveTime,
    Pressure,
    Speed,
    Tensions,
    Text,
)
from cosim.config.toml.rules import Fault, Told, rule
from cosim.config.toml.tables import KindTable, Table
from cosim.errors import InputError, ScenarioError

if TYPE_CHECKING:
    from cosim.base.tip_course import TipCourse


Value = TypeVar("Value")


def by_name(table: Mapping[str, Value], names: Sequence[str], what: str, path: str) -> dict[str, Value]:
    """Return the value of each name that a table gives one by name, group or pattern; later entries win.

    Args:
        table: of a scenario.
        names: that there are.
        what: they are names of, for the message.
        path: of the table, for the message.

    Raises:
        ScenarioError: a key matches no name.
    """
    found: dict[str, Value] = {}
    for key, value in table.items():
        meant = matching(key, names)
        if not meant:
            raise ScenarioError(f"{path}.{key}", unknown_name_message(what, key, tuple(names)))
        found.update(dict.fromkeys(meant, value))
    return found


def given_values(
    setting: OneOrByName[Value] | None, names: Sequence[str], path: str
) -> tuple[Value | None, ...]:
    """Return the value that a setting gives for each chamber; None where it leaves one out.

    Args:
        setting: of a scenario.
        names: of the chambers.
        path: of the setting, for messages.

    Raises:
        ScenarioError: a list of another length, or a name that matches no chamber.
    """
    if isinstance(setting, Mapping):
        found = by_name(setting, names, "chamber", path)
        return tuple(found.get(name) for name in names)
    if not isinstance(setting, tuple):
        return (setting,) * len(names)
    if len(setting) != len(names):
        raise ScenarioError(
            path, f"has {len(setting)} entries; there are {len(names)} chambers: {listing(names)}"
        )
    return setting


def values_after(
    before: tuple[Value, ...], setting: OneOrByName[Value] | None, names: Sequence[str], path: str
) -> tuple[Value, ...]:
    """Return the value of each chamber after a setting; what it leaves out stays as before.

    Raises:
        ScenarioError: see `given_values`.
    """
    given = given_values(setting, names, path)
    return tuple(old if new is None else new for old, new in zip(before, given, strict=True))


@dataclass(frozen=True, kw_only=True)
class CommandTable(KindTable):
    """A source of commands.

    Args:
        kind: of the source; each kind has its own further keys.
    """

    def source(self, given: Any, scenario: Any) -> Any:
        """Return a source of commands (`cosim.devices.command_source.CommandSource`) in place of another.

        Args:
            given: what would be asked for without it, a `CommandSource`.
            scenario: a checked `Scenario`.

        Raises:
            InputError: there is no such cable, or what else is asked for.
        """
        raise NotImplementedError


MOST_POINTS: Final = 10_000
"""Of a tip path."""

MOST_SHAKE_PERIODS: Final = 1_000
CELL_KEYS: Final = ("cell_shift_m", "cell_angle_rad", "cell_speed_m_s", "cell_speed_rad_s")
"""Keys of a phase that drive joints of the cell."""

JOINT_KEYS: Final = ("joint_shift_m", "joint_angle_rad")
"""Keys of a phase, and of the start, that lead joints of the arm: those that slide, those that turn."""

SETPOINTS: Final = {
    "control_bending_angle_rad": "bending_angle_rad", "control_tip_height_m": "tip_height_m"
}  # fmt: skip
"""Key of a phase -> what the controllers that it names measure."""

_MOVES: Final = ("flange", "flange_turn", "flange_shift_m", "flange_shake")
_SAME: Final = 1e-6  # of a duration


@final
@dataclass(frozen=True)
class FlangePoseTable(Table):
    """Absolute pose of the flange: origin, z axis, roll about it (see the module's text).

    Args:
        position_m: of the flange's origin, world.
        direction: the flange's z axis, out of the flange, world; of any length.
        roll_rad: about that axis.
    """

    position_m: Position
    direction: Direction
    roll_rad: Angle = 0.0


@final
@dataclass(frozen=True)
class FlangeTurnTable(Table):
    """Right-handed rotation about the flange's origin, world axis, from where the phase starts.

    Args:
        axis: world; of any length.
        angle_rad: at the end of the ramp.
    """

    axis: Direction
    angle_rad: Annotated[float, Interval(ge=-100.0, le=100.0)]


@final
@dataclass(frozen=True)
class FlangeShakeTable(Table):
    """The flange swings to and fro along a line, and ends where it began.

    Args:
        axis: world.
        amplitude_m: reached after the first period, kept up to the last one.
        frequency_Hz: the phase must last at least three periods, and its ramp be linear.
    """

    axis: Direction
    amplitude_m: PositiveLength
    frequency_Hz: PositiveFrequency


@final
@dataclass(frozen=True)
class TipTargetTable(Table):
    """Where the soft tip should be at the end of a phase: `position_m`, or only its height.

    Args:
        position_m: of the centre of the last hole ring, world.
        direction: unit normal of the last hole ring, away from the base, world.
        height_m: world z of the tip; only with reach_with = "cables".
        reach_with: "flange": the flange goes where the deformed tip meets the target;
            "cables": the flange stays, tensions are found;
            "none": the flange goes where the undeformed tip would meet it (to see the error).
    """

    position_m: Position | None = None
    direction: Direction | None = None
    height_m: Length | None = None
    reach_with: Literal["flange", "cables", "none"] = "flange"

    @rule
    def _is_one_place(self) -> Told:
        if (self.position_m is None) == (self.height_m is None):
            given = "neither" if self.position_m is None else "both"
            yield "", f"give position_m or height_m; {given} is given"
        elif self.reach_with != "cables" and self.height_m is not None:
            yield "height_m", "needs reach_with = 'cables'"


@final
@dataclass(frozen=True)
class TipPathTable(Table):
    """A path that the tip follows from rest to rest: a smooth curve through points, at one speed.

    Args:
        points_m: of the centre of the last hole ring, world; the first one is where the tip is when the phase
            starts. Straight between two, a cubic spline through more.
        directions: unit normals of the last hole ring, away from the base, world: one for the whole path, or
            one for each point; left out, the tip turns as it comes.
        file: CSV in place of both, beside the scenario: a header with x_m, y_m, z_m and, for directions,
            direction_x, direction_y, direction_z.
        speed_m_s: along the path, between its ramps.
        ramp_s: from rest to that speed, and from it to rest.
        reach_with: "flange": the flange goes where the deformed tip is on the path;
            "none": the flange goes where the undeformed tip would be on it (to see the error).
    """

    speed_m_s: PositiveSpeed
    points_m: Annotated[tuple[Position, ...], Len(max_length=MOST_POINTS)] = ()
    directions: Annotated[tuple[Direction, ...], Len(max_length=MOST_POINTS)] = ()
    file: Text | None = None
    ramp_s: PositiveTime = 0.5
    reach_with: Literal["flange", "none"] = "flange"

    def course(self) -> "TipCourse":
        """Return where the tip is to be, and when.

        Raises:
            InputError: there is no such curve.
        """
        from cosim.base.tip_course import course_of  # here: scenarios without a path need no splines

        return course_of(self.points_m, self.directions, self.speed_m_s, self.ramp_s)


@final
@dataclass(frozen=True)
class StartTable(Table):
    """State before the first tick; an empty list of tensions means none.

    Args:
        flange: where it is.
        pressure_Pa: gauge pressure; of all chambers, or a list, or a table by chamber.
        cable_tension_N: at the base end of each cable.
        joint_shift_m: where joints of the arm that slide are, by name, such as a rail; see `[[phase]]`.
        joint_angle_rad: the same of those that turn.
    """

    flange: FlangePoseTable
    pressure_Pa: OneOrByName[Pressure] = 0.0
    cable_tension_N: Tensions = ()
    joint_shift_m: Mapping[str, Length] | None = None
    joint_angle_rad: Mapping[str, Angle] | None = None


@final
@dataclass(frozen=True)
class SupportTable(Table):
    """Nodes held in the world; only without an arm.

    Args:
        rings: such as "unit_1.outer".
        corners: of these rings, 0 to sides - 1; omitted: all nodes of the rings.
        axes: world axes along which they are held, where they are when the phase starts.
    """

    rings: Annotated[tuple[str, ...], Len(min_length=1)]
    corners: tuple[int, ...] | None = None
    axes: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz"


@final
@dataclass(frozen=True)
class ForceTable(Table):
    """A dead load on nodes, at the end of the ramp.

    Args:
        rings: such as "unit_5.outer".
        corners: of these rings, 0 to sides - 1; omitted: all nodes of the rings.
        total_N: shared evenly by the nodes, world axes.
    """

    rings: Annotated[tuple[str, ...], Len(min_length=1)]
    total_N: tuple[Force, Force, Force]
    corners: tuple[int, ...] | None = None


@final
@dataclass(frozen=True)
class PhaseTable(Table):
    """One stretch of the run; omitted values stay as they are.

    Values of the gas are one value for all chambers, or a list, or a table by chamber.

    Args:
        name: of the phase; overrides, curves and the summary call it by that.
        duration_s: of the ramp; beside `tip_path` it follows from the path, and is left out.
        settle_s: held afterwards, at the end values.
        increments: of the ramp, in the quasistatic mode.
        ramp: "smooth" is the minimum-jerk quintic.
        gas: "prescribed": the pressure is given; "sealed": the gas in the chamber at the phase's start stays
            in it, and its pressure follows from the volume. Prescribed until a phase seals it.
        leak_kg_s_Pa: mass that a sealed gas loses per second and pascal of gauge pressure.
        pressure_Pa: gauge pressure at the end of the ramp.
        cable_tension_N: at the base end of each cable, at the end of the ramp; in the file a list, or a table
            by name, group or pattern, whose cables left out stay as they were.
        cable_length_m: unstretched length between first and last eyelet at the end of the ramp, by cable; it
            stays commanded until a tension is.
        cable_shortening_m: the same, as the change since the start of the phase.
        pump_pressure_Pa: setpoint from the start of the phase on, by pump; while the gas is sealed.
        control: controllers that act in this phase without a setpoint.
        control_bending_angle_rad: setpoint of the angle between tip direction and flange axis, by controller.
        control_tip_height_m: setpoint of the tip's world z, by controller.
        flange: absolute pose at the end of the ramp.
        flange_turn: relative rotation; may be combined with `flange_shift_m`.
        flange_shift_m: relative displacement, world axes.
        flange_shake: a swing on top of `flange_turn` and `flange_shift_m`.
        joint_shift_m: where joints of the arm that slide are at the end of the ramp, by name, such as a rail;
            the others follow the flange. At least six must. Without it a joint follows the flange as well.
        joint_angle_rad: the same of joints that turn, such as a turntable.
        cell_shift_m: place of slides of the cell at the end of the ramp, by joint; 0 is where its file has
            them.
        cell_angle_rad: the same of its hinges.
        cell_speed_m_s: of slides of the cell from the start of the phase on, by joint, such as a conveyor; it
            stays until a phase gives another speed, or a place.
        cell_speed_rad_s: the same of its hinges.
        release: rings let go when the phase starts, before anything else is held.
        clamp: rings held rigidly to the flange from here on, as they are when the phase starts.
        supports: `[[phase.support]]` in the file; held from here on, in addition to the rings held already.
        forces: `[[phase.force]]` in the file; together they replace the forces of earlier phases.
        tip_target: where the tip should end up.
        tip_path: path that the tip follows, with a time law in place of `ramp`.
    """

    name: Name
    duration_s: PositiveTime
    settle_s: NonNegativeTime = 0.0
    increments: Count = 100
    ramp: Literal["smooth", "linear", "step"] = "smooth"
    gas: OneOrByName[Literal["prescribed", "sealed"]] | None = None
    leak_kg_s_Pa: OneOrByName[NonNegativeConductance] | None = None
    pressure_Pa: OneOrByName[Pressure] | None = None
    cable_tension_N: Tensions | None = None
    cable_length_m: Mapping[str, PositiveLength] | None = None
    cable_shortening_m: Mapping[str, Length] | None = None
    pump_pressure_Pa: Mapping[str, Pressure] | None = None
    control: tuple[str, ...] = ()
    control_bending_angle_rad: Mapping[str, Angle] | None = None
    control_tip_height_m: Mapping[str, Length] | None = None
    flange: FlangePoseTable | None = None
    flange_turn: FlangeTurnTable | None = None
    flange_shift_m: Position | None = None
    flange_shake: FlangeShakeTable | None = None
    joint_shift_m: Mapping[str, Length] | None = None
    joint_angle_rad: Mapping[str, Angle] | None = None
    cell_shift_m: Mapping[str, Length] | None = None
    cell_angle_rad: Mapping[str, Angle] | None = None
    cell_speed_m_s: Mapping[str, Speed] | None = None
    cell_speed_rad_s: Mapping[str, Speed] | None = None
    release: tuple[str, ...] = ()
    clamp: tuple[str, ...] = ()
    supports: tuple[SupportTable, ...] = field(default=(), metadata={"alias": "support"})
    forces: tuple[ForceTable, ...] = field(default=(), metadata={"alias": "force"})
    tip_target: TipTargetTable | None = None
    tip_path: TipPathTable | None = None

    @property
    def tip_key(self) -> str | None:
        """The key that says where the tip goes; None where nothing does."""
        return next(iter(self._given(("tip_target", "tip_path"))), None)

    @property
    def commands_lengths(self) -> bool:
        """Whether it commands cable lengths."""
        return bool(self._given(("cable_length_m", "cable_shortening_m")))

    def acting(self) -> dict[str, float | None]:
        """Return the controllers that act in it, with their setpoints; None for one without."""
        named: dict[str, float | None] = dict.fromkeys(self.control)
        for key in SETPOINTS:
            named.update(getattr(self, key) or {})
        return named

    def _given(self, keys: Sequence[str]) -> list[str]:
        return [key for key in keys if getattr(self, key) is not None]

    @rule
    def _moves_in_one_way(self) -> Told:
        moves = self._given(_MOVES)
        if self.flange is not None and len(moves) > 1:
            yield moves[1], "cannot be combined with flange, which already gives the pose"

    @rule
    def _shakes(self) -> Told:
        if self.flange_shake is None:
            return
        if self.ramp != "linear":
            yield "ramp", f"flange_shake needs ramp = 'linear'; it is '{self.ramp}'"
        periods = self.flange_shake.frequency_Hz * self.duration_s
        if periods < 3.0:
            yield "duration_s", f"{self.duration_s:g} is shorter than 3 periods of flange_shake"
        if periods > MOST_SHAKE_PERIODS:
            yield Fault(
                "flange_shake.frequency_Hz",
                f"makes {periods:g} periods in one phase; at most {MOST_SHAKE_PERIODS} are allowed",
            )

    @rule
    def _follows_a_path_alone(self) -> Told:
        if self.tip_path is None:
            return
        for other in self._given((*_MOVES, "tip_target")):
            yield other, "cannot be combined with tip_path, which moves the flange"
        if self.ramp != "linear":
            yield "ramp", f"is '{self.ramp}'; a tip_path has its own ramps (ramp_s): leave it out"

    @rule
    def _lasts_as_long_as_its_path(self) -> Told:
        path = self.tip_path
        if path is None:
            return
        if path.file is not None:
            yield "tip_path.file", "is read where a scenario's file names it; give points_m"
            return
        try:
            lasts_s = path.course().duration_s
        except InputError as error:
            yield "tip_path", str(error)
            return
        if not math.isclose(self.duration_s, lasts_s, rel_tol=_SAME):
            yield Fault(
                "duration_s",
                f"is {self.duration_s:g}, but the path takes {lasts_s:.6g} s at {path.speed_m_s:g} m/s; "
                "leave it out",
            )

    @rule
    def _reaches_in_one_way(self) -> Told:
        if self.tip_target is None:
            return
        for key in self._given(_MOVES)[:1]:
            yield key, "cannot be combined with tip_target in one phase"
        if self.tip_target.reach_with == "cables" and self.cable_tension_N is not None:
            yield "cable_tension_N", "cannot be combined with a target reached with cables"

    @rule
    def _commands_cables_in_one_way(self) -> Told:
        for key in self._given(("cable_length_m", "cable_shortening_m")):
            if getattr(self, key) and self.cable_tension_N is not None:
                yield key, "cannot be combined with cable_tension_N, which commands the same cables"
        for name in sorted((self.cable_length_m or {}).keys() & (self.cable_shortening_m or {}).keys()):
            yield f"cable_shortening_m.{name}", "cannot be combined with cable_length_m of the same cable"


HOLD: Final = PhaseTable(name="hold", duration_s=1e9, ramp="step")
"""What a scenario without phases does: it stays as it starts, longer than anybody steps it."""
