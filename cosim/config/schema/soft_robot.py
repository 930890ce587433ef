"""Schema of a soft robot's file (`robots/*.toml`): frozen, SI units in the names of the keys.

What draws the film of a soft robot, other than a stack of units: `[body]` of its file, of some kind.

Tables of elements that a soft robot has besides its film, folds, cables and stiffeners: `[[element]]`.

Each kind has its own table, a subclass of `ElementTable`, and is known once it is registered.

Tables of what a soft robot is made of besides its film: hinges, stiffeners, mass."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

from annotated_types import Interval, Len

from cosim.base.names import ONLY_CHAMBER
from cosim.base.resources import is_file, quoted_name
from cosim.config.schema.film import FIRST_RING, FilmTable, StackTable
from cosim.config.toml import keys
from cosim.config.toml.quantities import (
    Angle,
    Colour,
    Count,
    CountOrLast,
    Length,
    Name,
    NonNegative,
    NonNegativeDamping,
    NonNegativeDensity,
    NonNegativeForce,
    NonNegativeLength,
    NonNegativeMass,
    Position,
    Positive,
    PositiveLength,
    PositiveMass,
    PositivePressure,
    PositiveStiffness,
    PositiveTime,
    SchemaNumber,
    Text,
    UpToOne,
)
from cosim.config.toml.rules import Fault, Told, rule
from cosim.config.toml.tables import KindTable, Table


@dataclass(frozen=True, kw_only=True)
class BodySourceTable(KindTable):
    """What draws the film of a soft robot.

    Args:
        kind: of the source; each kind has its own further keys.
    """

    def set_names(self) -> tuple[str, ...]:
        """Return the names of the node sets, by which robots and scenarios hold, load and route cables."""
        raise NotImplementedError

    def chamber_names(self) -> tuple[str, ...]:
        """Return the names of the gas chambers that the film encloses."""
        return (ONLY_CHAMBER,)

    def has_frames(self) -> bool:
        """Whether it may name lines that stiffeners run along."""
        return False

    def mesh(self) -> Any:
        """Return the film (`cosim.soft.geometry.named_mesh.NamedMesh`), in the flange's frame.

        Its rings are the node sets; its lines are those that cables may lead through.

        Raises:
            InputError: there is no such film.
        """
        raise NotImplementedError


@final
@dataclass(frozen=True)
class NodeSetTable(Table):
    """Nodes of a mesh by a name, said in one of three ways.

    Args:
        name: of the set; base, tip, cables, supports and forces name it.
        axis: of the flange's frame, with `at_m`: all nodes in a plane across it, in order around it.
        at_m: where that plane is.
        points_m: the nodes nearest to these points, in this order, such as those that a cable runs through.
        group: the nodes of a named group of triangles of the file.
    """

    name: Name
    axis: Literal["x", "y", "z"] | None = None
    at_m: Length | None = None
    points_m: tuple[Position, ...] = ()
    group: Text | None = None

    @rule
    def _is_said_once(self) -> Told:
        ways = (self.axis is not None, self.at_m is not None, bool(self.points_m), self.group is not None)
        if ways not in ((True, True, False, False), (False, False, True, False), (False, False, False, True)):
            yield "", "give axis and at_m, or points_m, or group, and one of these"


@final
@dataclass(frozen=True, kw_only=True)
class MeshTable(BodySourceTable):
    """A film from a mesh file, its open ends closed by caps.

    Args:
        kind: of `[body]`.
        file: STL or OBJ, beside the file that names it; counter-clockwise seen from outside, in the flange's
            frame. The groups of an OBJ file (`g NAME`) are those that `[[group]]` gives their own film.
        scale: multiplies the numbers of the file, such as 0.001 for a file in mm.
        sets: `[[body.set]]` in the file.
        tip: the set around the free end.
    """

    kind: Literal["mesh"] = "mesh"
    file: Text
    scale: Positive = 1.0
    sets: Annotated[tuple[NodeSetTable, ...], Len(min_length=2)] = field(metadata={"alias": "set"})
    tip: Name = "tip"

    @rule
    def _has_its_file(self) -> Told:
        if not is_file(Path(self.file)):
            yield "file", f"no file {quoted_name(self.file)} beside the one that names it"

    @rule
    def _has_its_tip(self) -> Told:
        if self.tip not in self.set_names():
            yield "tip", keys.unknown_name_message("set", self.tip, self.set_names())

    def set_names(self) -> tuple[str, ...]:
        """Return the names of the node sets."""
        return tuple(entry.name for entry in self.sets)


BodySourceTable.kinds["mesh"] = MeshTable


@dataclass(frozen=True, kw_only=True)
class ElementTable(KindTable):
    """Further elements of a soft robot.

    Args:
        kind: of the elements; each kind has its own further keys.
    """

    def element(self, body: Any) -> Any:
        """Return the elements (`cosim.soft.elements.element.Element`) for a body (`SoftBody`) without them.

        Raises:
            InputError: the body has no such rings, or what else is asked for.
        """
        raise NotImplementedError


@final
@dataclass(frozen=True)
class HingeTable(Table):
    """Rotational springs of the folds.

    Args:
        rule: "uniform": every hinge has the same spring constant (scaled on a refined mesh, so that the mean
            energy of bending to a cylinder stays); "shell": each by the triangles beside it, so that the film
            bends like a shell.
        stiffness_factor: uniform: spring constant divided by E t^3 / 12 [N m/rad]; shell: flexural rigidity
            divided by E t^3 / (12 (1 - nu^2)).
        fold_barrier_rad: the moment grows steeply below this dihedral angle and above 2 pi minus it.
    """

    rule: Literal["uniform", "shell"] = "uniform"
    stiffness_factor: NonNegative = 1.0
    fold_barrier_rad: Annotated[float, Interval(ge=0.0, lt=3.141592653589793)] = 0.0


@final
@dataclass(frozen=True)
class StiffenerTable(Table):
    """Printed frames around the outer ring of every unit.

    Args:
        kind: "none"; "stiff": each outer ring keeps its drawn shape and moves almost as a rigid body; "beam":
            each outer ring is a ring of beams of rectangular section, pinned to the film at its nodes.
        stiffness_N_m: stiff: of the springs that keep the shape.
        width_m: beam: of the section, in the ring's plane.
        height_m: beam: of the section, along the stack.
        young_modulus_Pa: beam: of the material.
        poisson_ratio: beam: of the material.
        density_kg_m3: beam: of the material; its mass comes to that of the ring's nodes.
        strength_strain: beam: largest strain that the material bears; a phase that ends beyond it gives a
            warning; omitted: none is given.
        rest_on_one_another: beam: neighbouring frames come no nearer than they are high, with two films
            between them, as in a stowed pack; otherwise they pass through one another.
    """

    kind: Literal["none", "stiff", "beam"] = "none"
    stiffness_N_m: PositiveStiffness = 1e6
    width_m: PositiveLength | None = None
    height_m: PositiveLength | None = None
    young_modulus_Pa: PositivePressure | None = None
    poisson_ratio: Annotated[float, Interval(gt=-1.0, le=0.5)] = 0.35
    density_kg_m3: NonNegativeDensity = 0.0
    strength_strain: Positive | None = None
    rest_on_one_another: bool = False

    @rule
    def _is_a_beam(self) -> Told:
        for key in ("width_m", "height_m", "young_modulus_Pa"):
            given = getattr(self, key) is not None
            if given is not (self.kind == "beam"):
                has = "goes with" if given else "is missing; needed with"
                yield key, f"{has} kind = 'beam'; the kind is '{self.kind}'"
                return


@final
@dataclass(frozen=True)
class MassTable(Table):
    """Mass beyond that of the film.

    Args:
        node_mass_kg: at every node of the unrefined mesh.
        seam_mass_kg: at every node of its outer rings (a unit's frame), in addition.

    A refined mesh spreads the same totals evenly over its nodes; one refined at the holes, evenly over the
    area around each node of the drawn mesh.
    """

    node_mass_kg: NonNegativeMass = 0.0
    seam_mass_kg: NonNegativeMass = 0.0


UnitRange = tuple[Count, CountOrLast]
LEAST_NODE_MASS_kg: Final = 1e-12


@final
@dataclass(frozen=True)
class CableTable(Table):
    """A cable through the outer rings of a range of units, along a corner line or around, or another line.

    Exactly one of capstan_factor and friction_coefficient is given; a constant loss comes on top.

    Args:
        name: of the cable; tensions and lengths are given by it.
        corner: 0 to sides - 1, of the first of its units; counted about the flange's z axis.
        corners_per_unit: by how many corners the cable turns about that axis from unit to unit; not 0: a
            spiral, which twists the stack.
        units: first and last unit with an eyelet, counted from 1; "last" is the last of the stack, however
            many it has.
        capstan_factor: tension beyond an eyelet divided by the tension before it.
        friction_coefficient: mu in exp(-mu * wrap angle) at each eyelet.
        line: a set of nodes in order, base to tip, where no stack draws the film: without corner and units.
        stiffness_N_m: tension per stretch of the whole cable; matters where its length is commanded, and
            where it sticks at eyelets.
        damping_Ns_m: tension per rate of that stretch, of a cable that creeps (Kelvin-Voigt), in time.
        eyelet_loss_N: tension lost at each eyelet besides, whatever the tension.
        losses: "one_way": tension falls from the base on, whichever way the cable slides, as in the paper's
            model; "directed": against the way it slides, with separate stick and slip at each eyelet.
    """

    name: Name
    corner: Annotated[int, Interval(ge=0)] | None = None
    corners_per_unit: Annotated[int, Interval(ge=-2, le=2)] = 0
    units: UnitRange | None = None
    line: Name | None = None
    capstan_factor: UpToOne | None = None
    friction_coefficient: NonNegative | None = None
    stiffness_N_m: PositiveStiffness = 1e4
    damping_Ns_m: NonNegativeDamping = 0.0
    eyelet_loss_N: NonNegativeForce = 0.0
    losses: Literal["directed", "one_way"] = "one_way"

    @rule
    def _runs_along_a_stack(self, robot: SoftRobotTable) -> Told:
        if robot.stack is None:
            return
        if self.corner is None or self.units is None or self.line is not None:
            yield "", "runs along a stack of units: give corner and units, and no line"
            return
        units, sides = robot.stack.units, robot.stack.sides
        first, last = self.units[0], units if self.units[1] == "last" else self.units[1]
        if self.corner >= sides:
            yield "corner", f"{self.corner} does not exist; corners 0 to {sides - 1} do"
        if last > units:
            yield "units", f"unit {last} does not exist; units 1 to {units} do"
        elif first >= last:
            yield "units", f"[{first}, {last}] must run from a unit to a later one"

    @rule
    def _runs_along_a_line(self, robot: SoftRobotTable) -> Told:
        if robot.stack is not None or robot.body is None:
            return
        names = robot.body.set_names()
        if self.line is None or self.corner is not None or self.units is not None or self.corners_per_unit:
            yield "", "runs along no stack of units: give line, without corner, corners_per_unit and units"
        elif self.line not in names:
            yield "line", keys.unknown_name_message("set", self.line, names)

    @rule
    def _has_one_law_of_losses(self) -> Told:
        if (self.capstan_factor is None) == (self.friction_coefficient is None):
            given = "neither" if self.capstan_factor is None else "both"
            yield "", f"give capstan_factor or friction_coefficient; {given} is given"
        if self.eyelet_loss_N > 0.0 and self.losses == "one_way":
            yield "eyelet_loss_N", "opposes the way the cable slides; it needs losses = 'directed'"


ARM_CHAMBER: Final = "arm"
"""Name of the gas chamber of a robot that carries others."""


@final
@dataclass(frozen=True)
class CopiesTable(Table):
    """The robot several times on one flange, evenly spaced about its z axis, such as fingers on a palm.

    Ring names mean the first copy, towards the flange's +x; the rings of copy k are called copy_k/NAME, and
    copy_*/NAME means those of all. Cables come copy by copy; each copy has a gas chamber, copy_k.

    Args:
        count: of the copies.
        radius_m: of their origins from the flange's z axis.
        tilt_rad: outwards, of their z axes from the flange's.
        spin_rad: about their own z axes; at 0 their x axes point away from the flange's z axis.
        height_m: of their origins along the flange's z axis.
    """

    count: Annotated[int, Interval(ge=1, le=12)]
    radius_m: NonNegativeLength
    tilt_rad: Angle = 0.0
    spin_rad: Angle = 0.0
    height_m: Length = 0.0


@final
@dataclass(frozen=True)
class PalmTable(Table):
    """A round plate fixed to the flange, its back on the flange's xy plane; rigid bodies touch it.

    The film does not: it is mounted there. Only with an arm.

    Args:
        radius_m: of the disc.
        thickness_m: of the disc.
        mass_kg: of the disc.
        rgba: colour: red, green, blue, opacity.
        friction: coefficient of sliding.
        contact_time_s: in which a body that touches it comes to move with it; a held one slips in proportion.
            A tick is taken where that is longer.
    """

    radius_m: PositiveLength
    thickness_m: PositiveLength
    mass_kg: PositiveMass
    friction: NonNegative = 0.8
    contact_time_s: PositiveTime = 0.004
    rgba: Colour = (0.25, 0.27, 0.30, 1.0)


@final
@dataclass(frozen=True)
class PlateTable(Table):
    """A stiff plate between two soft robots.

    Args:
        mass_kg: spread over the nodes that it joins.
        stiffness_N_m: of the springs that keep its shape.
    """

    mass_kg: NonNegativeMass = 0.0
    stiffness_N_m: PositiveStiffness = 1e6


@final
@dataclass(frozen=True)
class AttachmentTable(Table):
    """Another soft robot on the tip of this one; a plate joins its base rings to the tip ring.

    Its rings, cables and chambers are called NAME/ and their own name.

    Args:
        name: begins the names of all that it brings.
        robot: in the file a table `{file = NAME, ...}` of changes to that file, as in a scenario; its own
            `copies` stand about the axis of the tip.
        height_m: of its origin beyond the tip ring, along the axis.
    """

    name: Name
    robot: SoftRobotTable
    height_m: NonNegativeLength = 0.0
    plate: PlateTable = PlateTable()

    @rule
    def _has_a_tip_to_be_on(self, robot: SoftRobotTable) -> Told:
        if robot.copies is not None:
            yield "", "cannot be combined with copies, which have no single tip"

    @rule
    def _has_the_same_film(self, robot: SoftRobotTable) -> Told:
        if self.robot.film != robot.film:
            yield "robot.film", f"differs from the film of '{robot.name}'; must not"

    @rule
    def _has_the_same_barrier(self, robot: SoftRobotTable) -> Told:
        barrier, own = self.robot.hinge.fold_barrier_rad, robot.hinge.fold_barrier_rad
        if barrier != own:
            yield Fault(
                "robot.hinge.fold_barrier_rad",
                f"{barrier:g} differs from that of '{robot.name}', {own:g}; must not",
            )


@final
@dataclass(frozen=True)
class FaceGroupTable(Table):
    """A named group of triangles with its own film; a hinge between two films has the harmonic mean.

    Args:
        name: as whatever draws the film calls the group.
        film: of its triangles.
    """

    name: Text
    film: FilmTable


@final
@dataclass(frozen=True)
class KnownTable(Table):
    """How the values of a soft robot's file are known, by keys such as "film.thickness_m" or "cable".

    The longest key that a value is under decides; of values under none nothing is said.

    Args:
        published: in the source that the file names.
        measured: on the robot itself.
        assumed: by whoever wrote the file.
    """

    published: tuple[Text, ...] = ()
    measured: tuple[Text, ...] = ()
    assumed: tuple[Text, ...] = ()

    @rule
    def _names_keys(self, robot: SoftRobotTable) -> Told:
        for entry in fields(self):
            for key in getattr(self, entry.name):
                if not _has_key(robot, key.split(".")):
                    yield entry.name, f"names '{key}'; the robot has no such key"

    @rule
    def _names_each_once(self) -> Told:
        counts = Counter((*self.published, *self.measured, *self.assumed))
        for key in [key for key, count in counts.items() if count > 1][:1]:
            yield "", f"names '{key}' more than once"


def _has_key(table: Any, parts: list[str]) -> bool:
    """Return whether a table has a key; of a table that is left out, any."""
    if isinstance(table, tuple):
        table = table[0] if table else None
    if table is None or not parts:
        return True
    names = {keys.key_of(entry): entry.name for entry in fields(table)} if is_dataclass(table) else {}
    return parts[0] in names and _has_key(getattr(table, names[parts[0]]), parts[1:])


@final
@dataclass(frozen=True)
class SoftRobotTable(Table):
    """A soft robot: geometry, film, folds, masses, clamped rings and cables.

    Args:
        name: of the robot.
        source: where its values come from, in words.
        schema: number of the names of the keys; see that of scenarios.
        stack: what draws the film, or `body` does.
        body: what else may draw it: a mesh file, or a kind registered from Python.
        groups: `[[group]]` in the file: triangles of `body` with their own film.
        base: rings clamped to the flange from the start, such as "unit_1.hole".
        cables: `[[cable]]` in the file, of one copy.
        copies: how often, and where, all this is on the flange; omitted: once, along its z axis.
        attachments: `[[attach]]` in the file.
        palm: rigid plate that the soft parts are mounted on; omitted: none.
        elements: `[[element]]` in the file, of one copy; kinds are registered from Python.
        known: how its values are known.
    """

    name: Name
    source: Text
    film: FilmTable
    stack: StackTable | None = None
    body: BodySourceTable | None = None
    groups: tuple[FaceGroupTable, ...] = field(default=(), metadata={"alias": "group"})
    hinge: HingeTable = HingeTable()
    stiffener: StiffenerTable = StiffenerTable()
    mass: MassTable = MassTable()
    base: Annotated[tuple[str, ...], Len(min_length=1)] = (FIRST_RING,)
    cables: tuple[CableTable, ...] = field(default=(), metadata={"alias": "cable"})
    copies: CopiesTable | None = None
    attachments: tuple[AttachmentTable, ...] = field(default=(), metadata={"alias": "attach"})
    palm: PalmTable | None = None
    elements: tuple[ElementTable, ...] = field(default=(), metadata={"alias": "element"})
    known: KnownTable = KnownTable()
    schema: SchemaNumber = 2

    @property
    def stored_m(self) -> float | None:
        """Length of a single stack of units laid flat [m]: frame height and two films a unit.

        Without frames each unit is as high as it is drawn. None for copies, attachments and other bodies.
        """
        if self.stack is None or self.copies is not None or self.attachments:
            return None
        unit_m = self.stack.unit_height_m if self.stiffener.height_m is None else self.frame_pitch_m
        return self.stack.units * unit_m

    @property
    def frame_pitch_m(self) -> float:
        """Distance of the frames of neighbouring units that rest on one another: a frame and two films."""
        return (self.stiffener.height_m or 0.0) + 2.0 * self.film.thickness_m

    def cable_names(self) -> tuple[str, ...]:
        """Return the names of all cables, copy by copy, then those of attachments."""
        own = tuple(cable.name for cable in self.cables)
        count = 1 if self.copies is None else self.copies.count
        own += tuple(f"copy_{k}/{name}" for k in range(2, count + 1) for name in own)
        return own + tuple(
            f"{part.name}/{name}" for part in self.attachments for name in part.robot.cable_names()
        )

    def chamber_names(self) -> tuple[str, ...]:
        """Return the names of all gas chambers: "chamber" ("arm" with attachments), or one for each copy.

        A body with several chambers has them by their names, copy_k/NAME where there are copies.
        """
        drawn = (ONLY_CHAMBER,) if self.body is None else self.body.chamber_names()
        single = len(drawn) == 1
        count = 0 if self.copies is None else self.copies.count
        own = tuple(
            f"copy_{k}" if single else f"copy_{k}/{name}" for k in range(1, count + 1) for name in drawn
        )
        if not own:
            own = (ARM_CHAMBER if self.attachments else ONLY_CHAMBER,) if single else drawn
        for part in self.attachments:
            names = part.robot.chamber_names()
            own += (
                (part.name,) if names == (ONLY_CHAMBER,) else tuple(f"{part.name}/{name}" for name in names)
            )
        return own

    def ring_names(self) -> tuple[str, ...]:
        """Return the names of all rings, base to tip, then those of each copy, then those of attachments."""
        own = self._own_rings()
        count = 0 if self.copies is None else self.copies.count
        own += tuple(f"copy_{k}/{name}" for k in range(1, count + 1) for name in own)
        return own + tuple(
            f"{part.name}/{name}" for part in self.attachments for name in part.robot.ring_names()
        )

    def sides_of(self, ring: str) -> int:
        """Return how many corners a ring has, this robot's or that of an attachment; 0 for none."""
        for part in self.attachments:
            if ring.startswith(f"{part.name}/"):
                return part.robot.sides_of(ring.removeprefix(f"{part.name}/"))
        return 0 if self.stack is None else self.stack.sides

    def _own_rings(self) -> tuple[str, ...]:
        if self.stack is not None:
            return self.stack.ring_names()
        return () if self.body is None else self.body.set_names()

    @property
    def triangles(self) -> int:
        """How many triangles its mesh has, with its copies and attachments."""
        copies = 1 if self.copies is None else self.copies.count
        own = 0 if self.stack is None else self.stack.triangles  # mesh files have a bound of their own
        return copies * own + sum(part.robot.triangles for part in self.attachments)

    @rule
    def _is_drawn_once(self) -> Told:
        if self.stack is not None and self.body is not None:
            yield "body", "cannot be combined with stack; one draws the film"
        elif self.stack is None and self.body is None:
            yield "stack", "is missing; give [stack], or [body] with what draws the film"
        elif self.stack is not None and self.groups:
            yield "group", "a stack of units has no named groups of triangles"

    @rule
    def _has_outer_rings(self) -> Told:
        if self.stack is None and self.body is not None:
            if self.stiffener.kind != "none" and not self.body.has_frames():
                yield "stiffener.kind", "is of stacks of units and of drawings with a layer FRAME"
            elif self.stiffener.rest_on_one_another:
                yield "stiffener.rest_on_one_another", "is of stacks of units"
            if self.mass.seam_mass_kg:
                yield "mass.seam_mass_kg", "is of stacks of units: they have outer rings"

    @rule
    def _has_mass(self) -> Told:
        size_m = 1.0 if self.stack is None else self.stack.unit_height_m  # of other films the mesh will tell
        film_mass = self.film.density_kg_m3 * self.film.thickness_m * size_m**2
        if self.mass.node_mass_kg < LEAST_NODE_MASS_kg and film_mass < LEAST_NODE_MASS_kg:
            yield Fault(
                "mass.node_mass_kg",
                f"every node needs mass, {LEAST_NODE_MASS_kg:g} kg at least; give node_mass_kg or "
                "film.density_kg_m3",
            )

    @rule
    def _has_its_base(self) -> Told:
        known = self.ring_names()
        for ring in [ring for ring in self.base if not keys.matching(ring, known)][:1]:
            yield "base", keys.unknown_name_message("ring", ring, known)

    @property
    def all_stacks(self) -> bool:
        """Whether stacks of units draw all of it, what it carries included."""
        return self.stack is not None and all(part.robot.all_stacks for part in self.attachments)
