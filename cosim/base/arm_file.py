"""Describes an arm for both engines: the URDF chain from its base to its flange, its home, and its servos."""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.errors import InputError

FIXED: Final = "fixed"
MOVING: Final = ("revolute", "continuous", "prismatic")
"""Types of URDF joints that move."""

ARMATURE: Final = 0.1
"""Rotor inertia seen at a joint [kg m^2], of arms whose files name none."""


@final
@dataclass(frozen=True)
class LinkShape:
    """A shape of a link that its URDF does not hold.

    Args:
        link: its name.
        kind: "box", "sphere", "capsule", "cylinder", "ellipsoid" or "mesh".
        size: (3,) half dimensions [m], as MuJoCo has them.
        pose: link from shape.
        rgba: (4,) colour, components 0 to 1.
        collides: whether it touches objects.
        drawn: whether it is seen.
        vertices: (n, 3) [m], of a mesh.
        triangles: (m, 3), of a mesh.
    """

    link: str
    kind: str
    size: Array
    pose: Pose
    rgba: Array
    collides: bool
    drawn: bool
    vertices: Array
    triangles: IntArray


@final
@dataclass(frozen=True)
class ArmFile:
    """An arm, as both engines read it.

    Quantities of joints are [rad], [N m], [kg m^2], of prismatic ones [m], [N], [kg].

    Args:
        name: as the user has asked for it.
        path: file that it was read from.
        urdf: URDF text of the chain from the root to the flange, mesh files as absolute paths.
        flange_frame: link whose frame is the flange: origin in the mounting face, z out of it.
        joint_names: the moving joints, base to flange.
        home: (joints,), a configuration far from singularities.
        acceleration_bound: (joints,) [rad/s^2], positive; a motion beyond it is reported. Missing joints have
            no bound.
        armature: (joints,) inertia of the rotors, seen at the joints; `ARMATURE` unless given.
        servo_stiffness: (joints,) [N m/rad]; None, or nan of a joint: from the torque limits.
        servo_damping: (joints,) [N m s/rad]; the same.
        world_from_base: pose of the root link.
        home_known: whether the user or the file has given the home.
        shapes: of links, besides those in the URDF.
        files: all files that it was read from.
        notes: assumptions and replacements of the reader, as parts of a sentence.
        drawn_as: model of the MuJoCo Menagerie whose meshes are drawn, if it is on this machine.
    """

    name: str
    path: Path
    urdf: str
    flange_frame: str
    joint_names: tuple[str, ...]
    home: Array
    acceleration_bound: Array = field(default_factory=lambda: np.zeros(0))
    armature: Array = field(default_factory=lambda: np.zeros(0))
    servo_stiffness: Array | None = None
    servo_damping: Array | None = None
    world_from_base: Pose = field(default_factory=Pose)
    home_known: bool = True
    shapes: tuple[LinkShape, ...] = ()
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    drawn_as: str | None = None

    def __post_init__(self) -> None:
        home = np.array(self.home, dtype=np.float64)
        if home.shape != (len(self.joint_names),):
            raise InputError(
                f"arm {self.name!r} has {len(self.joint_names)} joints {self.joint_names}, "
                f"but its home has {home.size} angles"
            )
        bound = np.full(len(home), np.inf)
        given = np.asarray(self.acceleration_bound, dtype=np.float64)[: len(bound)]
        if not (given > 0.0).all():
            raise InputError(f"arm {self.name!r}: bounds of joint acceleration {given} must be above 0")
        bound[: len(given)] = given
        armature = np.array(self.armature if len(self.armature) else np.full(len(home), ARMATURE))
        for name, values in (("home", home), ("acceleration_bound", bound), ("armature", armature)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    @cached_property
    def joint_kinds(self) -> tuple[str, ...]:
        """Type of each joint, one of `MOVING`."""
        joints = ElementTree.fromstring(self.urdf).findall("joint")
        kinds = {joint.get("name", ""): joint.get("type", "") for joint in joints}
        return tuple(kinds[name] for name in self.joint_names)

    @property
    def prismatic(self) -> Mask:
        """Which joints slide (joints,)."""
        return np.array([kind == "prismatic" for kind in self.joint_kinds])

    @property
    def continuous(self) -> Mask:
        """Which joints turn without limits (joints,)."""
        return np.array([kind == "continuous" for kind in self.joint_kinds])
