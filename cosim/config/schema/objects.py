"""Tables of the rigid objects and wires of a scenario, and of its cell.

An object has one `shape`, or `[[object.part]]`s, or both: all of them make one rigid body. A mesh is a closed
surface from an STL or OBJ file in m, from the scenario's folder or from `robots/objects/`. The film and rigid
bodies touch the convex hull of each of its shells (pieces that share no vertex), which is exact where each
shell is convex: cut a concave solid into convex shells in one file. With `convex = false` the film touches
the surface itself through a table of distances (cells of 1/40 of its longest edge, trilinear: blunt by a
fraction of a cell at edges), while rigid bodies touch the hull of the whole. With a `hinge` or a `slide` an
object hangs on the world or on its `parent`, another object, and turns or shifts from its position in the
scenario; it does not collide with its parent. Poses, axes and anchors are those of the world at the start,
also with a parent. A wire is a row of capsules joined by ball joints that resist bending. An object may hold
its first point, such as a spool on a hinge, and another its last one. It touches robots, soft robots, the
floor and objects, but not itself. Soft robots feel it from a radius of 2 mm on: a wire thinner than twice the
depth of contact slips through the film.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias, final

import numpy as np
from annotated_types import Interval, Len

from cosim.base.frames import Array
from cosim.base.resources import is_file, list_object_meshes, object_mesh_path, quoted_name
from cosim.base.triangle_mesh import read_mesh
from cosim.config.toml.quantities import (
    UNTURNED,
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
    NonNegativeTorque,
    Number,
    Position,
    Positive,
    PositiveLength,
    PositiveMass,
    Quaternion,
    Text,
)
from cosim.config.toml.rules import Fault, Violations, rule
from cosim.config.toml.tables import Table
from cosim.errors import MeshError

Shape: TypeAlias = Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh"]
Size: TypeAlias = Annotated[tuple[PositiveLength, ...], Len(max_length=3)]
GREY: tuple[float, float, float, float] = (0.55, 0.57, 0.60, 1.0)
SMALLEST_MESH_m: Final = 1e-6
LARGEST_MESH_m: Final = 100.0
LEAST_INERTIA_kg_m2: Final = 1e-15  # that MuJoCo accepts
_SIZE_ENTRIES: Final = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3, "mesh": 0}
COPPER: tuple[float, float, float, float] = (0.72, 0.45, 0.20, 1.0)


class _Shaped(Table):
    """A table with a shape, and the rules for it."""

    shape: Shape | None
    size_m: Size
    file: str | None
    scale: Number

    @rule
    def _has_its_size(self) -> Violations:
        if self.shape is None:
            if self.size_m:
                yield "size_m", "goes with a shape; none is given"
        elif len(self.size_m) != _SIZE_ENTRIES[self.shape]:
            has, needed = len(self.size_m), _SIZE_ENTRIES[self.shape]
            yield "size_m", f"has {has} entries; a {self.shape} has {needed}"

    @rule
    def _has_its_mesh(self) -> Violations:
        if self.shape != "mesh":
            if self.file is not None:
                yield "file", "goes with shape = 'mesh'"
        elif self.file is None:
            yield "file", "is missing; a mesh needs an .stl or .obj file"
        elif not Path(self.file).is_absolute() and self.file not in list_object_meshes():
            known = ", ".join(list_object_meshes()) or "none"
            yield (
                "file",
                f"{quoted_name(self.file)} is neither in the scenario's folder nor one of cosim's: {known}",
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


def _range_violations(key: str, limits: tuple[float, float] | None) -> Violations:
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
        rgba: colour; omitted: that of the object.
        friction: coefficient of sliding; omitted: that of the object.
    """

    shape: Shape
    size_m: Size = ()
    file: str | None = None
    scale: Positive = 1.0
    convex: bool = True
    position_m: Position = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UNTURNED
    relative_density: Positive = 1.0
    rgba: Colour | None = None
    friction: NonNegative | None = None


@final
@dataclass(frozen=True)
class HingeJointTable(Table):
    """Turns an object about an axis; the moment is -stiffness q - damping dq/dt - dry friction.

    Args:
        damping_Nms: torque per angular velocity, opposed to it.
        stiffness_Nm: torque per angle, towards the angle at the start.
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
    def _ranges(self) -> Violations:
        return _range_violations("range_rad", self.range_rad)


@final
@dataclass(frozen=True)
class SlideJointTable(Table):
    """Shifts an object along an axis; the force is -stiffness q - damping dq/dt - dry friction.

    Args:
        damping_Ns_m: force per velocity, opposed to it.
        stiffness_N_m: force per displacement, towards the position at the start.
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
    def _ranges(self) -> Violations:
        return _range_violations("range_m", self.range_m)


@final
@dataclass(frozen=True)
class ObjectTable(_Shaped):
    """A rigid body of the scene.

    Args:
        name: of the object, in the recording and in results.
        rgba: colour: red, green, blue, opacity.
        position_m: of its frame, world: the centre of its shape; of a mesh: the origin of its file.
        shape: centred on its frame; omitted for a body that consists of its parts alone.
        size_m: box: three edge lengths; sphere: radius; cylinder, capsule: radius and length (of a capsule,
            between the centres of its caps); ellipsoid: three half axes; mesh: none.
        file: of a mesh, ends in .stl or .obj; relative to the scenario file, or a name of robots/objects/.
        scale: of a mesh, multiplies the numbers of its file, such as 0.001 for a file in mm.
        convex: of a mesh: true: everything touches the convex hull of each of its shells; false: the film
            touches the surface itself.
        quaternion: (w, x, y, z), world from object; normalised on use.
        mass_kg: of all its solids together; omitted: fixed to the world.
        inertia_kg_m2: moments about the centre of mass, along the object's axes; omitted: those of its
            solids. Needs mass_kg.
        center_of_mass_m: in the object's frame, together with inertia_kg_m2.
        friction: coefficient of sliding; contact.pair_friction combines those of two touching bodies.
        torsional_friction_m: torque per normal force against turning on the spot; the larger value of two
            touching bodies holds. Film has none.
        rolling_friction_m: torque per normal force against rolling; likewise.
        hinge: that it hangs on; needs mass_kg.
        slide: that it hangs on; needs mass_kg. An object has a hinge, a slide, or neither.
        parts: `[[object.part]]` in the file.
    """

    name: Name
    position_m: Position
    shape: Shape | None = None
    size_m: Size = ()
    file: str | None = None
    scale: Positive = 1.0
    convex: bool = True
    quaternion: Quaternion = UNTURNED
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
    def _is_something(self) -> Violations:
        if self.shape is None and not self.parts:
            yield "", "give a shape, or [[object.part]] tables; neither is given"

    @rule
    def _has_inertia(self) -> Violations:
        inertia = self.inertia_kg_m2
        if inertia is None:
            if self.center_of_mass_m is not None:
                yield "center_of_mass_m", "goes with inertia_kg_m2; none is given"
        elif self.mass_kg is None:
            yield "mass_kg", "is missing; inertia_kg_m2 needs it"
        elif 2.0 * max(inertia) > sum(inertia):
            yield Fault(
                "inertia_kg_m2",
                f"{list(inertia)} is impossible: the largest must not be above the sum of the other two",
            )

    @rule
    def _hangs_on_one_joint(self) -> Violations:
        if self.hinge is not None and self.slide is not None:
            yield "slide", "cannot be combined with hinge; an object has one joint"
        elif (self.hinge or self.slide) and self.mass_kg is None:
            key = "slide" if self.hinge is None else "hinge"
            yield "mass_kg", f"is missing; an object on a {key} needs it"


@final
@dataclass(frozen=True)
class SceneTable(Table):
    """The cell: surroundings of the arm from an MJCF file, in addition to objects.

    Args:
        mjcf: file in MuJoCo's format, ends in .xml; relative to the scenario file. Phases prescribe the
            motion of its slides and hinges, whatever force acts on them. A plane in it replaces the floor;
            its options are ignored.
    """

    mjcf: Text

    @rule
    def _has_its_file(self) -> Violations:
        if Path(self.mjcf).suffix.lower() != ".xml" or not is_file(Path(self.mjcf)):
            yield "mjcf", f"{quoted_name(self.mjcf)} is no file that ends in .xml"


@final
@dataclass(frozen=True)
class WireTable(Table):
    """A thin flexible body that cannot stretch; its bodies are called NAME/1, NAME/2, ...

    Args:
        name: of the wire, in the recording and in results.
        rgba: colour: red, green, blue, opacity.
        points_m: polyline along which it lies at the start, world.
        radius_m: of its capsules.
        segments: number of capsules, evenly spaced along the polyline; each must be longer than thick.
        mass_kg: of the whole wire.
        bending_stiffness_Nm2: flexural rigidity EI; also the torsional rigidity.
        bending_damping_Nm2s: moment per rate of curvature and of twist.
        straight: true: the wire is straight without load; false: its shape at the start is that without load.
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
        """Lengths of the segments (segments,) [m]."""
        return np.asarray(np.linalg.norm(np.diff(self.knots, axis=0), axis=1))

    @rule
    def _bends(self) -> Violations:
        lengths, thick = self.lengths_m, 2.0 * self.radius_m
        if not lengths.min() > thick:
            yield Fault(
                "segments",
                f"{self.segments} segments, the shortest {lengths.min():.3g} m, are not longer than thick "
                f"({thick:g} m); take fewer than {min(self.segments, int(lengths.sum() / thick))}",
            )

    @rule
    def _is_heavy_enough(self) -> Violations:
        least = LEAST_INERTIA_kg_m2 / (0.4 * self.radius_m**2) * self.segments
        if self.mass_kg <= least:
            yield Fault(
                "mass_kg",
                f"{self.mass_kg:g} is too light: MuJoCo needs more inertia for {self.segments} segments that "
                f"thin; must be above {least:.3g}",
            )


def mesh_path(file: str) -> Path:
    """Return the path of a mesh file, given as an absolute path or as the name of one that cosim includes."""
    return Path(file) if Path(file).is_absolute() else object_mesh_path(file)
