"""Tables of a soft robot's film, isotropic or woven: `[film]` and `[film.fabric]`."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal, final

from annotated_types import Interval

from cosim.config.toml.quantities import (
    NonNegative,
    NonNegativeDensity,
    NonNegativeStiffness,
    Positive,
    PositiveFrequency,
    PositiveLength,
    PositivePressure,
    Vector3,
)
from cosim.config.toml.rules import Violations, rule
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
        straight_modulus_warp_Pa: along the warp with straight yarns; omitted: `modulus_warp_Pa`.
        straight_modulus_weft_Pa: along the weft with straight yarns; omitted: `modulus_weft_Pa`.
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
    def _has_a_direction(self) -> Violations:
        if not any(self.warp_direction):
            yield "warp_direction", "has no length; give a direction that lies in the film"

    @rule
    def _gets_no_softer(self) -> Violations:
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
        young_modulus_Pa: of an isotropic sheet; a woven one has `[film.fabric]` in its place.
        poisson_ratio: of the sheet; of fabric: contraction along the weft over extension along the warp.
        thickness_m: of one sheet, undeformed.
        fabric: stiffnesses of a woven sheet, in place of `young_modulus_Pa`.
        density_kg_m3: of the sheet; its mass is added to that of `[mass]`.
        law: "plain": linear elastic; "tension_field": wrinkles almost without resistance; "edge_strain":
            strain as measured by bars along the triangles' edges (for comparison with published data);
            "wrinkling": plain in tension; in compression it has the reduced stiffness of panels that wrinkle
            from seam to hole, for meshes too coarse to show the wrinkles; "neo_hookean": incompressible
            rubber, for large strains, does not wrinkle.
        wrinkle_panel_m: width of the panels of a film with law = "wrinkling"; omitted: the distance from the
            sides of each unit's outer ring to those of its hole.
        buckling_force_N_m: compression per width, across any line, at which a film with law = "tension_field"
            wrinkles, such as E t^2 / (r sqrt(3 (1 - nu^2))) of a sheet curved with radius r.
        stiffening: of a film with law = "neo_hookean", which stiffens at large stretch: the second constant
            of Yeoh's law over the first, such as 0.012 of soft silicone.
        loss_factor: tan delta of the sheet, from its data sheet: in the dynamic mode it damps stretching and
            bending; rigid motion is not damped.
        loss_frequency_Hz: of that loss factor; that of a Kelvin-Voigt material is proportional to frequency.
    """

    young_modulus_Pa: PositivePressure | None = None
    poisson_ratio: Annotated[float, Interval(gt=-1.0, lt=1.0)]
    thickness_m: PositiveLength
    density_kg_m3: NonNegativeDensity = 0.0
    law: Literal["plain", "tension_field", "edge_strain", "wrinkling", "neo_hookean"] = "plain"
    wrinkle_panel_m: PositiveLength | None = None
    buckling_force_N_m: NonNegativeStiffness = 0.0
    stiffening: NonNegative = 0.0
    loss_factor: NonNegative = 0.0
    loss_frequency_Hz: PositiveFrequency = 1.0
    fabric: FabricTable | None = None

    @rule
    def _is_of_one_kind(self) -> Violations:
        if (self.young_modulus_Pa is None) is (self.fabric is None):
            given = "neither is" if self.fabric is None else "both are"
            yield "young_modulus_Pa", f"give this or film.fabric; {given} given"

    @rule
    def _bears_loads(self) -> Violations:
        given = {"young_modulus_Pa": self.young_modulus_Pa}
        if self.fabric is not None:
            warp, weft = self.fabric.modulus_warp_Pa, self.fabric.modulus_weft_Pa
            given = {"fabric.modulus_warp_Pa": warp, "fabric.modulus_weft_Pa": weft}
        for key, modulus in given.items():
            # tolerance, so that the printed bound itself is accepted
            if modulus is not None and modulus * self.thickness_m < (1.0 - 1e-5) * LEAST_STIFFNESS_N_m:
                least = f"{LEAST_STIFFNESS_N_m / self.thickness_m:g}"
                yield (
                    key,
                    f"is {modulus:g}; must be at least {least} with thickness_m = {self.thickness_m:g}: a "
                    "softer film bears no load. Give it in Pa (plastics have some 1e9, silicone 1e6), or a "
                    "larger thickness",
                )

    @rule
    def _resists_all_strains(self) -> Violations:
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
    def _wrinkles_as_fabric(self) -> Violations:
        if self.fabric is not None and self.law not in FABRIC_LAWS:
            yield "law", f"'{self.law}' is for isotropic film; of fabric it is 'plain' or 'tension_field'"

    @rule
    def _wrinkles_in_panels(self) -> Violations:
        if self.wrinkle_panel_m is not None and self.law != "wrinkling":
            yield "wrinkle_panel_m", f"goes with law = 'wrinkling'; the law is '{self.law}'"

    @rule
    def _stiffens_as_rubber(self) -> Violations:
        if self.stiffening and self.law != "neo_hookean":
            yield "stiffening", f"goes with law = 'neo_hookean'; the law is '{self.law}'"

    @rule
    def _resists_as_a_tension_field(self) -> Violations:
        if self.buckling_force_N_m and self.law != "tension_field":
            yield "buckling_force_N_m", f"goes with law = 'tension_field'; the law is '{self.law}'"
