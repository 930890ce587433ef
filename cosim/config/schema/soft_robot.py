"""Tables of a soft robot's file (`robots/*.toml`): film, folds, stiffeners, masses, cables, copies,
attachments. The tables are frozen; units are SI and part of the keys' names. Custom elements are
`[[element]]` tables of kinds that are registered as subclasses of `ElementTable`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, Final, Literal, final

from annotated_types import Interval, Len

from cosim.base.names import ONLY_CHAMBER
from cosim.config.schema.body_sources import BodySourceTable
from cosim.config.schema.film import FilmTable
from cosim.config.schema.stack import FIRST_RING, StackTable
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
from cosim.config.toml.rules import Fault, Violations, rule
from cosim.config.toml.tables import KindTable, Table

UnitRange = tuple[Count, CountOrLast]
LEAST_NODE_MASS_kg: Final = 1e-12
ARM_CHAMBER: Final = "arm"
"""Name of the gas chamber of a robot that carries others."""


@dataclass(frozen=True, kw_only=True)
class ElementTable(KindTable):
    """Custom elements of a soft robot.

    Args:
        kind: of the elements; each kind has further keys.
    """

    def element(self, body: Any) -> Any:
        """Return the elements (`cosim.soft.elements.element.Element`) for a body.

        Args:
            body: a `SoftBody` without these elements.

        Raises:
            InputError: the table names a ring or other part that the body does not have.
        """
        raise NotImplementedError


@final
@dataclass(frozen=True)
class HingeTable(Table):
    """Rotational springs of the folds.

    Args:
        rule: "uniform": every hinge has the same spring constant (scaled on a refined mesh, so that the mean
            energy of bending to a cylinder is constant); "shell": the spring constant of a hinge follows from
            its two triangles, so that the film bends like a shell.
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
        density_kg_m3: beam: of the material; its mass is added to that of the ring's nodes.
        strength_strain: beam: strain at which the material fails; a phase that ends above it gives a
            warning; omitted: no warning.
        rest_on_one_another: beam: whether neighbouring frames touch, at a distance of their height and two
            films, as in a stowed pack; if not, they pass through one another.
        side_ratio: side of the frame over that of the film's drawn rim; below 1 the film is slack in its
            frame, above 1 it is stretched.
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
    side_ratio: Annotated[float, Interval(ge=0.9, le=1.05)] = 1.0

    @rule
    def _has_a_size(self) -> Violations:
        if self.kind == "none" and self.side_ratio != 1.0:
            yield "side_ratio", "needs a frame: kind = 'beam' or 'stiff'; the kind is 'none'"

    @rule
    def _is_a_beam(self) -> Violations:
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
        units: first and last unit with an eyelet, counted from 1; "last" is the last unit of the stack.
        capstan_factor: tension beyond an eyelet divided by the tension before it.
        friction_coefficient: mu in exp(-mu * wrap angle) at each eyelet.
        line: a set of nodes in order, base to tip, in place of corner and units if no stack draws the film.
        stiffness_N_m: tension per stretch of the whole cable; it has an effect if the length is commanded,
            and while the cable sticks at eyelets.
        damping_Ns_m: tension per rate of that stretch (Kelvin-Voigt), in the dynamic mode.
        eyelet_loss_N: constant loss of tension at each eyelet, in addition to the capstan loss.
        losses: "one_way": tension falls from the base on, whatever the direction of sliding, as in the
            paper's model; "directed": friction opposes the sliding, with separate stick and slip at each
            eyelet.
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
    def _runs_along_a_stack(self, robot: SoftRobotTable) -> Violations:
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
    def _runs_along_a_line(self, robot: SoftRobotTable) -> Violations:
        if robot.stack is not None or robot.body is None:
            return
        names = robot.body.set_names()
        if self.line is None or self.corner is not None or self.units is not None or self.corners_per_unit:
            yield "", "runs along no stack of units: give line, without corner, corners_per_unit and units"
        elif self.line not in names:
            yield "line", keys.unknown_name_message("set", self.line, names)

    @rule
    def _has_one_law_of_losses(self) -> Violations:
        if (self.capstan_factor is None) == (self.friction_coefficient is None):
            given = "neither" if self.capstan_factor is None else "both"
            yield "", f"give capstan_factor or friction_coefficient; {given} is given"
        if self.eyelet_loss_N > 0.0 and self.losses == "one_way":
            yield "eyelet_loss_N", "opposes the way the cable slides; it needs losses = 'directed'"


@final
@dataclass(frozen=True)
class CopiesTable(Table):
    """The robot several times on one flange, evenly spaced about its z axis, such as fingers on a palm.

    A ring's name is that of the first copy, towards the flange's +x; the rings of copy k are called
    copy_k/NAME, and copy_*/NAME names those of all. Cables are listed copy by copy; each copy has a gas
    chamber, copy_k.

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
        contact_time_s: time constant of the contact; a held body slips in proportion to it. At least a tick.
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
        mass_kg: spread over the joined nodes.
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
        name: prefix of its rings, cables and chambers.
        robot: in the file a table `{file = NAME, ...}` of changes to that file, as in a scenario; its
            `copies` are placed about the axis of the tip.
        height_m: of its origin beyond the tip ring, along the axis.
    """

    name: Name
    robot: SoftRobotTable
    height_m: NonNegativeLength = 0.0
    plate: PlateTable = PlateTable()

    @rule
    def _has_a_tip_to_be_on(self, robot: SoftRobotTable) -> Violations:
        if robot.copies is not None:
            yield "", "cannot be combined with copies, which have no single tip"

    @rule
    def _has_the_same_film(self, robot: SoftRobotTable) -> Violations:
        if self.robot.film != robot.film:
            yield "robot.film", f"differs from the film of '{robot.name}'; must not"

    @rule
    def _has_the_same_barrier(self, robot: SoftRobotTable) -> Violations:
        barrier, own = self.robot.hinge.fold_barrier_rad, robot.hinge.fold_barrier_rad
        if barrier != own:
            yield Fault(
                "robot.hinge.fold_barrier_rad",
                f"{barrier:g} differs from that of '{robot.name}', {own:g}; must not",
            )


@final
@dataclass(frozen=True)
class FaceGroupTable(Table):
    """A named group of triangles with a different film; a hinge between two films has the harmonic mean.

    Args:
        name: of the group, in the mesh file or drawing.
        film: of its triangles.
    """

    name: Text
    film: FilmTable


@final
@dataclass(frozen=True)
class KnownTable(Table):
    """Origin of the values in a soft robot's file, by keys such as "film.thickness_m" or "cable".

    The longest key that contains a value decides; a value under no key has no stated origin.

    Args:
        published: values from the source that the file names.
        measured: values measured on the robot.
        identified: values fitted to curves; the file says to which.
        assumed: values assumed by the author of the file.
    """

    published: tuple[Text, ...] = ()
    measured: tuple[Text, ...] = ()
    identified: tuple[Text, ...] = ()
    assumed: tuple[Text, ...] = ()

    @rule
    def _names_keys(self, robot: SoftRobotTable) -> Violations:
        for entry in fields(self):
            for key in getattr(self, entry.name):
                if not _has_key(robot, key.split(".")):
                    yield entry.name, f"names {keys.shown(key)}; the robot has no such key"

    @rule
    def _names_each_once(self) -> Violations:
        counts = Counter(key for entry in fields(self) for key in getattr(self, entry.name))
        for key in [key for key, count in counts.items() if count > 1][:1]:
            yield "", f"names {keys.shown(key)} more than once"


def _has_key(table: Any, parts: list[str]) -> bool:
    """Return whether a table has the key with these parts; true for a table that the file omits."""
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
        source: origin of its values, in words.
        schema: number of the file format, see that of scenarios.
        stack: a stack of units, which draws the film; or give `body`.
        body: what draws the film in place of a stack: a mesh file, a cut pattern, or a kind registered from
            Python.
        groups: `[[group]]` in the file: triangles of `body` with a different film.
        base: rings clamped to the flange from the start, such as "unit_1.hole".
        cables: `[[cable]]` in the file, of one copy.
        copies: number and placement of copies of the robot on the flange; omitted: one, along its z axis.
        attachments: `[[attach]]` in the file.
        palm: rigid plate that the soft parts are mounted on; omitted: none.
        elements: `[[element]]` in the file, of one copy; kinds are registered from Python.
        known: origin of its values.
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
        """Stowed length of a single stack of units [m]: frame height and two films per unit.

        Without frames each unit has its drawn height. None for copies, attachments and other bodies.
        """
        if self.stack is None or self.copies is not None or self.attachments:
            return None
        unit_m = self.stack.unit_height_m if self.stiffener.height_m is None else self.frame_pitch_m
        return self.stack.units * unit_m

    @property
    def frame_pitch_m(self) -> float:
        """Distance of neighbouring frames that rest on one another [m]: the frame's height and two films."""
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

        A body with several chambers has their names, copy_k/NAME with copies.
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
        """Return the number of corners of a ring of this robot or of an attachment; 0 for rings without."""
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
        """Number of triangles of its stacks, with copies and attachments; reading a mesh file has a bound."""
        copies = 1 if self.copies is None else self.copies.count
        single = 0 if self.stack is None else self.stack.triangles
        return copies * single + sum(part.robot.triangles for part in self.attachments)

    @rule
    def _is_drawn_once(self) -> Violations:
        if self.stack is not None and self.body is not None:
            yield "body", "cannot be combined with stack; one draws the film"
        elif self.stack is None and self.body is None:
            yield "stack", "is missing; give [stack], or [body] with what draws the film"
        elif self.stack is not None and self.groups:
            yield "group", "a stack of units has no named groups of triangles"

    @rule
    def _has_outer_rings(self) -> Violations:
        if self.stack is None and self.body is not None:
            if self.stiffener.kind != "none" and not self.body.has_frames():
                yield "stiffener.kind", "is of stacks of units and of drawings with a layer FRAME"
            elif self.stiffener.rest_on_one_another:
                yield "stiffener.rest_on_one_another", "is of stacks of units"
            if self.mass.seam_mass_kg:
                yield "mass.seam_mass_kg", "is of stacks of units: they have outer rings"

    @rule
    def _has_mass(self) -> Violations:
        size_m = 1.0 if self.stack is None else self.stack.unit_height_m  # other films are checked as meshes
        film_mass = self.film.density_kg_m3 * self.film.thickness_m * size_m**2
        if self.mass.node_mass_kg < LEAST_NODE_MASS_kg and film_mass < LEAST_NODE_MASS_kg:
            yield Fault(
                "mass.node_mass_kg",
                f"every node needs mass, {LEAST_NODE_MASS_kg:g} kg at least; give node_mass_kg or "
                "film.density_kg_m3",
            )

    @rule
    def _has_its_base(self) -> Violations:
        known = self.ring_names()
        for ring in [ring for ring in self.base if not keys.matching(ring, known)][:1]:
            yield "base", keys.unknown_name_message("ring", ring, known)

    @property
    def all_stacks(self) -> bool:
        """Whether stacks of units draw this robot and all its attachments."""
        return self.stack is not None and all(part.robot.all_stacks for part in self.attachments)
