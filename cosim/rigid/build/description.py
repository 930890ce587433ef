"""Description of a rigid scene: an arm on its base, its servos, objects with their shapes and joints, wires,
the cell, and friction of pairs.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from cosim.base import arm_file, triangle_mesh
from cosim.base.frames import Array, Pose
from cosim.config.schema.objects import WireTable
from cosim.errors import InputError
from cosim.rigid.build.pair_friction import PairFriction

VISUAL_GROUP = 1  # MuJoCo's URDF reader puts what is drawn into this geom group


@dataclass(frozen=True)
class Geometry:
    """A solid of one shape on a body.

    Args:
        shape: as of `[[object]]`, or "plane"; axes of cylinder, capsule and the plane's normal are z.
        size_m: as of `[[object]]`; of a plane, its edges along x and y.
        position_m: (3,) [m], of its centre, body frame; of a mesh: of the origin of its vertices.
        quaternion: (w, x, y, z), body from geometry.
        rgba: colour, components 0 to 1.
        friction: sliding friction coefficient.
        relative_density: the body's mass is divided among its solids by this times their volume.
        mesh: of shape "mesh".
        convex: of shape "mesh": whether contact is with the convex hull of each shell; if not, soft robots
            touch the surface itself, by a table of distances, and rigid bodies the hull of the whole.
    """

    shape: str
    size_m: tuple[float, ...] = ()
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    rgba: tuple[float, float, float, float] = (0.75, 0.55, 0.35, 1.0)
    friction: float = 0.8
    relative_density: float = 1.0
    mesh: triangle_mesh.TriangleMesh | None = None
    convex: bool = True

    @property
    def volume_m3(self) -> float:
        """Enclosed volume [m^3]; 0 for a plane."""
        if self.mesh is not None:
            return self.mesh.volume_m3
        s = self.size_m
        match self.shape:
            case "box":
                return s[0] * s[1] * s[2]
            case "sphere":
                return 4.0 / 3.0 * np.pi * s[0] ** 3
            case "cylinder":
                return np.pi * s[0] ** 2 * s[1]
            case "capsule":
                return np.pi * s[0] ** 2 * (s[1] + 4.0 / 3.0 * s[0])
            case "ellipsoid":
                return 4.0 / 3.0 * np.pi * s[0] * s[1] * s[2]
            case _:
                return 0.0


@dataclass(frozen=True)
class Joint:
    """One degree of freedom q between an object and its parent; q = 0 at the start.

    Moment = -stiffness q - damping dq/dt - friction sign(dq/dt). MuJoCo integrates springs explicitly, which
    is unstable with long ticks. An inertia of stiffness h^2 / 4 on the joint, h the tick, turns this into the
    trapezoidal rule: stable at any tick, tan(w' h / 2) = w h / 2 for the circular frequency, no damping.

    Args:
        kind: "hinge" turns about the axis, "slide" shifts along it.
        axis: (3,) world, at the start.
        anchor_m: (3,) [m], world, a point on the axis of a hinge.
        parent: name of the object that it hangs on; None for the world.
        limits: smallest and largest q [rad] or [m]; None for free motion.
        damping: [N m s] or [N s/m].
        stiffness: [N m] or [N/m].
        friction: dry, [N m] or [N].
    """

    kind: Literal["hinge", "slide"]
    axis: tuple[float, float, float]
    anchor_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    parent: str | None = None
    limits: tuple[float, float] | None = None
    damping: float = 0.0
    stiffness: float = 0.0
    friction: float = 0.0


@final
@dataclass(frozen=True)
class CellJoint:
    """A driven joint of a cell.

    Args:
        name: of the joint, or of its body if it has none.
        slides: whether it is a slide; if not, it is a hinge.
        limits: smallest and largest position [m] or [rad]; infinite without limits.
    """

    name: str
    slides: bool
    limits: tuple[float, float]


@final
@dataclass(frozen=True)
class Cell:
    """A cell, the surroundings of an arm.

    Args:
        path: of its MJCF.
        spec: MuJoCo's specification; copied before use.
        touched: number of geoms that collide.
        has_plane: whether a plane of it collides, which then is the floor.
        joints: driven joints, in the order of the compiled model.
        ignored: options of the file that the scene overrides, with their values.
    """

    path: Path
    spec: Any
    touched: int
    has_plane: bool
    joints: tuple[CellJoint, ...]
    ignored: tuple[str, ...]

    @property
    def report(self) -> str:
        """Text for the report of a run."""
        floor = "its plane is the floor" if self.has_plane else "on the scene's floor"
        text = f"{self.path.name}, {self.touched} geoms that can be touched, {floor}"
        if self.joints:
            text = f"{text}; driven: {', '.join(joint.name for joint in self.joints)}"
        return f"{text}; options left out: {', '.join(self.ignored)}" if self.ignored else text


@dataclass(frozen=True)
class SceneObject:
    """A rigid body of one shape, or of several parts.

    Args:
        name: unique in the scene.
        shape: as of a `Geometry`, about the body's frame; None for a body that is made of its parts.
        size_m: as of `[[object]]`; of a plane, its edges along x and y.
        position_m: (3,) [m], of the body's frame, world; the centre of a shape that is no mesh.
        quaternion: (w, x, y, z), world from object.
        mass_kg: 0 for a fixed object; parts share it by volume times relative density.
        rgba: colour, components 0 to 1.
        friction: sliding friction coefficient.
        inertia: (3,) [kg m^2], about the centre of mass, body axes; None: that of its solids.
        center_of_mass_m: (3,), body frame, where `inertia` is given.
        spin_friction_m: torsional and rolling friction, torque over normal force; None: no such friction.
        contact_time_s: of a body on the flange: time constant of its contacts.
        mesh: of shape "mesh", see `Geometry`.
        convex: of shape "mesh", see `Geometry`.
        parts: further solids on the same body; they may overlap.
        joint: that it hangs on; None for a free or fixed body.
    """

    name: str
    shape: str | None = None
    size_m: tuple[float, ...] = ()
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    mass_kg: float = 0.0
    rgba: tuple[float, float, float, float] = (0.75, 0.55, 0.35, 1.0)
    friction: float = 0.8
    mesh: triangle_mesh.TriangleMesh | None = None
    convex: bool = True
    parts: tuple[Geometry, ...] = ()
    joint: Joint | None = None
    inertia: tuple[float, float, float] | None = None
    center_of_mass_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin_friction_m: tuple[float, float] | None = None
    contact_time_s: float = 0.004

    @property
    def geometries(self) -> tuple[Geometry, ...]:
        """All solids of the body, its own shape first."""
        if self.shape is None:
            return self.parts
        own = Geometry(
            self.shape,
            self.size_m,
            rgba=self.rgba,
            friction=self.friction,
            mesh=self.mesh,
            convex=self.convex,
        )
        return (own, *self.parts)


@dataclass(frozen=True)
class ServoGains:
    """Gains of the joint servos, torque = stiffness (q_ref - q) + damping (v_ref - v) + feedforward.

    Args:
        stiffness: (joints,) [N m/rad].
        damping: (joints,) [N m s/rad].
    """

    stiffness: Array
    damping: Array

    @classmethod
    def of(cls, arm: arm_file.ArmFile, effort: Array) -> "ServoGains":
        """Return the gains of an arm's file; where it gives none, gains that grow with the torque limit.

        These are 500 max(1, effort / 37.5 N m) and a fifth of it: on the UR5e 2000/400 and 500/100, values in
        common use for this arm in MuJoCo. A prismatic joint has its whole force, 1 kN at least, at 20 mm.

        Args:
            arm: with the joints.
            effort: (joints,) [N m], of prismatic joints [N]; 0: no limit.
        """
        effort = np.asarray(effort, dtype=np.float64)
        stiffness = 500.0 * np.maximum(1.0, effort / 37.5)
        stiffness = np.where(arm.prismatic, 50.0 * np.maximum(1e3, effort), stiffness)
        stiffness = _given(arm.servo_stiffness, stiffness)
        return cls(stiffness, _given(arm.servo_damping, 0.2 * stiffness))


def _given(values: Array | None, others: Array) -> Array:
    """Return the values of an arm's file (n,), with `others` (n,) where it gives none."""
    return others if values is None else np.where(np.isnan(values), others, values)


@dataclass(frozen=True)
class SceneDescription:
    """Everything that a rigid scene is built from.

    Args:
        arm: fixed to the world.
        tick_s: length of a tick [s].
        substeps: number of MuJoCo's steps per tick.
        gravity: (3,) [m/s^2], world.
        world_from_base: pose of the arm's root link; None: that of the arm's file.
        objects: bodies around the arm.
        wires: around the arm.
        mounted: bodies fixed to the flange, with poses in its frame.
        floor_height_m: height of a floor plane [m], or None for no floor.
        cell: further surroundings; a plane of it is the floor.
        armature: rotor inertia seen at each joint [kg m^2]; None: those of the arm's file.
        gains: of the servos; None: those of the arm's file, or from its torque limits.
        friction: of pairs of bodies, and of the film on them.
        prefix: of the names of the arm's bodies, joints and sensors among several arms, such as left/.
    """

    arm: arm_file.ArmFile
    tick_s: float = 0.002
    substeps: int = 1
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    world_from_base: Pose | None = None
    objects: tuple[SceneObject, ...] = ()
    wires: tuple[WireTable, ...] = ()
    mounted: tuple[SceneObject, ...] = ()
    floor_height_m: float | None = 0.0
    cell: Cell | None = None
    armature: float | None = None
    gains: ServoGains | None = None
    friction: PairFriction = PairFriction()
    prefix: str = ""

    @property
    def step_s(self) -> float:
        """Length of a step of MuJoCo [s]."""
        return self.tick_s / self.substeps

    def objects_by_parent(self) -> tuple[SceneObject, ...]:
        """Return the objects in an order in which each comes after its parent.

        Raises:
            InputError: an object hangs on itself, or on one that does not exist.
        """
        ordered: list[SceneObject] = []
        waiting = list(self.objects)
        while waiting:
            placed = {None, *(item.name for item in ordered)}
            ready = [item for item in waiting if (item.joint and item.joint.parent) in placed]
            if not ready:
                names = ", ".join(repr(item.name) for item in waiting)
                raise InputError(
                    f"{names}: hang on themselves, or on an object that does not exist; name one of the scene"
                )
            ordered += ready
            placed |= {item.name for item in ready}
            waiting = [item for item in waiting if item.name not in placed]
        return tuple(ordered)
