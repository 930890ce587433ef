"""Tables of a soft robot's film: isotropic or woven; stacks of polygonal units, which draw it."""

import math
from dataclasses import dataclass
from typing import Annotated, Final, Literal, final

from annotated_types import Interval

from cosim.config.toml.quantities import (
    Angle,
    Fraction,
    Increasing,
    NonNegative,
    NonNegativeDensity,
    NonNegativeStiffness,
    Positive,
    PositiveFrequency,
    PositiveLength,
    PositivePressure,
    UpToOne,
    Vector3,
)
from cosim.config.toml.rules import Fault, Told, rule
from cosim.config.toml.tables import Table

FABRIC_LAWS: Final = ("plain", "tension_field")
"""Laws of a film that is a fabric."""
LEAST_STIFFNESS_N_m: Final = 1.0
"""Of modulus times thickness: 1 N per metre doubles its length. The softest silicone has it at 20 um."""


@final
@dataclass(frozen=True)
class FabricTable(Table):
    """A woven or coated sheet, which resists along its yarns more than between them: `[film.fabric]`.

    The yarns are crimped by the weave. Their modulus grows in proportion to their strain, up to that of
    straight yarns. Folds bend with the root of warp times weft modulus. With film.law = "tension_field" the
    fabric wrinkles.

    Args:
        modulus_warp_Pa: Young's modulus along the warp, at small strain.
        modulus_weft_Pa: Young's modulus along the weft, at small strain.
        shear_modulus_Pa: between warp and weft.
        warp_direction: in the flange's frame, in the drawn shape; projected on each triangle.
        straight_modulus_warp_Pa: along the warp once its yarns are straight; omitted: `modulus_warp_Pa`.
        straight_modulus_weft_Pa: along the weft once its yarns are straight; omitted: `modulus_weft_Pa`.
        straight_strain_warp: strain at which the yarns of the warp are straight.
        straight_strain_weft: strain at which the yarns of the weft are straight.
    """

    modulus_warp_Pa: PositivePressure
    modulus_weft_Pa: PositivePressure
    shear_modulus_Pa: PositivePressure
    warp_direction: Vector3 = (0.0, 0.0, 1.0)
    straight_modulus_warp_Pa: PositivePressure | None = None
    straight_modulus_weft_Pa: PositivePressure | None = None
    straight_strain_warp: Positive = 0.01
    straight_strain_weft: Positive = 0.01

    @property
    def straight_modulus_Pa(self) -> tuple[float, float]:
        """Modulus of straight yarns, along warp and weft."""
        warp, weft = self.straight_modulus_warp_Pa, self.straight_modulus_weft_Pa
        return (
            self.modulus_warp_Pa if warp is None else warp,
            self.modulus_weft_Pa if weft is None else weft,
        )

    @rule
    def _has_a_direction(self) -> Told:
        if not any(self.warp_direction):
            yield "warp_direction", "has no length; give a direction that lies in the film"

    @rule
    def _gets_no_softer(self) -> Told:
        for name, straight in zip(("warp", "weft"), self.straight_modulus_Pa, strict=True):
            drawn = getattr(self, f"modulus_{name}_Pa")
            if straight < drawn:
                yield (
                    f"straight_modulus_{name}_Pa",
                    f"is {straight:g}; must be modulus_{name}_Pa, {drawn:g}, at least",
                )


@final
@dataclass(frozen=True, kw_only=True)
class FilmTable(Table):
    """Elastic sheet of the chamber walls.

    Args:
        young_modulus_Pa: of the sheet, isotropic; in its place `[film.fabric]`.
        poisson_ratio: of the sheet; of fabric: contraction along the weft over extension along the warp.
        thickness_m: of one sheet, undeformed.
        fabric: stiffnesses of a woven sheet, in place of `young_modulus_Pa`.
        density_kg_m3: of the sheet; its mass is added to that of `[mass]`.
        law: "plain"; "tension_field": a film that wrinkles almost without resistance; "edge_strain": strain
            as bars along the triangles' edges measure it (for comparison with published data); "wrinkling":
            plain in tension; compressed, it wrinkles as panels from seam to hole do, on meshes too coarse
            for it; "neo_hookean": incompressible rubber, which stretches far and does not wrinkle.
        wrinkle_panel_m: width of the panels that a wrinkling film wrinkles in; omitted: from the
            sides of each unit's outer ring to those of its hole.
        buckling_force_N_m: compression per width, across any line, that a film with law = "tension_field"
            bears before it wrinkles, such as E t^2 / (r sqrt(3 (1 - nu^2))) of a sheet curved with radius r.
        loss_factor: tan delta of the sheet, as data sheets give it: in the dynamic mode it resists rates of
            stretching and bending, and rigid motion not at all.
        loss_frequency_Hz: at which that holds; a Kelvin-Voigt material's grows in proportion to frequency.
    """

    young_modulus_Pa: PositivePressure | None = None
    poisson_ratio: Annotated[float, Interval(gt=-1.0, lt=1.0)]
    thickness_m: PositiveLength
    density_kg_m3: NonNegativeDensity = 0.0
    law: Literal["plain", "tension_field", "edge_strain", "wrinkling", "neo_hookean"] = "plain"
    wrinkle_panel_m: PositiveLength | None = None
    buckling_force_N_m: NonNegativeStiffness = 0.0
    loss_factor: NonNegative = 0.0
    loss_frequency_Hz: PositiveFrequency = 1.0
    fabric: FabricTable | None = None

    @rule
    def _is_of_one_kind(self) -> Told:
        if (self.young_modulus_Pa is None) is (self.fabric is None):
            given = "neither is" if self.fabric is None else "both are"
            yield "young_modulus_Pa", f"give this or film.fabric; {given} given"

    @rule
    def _bears_loads(self) -> Told:
        given = {"young_modulus_Pa": self.young_modulus_Pa}
        if self.fabric is not None:
            warp, weft = self.fabric.modulus_warp_Pa, self.fabric.modulus_weft_Pa
            given = {"fabric.modulus_warp_Pa": warp, "fabric.modulus_weft_Pa": weft}
        for key, modulus in given.items():
            # with room for the bound as it is printed
            if modulus is not None and modulus * self.thickness_m < (1.0 - 1e-5) * LEAST_STIFFNESS_N_m:
                least = f"{LEAST_STIFFNESS_N_m / self.thickness_m:g}"
                yield (
                    key,
                    f"is {modulus:g}; must be at least {least} with thickness_m = {self.thickness_m:g}: a "
                    "softer film bears no load. Give it in Pa (plastics have some 1e9, silicone 1e6), or a "
                    "larger thickness",
                )

    @rule
    def _resists_all_strains(self) -> Told:
        nu, fabric = self.poisson_ratio, self.fabric
        if self.law == "neo_hookean":
            if nu != 0.5:
                yield "poisson_ratio", f"is {nu:g}; law = 'neo_hookean' is incompressible: give 0.5"
        elif fabric is None and not nu < 0.5:
            yield "poisson_ratio", f"is {nu:g}; must be below 0.5"
        elif fabric is not None and not nu**2 < fabric.modulus_warp_Pa / fabric.modulus_weft_Pa:
            bound = (fabric.modulus_warp_Pa / fabric.modulus_weft_Pa) ** 0.5
            yield "poisson_ratio", f"is {nu:g}; must be below {bound:.3g}, the root of warp over weft modulus"

    @rule
    def _wrinkles_as_fabric(self) -> Told:
        if self.fabric is not None and self.law not in FABRIC_LAWS:
            yield "law", f"'{self.law}' is for isotropic film; of fabric it is 'plain' or 'tension_field'"

    @rule
    def _wrinkles_in_panels(self) -> Told:
        if self.wrinkle_panel_m is not None and self.law != "wrinkling":
            yield "wrinkle_panel_m", f"goes with law = 'wrinkling'; the law is '{self.law}'"

    @rule
    def _resists_as_a_tension_field(self) -> Told:
        if self.buckling_force_N_m and self.law != "tension_field":
            yield "buckling_force_N_m", f"goes with law = 'tension_field'; the law is '{self.law}'"


HeightFractions = Annotated[tuple[Fraction, Fraction, Fraction], Increasing]
FIRST_RING: Final = "unit_1.hole"
"""The ring of a stack that the flange holds, unless a robot's `base` says otherwise."""
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
        mesh: "drawn", the paper's triangles; "graded", others on the same shape, nearer to a fine mesh:
            docs/mesh_study.md.
        refine_holes: of a drawn mesh, how often all edges that end at hole rings are cut, a third of the
            logarithmic way outwards: units bend there, and it is several times too stiff for it.
        neck: films fused around the holes; omitted: each unit has its own films up to the holes. Only with
            refine_holes or a graded mesh.
        refine: how often each triangle is divided into four, after that.
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
        """How many triangles the refined mesh has."""
        counts = _TRIANGLES_PER_UNIT_AND_SIDE if self.neck is None else _WITH_NECK
        count = counts[self.refine_holes]
        if self.mesh == "graded":
            count = _GRADED if self.neck is None else _GRADED_WITH_NECK
        return count * self.sides * self.units << 2 * self.refine

    @property
    def neck_bound_m(self) -> float:
        """Distance from the axis of the nodes next to a hole, those of the smallest mid ring's edges."""
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
    def _has_holes_that_fit(self) -> Told:
        if self.smallest_radius_m <= self.hole_radius_m:
            yield Fault(
                "hole_radius_m",
                f"{self.hole_radius_m:g} must be below the last unit's corner radius, "
                f"{self.smallest_radius_m:.4g}",
            )

    @rule
    def _has_a_neck_that_fits(self) -> Told:
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
