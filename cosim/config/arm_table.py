"""Tables of an arm's file, `arm.toml`, and of the rails and turntables under it (also `[arm_base]` of a
scenario). Lists have an entry for each joint from the base to the flange: angles in rad and torques in N m;
of prismatic joints lengths in m and forces in N.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal, NamedTuple, final

from cosim.config.toml.quantities import (
    UNTURNED,
    Angle,
    Direction,
    Increasing,
    Length,
    Name,
    NonNegative,
    NonNegativeMass,
    Number,
    Position,
    Positive,
    PositiveAcceleration,
    PositiveForce,
    PositiveLength,
    PositiveMass,
    PositiveSpeed,
    PositiveTorque,
    Quaternion,
    Text,
    Vector3,
)
from cosim.config.toml.tables import Table


class BaseJoint(NamedTuple):
    """A rail or turntable as a joint, in [m], [N] or in [rad], [N m].

    Args:
        kind: "prismatic" or "revolute".
        bounds: lowest and highest position.
        speed: largest.
        acceleration: largest; None: not known.
        effort: largest force or torque.
        center_m: world, of a point on the axis; None: the origin of the arm's root link.
    """

    kind: str
    bounds: tuple[float, float]
    speed: float
    acceleration: float | None
    effort: float
    center_m: Vector3 | None


@final
@dataclass(frozen=True)
class RailTable(Table):
    """Carries the arm along a line; stands on the rail before it.

    Args:
        axis: along which it slides, world.
        range_m: lowest and highest position; at 0 the arm is at the pose of its base.
        speed_m_s: largest.
        acceleration_m_s2: above which a motion is reported; omitted: none.
        force_N: largest; the stiffness of its servo follows from it, as of any joint.
        mass_kg: of the carriage.
        name: of the joint.
    """

    axis: Direction
    range_m: Annotated[tuple[Length, Length], Increasing]
    speed_m_s: PositiveSpeed
    acceleration_m_s2: PositiveAcceleration | None = None
    force_N: PositiveForce = 5e3
    mass_kg: PositiveMass = 50.0
    name: Name = "rail"

    @property
    def joint(self) -> BaseJoint:
        """What it is as a joint."""
        return BaseJoint(
            "prismatic", self.range_m, self.speed_m_s, self.acceleration_m_s2, self.force_N, None
        )


@final
@dataclass(frozen=True)
class TurntableTable(Table):
    """Turns the arm about an axis; stands on the rails.

    Args:
        range_rad: smallest and largest angle; at 0 the arm is at the pose of its base.
        speed_rad_s: largest.
        axis: world.
        center_m: a point on the axis, world, with rails at 0; omitted: the origin of the arm's root link.
        acceleration_rad_s2: above which a motion is reported; omitted: none.
        torque_Nm: largest; the stiffness of its servo follows from it, as of any joint.
        mass_kg: of the table, a disc of 0.2 m about its axis.
        name: of the joint.
    """

    range_rad: Annotated[tuple[Angle, Angle], Increasing]
    speed_rad_s: PositiveSpeed
    axis: Direction = (0.0, 0.0, 1.0)
    center_m: Position | None = None
    acceleration_rad_s2: Positive | None = None
    torque_Nm: PositiveTorque = 2e3
    mass_kg: PositiveMass = 50.0
    name: Name = "turntable"

    @property
    def joint(self) -> BaseJoint:
        """What it is as a joint."""
        return BaseJoint(
            "revolute", self.range_rad, self.speed_rad_s, self.acceleration_rad_s2, self.torque_Nm,
            self.center_m,
        )  # fmt: skip


@final
@dataclass(frozen=True)
class BaseTable(Table):
    """Pose of the arm's root link, and the rails and turntables that move it.

    Args:
        position_m: of its origin, world.
        quaternion: (w, x, y, z), world from root link; normalised on use.
        rails: `[[arm_base.rail]]` in the file (of an arm `[[base.rail]]`), each on the one before; several
            make a gantry.
        turntables: `[[arm_base.turntable]]` in the file, each on the one before, the first on the last rail.
    """

    position_m: Position = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UNTURNED
    rails: tuple[RailTable, ...] = field(default=(), metadata={"alias": "rail"})
    turntables: tuple[TurntableTable, ...] = field(default=(), metadata={"alias": "turntable"})


@final
@dataclass(frozen=True)
class AdapterTable(Table):
    """A rigid piece between the arm's flange and the soft robot: a cylinder from one to the other.

    Args:
        position_m: of the mounting face of soft robots, flange frame.
        quaternion: (w, x, y, z), flange from mounting face; normalised on use.
        mass_kg: of the cylinder.
        radius_m: of the cylinder.
    """

    position_m: Position
    quaternion: Quaternion = UNTURNED
    mass_kg: NonNegativeMass = 0.0
    radius_m: PositiveLength = 0.03


@final
@dataclass(frozen=True)
class LimitsTable(Table):
    """Limits of the joints, in place of those in the arm's file.

    Args:
        lower: smallest angles; continuous joints get them too, with `upper`.
        upper: largest angles.
        velocity: largest speeds.
        acceleration: above which a motion is reported.
        effort: largest torques.
        assumed: which of these, or of those in the arm's file, no data sheet states; every run reports it.
    """

    lower: tuple[Number, ...] | None = None
    upper: tuple[Number, ...] | None = None
    velocity: tuple[Positive, ...] | None = None
    acceleration: tuple[Positive, ...] | None = None
    effort: tuple[Positive, ...] | None = None
    assumed: tuple[Literal["lower", "upper", "velocity", "acceleration", "effort"], ...] = ()


@final
@dataclass(frozen=True)
class ServosTable(Table):
    """Servos of the joints: torque = stiffness * angle error + damping * speed error.

    Args:
        stiffness: N m/rad; omitted: from the torque limits.
        damping: N m s/rad; omitted: a fifth of the stiffness.
        armature: rotor inertia seen at the joint, kg m^2; omitted: the file's, or 0.1.
    """

    stiffness: tuple[Positive, ...] | None = None
    damping: tuple[NonNegative, ...] | None = None
    armature: tuple[NonNegative, ...] | None = None


@final
@dataclass(frozen=True)
class ArmTable(Table):
    """A rigid arm.

    Args:
        file: URDF (.urdf) or MJCF (.xml) in the folder of this file, or package://NAME/..., or
            menagerie:MODEL.
        title: one line that describes the arm.
        flange: link, or site of an MJCF, whose frame is the flange: z out of its face. Omitted:
            attachment_site, tool0, flange, or the last link before the chain branches or ends.
        home: joint angles far from singularities, from which inverse kinematics starts; omitted: the file's,
            or cosim searches for one.
        package_paths: folders that may hold the NAME of package://NAME/..., in addition to the folders above
            the file and the robots of the package example-robot-data.
        drawn_as: menagerie:MODEL, the same arm with the same zero of its joints: if it is on this machine,
            its meshes are drawn in recordings and by cameras. Motion and forces do not depend on it.
    """

    file: Text
    title: Text | None = None
    flange: Text | None = None
    home: tuple[Number, ...] | None = None
    package_paths: tuple[Text, ...] = ()
    drawn_as: Text | None = None
    base: BaseTable = BaseTable()
    adapter: AdapterTable | None = None
    limits: LimitsTable = LimitsTable()
    servos: ServosTable = ServosTable()
