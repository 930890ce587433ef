"""Tables of the start and the phases of a scenario: motion of the flange, loads, held rings, targets of the
tip; and the base class of command sources (`[[command]]`). A rigid target is a pose of the flange.
`direction` is the flange's z axis, out of the flange. At `roll_rad = 0` the flange is turned the shortest way
from hanging straight down with its x axis along the world's x axis; pointing straight up it is turned half a
turn about the world's y axis instead.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, final

from annotated_types import Interval, Len

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
from cosim.config.toml.rules import Fault, Violations, rule
from cosim.config.toml.tables import KindTable, Table
from cosim.errors import InputError

if TYPE_CHECKING:
    from cosim.base.tip_course import TipCourse

MOST_POINTS: Final = 10_000
"""Of a tip path."""
MOST_SHAKE_PERIODS: Final = 1_000
CELL_KEYS: Final = ("cell_shift_m", "cell_angle_rad", "cell_speed_m_s", "cell_speed_rad_s")
"""Keys of a phase that drive joints of the cell."""
JOINT_KEYS: Final = ("joint_shift_m", "joint_angle_rad")
"""Keys of a phase, and of the start, that prescribe joints of the arm: prismatic ones, revolute ones."""
SETPOINTS: Final = {
    "control_bending_angle_rad": "bending_angle_rad", "control_tip_height_m": "tip_height_m"
}  # fmt: skip
"""Key of a phase -> quantity that the controllers it names measure."""
_MOVES: Final = ("flange", "flange_turn", "flange_shift_m", "flange_shake")
_SAME: Final = 1e-6  # of a duration


@dataclass(frozen=True, kw_only=True)
class CommandTable(KindTable):
    """A source of commands.

    Args:
        kind: of the source; each kind has further keys.
    """

    def source(self, given: Any, scenario: Any) -> Any:
        """Return a source of commands (`cosim.devices.command_source.CommandSource`) that wraps another.

        Args:
            given: the `CommandSource` whose commands it changes.
            scenario: a checked `Scenario`.

        Raises:
            InputError: the table names a cable or other part that does not exist.
        """
        raise NotImplementedError


@final
@dataclass(frozen=True)
class FlangePoseTable(Table):
    """Absolute pose of the flange: origin, z axis, roll about it.

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
    """Right-handed rotation about the flange's origin and a world axis, from the pose at the phase's start.

    Args:
        axis: world; of any length.
        angle_rad: at the end of the ramp.
    """

    axis: Direction
    angle_rad: Annotated[float, Interval(ge=-100.0, le=100.0)]


@final
@dataclass(frozen=True)
class FlangeShakeTable(Table):
    """The flange oscillates along a line, and ends where it began.

    Args:
        axis: world.
        amplitude_m: reached after the first period, constant up to the last one.
        frequency_Hz: of the oscillation; the phase must last at least three periods, with ramp = "linear".
    """

    axis: Direction
    amplitude_m: PositiveLength
    frequency_Hz: PositiveFrequency


@final
@dataclass(frozen=True)
class TipTargetTable(Table):
    """Target of the soft tip at the end of a phase: `position_m`, or only its height.

    Args:
        position_m: of the centre of the last hole ring, world.
        direction: unit normal of the last hole ring, away from the base, world.
        height_m: world z of the tip; only with reach_with = "cables".
        reach_with: "flange": the flange moves so that the deformed tip meets the target; "cables": the
            flange stays, and cable tensions bring the tip there; "none": the flange moves so that the
            undeformed tip would meet the target (to see the error).
    """

    position_m: Position | None = None
    direction: Direction | None = None
    height_m: Length | None = None
    reach_with: Literal["flange", "cables", "none"] = "flange"

    @rule
    def _is_one_place(self) -> Violations:
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
        points_m: of the centre of the last hole ring, world; the first one is the tip's position at the
            phase's start. Two are joined by a straight line, more by a cubic spline.
        directions: unit normals of the last hole ring, away from the base, world: one for the whole path, or
            one for each point; omitted: the tip's direction is free.
        file: CSV in place of both, in the scenario's folder: a header with x_m, y_m, z_m and, for directions,
            direction_x, direction_y, direction_z.
        speed_m_s: along the path, between its ramps.
        ramp_s: duration from rest to that speed, and from it to rest.
        reach_with: "flange": the flange moves so that the deformed tip is on the path;
            "none": the flange moves so that the undeformed tip would be on it (to see the error).
    """

    speed_m_s: PositiveSpeed
    points_m: Annotated[tuple[Position, ...], Len(max_length=MOST_POINTS)] = ()
    directions: Annotated[tuple[Direction, ...], Len(max_length=MOST_POINTS)] = ()
    file: Text | None = None
    ramp_s: PositiveTime = 0.5
    reach_with: Literal["flange", "none"] = "flange"

    def course(self) -> "TipCourse":
        """Return the tip's target over time.

        Raises:
            InputError: no curve leads through the points.
        """
        from cosim.base.tip_course import course_of  # imported here: only paths need scipy's splines

        return course_of(self.points_m, self.directions, self.speed_m_s, self.ramp_s)


@final
@dataclass(frozen=True)
class StartTable(Table):
    """State before the first tick; an empty list of tensions means none.

    Args:
        flange: its pose.
        pressure_Pa: gauge pressure; of all chambers, or a list, or a table by chamber.
        cable_tension_N: at the base end of each cable.
        joint_shift_m: positions of prismatic joints of the arm by name, such as a rail; see `[[phase]]`.
        joint_angle_rad: angles of revolute joints of the arm by name.
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
        axes: world axes along which they are held, at their positions when the phase starts.
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
    """A part of the run: it ramps to its values, then holds them. Omitted values keep those before it.

    Values of the gas are one value for all chambers, or a list, or a table by chamber.

    Args:
        name: of the phase, in overrides, curves and the summary.
        duration_s: of the ramp; with `tip_path` omit it: it follows from the path, stretched to whole ticks.
        settle_s: time after the ramp in which the end values are held.
        increments: of the ramp, in the quasistatic mode.
        ramp: "smooth" is the minimum-jerk quintic.
        gas: "prescribed": the pressure is given; "sealed": the gas in the chamber at the phase's start stays
            in it, and its pressure follows from the volume. At the start it is "prescribed".
        leak_kg_s_Pa: mass that a sealed gas loses per second and pascal of gauge pressure.
        pressure_Pa: gauge pressure at the end of the ramp.
        cable_tension_N: at the base end of each cable, at the end of the ramp; in the file a list, or a table
            by name, group or pattern. Cables that the table omits keep their tension.
        cable_length_m: unstretched length between first and last eyelet at the end of the ramp, by cable; it
            holds until a phase commands a tension.
        cable_shortening_m: decrease of that length since the start of the phase, by cable.
        pump_pressure_Pa: setpoint from the start of the phase on, by pump; while the gas is sealed.
        control: controllers that act in this phase without a setpoint.
        control_bending_angle_rad: setpoint of the angle between tip direction and flange axis, by controller.
        control_tip_height_m: setpoint of the tip's world z, by controller.
        flange: absolute pose at the end of the ramp.
        flange_turn: relative rotation; may be combined with `flange_shift_m`.
        flange_shift_m: relative displacement, world axes.
        flange_shake: an oscillation on top of `flange_turn` and `flange_shift_m`.
        joint_shift_m: positions of prismatic joints of the arm at the end of the ramp, by name, such as a
            rail. The other joints, at least six, follow the flange. Without a value a joint follows the
            flange as well.
        joint_angle_rad: angles of revolute joints of the arm at the end of the ramp, such as a turntable.
        cell_shift_m: positions of slides of the cell at the end of the ramp, by joint; 0 is the position in
            its file.
        cell_angle_rad: angles of hinges of the cell at the end of the ramp, by joint.
        cell_speed_m_s: speeds of slides of the cell from the start of the phase on, by joint, such as a
            conveyor; a speed holds until a phase gives another speed, or a position.
        cell_speed_rad_s: speeds of hinges of the cell from the start of the phase on, by joint.
        release: rings released when the phase starts, before others are held.
        clamp: rings held rigidly to the flange from the start of the phase on, in their shape at that time.
        supports: `[[phase.support]]` in the file; held from the start of the phase on, in addition to rings
            that are held already.
        forces: `[[phase.force]]` in the file; together they replace the forces of earlier phases.
        tip_target: target of the tip at the end of the phase.
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
        """The key that gives the tip's target, "tip_target" or "tip_path"; None without one."""
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
    def _moves_in_one_way(self) -> Violations:
        moves = self._given(_MOVES)
        if self.flange is not None and len(moves) > 1:
            yield moves[1], "cannot be combined with flange, which already gives the pose"

    @rule
    def _shakes(self) -> Violations:
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
    def _follows_a_path_alone(self) -> Violations:
        if self.tip_path is None:
            return
        for other in self._given((*_MOVES, "tip_target")):
            yield other, "cannot be combined with tip_path, which moves the flange"
        if self.ramp != "linear":
            yield "ramp", f"is '{self.ramp}'; a tip_path has its own ramps (ramp_s): leave it out"

    @rule
    def _lasts_as_long_as_its_path(self) -> Violations:
        path = self.tip_path
        if path is None:
            return
        if path.file is not None:
            yield "tip_path.file", "works only in a scenario's file; give points_m"
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
    def _reaches_in_one_way(self) -> Violations:
        if self.tip_target is None:
            return
        for key in self._given(_MOVES)[:1]:
            yield key, "cannot be combined with tip_target in one phase"
        if self.tip_target.reach_with == "cables" and self.cable_tension_N is not None:
            yield "cable_tension_N", "cannot be combined with a target reached with cables"

    @rule
    def _commands_cables_in_one_way(self) -> Violations:
        for key in self._given(("cable_length_m", "cable_shortening_m")):
            if getattr(self, key) and self.cable_tension_N is not None:
                yield key, "cannot be combined with cable_tension_N, which commands the same cables"
        for name in sorted((self.cable_length_m or {}).keys() & (self.cable_shortening_m or {}).keys()):
            yield f"cable_shortening_m.{name}", "cannot be combined with cable_length_m of the same cable"


HOLD: Final = PhaseTable(name="hold", duration_s=1e9, ramp="step")
"""The phase of a scenario without phases: it holds the start, longer than any run."""
