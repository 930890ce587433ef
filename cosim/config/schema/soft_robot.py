"""Schema of a soft robot's file (`robots/*.toml`): frozen, SI units in the names of the keys."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final, Literal, final

from annotated_types import Interval, Len

from cosim.base.names import ONLY_CHAMBER
from cosim.config.schema.body_source import BodySourceTable
from cosim.config.schema.elements import ElementTable
from cosim.config.schema.film import FilmTable, HingeTable, MassTable, StiffenerTable
from cosim.config.schema.stack import FIRST_RING, CableTable, StackTable
from cosim.config.toml.constraints import (
    Colour,
    Name,
    NonNegative,
    Positive,
    Text,
)

ARM_CHAMBER: Final = "arm"
"""Name of the gas chamber of a robot that carries others."""


@final
@dataclass(frozen=True)
class CopiesTable:
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
    radius_m: NonNegative
    tilt_rad: float = 0.0
    spin_rad: float = 0.0
    height_m: float = 0.0


@final
@dataclass(frozen=True)
class PalmTable:
    """A round plate fixed to the flange, its back on the flange's xy plane; rigid bodies touch it.

    The film does not: it is mounted there. Only with an arm.

    Args:
        radius_m: of the disc.
        thickness_m: of the disc.
        mass_kg: of the disc.
        rgba: colour: red, green, blue, opacity.
        friction: coefficient of sliding.
    """

    radius_m: Positive
    thickness_m: Positive
    mass_kg: Positive
    friction: NonNegative = 0.8
    rgba: Colour = (0.25, 0.27, 0.30, 1.0)


@final
@dataclass(frozen=True)
class PlateTable:
    """A stiff plate between two soft robots.

    Args:
        mass_kg: spread over the nodes that it joins.
        stiffness_N_m: of the springs that keep its shape.
    """

    mass_kg: NonNegative = 0.0
    stiffness_N_m: Positive = 1e6


@final
@dataclass(frozen=True)
class AttachmentTable:
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
    height_m: NonNegative = 0.0
    plate: PlateTable = PlateTable()


@final
@dataclass(frozen=True)
class FaceGroupTable:
    """A named group of triangles with a film of its own; a hinge between two films has the harmonic mean.

    Args:
        name: as whatever draws the film calls the group.
        film: of its triangles.
    """

    name: Text
    film: FilmTable


@final
@dataclass(frozen=True)
class KnownTable:
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


@final
@dataclass(frozen=True)
class SoftRobotTable:
    """A soft robot: geometry, film, folds, masses, clamped rings and cables.

    Args:
        name: of the robot.
        source: where its values come from, in words.
        schema: number of the names of the keys; see that of scenarios.
        stack: what draws the film, or `body` does.
        body: what else may draw it: a mesh file, or a kind registered from Python.
        groups: `[[group]]` in the file: triangles of `body` with a film of their own.
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
    schema: Literal[2] = 2

    def cable_names(self) -> tuple[str, ...]:
        """Return the names of all cables, copy by copy, then those of attachments."""
        own = tuple(cable.name for cable in self.cables)
        count = 1 if self.copies is None else self.copies.count
        own += tuple(f"copy_{k}/{name}" for k in range(2, count + 1) for name in own)
        return own + tuple(
            f"{part.name}/{name}" for part in self.attachments for name in part.robot.cable_names()
        )

    def chamber_names(self) -> tuple[str, ...]:
        """Return the names of all gas chambers: "chamber" ("arm" with attachments), or one for each copy."""
        count = 0 if self.copies is None else self.copies.count
        own = tuple(f"copy_{k}" for k in range(1, count + 1))
        if not own:
            own = (ARM_CHAMBER if self.attachments else ONLY_CHAMBER,)
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
    def all_stacks(self) -> bool:
        """Whether stacks of units draw all of it, what it carries included."""
        return self.stack is not None and all(part.robot.all_stacks for part in self.attachments)
