"""Constant-strain film triangles in plane stress, under one of three laws on the Green strain.

With F = sum_a x_a g_a^T (3 x 2), E = (F^T F - 1) / 2, the energy density psi(E) of the law, the membrane
force N = dpsi/dE [N/m] and the tangent C = dN/dE,
    energy = A psi,
    gradient_a = A F N g_a,
    hessian_ab = A ((g_a . N g_b) 1 + B_a^T C B_b),   B_a = dE/dx_a.
Laws: "plain", St. Venant-Kirchhoff, psi = E : C : E / 2; "tension_field" and "edge_strain", see their files.
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
    add_block,
    device_function,
    kernel,
)
from cosim.errors import MeshError
from cosim.soft.elements.element import NODES, ROWS, STILL, DirectElement, Instant
from cosim.soft.elements.material import PLAIN, TENSION_FIELD, Film
from cosim.soft.elements.membrane_gradient import add_membrane_gradients, in_lanes
from cosim.soft.elements.tension_field import film_states, tension_field
from cosim.soft.published.edge_strain import edge_strain


@device_function
def _columns(x, triangle, g, f):  # type: ignore[no-untyped-def]
    """Fill f = F^T (2, 3) for one triangle and return E11, E22, 2 E12."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    for k in range(3):
        d1 = x[b, k] - x[a, k]
        d2 = x[c, k] - x[a, k]
        f[0, k] = d1 * g[1, 0] + d2 * g[2, 0]
        f[1, k] = d1 * g[1, 1] + d2 * g[2, 1]
    e11 = 0.5 * (f[0, 0] * f[0, 0] + f[0, 1] * f[0, 1] + f[0, 2] * f[0, 2] - 1.0)
    e22 = 0.5 * (f[1, 0] * f[1, 0] + f[1, 1] * f[1, 1] + f[1, 2] * f[1, 2] - 1.0)
    e12 = f[0, 0] * f[1, 0] + f[0, 1] * f[1, 1] + f[0, 2] * f[1, 2]
    return e11, e22, e12


@device_function
def _pair_block(f, stiffness, ga, gb, geometric, area, out):  # type: ignore[no-untyped-def]
    """Fill out = area (geometric 1 + B_a^T C B_b) with B_a = u1_a f1^T + u2_a f2^T."""
    # C u_q for u_1 = (gb0, 0, gb1) and u_2 = (0, gb1, gb0), in the strain components (E11, E22, 2 E12)
    p0 = stiffness[0, 0] * gb[0] + stiffness[0, 2] * gb[1]
    p1 = stiffness[1, 0] * gb[0] + stiffness[1, 2] * gb[1]
    p2 = stiffness[2, 0] * gb[0] + stiffness[2, 2] * gb[1]
    q0 = stiffness[0, 1] * gb[1] + stiffness[0, 2] * gb[0]
    q1 = stiffness[1, 1] * gb[1] + stiffness[1, 2] * gb[0]
    q2 = stiffness[2, 1] * gb[1] + stiffness[2, 2] * gb[0]
    c11 = area * (ga[0] * p0 + ga[1] * p2)
    c21 = area * (ga[1] * p1 + ga[0] * p2)
    c12 = area * (ga[0] * q0 + ga[1] * q2)
    c22 = area * (ga[1] * q1 + ga[0] * q2)
    for r in range(3):
        left1 = f[0, r] * c11 + f[1, r] * c21
        left2 = f[0, r] * c12 + f[1, r] * c22
        for c in range(3):
            out[r, c] = left1 * f[0, c] + left2 * f[1, c]
        out[r, r] += area * geometric


@device_function
def _first_node_blocks(k11, k21, k22, k10, k20, k00):  # type: ignore[no-untyped-def]
    """Fill the blocks of node 0: the gradients g_a sum to zero, so they follow from the others."""
    for r in range(3):
        for c in range(3):
            k10[r, c] = -k11[r, c] - k21[c, r]
            k20[r, c] = -k21[r, c] - k22[r, c]
    for r in range(3):
        for c in range(3):
            k00[r, c] = -k10[r, c] - k20[r, c]


@kernel(REAL(MATRIX, INDEX_TABLE, BLOCKS, VECTOR, MATRIX, MATRIX, INTEGER, REAL, INDEX_TABLE, MATRIX, BLOCKS))
def add_membranes(x, triangles, gradients, areas, drawn, stiffness, law, fraction, slots, gradient, blocks):  # type: ignore[no-untyped-def]
    """Add all triangles to gradient and, if slots is not empty, their Hessian to blocks.

    `law` is a law code of the film, `fraction` the compressive fraction. Returns the energy [J].
    """
    if law == PLAIN and slots.shape[0] == 0:
        return add_membrane_gradients(x, triangles, drawn, stiffness, gradient)
    f = np.empty((2, 3))
    fn = np.empty((2, 3))
    k11, k21, k22 = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    k10, k20, k00 = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    n = np.empty(3)
    rows = np.empty((3, 3))
    columns = np.empty((3, 3))
    tangent = stiffness.copy()
    with_hessian = slots.shape[0] > 0
    energy = 0.0
    for e in range(triangles.shape[0]):
        g = gradients[e]
        area = areas[e]
        e11, e22, e12 = _columns(x, triangles[e], g, f)
        if law == PLAIN:
            n11 = stiffness[0, 0] * e11 + stiffness[0, 1] * e22 + stiffness[0, 2] * e12
            n22 = stiffness[1, 0] * e11 + stiffness[1, 1] * e22 + stiffness[1, 2] * e12
            n12 = stiffness[2, 0] * e11 + stiffness[2, 1] * e22 + stiffness[2, 2] * e12
            energy += 0.5 * area * (e11 * n11 + e22 * n22 + e12 * n12)
        else:
            if law == TENSION_FIELD:
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
            _pair_block(f, tangent, g[1], g[1], s11, area, k11)
            _pair_block(f, tangent, g[2], g[1], s21, area, k21)
            _pair_block(f, tangent, g[2], g[2], s22, area, k22)
            _first_node_blocks(k11, k21, k22, k10, k20, k00)
            add_block(blocks, slots[e, 0], k00)
            add_block(blocks, slots[e, 1], k10)
            add_block(blocks, slots[e, 2], k11)
            add_block(blocks, slots[e, 3], k20)
            add_block(blocks, slots[e, 4], k21)
            add_block(blocks, slots[e, 5], k22)
    return energy


@kernel(MATRIX(MATRIX, INDEX_TABLE, BLOCKS, MATRIX, INTEGER, REAL))
def principal_forces(x, triangles, gradients, stiffness, law, fraction):  # type: ignore[no-untyped-def]
    """Return the principal membrane forces (m, 2) [N/m] of all triangles by the law, largest first."""
    principal = np.empty((triangles.shape[0], 2))
    f, n = np.empty((2, 3)), np.empty(3)
    tangent, rows, columns = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for e in range(triangles.shape[0]):
        e11, e22, e12 = _columns(x, triangles[e], gradients[e], f)
        if law == PLAIN:
            n[0] = stiffness[0, 0] * e11 + stiffness[0, 1] * e22 + stiffness[0, 2] * e12
            n[1] = stiffness[1, 0] * e11 + stiffness[1, 1] * e22 + stiffness[1, 2] * e12
            n[2] = stiffness[2, 0] * e11 + stiffness[2, 1] * e22 + stiffness[2, 2] * e12
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
        film: material.
    """

    label: ClassVar[str] = "triangles"
    merges: ClassVar[bool] = False
    counted: ClassVar[bool] = True

    triangles: Annotated[IntArray, NODES]
    shape_gradients: Annotated[Array, ROWS]
    areas: Annotated[Array, ROWS]
    film: Film

    @classmethod
    def from_shape(cls, positions: Array, triangles: IntArray, film: Film) -> Membranes:
        """Return the triangles, stress free in the given shape.

        Args:
            positions: (n, 3) [m], drawn shape.
            triangles: (m, 3) node indices.
            film: material.

        Raises:
            MeshError: a triangle has no area.
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
        return cls(triangles, gradients, 0.5 * twice_area, film)

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        energy: float = add_membranes(positions, *self._given, slots, gradient, blocks)
        return energy

    @cached_property
    def _given(self) -> tuple[IntArray, Array, Array, Array, Array, int, float]:
        """What the kernel takes of them."""
        return (
            self.triangles, self.shape_gradients, self.areas, in_lanes(self.shape_gradients, self.areas),
            self._stiffness, self.film.law_code, self.film.compressive_fraction,
        )  # fmt: skip

    @cached_property
    def _stiffness(self) -> Array:
        return self.film.membrane_stiffness

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
            film.law_code, film.compressive_fraction,
        )  # fmt: skip
        return forces / film.thickness_m
