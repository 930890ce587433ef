"""Schema of the file of an arm, `arm.toml`: where its URDF or MJCF is, and what that does not say.

Lists have an entry for each joint from the base to the flange: angles in rad and torques in N m; of prismatic
joints lengths in m and forces in N.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.config.toml.constraints import NonNegative, Positive, Quaternion, Text, Vector3

UNTURNED: Quaternion = (1.0, 0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class BaseTable:
    """Where the root link of the arm stands.

    Args:
        position_m: of its origin, world.
        quaternion: (w, x, y, z), world from root link; normalised on use.
    """

    position_m: Vector3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UNTURNED


@final
@dataclass(frozen=True)
class AdapterTable:
    """A rigid piece between the arm's flange and the soft robot: a cylinder from one to the other.

    Args:
        position_m: where soft robots are mounted, flange frame.
        quaternion: (w, x, y, z), flange from mounting face; normalised on use.
        mass_kg: of the cylinder.
        radius_m: of the cylinder.
    """

    position_m: Vector3
    quaternion: Quaternion = UNTURNED
    mass_kg: NonNegative = 0.0
    radius_m: Positive = 0.03


@final
@dataclass(frozen=True)
class LimitsTable:
    """Bounds of the joints in place of those in the arm's file.

    Args:
        lower: smallest angles; continuous joints get them too, with `upper`.
        upper: largest angles.
        velocity: largest speeds.
        acceleration: beyond which a motion is reported.
        effort: largest torques.
    """

    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None
    velocity: tuple[Positive, ...] | None = None
    acceleration: tuple[Positive, ...] | None = None
    effort: tuple[Positive, ...] | None = None


@final
@dataclass(frozen=True)
class ServosTable:
    """Servos of the joints: torque = stiffness times error of the angle + damping times that of the speed.

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
class ArmTable:
    """A rigid arm.

    Args:
        file: URDF (.urdf) or MJCF (.xml), beside this file, or package://NAME/..., or menagerie:MODEL.
        title: what it is.
        flange: link, or site of an MJCF, whose frame is the flange: z out of its face. Omitted:
            attachment_site, tool0, flange, or the last link before the chain branches or ends.
        home: joint angles far from singularities, from which the plan starts to look; omitted: the file's,
            or one is found.
        package_paths: folders in which the NAME of package://NAME/... is looked for, beside the folders above
            the file and the robots of the package example-robot-data.
    """

    file: Text
    title: Text | None = None
    flange: Text | None = None
    home: tuple[float, ...] | None = None
    package_paths: tuple[Text, ...] = ()
    base: BaseTable = BaseTable()
    adapter: AdapterTable | None = None
    limits: LimitsTable = LimitsTable()
    servos: ServosTable = ServosTable()
