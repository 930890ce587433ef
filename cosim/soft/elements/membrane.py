"""Constant-strain film triangles in plane stress, under one of five laws on the Green strain.

Energy and gradient are computed in groups, one triangle per lane. With F = sum_a x_a g_a^T (3 x 2),
E = (F^T F - 1) / 2, the energy density psi(E) of the law, the membrane force N = dpsi/dE [N/m] and the
tangent C = dN/dE,
    energy = A psi,
    gradient_a = A F N g_a,
    hessian_ab = A ((g_a . N g_b) 1 + B_a^T C B_b),   B_a = dE/dx_a.
Laws: "plain", St. Venant-Kirchhoff, psi = E : C : E / 2; "wrinkling", "tension_field" and "edge_strain",
see their modules; "neo_hookean", see below. The axes of E are along a triangle's first edge and across; of
fabric they are warp and weft, so that all triangles have one C, and its yarns straighten, see `fabric`.
Source: any text on nonlinear finite elements, e.g. Bonet and Wood, chapter 9.
"neo_hookean", an incompressible membrane, such as silicone, whose thickness follows from its area: with
C = 2 E + 1, J = det C (the square of the stretch of area) and the shear modulus mu = E_0 / 3,
    psi = mu t (i + c i^2) / 2,   i = tr C + 1 / J - 3,   N = (1 + 2 c i) mu t (1 - C^-1 / J).
c, `Film.stiffening`, is 0 for neo-Hookean rubber; with it this is Yeoh's law without its third term.
psi is convex in E. At small strain it is the plain law of Young's modulus E_0 and Poisson's ratio 1/2. A
sphere of drawn radius R has p = 2 mu t / R (1 / l - 1 / l^7), largest at the stretch l = 7^(1/6).
Source: Holzapfel, Nonlinear Solid Mechanics, section 6.5; Mueller and Strehlow, Rubber and Rubber Balloons,
chapter 2; Yeoh, Rubber Chemistry and Technology 66 (1993) 754.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.errors import InputError, MeshError
from cosim.soft.elements.edge_strain import edge_strain
from cosim.soft.elements.element import NODES, ROWS, Call, LeafElement, Remembered, writable
from cosim.soft.elements.material import NEO_HOOKEAN, PLAIN, STRAIGHTENING, TENSION_FIELD, WRINKLING, Film
from cosim.soft.elements.tension_field import tension_field
from cosim.soft.elements.wrinkling import (
    density,
    hide_across,
    principal,
    turn_forces,
    wrinkling,
    wrinkling_forces,
)
from cosim.soft.linear.pattern import add_block


@device_function
def neo_hookean(
    strain: tuple[float, float, float], shear: float, stiffening: float, n: Vector, c: Matrix
) -> float:
    """Fill n (3,) and c (3, 3), first and second derivative of the energy density by (E11, E22, 2 E12).

    Args:
        strain: E11, E22, 2 E12.
        shear: mu t [N/m].
        stiffening: c of the module's text.
        n: filled.
        c: filled.

    Returns:
        Energy density [J/m^2]; infinite where the film has no area.
    """
    c11, c22, c12 = 1.0 + 2.0 * strain[0], 1.0 + 2.0 * strain[1], strain[2]
    inverse = 1.0 / (c11 * c22 - c12 * c12)
    square = shear * inverse * inverse
    n[0], n[1], n[2] = shear - square * c22, shear - square * c11, square * c12
    cube = 4.0 * square * inverse
    c[0, 0], c[1, 1], c[2, 2] = cube * c22 * c22, cube * c11 * c11, square + cube * c12 * c12
    c[0, 1] = c[1, 0] = cube * c11 * c22 - 2.0 * square
    c[0, 2] = c[2, 0] = -cube * c22 * c12
    c[1, 2] = c[2, 1] = -cube * c11 * c12
    i = c11 + c22 + inverse - 3.0
    if stiffening == 0.0:
        return 0.5 * shear * i  # infinite where the film has no area, which 0 times i is not
    growth, outer = 1.0 + 2.0 * stiffening * i, 4.0 * stiffening / shear
    for r in range(3):
        for s in range(3):
            c[r, s] = growth * c[r, s] + outer * n[r] * n[s]
    for r in range(3):
        n[r] *= growth
    return 0.5 * shear * i * (1.0 + stiffening * i)


@device_function
def deformation(x: Matrix, triangle: Indices, g: Matrix, f: Matrix) -> tuple[float, float, float]:
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
def _pair_block(
    f: Matrix, stiffness: Matrix, pair: tuple[Vector, Vector], n: Vector, area: float, out: Matrix
) -> None:
    """Fill out = area ((g_a . N g_b) 1 + B_a^T C B_b) with B_a = u1_a f1^T + u2_a f2^T."""
    ga, gb = pair
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
    geometric = ga[0] * (n[0] * gb[0] + n[2] * gb[1]) + ga[1] * (n[2] * gb[0] + n[1] * gb[1])
    for r in range(3):
        left1 = f[0, r] * c11 + f[1, r] * c21
        left2 = f[0, r] * c12 + f[1, r] * c22
        for c in range(3):
            out[r, c] = left1 * f[0, c] + left2 * f[1, c]
        out[r, r] += area * geometric


class MembraneRows(NamedTuple):
    """Film triangles of one material, for kernels.

    Args:
        triangles: (m, 3) node indices.
        gradients: (m, 3, 2), see `Membranes`.
        areas: (m,) [m^2].
        drawn: (groups, 5 LANES), see `in_lanes`.
        stiffness: (3, 3) [N/m].
        law: code of the film's law.
        compression: (2,), see `Film.compression`.
        forces: (m, 2) [N/m], see `wrinkling_forces`; empty for other laws.
        yarns: (2, 2), see `Film.yarns`.
        stiffening: see `Film.stiffening`.
    """

    triangles: IndexTable
    gradients: Blocks
    areas: Vector
    drawn: Matrix
    stiffness: Matrix
    law: int
    compression: Vector
    forces: Matrix
    yarns: Matrix
    stiffening: float


# Quantity q of a lane is at s[q * LANES + lane], as in `hinge`.
LANES = 64
_D1, _D2, ENERGY, STRAIN, FORCE = 0, 3 * LANES, 6 * LANES, 7 * LANES, 10 * LANES
_WHICH, _PLATE, _HARDENING, _FIRST, _FOUND = (LANES * place for place in (13, 14, 15, 16, 17))
SIZE = 21 * LANES
_STRIDE = 8  # lanes of the widest registers; wrinkled triangles are padded to a multiple of it


def in_lanes(shape_gradients: Array, areas: Array) -> Array:
    """Return g_1 (2), g_2 (2) and A of all triangles by group and lane (groups, 5 LANES), spare lanes zero.

    Args:
        shape_gradients: (m, 3, 2) [1/m].
        areas: (m,) [m^2].
    """
    groups = -(-len(areas) // LANES)
    values = np.zeros((5, groups * LANES))
    values[:4, : len(areas)] = shape_gradients[:, 1:].reshape(-1, 4).T
    values[4, : len(areas)] = areas
    return np.ascontiguousarray(values.reshape(5, groups, LANES).transpose(1, 0, 2).reshape(groups, -1))


@device_function
def stretch(x: Matrix, film: MembraneRows, first: int, lanes: int, drawn: Vector, s: Vector) -> None:
    """Fill F^T and strains, and forces A N and energies of the plain law, of a group of triangles.

    Spare lanes repeat the first triangle. Node indices are unsigned, so that no test for negative indices is
    compiled.
    """
    triangles, stiffness = film.triangles, film.stiffness
    for lane in range(LANES):  # both edges from node 0
        e = first + (lane if lane < lanes else 0)
        i, j, k = np.uint64(triangles[e, 0]), np.uint64(triangles[e, 1]), np.uint64(triangles[e, 2])
        for r in range(3):
            s[_D1 + r * LANES + lane] = x[j, r] - x[i, r]
            s[_D2 + r * LANES + lane] = x[k, r] - x[i, r]
    c00, c01, c02 = stiffness[0, 0], stiffness[0, 1], stiffness[0, 2]
    c10, c11, c12 = stiffness[1, 0], stiffness[1, 1], stiffness[1, 2]
    c20, c21, c22 = stiffness[2, 0], stiffness[2, 1], stiffness[2, 2]
    for lane in range(LANES):
        ax, ay = drawn[lane], drawn[LANES + lane]
        bx, by = drawn[2 * LANES + lane], drawn[3 * LANES + lane]
        area = drawn[4 * LANES + lane]
        d0, d1, d2 = s[_D1 + lane], s[_D1 + LANES + lane], s[_D1 + 2 * LANES + lane]
        h0, h1, h2 = s[_D2 + lane], s[_D2 + LANES + lane], s[_D2 + 2 * LANES + lane]
        f0, f1, f2 = d0 * ax + h0 * bx, d1 * ax + h1 * bx, d2 * ax + h2 * bx
        k0, k1, k2 = d0 * ay + h0 * by, d1 * ay + h1 * by, d2 * ay + h2 * by
        e11 = 0.5 * (f0 * f0 + f1 * f1 + f2 * f2 - 1.0)
        e22 = 0.5 * (k0 * k0 + k1 * k1 + k2 * k2 - 1.0)
        e12 = f0 * k0 + f1 * k1 + f2 * k2
        n11 = area * (c00 * e11 + c01 * e22 + c02 * e12)
        n22 = area * (c10 * e11 + c11 * e22 + c12 * e12)
        n12 = area * (c20 * e11 + c21 * e22 + c22 * e12)
        s[ENERGY + lane] = 0.5 * (e11 * n11 + e22 * n22 + e12 * n12)
        s[_D1 + lane], s[_D2 + lane] = f0, k0
        s[_D1 + LANES + lane], s[_D2 + LANES + lane] = f1, k1
        s[_D1 + 2 * LANES + lane], s[_D2 + 2 * LANES + lane] = f2, k2
        s[STRAIN + lane], s[STRAIN + LANES + lane], s[STRAIN + 2 * LANES + lane] = e11, e22, e12
        s[FORCE + lane], s[FORCE + LANES + lane], s[FORCE + 2 * LANES + lane] = n11, n22, n12


@device_function
def _wrinkle(drawn: Vector, forces: Matrix, lanes: int, stiffness: Matrix, s: Vector) -> None:
    """Replace forces A N and energies where a triangle is not taut.

    Such lanes are listed, their strains, s0 and f0 moved to the front; the last is
    repeated up to the next multiple of the registers' lanes.
    """
    n, no_tangent = small_vector(3), small_matrix(0, 0)
    count = 0
    for lane in range(lanes):
        area = drawn[4 * LANES + lane]
        n11, n22, n12 = s[FORCE + lane], s[FORCE + LANES + lane], s[FORCE + 2 * LANES + lane]
        above, half = 0.5 * (n11 + n22) + area * forces[lane, 0], 0.5 * (n11 - n22)
        if above >= 0.0 and above * above >= half * half + n12 * n12:
            continue
        s[_WHICH + count], s[_PLATE + count], s[_HARDENING + count] = lane, forces[lane, 0], forces[lane, 1]
        for r in range(3):
            s[STRAIN + r * LANES + count] = s[STRAIN + r * LANES + lane]
        count += 1
    for spare in range(count, -(-count // _STRIDE) * _STRIDE):
        for quantity in (_PLATE, _HARDENING, STRAIN, STRAIN + LANES, STRAIN + 2 * LANES):
            s[quantity + spare] = s[quantity + count - 1]
    for lane in range(-(-count // _STRIDE) * _STRIDE):  # as if wrinkled; N1 shows whether it is
        plate, hardening = s[_PLATE + lane], s[_HARDENING + lane]
        e11, e22, e12 = s[STRAIN + lane], s[STRAIN + LANES + lane], s[STRAIN + 2 * LANES + lane]
        e1, e2, cosine, sine = principal(e11, e22, e12)
        r2, first = hide_across(e1, e2, stiffness, plate, hardening)
        n11, n22, n12 = turn_forces(first, -plate - r2, cosine, sine)
        s[_FOUND + lane], s[_FOUND + LANES + lane], s[_FOUND + 2 * LANES + lane] = n11, n22, n12
        s[_FOUND + 3 * LANES + lane] = density((e1, e2), first, (0.0, r2), plate, hardening)
        s[_FIRST + lane] = first
    for q in range(count):
        lane = int(s[_WHICH + q])
        area, psi, plate = drawn[4 * LANES + lane], s[_FOUND + 3 * LANES + q], s[_PLATE + q]
        n[0], n[1], n[2] = s[_FOUND + q], s[_FOUND + LANES + q], s[_FOUND + 2 * LANES + q]
        if s[_FIRST + q] < -plate:  # slack
            strain = s[STRAIN + q], s[STRAIN + LANES + q], s[STRAIN + 2 * LANES + q]
            psi = wrinkling(strain, stiffness, plate, s[_HARDENING + q], n, no_tangent)
        s[ENERGY + lane] = area * psi
        for r in range(3):
            s[FORCE + r * LANES + lane] = area * n[r]


@device_function
def scatter(
    drawn: Vector, triangles: IndexTable, first: int, lanes: int, s: Vector, gradient: Matrix
) -> float:
    """Replace F^T by the gradients of nodes 1 and 2, and add a group to gradient; return its energy."""
    for lane in range(LANES):
        ax, ay = drawn[lane], drawn[LANES + lane]
        bx, by = drawn[2 * LANES + lane], drawn[3 * LANES + lane]
        f0, f1, f2 = s[_D1 + lane], s[_D1 + LANES + lane], s[_D1 + 2 * LANES + lane]
        k0, k1, k2 = s[_D2 + lane], s[_D2 + LANES + lane], s[_D2 + 2 * LANES + lane]
        n11, n22, n12 = s[FORCE + lane], s[FORCE + LANES + lane], s[FORCE + 2 * LANES + lane]
        p1, q1 = n11 * ax + n12 * ay, n12 * ax + n22 * ay
        p2, q2 = n11 * bx + n12 * by, n12 * bx + n22 * by
        s[_D1 + lane], s[_D2 + lane] = f0 * p1 + k0 * q1, f0 * p2 + k0 * q2
        s[_D1 + LANES + lane], s[_D2 + LANES + lane] = f1 * p1 + k1 * q1, f1 * p2 + k1 * q2
        s[_D1 + 2 * LANES + lane], s[_D2 + 2 * LANES + lane] = f2 * p1 + k2 * q1, f2 * p2 + k2 * q2
    energy = 0.0
    for lane in range(LANES):
        if lane == lanes:
            break
        e = first + lane
        i, j, k = np.uint64(triangles[e, 0]), np.uint64(triangles[e, 1]), np.uint64(triangles[e, 2])
        energy += s[ENERGY + lane]
        for r in range(3):
            force_1, force_2 = s[_D1 + r * LANES + lane], s[_D2 + r * LANES + lane]
            gradient[j, r] += force_1
            gradient[k, r] += force_2
            gradient[i, r] -= force_1 + force_2
    return energy


@device_function
def _straighten(strain: tuple[float, float, float], yarns: Matrix, n: Vector, c: Matrix) -> float:
    """Add forces and stiffness of straightening yarns to n (3,) and c (3, 3); return the density [J/m^2].

    Law: see `fabric`. It has no compression and is convex, so a tension field with yarns is still one.

    Args:
        strain: E11, E22, 2 E12, along warp and weft.
        yarns: (2, 2), see `Film.yarns`.
        n: added to.
        c: added to.
    """
    density = 0.0
    for i in range(2):
        grown, full = yarns[i, 0], yarns[i, 1]
        bent = min(max(strain[i], 0.0), full)
        beyond = max(strain[i] - full, 0.0)
        n[i] += grown * (0.5 * bent * bent / full + beyond)
        c[i, i] += grown * bent / full
        density += grown * (bent * bent * bent / (6.0 * full) + 0.5 * beyond * (bent + beyond))
    return density


@device_function
def film_law(
    film: MembraneRows, e: int, strain: tuple[float, float, float], n: Vector, tangent: Matrix
) -> float:
    """Fill n (3,) and tangent (3, 3), derivatives of the energy density [J/m^2] of triangle e; return that.

    Of the plain law the tangent stays as it is.
    """
    stiffness = film.stiffness
    if film.law == WRINKLING:
        return wrinkling(strain, stiffness, film.forces[e, 0], film.forces[e, 1], n, tangent)
    if film.law == TENSION_FIELD:
        return tension_field(strain, stiffness, film.compression, n, tangent)
    if film.law == STRAIGHTENING:
        density = tension_field(strain, stiffness, film.compression, n, tangent)
        return density + _straighten(strain, film.yarns, n, tangent)
    if film.law == NEO_HOOKEAN:
        return neo_hookean(strain, stiffness[2, 2], film.stiffening, n, tangent)
    if film.law != PLAIN:
        return edge_strain(strain, film.gradients[e], stiffness, n, tangent)
    for r in range(3):
        n[r] = stiffness[r, 0] * strain[0] + stiffness[r, 1] * strain[1] + stiffness[r, 2] * strain[2]
    return 0.5 * (strain[0] * n[0] + strain[1] * n[1] + strain[2] * n[2])


@device_function
def add_hessian(
    f: Matrix, tangent: Matrix, n: Vector, film: tuple[Matrix, float], slots: Indices, blocks: Blocks
) -> None:
    """Add a triangle's Hessian; the gradients g_a sum to zero, so the blocks of node 0 follow from others."""
    g, area = film
    k11, k21, k22 = small_matrix(3, 3), small_matrix(3, 3), small_matrix(3, 3)
    k10, k20, k00 = small_matrix(3, 3), small_matrix(3, 3), small_matrix(3, 3)
    _pair_block(f, tangent, (g[1], g[1]), n, area, k11)
    _pair_block(f, tangent, (g[2], g[1]), n, area, k21)
    _pair_block(f, tangent, (g[2], g[2]), n, area, k22)
    for r in range(3):
        for c in range(3):
            k10[r, c] = -k11[r, c] - k21[c, r]
            k20[r, c] = -k21[r, c] - k22[r, c]
    for r in range(3):
        for c in range(3):
            k00[r, c] = -k10[r, c] - k20[r, c]
    add_block(blocks, slots[0], k00)
    add_block(blocks, slots[1], k10)
    add_block(blocks, slots[2], k11)
    add_block(blocks, slots[3], k20)
    add_block(blocks, slots[4], k21)
    add_block(blocks, slots[5], k22)


@kernel
def add_membranes(
    x: Matrix, film: MembraneRows, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add all triangles to gradient and, if slots is not empty, their Hessian to blocks.

    Returns the energy [J].
    """
    triangles, energy = film.triangles, 0.0
    if film.law in (PLAIN, WRINKLING) and slots.shape[0] == 0:
        s = small_vector(SIZE)
        for first in range(0, triangles.shape[0], LANES):
            lanes, group = min(LANES, triangles.shape[0] - first), film.drawn[first // LANES]
            stretch(x, film, first, lanes, group, s)
            if film.forces.shape[0] > 0:
                _wrinkle(group, film.forces[first : first + lanes], lanes, film.stiffness, s)
            energy += scatter(group, triangles, first, lanes, s, gradient)
        return energy
    f, fn, n, tangent = small_matrix(2, 3), small_matrix(2, 3), small_vector(3), small_matrix(3, 3)
    for r in range(3):
        for c in range(3):
            tangent[r, c] = film.stiffness[r, c]
    for e in range(triangles.shape[0]):
        g, area = film.gradients[e], film.areas[e]
        energy += area * film_law(film, e, deformation(x, triangles[e], g, f), n, tangent)
        for k in range(3):
            fn[0, k] = area * (f[0, k] * n[0] + f[1, k] * n[2])
            fn[1, k] = area * (f[0, k] * n[2] + f[1, k] * n[1])
        i0, i1, i2 = triangles[e, 0], triangles[e, 1], triangles[e, 2]
        for k in range(3):
            r1 = fn[0, k] * g[1, 0] + fn[1, k] * g[1, 1]
            r2 = fn[0, k] * g[2, 0] + fn[1, k] * g[2, 1]
            gradient[i1, k] += r1
            gradient[i2, k] += r2
            gradient[i0, k] -= r1 + r2
        if slots.shape[0] > 0:
            add_hessian(f, tangent, n, (g, area), slots[e], blocks)
    return energy


@kernel(allocates=True)
def principal_forces(x: Matrix, film: MembraneRows) -> Matrix:
    """Return the principal membrane forces (m, 2) [N/m] of all triangles by the law, largest first."""
    count = film.triangles.shape[0]
    principal = np.empty((count, 2))
    f, n, tangent, s = small_matrix(2, 3), small_vector(3), small_matrix(3, 3), small_vector(SIZE)
    for first in range(0, count, LANES):
        lanes, group = min(LANES, count - first), film.drawn[first // LANES]
        if film.law in (PLAIN, WRINKLING):
            stretch(x, film, first, lanes, group, s)
            if film.forces.shape[0] > 0:
                _wrinkle(group, film.forces[first : first + lanes], lanes, film.stiffness, s)
        for lane in range(lanes):
            e = first + lane
            if film.law in (PLAIN, WRINKLING):
                for r in range(3):
                    n[r] = s[FORCE + r * LANES + lane] / group[4 * LANES + lane]
            else:
                strain = deformation(x, film.triangles[e], film.gradients[e], f)
                film_law(film, e, strain, n, tangent)
            half = 0.5 * (n[0] - n[1])
            mean, radius = 0.5 * (n[0] + n[1]), np.sqrt(half * half + n[2] * n[2])
            principal[e, 0], principal[e, 1] = mean + radius, mean - radius
    return principal


@final
@dataclass(frozen=True)
class Membranes(LeafElement):
    """Film triangles of one material.

    Args:
        triangles: (m, 3) node indices.
        shape_gradients: (m, 3, 2) [1/m], g_a in each triangle's own plane axes; of fabric warp and weft.
        areas: (m,) [m^2], drawn shape.
        wrinkle_panel_m: (m,) [m], of the panels in which a "wrinkling" film wrinkles; 0 for unknown.
        film: material.

    Raises:
        InputError: the film wrinkles, and the width of its panels is unknown.
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
    ) -> "Membranes":
        """Return the triangles, stress free in the given shape.

        Args:
            positions: (n, 3) [m], drawn shape.
            triangles: (m, 3) node indices.
            film: material.
            wrinkle_panel_m: (m,) [m], see the class.

        Raises:
            MeshError: a triangle has no area, or the warp of a fabric is normal to it.
            InputError: the film wrinkles, and the width of its panels is unknown.
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
        unit = normal / twice_area[:, None]
        axis1 = d1 / np.linalg.norm(d1, axis=1)[:, None]
        axis2 = np.cross(unit, axis1)
        # rows of the inverse of [[d1.a1, d2.a1], [0, d2.a2]] are the gradients of nodes 1 and 2
        a, b, d = (d1 * axis1).sum(1), (d2 * axis1).sum(1), (d2 * axis2).sum(1)
        gradients = np.zeros((len(triangles), 3, 2))
        gradients[:, 1] = np.stack([1.0 / a, -b / (a * d)], axis=1)
        gradients[:, 2, 1] = 1.0 / d
        gradients[:, 0] = -gradients[:, 1] - gradients[:, 2]
        if film.fabric is not None:
            warp = film.fabric.warps(unit)
            turn = np.stack([(warp * axis1).sum(1), (warp * axis2).sum(1)], axis=1)
            across = np.stack([-turn[:, 1], turn[:, 0]], axis=1)
            gradients = np.einsum("mij,maj->mai", np.stack([turn, across], axis=1), gradients)
        panel = (
            np.zeros(len(triangles))
            if wrinkle_panel_m is None
            else np.array(wrinkle_panel_m, dtype=np.float64)
        )
        return cls(triangles, gradients, 0.5 * twice_area, panel, film)

    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call:
        return Call(add_membranes, (self.arrays, slots, gradient, blocks))

    @cached_property
    def arrays(self) -> MembraneRows:
        """The triangles, for kernels."""
        return MembraneRows(
            writable(self.triangles), writable(self.shape_gradients), writable(self.areas),
            in_lanes(self.shape_gradients, self.areas), self._stiffness, self.film.law_code,
            self._compression, self._forces, self._yarns, self.film.stiffening,
        )  # fmt: skip

    @cached_property
    def _stiffness(self) -> Array:
        return self.film.membrane_stiffness

    @cached_property
    def _compression(self) -> Array:
        return self.film.compression

    @cached_property
    def _yarns(self) -> Array:
        return self.film.yarns

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

    def principal_stress(self, positions: Array) -> Array:
        """Return the principal second Piola-Kirchhoff stresses (m, 2) [Pa] of the law, largest first.

        Args:
            positions: (n, 3) [m].
        """
        forces: Array = principal_forces(np.ascontiguousarray(positions), self.arrays)
        return forces / self.film.thickness_m
