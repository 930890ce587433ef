"""Tables of what a soft robot is made of: film, hinges, stiffeners, mass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, final

from annotated_types import Interval

from cosim.config.toml.constraints import (
    NonNegative,
    Positive,
)


@final
@dataclass(frozen=True)
class FilmTable:
    """Elastic sheet of the chamber walls.

    Args:
        young_modulus_Pa: of the sheet, isotropic.
        poisson_ratio: of the sheet.
        thickness_m: of one sheet, undeformed.
        density_kg_m3: of the sheet; its mass is added to that of `[mass]`.
        law: "plain"; "tension_field": a film that wrinkles almost without resistance; "edge_strain": strain
            as bars along the triangles' edges measure it (for comparison with published data); "wrinkling":
            plain in tension; compressed, it wrinkles as panels from seam to hole do, on meshes too coarse
            for it.
        wrinkle_panel_m: width of the panels that a wrinkling film wrinkles in; omitted: from the
            sides of each unit's outer ring to those of its hole.
    """

    young_modulus_Pa: Positive
    poisson_ratio: Annotated[float, Interval(gt=-1.0, lt=0.5)]
    thickness_m: Positive
    density_kg_m3: NonNegative = 0.0
    law: Literal["plain", "tension_field", "edge_strain", "wrinkling"] = "plain"
    wrinkle_panel_m: Positive | None = None


@final
@dataclass(frozen=True)
class HingeTable:
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
class StiffenerTable:
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
    """

    kind: Literal["none", "stiff", "beam"] = "none"
    stiffness_N_m: Positive = 1e6
    width_m: Positive | None = None
    height_m: Positive | None = None
    young_modulus_Pa: Positive | None = None
    poisson_ratio: Annotated[float, Interval(gt=-1.0, le=0.5)] = 0.35
    density_kg_m3: NonNegative = 0.0
    strength_strain: Positive | None = None


@final
@dataclass(frozen=True)
class MassTable:
    """Mass beyond that of the film.

    Args:
        node_mass_kg: at every node of the unrefined mesh.
        seam_mass_kg: at every node of its outer rings (a unit's frame), in addition.

    A refined mesh spreads the same totals evenly over its nodes; one refined at the holes, evenly over the
    area around each node of the drawn mesh.
    """

    node_mass_kg: NonNegative = 0.0
    seam_mass_kg: NonNegative = 0.0
