"""The material of the film: elastic constants, thickness, and the law by which it answers to strain."""

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.soft.elements.fabric import Fabric

FilmLaw: TypeAlias = Literal["plain", "tension_field", "edge_strain", "wrinkling", "neo_hookean"]

# codes of the laws in kernels, see cosim.base.kernel_cache
PLAIN: Final = 0
TENSION_FIELD: Final = 1
EDGE_STRAIN: Final = 2
WRINKLING: Final = 3
STRAIGHTENING: Final = 4
NEO_HOOKEAN: Final = 5
_LAWS: dict[str, int] = {
    "plain": PLAIN,
    "tension_field": TENSION_FIELD,
    "edge_strain": EDGE_STRAIN,
    "wrinkling": WRINKLING,
    "neo_hookean": NEO_HOOKEAN,
}


@final
@dataclass(frozen=True)
class Film:
    """Elastic film, isotropic unless it is a fabric.

    Args:
        young_modulus_Pa: Young's modulus; of fabric E_1, along the warp.
        poisson_ratio: between -1 and 1 (plane stress; 1/2 is incompressible); of fabric nu.
        thickness_m: thickness.
        law: of the membrane force by strain.
        compressive_fraction: of the plain law's compressive stiffness that a "tension_field" keeps, 0 to 1.
        wrinkle_panel_m: width of the panels that a "wrinkling" film wrinkles in, such as from the seam to the
            hole; None: that of the mesh, which must have one.
        loss_factor: tan delta of the material; 0 for none.
        loss_frequency_Hz: at which it holds.
        fabric: further constants of woven film; its law is "plain" or "tension_field".
        buckling_force_N_m: compression across any line that a "tension_field" bears before it wrinkles.
        stiffening: c of "neo_hookean" rubber, which stiffens by 2 c i at i = tr C + 1 / det C - 3.

    Raises:
        InputError: a constant out of its bounds, an unknown law, or a constant that does not fit the law.
    """

    young_modulus_Pa: float
    poisson_ratio: float
    thickness_m: float
    law: FilmLaw = "plain"
    compressive_fraction: float = 0.0
    wrinkle_panel_m: float | None = None
    loss_factor: float = 0.0
    loss_frequency_Hz: float = 1.0
    fabric: Fabric | None = None
    buckling_force_N_m: float = 0.0
    stiffening: float = 0.0

    def __post_init__(self) -> None:
        for name in ("young_modulus_Pa", "thickness_m", "loss_frequency_Hz"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} is {getattr(self, name)}; it must be positive and finite")
        if not -1.0 < self.poisson_ratio < 1.0:
            raise InputError(
                f"poisson_ratio is {self.poisson_ratio}; it must lie between -1 and 1 (exclusive)"
            )
        if not 0.0 <= self.loss_factor < math.inf:
            raise InputError(f"loss_factor is {self.loss_factor}; it must be 0 or more, and finite")
        if self.law not in _LAWS:
            raise InputError(f"film law {self.law!r} is unknown; there are {', '.join(_LAWS)}")
        if self.law == "neo_hookean" and self.poisson_ratio != 0.5:
            raise InputError(f"film law 'neo_hookean' has poisson_ratio 0.5; it is {self.poisson_ratio}")
        if not 0.0 <= self.compressive_fraction <= 1.0:
            raise InputError(f"compressive_fraction is {self.compressive_fraction}; it must be 0 to 1")
        if self.compressive_fraction and self.law != "tension_field":
            raise InputError(f"compressive_fraction goes with law 'tension_field'; the law is {self.law!r}")
        if not 0.0 <= self.buckling_force_N_m < math.inf:
            raise InputError(
                f"buckling_force_N_m is {self.buckling_force_N_m}; it must be 0 or more, and finite"
            )
        if self.buckling_force_N_m and self.law != "tension_field":
            raise InputError(f"buckling_force_N_m goes with law 'tension_field'; the law is {self.law!r}")
        if not 0.0 <= self.stiffening < math.inf:
            raise InputError(f"stiffening is {self.stiffening}; it must be 0 or more, and finite")
        if self.stiffening and self.law != "neo_hookean":
            raise InputError(f"stiffening goes with law 'neo_hookean'; the law is {self.law!r}")
        if self.wrinkle_panel_m is not None:
            if not 0.0 < self.wrinkle_panel_m < math.inf:
                raise InputError(f"wrinkle_panel_m is {self.wrinkle_panel_m}; it must be positive and finite")
            if self.law != "wrinkling":
                raise InputError(f"wrinkle_panel_m goes with law 'wrinkling'; the law is {self.law!r}")
        if self.fabric is not None:
            self._check_fabric(self.fabric)

    def _check_fabric(self, fabric: Fabric) -> None:
        if self.law not in ("plain", "tension_field"):
            raise InputError(f"fabric has law 'plain' or 'tension_field'; the law is {self.law!r}")
        ratio = self.young_modulus_Pa / fabric.modulus_weft_Pa
        if not self.poisson_ratio**2 < ratio:
            raise InputError(
                f"poisson_ratio is {self.poisson_ratio}; its square must be less than the modulus along the "
                f"warp over that along the weft, {ratio:g}"
            )
        if (self.yarns[:, 0] < 0.0).any():
            raise InputError(
                f"straight_modulus_Pa is {fabric.straight_modulus_Pa}; yarns get no softer as they "
                f"straighten: {self.young_modulus_Pa:g} and {fabric.modulus_weft_Pa:g} Pa at least"
            )

    @property
    def law_code(self) -> int:
        """Code of the law in kernels; yarns that straighten have a separate one, plain or tension field."""
        return STRAIGHTENING if (self.yarns[:, 0] > 0.0).any() else _LAWS[self.law]

    @property
    def compression(self) -> Array:
        """(2,): fraction of the plain law's compressive stiffness in a tension field, and its force [N/m].

        A plain film keeps all of its stiffness.
        """
        remaining_fraction = 1.0 if self.law == "plain" else self.compressive_fraction
        return np.array([remaining_fraction, self.buckling_force_N_m])

    @property
    def loss_time_s(self) -> float:
        """tau [s] of a Kelvin-Voigt material with that loss factor at that frequency: tan delta / omega."""
        return self.loss_factor / (2.0 * math.pi * self.loss_frequency_Hz)

    @property
    def least_modulus_Pa(self) -> float:
        """The smaller one of the moduli along warp and weft; of isotropic film Young's modulus."""
        weft = self.young_modulus_Pa if self.fabric is None else self.fabric.modulus_weft_Pa
        return min(self.young_modulus_Pa, weft)

    @property
    def membrane_stiffness(self) -> Array:
        """(3, 3) [N/m]: maps (E11, E22, 2 E12) to (N11, N22, N12); of fabric without its straight yarns."""
        nu, fabric = self.poisson_ratio, self.fabric
        if fabric is None:
            factor = self.young_modulus_Pa * self.thickness_m / (1.0 - nu * nu)
            return factor * np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - nu)]])
        ratio = fabric.modulus_weft_Pa / self.young_modulus_Pa
        factor = self.young_modulus_Pa * self.thickness_m / (1.0 - nu * nu * ratio)
        shear = fabric.shear_modulus_Pa * self.thickness_m
        across = factor * nu * ratio
        return np.array([[factor, across, 0.0], [across, factor * ratio, 0.0], [0.0, 0.0, shear]])

    @property
    def yarns(self) -> Array:
        """(2, 2): growth of the stiffness along warp and weft [N/m], and the strain at which it ends."""
        fabric = self.fabric
        if fabric is None:
            return np.array([[0.0, 1.0], [0.0, 1.0]])
        drawn = self.young_modulus_Pa, fabric.modulus_weft_Pa
        grown = self.thickness_m * (np.array(fabric.straight_modulus_Pa) - drawn)
        return np.stack([grown, np.array(fabric.straight_strain)], axis=1)

    @property
    def bending_stiffness_Nm(self) -> float:
        """E t^3 / 12 [N m], the paper's hinge stiffness for unit edge factor; E of fabric: sqrt(E_1 E_2)."""
        modulus_Pa = self.young_modulus_Pa
        if self.fabric is not None:
            modulus_Pa = math.sqrt(modulus_Pa * self.fabric.modulus_weft_Pa)
        return modulus_Pa * self.thickness_m**3 / 12.0

    @property
    def flexural_rigidity_Nm(self) -> float:
        """E t^3 / (12 (1 - nu^2)) [N m], bending moment per width over curvature.

        Of fabric, sqrt(E_1 E_2) t^3 / (12 (1 - nu^2 E_2 / E_1)), whichever direction is called the warp.
        """
        weft = 1.0 if self.fabric is None else self.fabric.modulus_weft_Pa / self.young_modulus_Pa
        return self.bending_stiffness_Nm / (1.0 - self.poisson_ratio**2 * weft)
