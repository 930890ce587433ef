"""Schema of the rigid objects and wires of a scenario, of sensors and cameras, and where mesh files are.

An object has one `shape`, or `[[object.part]]`s, or both: all of them make one rigid body. A mesh is a closed
surface from an STL or OBJ file in m, looked up beside the scenario file, then in `robots/objects/`. Its
shells (pieces that share no vertex) are touched as their convex hulls, which is exact where each shell is
convex: cut a concave solid into convex shells in one file. With `convex = false` the film touches the surface
itself through a table of distances (cells of 1/40 of its longest edge, trilinear: blunt by a fraction of a
cell at edges), while rigid bodies meet the hull of the whole.

With a `hinge` or a `slide` an object hangs on the world or on another object, its `parent`, and turns or
shifts from where the scenario puts it; it does not collide with its parent. Poses, axes and anchors are
those of the world at the start, also with a parent.

A wire is a row of capsules joined by ball joints that resist bending. Its first point may be held by an
object, such as a spool on a hinge, and its last one tied to another. It touches robots, soft robots, the
floor and objects, but not itself. Soft robots feel it from 2 mm of radius on: what is thinner than twice the
depth of contact slips through the film.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias, final

import numpy as np
from annotated_types import Interval, Len

from cosim.base.frames import Array
from cosim.base.resources import is_file, list_object_meshes, object_mesh_path, quoted_name
from cosim.base.solid import read_mesh
from cosim.config.toml.quantities import (
    Angle,
    Colour,
    Direction,
    Length,
    Name,
    NonNegative,
    NonNegativeAngularDamping,
    NonNegativeBendingDamping,
    NonNegativeBendingStiffness,
    NonNegativeDamping,
    NonNegativeForce,
    NonNegativeLength,
    NonNegativeStiffness,
    NonNegativeTime,
    NonNegativeTorque,
    Number,
    OneOrEach,
    Position,
    Positive,
    PositiveFrequency,
    PositiveLength,
    PositiveMass,
    Quaternion,
    Text,
    Vector3,
)
from cosim.config.toml.rules import Fault, Told, rule
from cosim.config.toml.tables import Table
from cosim.errors import MeshError

Shape: TypeAlias = Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh"]
Size: TypeAlias = Annotated[tuple[PositiveLength, ...], Len(max_length=3)]
STANDING_STILL: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
GREY: tuple[float, float, float, float] = (0.55, 0.57, 0.60, 1.0)
SMALLEST_MESH_m: Final = 1e-6
LARGEST_MESH_m: Final = 100.0
LEAST_INERTIA_kg_m2: Final = 1e-15  # that MuJoCo takes
_SIZE_ENTRIES: Final = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3, "mesh": 0}


class _Shaped(Table):
    """Rules of what has a shape."""

    shape: Shape | None
    size_m: Size
    file: str | None
    scale: Number

    @rule
    def _has_its_size(self) -> Told:
        if self.shape is None:
            if self.size_m:
                yield "size_m", "goes with a shape; none is given"
        elif len(self.size_m) != _SIZE_ENTRIES[self.shape]:
            has, needed = len(self.size_m), _SIZE_ENTRIES[self.shape]
            yield "size_m", f"has {has} entries; a {self.shape} has {needed}"

    @rule
    def _has_its_mesh(self) -> Told:
        if self.shape != "mesh":
            if self.file is not None:
                yield "file", "goes with shape = 'mesh'"
        elif self.file is None:
            yield "file", "is missing; a mesh needs an .stl or .obj file"
        elif not Path(self.file).is_absolute() and self.file not in list_object_meshes():
            there = ", ".join(list_object_meshes()) or "none"
            yield (
                "file",
                f"{quoted_name(self.file)} is neither beside the scenario nor one of cosim's: {there}",
            )
        else:
            try:
                size_m = self.scale * float(np.abs(read_mesh(mesh_path(self.file)).vertices).max())
            except MeshError as error:
                yield "file", str(error)
                return
            if not SMALLEST_MESH_m <= size_m <= LARGEST_MESH_m:
                yield Fault(
                    "scale",
                    f"{self.scale:g} makes the mesh reach {size_m:g} m from its origin; must be within "
                    f"{SMALLEST_MESH_m:g} and {LARGEST_MESH_m:g} m",
                )


def _range_told(key: str, limits: tuple[float, float] | None) -> Told:
    if limits is not None and not (limits[0] <= 0.0 <= limits[1] and limits[0] < limits[1]):
        yield key, f"{list(limits)} must increase and hold 0, where the object starts"


@final
@dataclass(frozen=True)
class SolidTable(_Shaped):
    """A further solid on an object's body; parts may overlap.

    Args:
        shape: as of an object.
        size_m: as of an object.
        file: as of an object.
        scale: as of an object.
        convex: as of an object.
        position_m: of its centre, in the object's frame; of a mesh: of the origin of its file.
        quaternion: (w, x, y, z), object from part; normalised on use.
        relative_density: the object's mass is shared by volume times this.
        rgba: omitted = that of the object.
        friction: omitted = that of the object.
    """

    shape: Shape
    size_m: Size = ()
    file: str | None = None
    scale: Positive = 1.0
    convex: bool = True
    position_m: Position = (0.0, 0.0, 0.0)
    quaternion: Quaternion = STANDING_STILL
    relative_density: Positive = 1.0
    rgba: Colour | None = None
    friction: NonNegative | None = None


@final
@dataclass(frozen=True)
class HingeJointTable(Table):
    """Turns an object about an axis; the moment is -stiffness q - damping dq/dt - dry friction.

    Args:
        damping_Nms: torque per angular velocity, against it.
        stiffness_Nm: torque per angle, back to where it starts.
        axis: world.
        anchor_m: a point on the axis, world.
        parent: name of an object; omitted: the world.
        range_rad: smallest and largest angle, 0 at the start; omitted: free.
        friction_Nm: dry, such as the brake of a spool.
    """

    axis: Direction
    anchor_m: Position
    parent: str | None = None
    range_rad: tuple[Angle, Angle] | None = None
    damping_Nms: NonNegativeAngularDamping = 0.0
    stiffness_Nm: NonNegativeTorque = 0.0
    friction_Nm: NonNegativeTorque = 0.0

    @rule
    def _ranges(self) -> Told:
        return _range_told("range_rad", self.range_rad)


@final
@dataclass(frozen=True)
class SlideJointTable(Table):
    """Shifts an object along an axis; the force is -stiffness q - damping dq/dt - dry friction.

    Args:
        damping_Ns_m: force per velocity, against it.
        stiffness_N_m: force per displacement, back to where it starts.
        axis: world.
        parent: name of an object; omitted: the world.
        range_m: smallest and largest shift, 0 at the start; omitted: free.
        friction_N: dry.
    """

    axis: Direction
    parent: str | None = None
    range_m: tuple[Length, Length] | None = None
    damping_Ns_m: NonNegativeDamping = 0.0
    stiffness_N_m: NonNegativeStiffness = 0.0
    friction_N: NonNegativeForce = 0.0

    @rule
    def _ranges(self) -> Told:
        return _range_told("range_m", self.range_m)


@final
@dataclass(frozen=True)
class ObjectTable(_Shaped):
    """A rigid body of the scene.

    Args:
        name: of the object, in the recording and in results.
        rgba: colour: red, green, blue, opacity.
        position_m: of its frame, world: the centre of its shape; of a mesh: the origin of its file.
        shape: about its frame; omitted for a body that is made of its parts.
        size_m: box: three edge lengths; sphere: radius; cylinder, capsule: radius and length (of a capsule,
            between the centres of its caps); ellipsoid: three half axes; mesh: none.
        file: of a mesh, ends in .stl or .obj; relative to the scenario file, or a name of robots/objects/.
        scale: of a mesh, multiplies the numbers of its file, such as 0.001 for a file in mm.
        convex: of a mesh, see the module's text.
        quaternion: (w, x, y, z), world from object; normalised on use.
        mass_kg: of all its solids together; omitted = fixed to the world.
        inertia_kg_m2: about the centre of mass, along the object's axes; omitted = that of its solids. Needs
            mass_kg.
        center_of_mass_m: in the object's frame, together with inertia_kg_m2.
        friction: coefficient of sliding; contact.pair_friction says what two of them make.
        torsional_friction_m: of turning on the spot, torque by normal force; of the two that touch the larger
            counts. Film has none.
        rolling_friction_m: of rolling, the same.
        hinge: that it hangs on; needs mass_kg.
        slide: the same; an object has one of them, or none.
        parts: `[[object.part]]` in the file.
    """

    name: Name
    position_m: Position
    shape: Shape | None = None
    size_m: Size = ()
    file: str | None = None
    scale: Positive = 1.0
    convex: bool = True
    quaternion: Quaternion = STANDING_STILL
    mass_kg: PositiveMass | None = None
    inertia_kg_m2: tuple[Positive, Positive, Positive] | None = None
    center_of_mass_m: Position | None = None
    rgba: Colour = GREY
    friction: NonNegative = 0.8
    torsional_friction_m: NonNegativeLength | None = None
    rolling_friction_m: NonNegativeLength | None = None
    hinge: HingeJointTable | None = None
    slide: SlideJointTable | None = None
    parts: tuple[SolidTable, ...] = field(default=(), metadata={"alias": "part"})

    @rule
    def _is_something(self) -> Told:
        if self.shape is None and not self.parts:
            yield "", "give a shape, or [[object.part]] tables; neither is given"

    @rule
    def _has_inertia(self) -> Told:
        inertia = self.inertia_kg_m2
        if inertia is None:
            if self.center_of_mass_m is not None:
                yield "center_of_mass_m", "goes with inertia_kg_m2; none is given"
        elif self.mass_kg is None:
            yield "mass_kg", "is missing; what has inertia_kg_m2 needs mass"
        elif 2.0 * max(inertia) > sum(inertia):
            yield Fault(
                "inertia_kg_m2",
                f"{list(inertia)} is of no body: the largest must not be above the sum of the other two",
            )

    @rule
    def _hangs_on_one_joint(self) -> Told:
        if self.hinge is not None and self.slide is not None:
            yield "slide", "cannot be combined with hinge; an object has one joint"
        elif (self.hinge or self.slide) and self.mass_kg is None:
            key = "slide" if self.hinge is None else "hinge"
            yield "mass_kg", f"is missing; what hangs on a {key} needs mass"


@final
@dataclass(frozen=True)
class SceneTable(Table):
    """What stands around the arm besides objects.

    Args:
        mjcf: MuJoCo's own format, ends in .xml; relative to the scenario file. What slides in it, or turns
            about a hinge, is driven by the phases, and moves as they say whatever pushes it. A plane of it
            takes the floor's place, its options are left out.
    """

    mjcf: Text

    @rule
    def _has_its_file(self) -> Told:
        if Path(self.mjcf).suffix.lower() != ".xml" or not is_file(Path(self.mjcf)):
            yield "mjcf", f"{quoted_name(self.mjcf)} is no file that ends in .xml"


COPPER: tuple[float, float, float, float] = (0.72, 0.45, 0.20, 1.0)


@final
@dataclass(frozen=True)
class WireTable(Table):
    """A thin flexible body that cannot stretch; its bodies are called NAME/1, NAME/2, ...

    Args:
        name: of the wire, in the recording and in results.
        rgba: colour: red, green, blue, opacity.
        points_m: polyline along which it lies at first, world.
        radius_m: of its capsules.
        segments: their number, evenly spaced along the polyline; each must be longer than thick.
        mass_kg: of all of it.
        bending_stiffness_Nm2: flexural rigidity EI, the same against twist.
        bending_damping_Nm2s: the same for rates.
        straight: without load it is straight; otherwise it keeps the shape that it has at first.
        first: object that holds its first point, elastically clamped; omitted: the end is free.
        last: object to which its last point is tied, free to turn; omitted: the end is free.
        friction: coefficient of sliding.
    """

    name: Name
    points_m: Annotated[tuple[Position, ...], Len(min_length=2)]
    radius_m: PositiveLength
    mass_kg: PositiveMass
    segments: Annotated[int, Interval(ge=1, le=500)] = 20
    bending_stiffness_Nm2: NonNegativeBendingStiffness = 0.0
    bending_damping_Nm2s: NonNegativeBendingDamping = 0.0
    straight: bool = False
    first: str | None = None
    last: str | None = None
    rgba: Colour = COPPER
    friction: NonNegative = 0.5

    @property
    def knots(self) -> Array:
        """Ends of the segments (segments + 1, 3) [m], world, evenly spaced along the polyline."""
        points = np.array(self.points_m, dtype=np.float64)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        wanted = np.linspace(0.0, along[-1], self.segments + 1)
        return np.stack([np.interp(wanted, along, points[:, r]) for r in range(3)], axis=1)

    @property
    def lengths_m(self) -> Array:
        """(segments,) [m]."""
        return np.asarray(np.linalg.norm(np.diff(self.knots, axis=0), axis=1))

    @rule
    def _bends(self) -> Told:
        lengths, thick = self.lengths_m, 2.0 * self.radius_m
        if not lengths.min() > thick:
            yield Fault(
                "segments",
                f"{self.segments} segments, the shortest {lengths.min():.3g} m, are not longer than thick "
                f"({thick:g} m); take fewer than {min(self.segments, int(lengths.sum() / thick))}",
            )

    @rule
    def _is_heavy_enough(self) -> Told:
        least = LEAST_INERTIA_kg_m2 / (0.4 * self.radius_m**2) * self.segments
        if self.mass_kg <= least:
            yield Fault(
                "mass_kg",
                f"{self.mass_kg:g} is too light for {self.segments} segments that thin, which would spin "
                f"without inertia; must be above {least:.3g}",
            )


def mesh_path(file: str) -> Path:
    """Return where a mesh file is: an absolute path, or one of those that come with cosim."""
    return Path(file) if Path(file).is_absolute() else object_mesh_path(file)


SensorKind: TypeAlias = Literal[
    "pressure", "cable_length", "cable_tension", "flange_force", "flange_torque", "tip_position",
    "tip_direction", "bending_angle", "joint_position", "joint_torque",
]  # fmt: skip
JOINTS: Final = ("joint_position", "joint_torque")
"""Kinds that read the joints of an arm."""
_XYZ: Final = ("x", "y", "z")
_PARALLEL: Final = 1e-6


@final
@dataclass(frozen=True)
class SensorTable(Table):
    """A sensor: quantum * round((truth + bias + noise * n) / quantum), n normal, held and late.

    Args:
        name: of the sensor; controllers name it in `sensors`.
        kind: of the measured value, in Pa, m, N, N m or rad; forces, torques and directions along the world's
            axes.
        of: names of the chambers or cables that it measures; omitted: all. Other kinds have no names.
        noise: standard deviation of white noise, in the unit of the kind; one for all values, or one
            for each.
        bias: constant error, in that unit; likewise.
        delay_s: age of a reading; rounded to whole ticks.
        rate_Hz: samples per second, each held until the next; omitted: one a tick.
        quantum: step between readings, in that unit; 0: none.
        seed: of the noise; two sensors of one seed have different noise.
    """

    name: Name
    kind: SensorKind
    of: tuple[str, ...] = ()
    noise: OneOrEach[NonNegative] = 0.0
    bias: OneOrEach[Number] = 0.0
    delay_s: NonNegativeTime = 0.0
    rate_Hz: PositiveFrequency | None = None
    quantum: OneOrEach[NonNegative] = 0.0
    seed: Annotated[int, Interval(ge=0, le=2**31 - 1)] = 0

    def values(self, chambers: tuple[str, ...], cables: tuple[str, ...]) -> tuple[str, ...] | None:
        """Return the names of what it reads; None: of the arm's joints, which a scenario does not name.

        Args:
            chambers: names of the soft robot's.
            cables: the same.
        """
        if self.kind in JOINTS:
            return None
        if self.kind == "bending_angle":
            return ("",)
        return self.of or self.named(chambers, cables) or _XYZ

    def named(self, chambers: tuple[str, ...], cables: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of chambers or cables that `of` may choose from; none for other kinds."""
        if self.kind == "pressure":
            return chambers
        return cables if self.kind in ("cable_length", "cable_tension") else ()


@final
@dataclass(frozen=True)
class CameraTable(Table):
    """A camera that sees colours, depths, and what every pixel belongs to.

    Args:
        name: of the camera.
        on: what carries it, and in whose axes it is placed. "flange": the flange's frame; "tip": at the tip,
            z along the tip's direction; "palm": the frame of the soft robot's palm; "world".
        position_m: of it.
        direction: in which it looks.
        up: that is up in its pictures; omitted: z, or x where it looks along z.
        size: (2,) width and height in pixels.
        fov_rad: field of view from the lower to the upper edge.
        rate_Hz: pictures per second, at most one a tick; in statics there is one of every increment.
    """

    name: Name
    on: Literal["world", "flange", "tip", "palm"] = "world"
    position_m: Position = (0.0, 0.0, 0.0)
    direction: Direction = (0.0, 0.0, 1.0)
    up: Direction | None = None
    size: tuple[Annotated[int, Interval(ge=1, le=4096)], Annotated[int, Interval(ge=1, le=4096)]] = (320, 240)
    fov_rad: Annotated[float, Interval(ge=0.01, le=3.0)] = 0.8
    rate_Hz: PositiveFrequency = 10.0

    @property
    def upward(self) -> Vector3:
        """What is up in its pictures."""
        x, y, z = self.direction
        along_z = x * x + y * y <= _PARALLEL * z * z
        return self.up or ((1.0, 0.0, 0.0) if along_z else (0.0, 0.0, 1.0))

    @rule
    def _knows_what_is_up(self) -> Told:
        (a, b, c), (x, y, z) = self.direction, self.upward
        across = (b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2
        if across <= _PARALLEL * (a * a + b * b + c * c) * (x * x + y * y + z * z):
            yield "up", f"{[x, y, z]} is the direction in which it looks; give another one"
