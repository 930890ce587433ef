"""What a rigid scene is made of: an arm on its base, its servos, and objects around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Array, Pose
from cosim.base.triangle_mesh import TriangleMesh
from cosim.errors import InputError
from cosim.rigid.build.cell import Cell
from cosim.rigid.build.geometry import Geometry
from cosim.rigid.build.joint import Joint
from cosim.rigid.build.wire import Wire

FLANGE_SITE, FORCE_SENSOR, TORQUE_SENSOR = "flange", "flange_force", "flange_torque"
VISUAL_GROUP = 1  # MuJoCo's URDF reader puts what is drawn into this geom group


@dataclass(frozen=True)
class SceneObject:
    """A rigid body of one shape, or of several parts.

    Args:
        name: unique in the scene.
        shape: one of `SIZES`, about the body's frame; None for a body that is made of its parts.
        size_m: full dimensions [m], in the order that `SIZES` says.
        position_m: (3,) [m], of the body's frame, world; the centre of a shape that is no mesh.
        quaternion: (w, x, y, z), world from object.
        mass_kg: 0 for an object that stands still; parts share it by volume times relative density.
        rgba: colour, components 0 to 1.
        friction: sliding friction coefficient.
        inertia: (3,) [kg m^2], about the centre of mass, body axes; None: that of its solids.
        center_of_mass_m: (3,), body frame, where `inertia` is given.
        spin_friction_m: torsional and rolling friction, torque by normal force; None: MuJoCo knows none.
        mesh: of shape "mesh", see `Geometry`.
        convex: of shape "mesh", see `Geometry`.
        parts: further solids on the same body; they may overlap.
        joint: that it hangs on; None for a body that is free, or stands still.

    Raises:
        InputError: unknown shape, wrong number of dimensions, or a value outside its bounds.
    """

    name: str
    shape: str | None = None
    size_m: tuple[float, ...] = ()
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    mass_kg: float = 0.0
    rgba: tuple[float, float, float, float] = (0.75, 0.55, 0.35, 1.0)
    friction: float = 0.8
    mesh: TriangleMesh | None = None
    convex: bool = True
    parts: tuple[Geometry, ...] = ()
    joint: Joint | None = None
    inertia: tuple[float, float, float] | None = None
    center_of_mass_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin_friction_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        where = f"object {self.name!r}"
        try:
            solids = self.geometries
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        if not solids:
            raise InputError(f"{where}: has neither a shape nor parts")
        if not (np.isfinite(self.mass_kg) and self.mass_kg >= 0.0):
            raise InputError(f"{where}: mass_kg is {self.mass_kg}; it must be finite and not negative")
        if self.mass_kg > 0.0 and any(solid.shape == "plane" for solid in solids):
            raise InputError(f"{where}: a plane cannot move, so its mass_kg must be 0")
        if self.joint is not None and self.mass_kg == 0.0:
            raise InputError(f"{where}: what hangs on a joint needs a mass_kg above 0")
        if not (np.all(np.isfinite(self.quaternion)) and np.linalg.norm(self.quaternion) > 1e-6):
            raise InputError(f"{where}: quaternion is {self.quaternion}; it must not be zero")
        if not np.all(np.isfinite(self.position_m)):
            raise InputError(f"{where}: position_m is {self.position_m}; it must be finite")

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
    def of(cls, arm: ArmFile, effort: Array) -> ServoGains:
        """Return the gains of an arm's file, or such that grow with the joint's torque limit.

        500 max(1, effort / 37.5 N m) and a fifth of it: on the UR5e 2000/400 and 500/100, the values
        in common use for this arm in MuJoCo. A prismatic joint gives its whole force at 20 mm, 1 kN at least.

        Args:
            arm: whose joints.
            effort: (joints,) [N m], of prismatic joints [N]; 0 where there is no limit.
        """
        effort = np.asarray(effort, dtype=np.float64)
        stiffness = 500.0 * np.maximum(1.0, effort / 37.5)
        stiffness = np.where(arm.prismatic, 50.0 * np.maximum(1e3, effort), stiffness)
        if arm.servo_stiffness is not None:
            stiffness = arm.servo_stiffness
        return cls(stiffness, 0.2 * stiffness if arm.servo_damping is None else arm.servo_damping)


@dataclass(frozen=True)
class SceneDescription:
    """Everything that a rigid scene is built from.

    Args:
        arm: fixed to the world.
        tick_s: length of a step [s].
        gravity: (3,) [m/s^2], world.
        world_from_base: pose of the arm's root link; that of the arm's file unless given.
        objects: bodies around the arm.
        wires: around the arm.
        mounted: bodies fixed to the flange, posed in its frame.
        floor_height_m: height of a floor plane [m], or None for no floor.
        cell: what else stands around the arm; a plane of it is the floor.
        armature: rotor inertia seen at each joint [kg m^2]; those of the arm's file unless given.
        gains: of the servos; those of the arm's file, or from its torque limits, unless given.

    Raises:
        InputError: a value outside its bounds, two things of one name, or a parent that is not there.
    """

    arm: ArmFile
    tick_s: float = 0.002
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    world_from_base: Pose | None = None
    objects: tuple[SceneObject, ...] = ()
    wires: tuple[Wire, ...] = ()
    mounted: tuple[SceneObject, ...] = ()
    floor_height_m: float | None = 0.0
    cell: Cell | None = None
    armature: float | None = None
    gains: ServoGains | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tick_s) and self.tick_s > 0.0):
            raise InputError(f"tick_s is {self.tick_s}; it must be above 0")
        if self.armature is not None and not (np.isfinite(self.armature) and self.armature >= 0.0):
            raise InputError(f"armature is {self.armature} kg m^2; it must be finite and not negative")
        names = [item.name for item in self.objects] + [wire.name for wire in self.wires]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"two objects are called {', '.join(map(repr, twice))}; names must be unique")
        held = [name for wire in self.wires for name in (wire.first, wire.last)]
        for name in held:
            if name is not None and name not in {item.name for item in self.objects}:
                raise InputError(f"a wire is held by {name!r}; there is no such object")
        self.objects_by_parent()

    def objects_by_parent(self) -> tuple[SceneObject, ...]:
        """Return the objects in an order in which each comes after the one that it hangs on.

        Raises:
            InputError: an object hangs on itself, or on one that is not there.
        """
        ordered: list[SceneObject] = []
        waiting = list(self.objects)
        while waiting:
            there = {None, *(item.name for item in ordered)}
            ready = [item for item in waiting if (item.joint and item.joint.parent) in there]
            if not ready:
                names = ", ".join(repr(item.name) for item in waiting)
                raise InputError(f"{names}: hang on themselves, or on an object that is not there")
            ordered += ready
            there |= {item.name for item in ready}
            waiting = [item for item in waiting if item.name not in there]
        return tuple(ordered)
