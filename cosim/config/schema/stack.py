"""Tables of a straight stack of polygonal units, which draws a film: `[stack]` of a soft robot's file."""

import math
from dataclasses import dataclass
from typing import Annotated, Final, Literal, final

from annotated_types import Interval

from cosim.config.toml.quantities import Angle, Fraction, Increasing, PositiveLength, UpToOne
from cosim.config.toml.rules import Fault, Violations, rule
from cosim.config.toml.tables import Table

HeightFractions = Annotated[tuple[Fraction, Fraction, Fraction], Increasing]
FIRST_RING: Final = "unit_1.hole"
"""The ring of a stack that the flange holds by default."""
_RINGS: Final = ("hole", "lower", "outer", "upper")
_TRIANGLES_PER_UNIT_AND_SIDE: Final = (14, 28, 56)
"""By `refine_holes`."""
_WITH_NECK: Final = (14, 28, 84)
_GRADED, _GRADED_WITH_NECK = 36, 44


@final
@dataclass(frozen=True)
class NeckTable(Table):
    """Film of double thickness around the holes, where the films of neighbouring units are fused.

    Args:
        fused_radius_m: its distance from the axis; beyond the holes' corners and within the mid rings.
    """

    fused_radius_m: PositiveLength


@final
@dataclass(frozen=True)
class StackTable(Table):
    """Geometry of a straight stack of polygonal units, drawn along the flange's z axis.

    Args:
        kind: the only geometry so far.
        sides: corners of each unit.
        units: number of units.
        corner_radius_m: distance of the first unit's corners from the axis.
        taper: corner radius of a unit divided by that of the unit before it.
        hole_radius_m: distance of the corners of the hole rings between units from the axis.
        mid_ring_fraction: 0 puts the mid rings' corners at the hole, 1 at the unit's corner.
        unit_height_m: drawn height of one unit.
        ring_heights: of lower mid, outer and upper mid ring, as fractions of the unit's height.
        first_corner_rad: angle of corner 0 from the flange's x axis about its z axis; omitted:
            -pi / sides, so that the edge between corners 0 and 1 faces +x.
        mesh: "drawn": the paper's triangles; "graded": other triangles on the same shape, whose results are
            nearer to those of a fine mesh, see docs/mesh_study.md.
        refine_holes: of a drawn mesh, how often all edges that end at hole rings are cut, a third of the
            logarithmic distance outwards. Units bend there, and the drawn mesh is several times too stiff.
        neck: films fused around the holes; omitted: each unit has separate films up to the holes. Only with
            refine_holes or a graded mesh.
        refine: how often each triangle is then divided into four.
    """

    sides: Annotated[int, Interval(ge=3, le=64)]
    units: Annotated[int, Interval(ge=1, le=200)]
    corner_radius_m: PositiveLength
    hole_radius_m: PositiveLength
    unit_height_m: PositiveLength
    ring_heights: HeightFractions
    kind: Literal["polygonal_stack"] = "polygonal_stack"
    taper: UpToOne = 1.0
    mid_ring_fraction: Fraction = 0.5
    first_corner_rad: Angle | None = None
    mesh: Literal["drawn", "graded"] = "drawn"
    refine_holes: Annotated[int, Interval(ge=0, le=2)] = 0
    neck: NeckTable | None = None
    refine: Annotated[int, Interval(ge=0, le=4)] = 0

    @property
    def smallest_radius_m(self) -> float:
        """Distance of the last unit's corners from the axis."""
        return self.corner_radius_m * self.taper ** (self.units - 1)

    @property
    def triangles(self) -> int:
        """Number of triangles of the refined mesh."""
        counts = _TRIANGLES_PER_UNIT_AND_SIDE if self.neck is None else _WITH_NECK
        count = counts[self.refine_holes]
        if self.mesh == "graded":
            count = _GRADED if self.neck is None else _GRADED_WITH_NECK
        return count * self.sides * self.units << 2 * self.refine

    @property
    def neck_bound_m(self) -> float:
        """Distance of the smallest mid ring's edges from the axis, the upper bound of a neck's radius."""
        middle = self.hole_radius_m + self.mid_ring_fraction * (self.smallest_radius_m - self.hole_radius_m)
        return middle * math.cos(math.pi / self.sides)

    def ring_names(self) -> tuple[str, ...]:
        """Return the names of the rings, base to tip; see `PolygonalStack.mesh`."""
        units = range(1, self.units + 1)
        return (*(f"unit_{unit}.{ring}" for unit in units for ring in _RINGS), "tip")

    def frame_rings(self) -> tuple[str, ...]:
        """Return the names of the rings that are frames of a section model, base to tip."""
        return (*(f"unit_{unit}.outer" for unit in range(1, self.units + 1)), "tip")

    @rule
    def _has_holes_that_fit(self) -> Violations:
        if self.smallest_radius_m <= self.hole_radius_m:
            yield Fault(
                "hole_radius_m",
                f"{self.hole_radius_m:g} must be below the last unit's corner radius, "
                f"{self.smallest_radius_m:.4g}",
            )

    @rule
    def _has_a_neck_that_fits(self) -> Violations:
        if self.neck is None or self.smallest_radius_m <= self.hole_radius_m:
            return
        fused, least, most = self.neck.fused_radius_m, self.hole_radius_m, self.neck_bound_m
        if not least < fused < most:
            yield Fault(
                "neck.fused_radius_m",
                f"{fused:g} must lie between hole_radius_m, {least:g}, and the mid rings, whose edges are "
                f"{most:.4g} from the axis at the least",
            )
        elif not self.refine_holes and self.mesh == "drawn":
            yield "refine_holes", "is 0; a neck needs 1 or 2, which put nodes where the fused films end"
