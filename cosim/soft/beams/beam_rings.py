"""Stiffeners with a section: closed rings of beams whose nodes are nodes of the film; their strength.

The film has positions only, a beam also rotations of its ends. The rotations are unknowns of the ring alone
(loads and film do not act on them), so they are eliminated at their equilibrium:
    energy(x) = min over the turns R of the sum of all beams' energies(x, R),   see `ring_kernels`,
    gradient  = derivative by x at these turns,
    hessian   = E_xx - E_xR E_RR^-1 E_Rx,
a full matrix over the ring. A node rotates as one, so that corners of the drawn shape are rigid, and a
straight side of one beam or of eight has the same stiffness between its ends (`beam`): the energy is that of
a continuous ring, for any refinement. Without loads the ring has its drawn shape, scaled if its lengths are.
The memory holds the rotations of the last accepted state, as quaternions in axes of the ring, and a factor of
E_RR; both start the next solution.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, cross
from cosim.errors import InputError, MeshError
from cosim.soft.beams.ring_kernels import BAND, BeamArrays, add_beam_rings, peak_strains, ring_axes
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.element import NODES, ROWS, Call, LeafElement, Remembered, writable


@final
@dataclass(frozen=True)
class RectangularSection:
    """Rectangular section of a beam along a ring, of an isotropic material.

    Args:
        width_m: b, in the plane of the ring.
        height_m: h, across that plane.
        young_modulus_Pa: E.
        poisson_ratio: nu; the shear modulus is G = E / (2 (1 + nu)).
        strength_strain: largest strain that the material bears; infinite if not known.

    Raises:
        InputError: a constant out of its bounds.
    """

    width_m: float
    height_m: float
    young_modulus_Pa: float
    poisson_ratio: float = 0.35
    strength_strain: float = math.inf

    def __post_init__(self) -> None:
        for name in ("width_m", "height_m", "young_modulus_Pa"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} is {getattr(self, name)}; it must be positive and finite")
        if not self.strength_strain > 0.0:
            raise InputError(f"strength_strain is {self.strength_strain}; it must be positive")
        if not -1.0 < self.poisson_ratio <= 0.5:
            raise InputError(
                f"poisson_ratio is {self.poisson_ratio}; it must lie above -1 and be 0.5 at most"
            )

    @property
    def area_m2(self) -> float:
        """A = b h."""
        return self.width_m * self.height_m

    @property
    def torsion_constant_m4(self) -> float:
        """J = s r^3 (1/3 - 64 r / (pi^5 s) sum over odd n of tanh(n pi s / (2 r)) / n^5), r <= s the sides.

        Source: Saint-Venant's solution, e.g. Timoshenko and Goodier, Theory of Elasticity, section 109.
        """
        short, long = sorted((self.width_m, self.height_m))
        series = sum(math.tanh(0.5 * n * math.pi * long / short) / n**5 for n in range(1, 12, 2))
        return long * short**3 * (1.0 / 3.0 - 64.0 * short / (math.pi**5 * long) * series)

    @property
    def rigidities(self) -> Array:
        """(4,): E A [N]; E h b^3 / 12 in the plane, E b h^3 / 12 out of it, G J [N m^2]."""
        e, b, h = self.young_modulus_Pa, self.width_m, self.height_m
        shear = 0.5 * e / (1.0 + self.poisson_ratio)
        return np.array(
            [e * self.area_m2, e * h * b**3 / 12.0, e * b * h**3 / 12.0, shear * self.torsion_constant_m4]
        )


@final
@dataclass(frozen=True)
class BeamRings(LeafElement):
    """Stiffeners of one body; all rings have the same number of nodes.

    Args:
        rings: (f, m) nodes, in order around each ring.
        directors: (f, m, 3, 3), of the beam from each node to the next: along it, in the ring's plane, across
            it; in axes of the ring.
        lengths: (f, m) [m], without loads.
        section: of all beams.
    """

    label: ClassVar[str] = "beams"

    rings: Annotated[IntArray, NODES]
    directors: Annotated[Array, ROWS]
    lengths: Annotated[Array, ROWS]
    section: RectangularSection

    @classmethod
    def from_shape(
        cls, positions: Array, rings: IntArray, section: RectangularSection, ratio: float = 1.0
    ) -> "BeamRings":
        """Return stiffeners that are stress free where each ring is the given one, scaled about its centre.

        Args:
            positions: (n, 3) [m], drawn shape.
            rings: (f, m) nodes, in order around each ring.
            section: of all beams.
            ratio: scale; lengths without loads are ratio times those drawn.

        Raises:
            MeshError: a ring has fewer than 3 nodes, lies on a line, or has two nodes in one place.
        """
        rings = np.array(rings, dtype=np.int64, order="C")
        if rings.ndim != 2 or rings.shape[1] < 3:
            raise MeshError(
                f"rings of beams have shape {rings.shape}; (rings, nodes), at least 3 nodes, is needed"
            )
        if rings.size and (rings.min() < 0 or rings.max() >= len(positions)):
            raise MeshError(
                f"beams refer to node {int(rings.max())}; there are nodes 0 to {len(positions) - 1}"
            )
        drawn = np.array(positions, dtype=np.float64, order="C")
        point, following = drawn[rings], drawn[np.roll(rings, -1, axis=1)]
        lengths = np.linalg.norm(following - point, axis=2)
        centred = point - point.mean(axis=1, keepdims=True)
        normal = cross(centred, np.roll(centred, -1, axis=1)).sum(axis=1, keepdims=True)
        axes = ring_axes(drawn, rings)
        for number in range(len(rings)):
            if not lengths[number].min() > 1e-9 * lengths[number].max():
                raise MeshError(f"ring of beams {number} has two neighbouring nodes in one place")
            if not np.linalg.norm(normal[number]) > 1e-9 * lengths[number].sum() ** 2:
                raise MeshError(f"ring of beams {number} lies on a line; it needs a plane")
            if not np.isfinite(axes[number]).all():
                raise MeshError(f"ring of beams {number} has nodes 0, m // 3 and 2 m // 3 on a line")
        along = (following - point) / lengths[:, :, None]
        across = normal - (normal * along).sum(axis=2, keepdims=True) * along
        across /= np.linalg.norm(across, axis=2, keepdims=True)
        directors = np.stack([along, cross(across, along), across], axis=2)
        return cls(rings, np.ascontiguousarray(directors @ axes[:, None]), ratio * lengths, section)

    def drawn_lengths(self, positions: Array) -> Array:
        """Return the distances (f, m) [m] of neighbouring nodes in a shape (n, 3) [m]."""
        point = positions[self.rings]
        return np.asarray(np.linalg.norm(np.roll(point, -1, axis=1) - point, axis=2))

    def first_memory(self, positions: Array) -> Array:
        count, nodes = self.rings.shape
        return np.tile(np.append(np.tile([1.0, 0.0, 0.0, 0.0], nodes), np.zeros(3 * BAND * nodes)), count)

    def fresh(self, memory: Array) -> Array:
        """Return memory (m,) without factors, so that the tangents of rotations are computed again."""
        rows = memory.reshape(len(self.rings), -1).copy()
        rows[:, 4 * self.rings.shape[1] :] = 0.0
        return rows.ravel()

    @cached_property
    def arrays(self) -> BeamArrays:
        """The beams, for kernels."""
        rings, directors, lengths = writable(self.rings), writable(self.directors), writable(self.lengths)
        return BeamArrays(rings, directors, lengths, self.section.rigidities)

    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call:
        arrays = self.arrays._replace(moving=moving)
        return Call(add_beam_rings, (arrays, memory, slots, gradient, blocks))

    def peak_strains(self, positions: Array, memory: Array) -> Array:
        """Return the largest strain (f, m) of each beam's fibres.

        Args:
            positions: (n, 3) [m].
            memory: (values,), initial guess of the turns.
        """
        size = self.section.width_m, self.section.height_m
        return np.asarray(peak_strains(positions, self.arrays, *size, memory))


class StiffenerStrain(NamedTuple):
    """Strain of stiffeners, and their strength.

    Args:
        peak: largest strain of a fibre.
        strength: strain that their material bears; infinite if not known.
    """

    peak: float
    strength: float


def stiffener_strain(body: SoftBody, positions: Array) -> StiffenerStrain | None:
    """Return the strain of the stiffeners nearest to their strength, or farthest beyond it; None without any.

    Of stiffeners with unknown strength, the largest strain.

    Args:
        body: with or without rings of beams.
        positions: (n, 3) [m].
    """
    x, of_rings = np.array(positions, order="C"), list[StiffenerStrain]()
    for beams in body.of_kind(BeamRings):
        strains = beams.peak_strains(x, beams.first_memory(body.positions))
        of_rings.append(StiffenerStrain(float(strains.max()), beams.section.strength_strain))
    return max(of_rings, key=lambda strain: (strain.peak / strain.strength, strain.peak), default=None)


def stiffener_report(body: SoftBody) -> str:
    """Return a description of a body's stiffeners."""
    sections = dict.fromkeys(beams.section for beams in body.of_kind(BeamRings))
    texts = [
        f"beams of {1e3 * section.width_m:g} x {1e3 * section.height_m:g} mm, "
        f"{1e-9 * section.young_modulus_Pa:g} GPa"
        + (f", strength {100.0 * section.strength_strain:g} %" if section.strength_strain < math.inf else "")
        for section in sections
    ]
    texts += ["stiff"] if body.frames is not None else []
    return "; ".join(texts) or "none"
