"""Constant-strain film triangles in plane stress, under one of four laws on the Green strain.

With F = sum_a x_a g_a^T (3 x 2), E = (F^T F - 1) / 2, the energy density psi(E) of the law, the membrane
force N = dpsi/dE [N/m] and the tangent C = dN/dE,
    energy = A psi,
    gradient_a = A F N g_a,
    hessian_ab = A ((g_a . N g_b) 1 + B_a^T C B_b),   B_a = dE/dx_a.
Laws: "plain", St. Venant-Kirchhoff, psi = E : C : E / 2; "wrinkling", "tension_field" and "edge_strain", see
their files.
Source: any text on nonlinear finite elements, e.g. Bonet and Wood, chapter 9.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import (
    BLOCKS,
    INDEX_TABLE,
    INTEGER,
    MATRIX,
    REAL,
    VECTOR,
    kernel,
    small_matrix,
    small_vector,
)
from cosim.errors import InputError, MeshError
from cosim.soft.elements.element import NODES, ROWS, STILL, DirectElement, Instant
from cosim.soft.elements.material import PLAIN, TENSION_FIELD, WRINKLING, Film
from cosim.soft.elements.membrane_blocks import deformation, first_node_blocks, pair_block
from cosim.soft.elements.membrane_gradient import add_membrane_gradients, in_lanes
from cosim.soft.elements.tension_field import film_states, tension_field
from cosim.soft.elements.wrinkling import wrinkling, wrinkling_forces
from cosim.soft.linear.pattern import add_block
from cosim.soft.published.edge_strain import edge_strain


@kernel(
    REAL(
        MATRIX,
        INDEX_TABLE,
        BLOCKS,
        VECTOR,
        MATRIX,
        MATRIX,
        INTEGER,
        REAL,
        MATRIX,
        INDEX_TABLE,
        MATRIX,
        BLOCKS,
    )
)
def add_membranes(  # type: ignore[no-untyped-def]
    x, triangles, gradients, areas, drawn, stiffness, law, fraction, forces, slots, gradient, blocks
):
    """Add all triangles to gradient and, if slots is not empty, their Hessian to blocks.

    `law` is a law code of the film, `fraction` the compressive fraction, `forces` those of
    `wrinkling_forces`, empty for other laws. Returns the energy [J].
    """
    if law in (PLAIN, WRINKLING) and slots.shape[0] == 0:
        return add_membrane_gradients(x, triangles, drawn, stiffness, forces, gradient)
    f, fn, n = small_matrix(2, 3), small_matrix(2, 3), small_vector(3)
    k11, k21, k22 = small_matrix(3, 3), small_matrix(3, 3), small_matrix(3, 3)
    k10, k20, k00 = small_matrix(3, 3), small_matrix(3, 3), small_matrix(3, 3)
    rows, columns, tangent = small_matrix(3, 3), small_matrix(3, 3), small_matrix(3, 3)
    for r in range(3):
        for c in range(3):
            tangent[r, c] = stiffness[r, c]
    with_hessian, energy = slots.shape[0] > 0, 0.0
    for e in range(triangles.shape[0]):
        g, area = gradients[e], areas[e]
        e11, e22, e12 = deformation(x, triangles[e], g, f)
        if law == PLAIN:
            n11 = stiffness[0, 0] * e11 + stiffness[0, 1] * e22 + stiffness[0, 2] * e12
            n22 = stiffness[1, 0] * e11 + stiffness[1, 1] * e22 + stiffness[1, 2] * e12
            n12 = stiffness[2, 0] * e11 + stiffness[2, 1] * e22 + stiffness[2, 2] * e12
            energy += 0.5 * area * (e11 * n11 + e22 * n22 + e12 * n12)
        else:
            if law == WRINKLING:
                density = wrinkling(e11, e22, e12, stiffness, forces[e, 0], forces[e, 1], n, tangent)
            elif law == TENSION_FIELD:
                density = tension_field(e11, e22, e12, stiffness, fraction, n, tangent)
            else:
                density = edge_strain(e11, e22, e12, g, stiffness, rows, columns, n, tangent)
            n11, n22, n12 = n[0], n[1], n[2]
            energy += area * density
        for k in range(3):
            fn[0, k] = area * (f[0, k] * n11 + f[1, k] * n12)
            fn[1, k] = area * (f[0, k] * n12 + f[1, k] * n22)
        i0, i1, i2 = triangles[e, 0], triangles[e, 1], triangles[e, 2]
        for k in range(3):
            r1 = fn[0, k] * g[1, 0] + fn[1, k] * g[1, 1]
            r2 = fn[0, k] * g[2, 0] + fn[1, k] * g[2, 1]
            gradient[i1, k] += r1
            gradient[i2, k] += r2
            gradient[i0, k] -= r1 + r2
        if with_hessian:
            s11 = g[1, 0] * (n11 * g[1, 0] + n12 * g[1, 1]) + g[1, 1] * (n12 * g[1, 0] + n22 * g[1, 1])
            s21 = g[2, 0] * (n11 * g[1, 0] + n12 * g[1, 1]) + g[2, 1] * (n12 * g[1, 0] + n22 * g[1, 1])
            s22 = g[2, 0] * (n11 * g[2, 0] + n12 * g[2, 1]) + g[2, 1] * (n12 * g[2, 0] + n22 * g[2, 1])
            pair_block(f, tangent, g[1], g[1], s11, area, k11)
            pair_block(f, tangent, g[2], g[1], s21, area, k21)
            pair_block(f, tangent, g[2], g[2], s22, area, k22)
            first_node_blocks(k11, k21, k22, k10, k20, k00)
            add_block(blocks, slots[e, 0], k00)
            add_block(blocks, slots[e, 1], k10)
            add_block(blocks, slots[e, 2], k11)
            add_block(blocks, slots[e, 3], k20)
            add_block(blocks, slots[e, 4], k21)
            add_block(blocks, slots[e, 5], k22)
    return energy


@kernel(MATRIX(MATRIX, INDEX_TABLE, BLOCKS, MATRIX, INTEGER, REAL, MATRIX), allocates=True)
def principal_forces(x, triangles, gradients, stiffness, law, fraction, forces):  # type: ignore[no-untyped-def]
    """Return the principal membrane forces (m, 2) [N/m] of all triangles by the law, largest first."""
    principal = np.empty((triangles.shape[0], 2))
    f, n = small_matrix(2, 3), small_vector(3)
    tangent, rows, columns = small_matrix(3, 3), small_matrix(3, 3), small_matrix(3, 3)
    for e in range(triangles.shape[0]):
        e11, e22, e12 = deformation(x, triangles[e], gradients[e], f)
        if law == PLAIN:
            n[0] = stiffness[0, 0] * e11 + stiffness[0, 1] * e22 + stiffness[0, 2] * e12
            n[1] = stiffness[1, 0] * e11 + stiffness[1, 1] * e22 + stiffness[1, 2] * e12
            n[2] = stiffness[2, 0] * e11 + stiffness[2, 1] * e22 + stiffness[2, 2] * e12
        elif law == WRINKLING:
            wrinkling(e11, e22, e12, stiffness, forces[e, 0], forces[e, 1], n, tangent)
        elif law == TENSION_FIELD:
            tension_field(e11, e22, e12, stiffness, fraction, n, tangent)
        else:
            edge_strain(e11, e22, e12, gradients[e], stiffness, rows, columns, n, tangent)
        half = 0.5 * (n[0] - n[1])
        mean, radius = 0.5 * (n[0] + n[1]), np.sqrt(half * half + n[2] * n[2])
        principal[e, 0], principal[e, 1] = mean + radius, mean - radius
    return principal


@final
@dataclass(frozen=True)
class Membranes(DirectElement):
    """Film triangles of one material.

    Args:
        triangles: (m, 3) node indices.
        shape_gradients: (m, 3, 2) [1/m], g_a in each triangle's own plane axes.
        areas: (m,) [m^2], drawn shape.
        wrinkle_panel_m: (m,) [m], of the panels in which a "wrinkling" film wrinkles; 0 where nobody said it.
        film: material.

    Raises:
        InputError: the film wrinkles, and nothing says how wide its panels are.
    """

    label: ClassVar[str] = "triangles"
    merges: ClassVar[bool] = False
    counted: ClassVar[bool] = True

    triangles: Annotated[IntArray, NODES]
    shape_gradients: Annotated[Array, ROWS]
    areas: Annotated[Array, ROWS]
    wrinkle_panel_m: Annotated[Array, ROWS]
    film: Film

    def __post_init__(self) -> None:
        if self.film.law == "wrinkling" and not (self._panel_m > 0.0).all():
            raise InputError(
                "film law 'wrinkling' needs the width of the panels that wrinkle; the mesh does not know it: "
                "give wrinkle_panel_m, such as the distance between a seam and a hole"
            )

    @classmethod
    def from_shape(
        cls, positions: Array, triangles: IntArray, film: Film, wrinkle_panel_m: Array | None = None
    ) -> Membranes:
        """Return the triangles, stress free in the given shape.

        Args:
            positions: (n, 3) [m], drawn shape.
            triangles: (m, 3) node indices.
            film: material.
            wrinkle_panel_m: (m,) [m], see the class.

        Raises:
            MeshError: a triangle has no area.
            InputError: the film wrinkles, and nothing says how wide its panels are.
        """
        d1 = positions[triangles[:, 1]] - positions[triangles[:, 0]]
        d2 = positions[triangles[:, 2]] - positions[triangles[:, 0]]
        normal = np.cross(d1, d2)
        twice_area = np.linalg.norm(normal, axis=1)
        longest = np.maximum((d1**2).sum(1), (d2**2).sum(1))
        bad = np.flatnonzero(~(twice_area > 1e-9 * longest))
        if len(bad):
            e = int(bad[0])
            raise MeshError(
                f"triangle {e} (nodes {triangles[e].tolist()}) has area {0.5 * twice_area[e]:.3g} m^2; "
                f"a film triangle needs an area above 1e-9 of its longest edge squared; "
                f"{len(bad)} of {len(triangles)} triangles fall short"
            )
        axis1 = d1 / np.linalg.norm(d1, axis=1)[:, None]
        axis2 = np.cross(normal / twice_area[:, None], axis1)
        # rows of the inverse of [[d1.a1, d2.a1], [0, d2.a2]] are the gradients of nodes 1 and 2
        a, b, d = (d1 * axis1).sum(1), (d2 * axis1).sum(1), (d2 * axis2).sum(1)
        gradients = np.zeros((len(triangles), 3, 2))
        gradients[:, 1] = np.stack([1.0 / a, -b / (a * d)], axis=1)
        gradients[:, 2, 1] = 1.0 / d
        gradients[:, 0] = -gradients[:, 1] - gradients[:, 2]
        panel = (
            np.zeros(len(triangles))
            if wrinkle_panel_m is None
            else np.array(wrinkle_panel_m, dtype=np.float64)
        )
        return cls(triangles, gradients, 0.5 * twice_area, panel, film)

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        energy: float = add_membranes(positions, *self.arrays, slots, gradient, blocks)
        return energy

    @cached_property
    def arrays(self) -> tuple[IntArray, Array, Array, Array, Array, int, float, Array]:
        """What `add_membranes` takes of them."""
        return (
            self.triangles, self.shape_gradients, self.areas, in_lanes(self.shape_gradients, self.areas),
            self._stiffness, self.film.law_code, self.film.compressive_fraction, self._forces,
        )  # fmt: skip

    @cached_property
    def _stiffness(self) -> Array:
        return self.film.membrane_stiffness

    @property
    def _panel_m(self) -> Array:
        stated = self.film.wrinkle_panel_m
        return self.wrinkle_panel_m if stated is None else np.full(len(self.triangles), stated)

    @cached_property
    def _forces(self) -> Array:
        film = self.film
        if film.law != "wrinkling":
            return np.zeros((0, 2))
        young_N_m = film.young_modulus_Pa * film.thickness_m
        return wrinkling_forces(film.flexural_rigidity_Nm, young_N_m, self._panel_m, self.areas)

    def strain(self, positions: Array) -> Array:
        """Return the Green strain (m, 3) as (E11, E22, 2 E12) in each triangle's axes.

        Args:
            positions: (n, 3) [m].
        """
        f = np.einsum("mak,mai->mik", positions[self.triangles], self.shape_gradients)
        metric = np.einsum("mik,mjk->mij", f, f)
        return np.stack([0.5 * (metric[:, 0, 0] - 1), 0.5 * (metric[:, 1, 1] - 1), metric[:, 0, 1]], axis=1)

    def states(self, positions: Array) -> IntArray:
        """Return SLACK, WRINKLED or TAUT (m,), as a tension field would have each triangle.

        Args:
            positions: (n, 3) [m].
        """
        return film_states(self.strain(positions), self.film.poisson_ratio)

    def principal_stress(self, positions: Array) -> Array:
        """Return the principal second Piola-Kirchhoff stresses (m, 2) [Pa] of the law, largest first.

        Args:
            positions: (n, 3) [m].
        """
        film = self.film
        forces: Array = principal_forces(
            np.ascontiguousarray(positions), self.triangles, self.shape_gradients, self._stiffness,
            film.law_code, film.compressive_fraction, self._forces,
        )  # fmt: skip
        return forces / film.thickness_m
