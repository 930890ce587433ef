"""Energy and gradient of many film triangles, plain or wrinkling, in groups: one triangle per lane."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernels import device_function, small_matrix, small_vector
from cosim.soft.elements.wrinkling import density, hide_across, principal, turn_forces, wrinkling

# Quantity q of a lane is at s[q * LANES + lane], as in `hinge_gradient`.
LANES = 64
_D1, _D2, _ENERGY, _E, _N = 0, 3 * LANES, 6 * LANES, 7 * LANES, 10 * LANES
_WHICH, _PLATE, _HARDENING, _FIRST, _FOUND = (LANES * place for place in (13, 14, 15, 16, 17))
_SIZE = 21 * LANES
_STRIDE = 8  # lanes of the widest registers: what wrinkles is filled up to full ones


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
def corners_of(triangles, e):  # type: ignore[no-untyped-def]
    """Return the nodes of a triangle, of a type that needs no test for places counted from the end."""
    return np.uint64(triangles[e, 0]), np.uint64(triangles[e, 1]), np.uint64(triangles[e, 2])


@device_function
def _gather(x, triangles, first, lanes, s):  # type: ignore[no-untyped-def]
    """Fill both edges from node 0; lanes to spare repeat the first triangle."""
    for lane in range(LANES):
        e = first + (lane if lane < lanes else 0)
        i, j, k = corners_of(triangles, e)
        for r in range(3):
            s[_D1 + r * LANES + lane] = x[j, r] - x[i, r]
            s[_D2 + r * LANES + lane] = x[k, r] - x[i, r]


@device_function
def _stretch(drawn, stiffness, s):  # type: ignore[no-untyped-def]
    """Replace the edges by F^T, and fill strains, and forces A N and energies of the plain law."""
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
        s[_ENERGY + lane] = 0.5 * (e11 * n11 + e22 * n22 + e12 * n12)
        s[_D1 + lane], s[_D2 + lane] = f0, k0
        s[_D1 + LANES + lane], s[_D2 + LANES + lane] = f1, k1
        s[_D1 + 2 * LANES + lane], s[_D2 + 2 * LANES + lane] = f2, k2
        s[_E + lane], s[_E + LANES + lane], s[_E + 2 * LANES + lane] = e11, e22, e12
        s[_N + lane], s[_N + LANES + lane], s[_N + 2 * LANES + lane] = n11, n22, n12


@device_function
def _list_wrinkled(drawn, forces, lanes, s):  # type: ignore[no-untyped-def]
    """List the lanes that are not taut, and move their strains, s0 and f0 to the front; return how many.

    Up to the next full run the last one is repeated.
    """
    count = 0
    for lane in range(lanes):
        area = drawn[4 * LANES + lane]
        n11, n22, n12 = s[_N + lane], s[_N + LANES + lane], s[_N + 2 * LANES + lane]
        above, half = 0.5 * (n11 + n22) + area * forces[lane, 0], 0.5 * (n11 - n22)
        if above >= 0.0 and above * above >= half * half + n12 * n12:
            continue
        s[_WHICH + count], s[_PLATE + count], s[_HARDENING + count] = lane, forces[lane, 0], forces[lane, 1]
        for r in range(3):
            s[_E + r * LANES + count] = s[_E + r * LANES + lane]
        count += 1
    for spare in range(count, -(-count // _STRIDE) * _STRIDE):
        for place in (_PLATE, _HARDENING, _E, _E + LANES, _E + 2 * LANES):
            s[place + spare] = s[place + count - 1]
    return count


@device_function
def _wrinkle_listed(count, stiffness, s):  # type: ignore[no-untyped-def]
    """Fill forces and energy density of listed lanes, as of the wrinkled state, and N1, which tells it."""
    for lane in range(count):
        plate, hardening = s[_PLATE + lane], s[_HARDENING + lane]
        e1, e2, cosine, sine = principal(s[_E + lane], s[_E + LANES + lane], s[_E + 2 * LANES + lane])
        r2, first = hide_across(e1, e2, stiffness, plate, hardening)
        n11, n22, n12 = turn_forces(first, -plate - r2, cosine, sine)
        s[_FOUND + lane], s[_FOUND + LANES + lane], s[_FOUND + 2 * LANES + lane] = n11, n22, n12
        s[_FOUND + 3 * LANES + lane] = density(e1, e2, first, 0.0, r2, plate, hardening)
        s[_FIRST + lane] = first


@device_function
def _wrinkle(drawn, forces, lanes, stiffness, n, no_tangent, s):  # type: ignore[no-untyped-def]
    """Replace forces A N and energies where a triangle is not taut."""
    count = _list_wrinkled(drawn, forces, lanes, s)
    _wrinkle_listed(-(-count // _STRIDE) * _STRIDE, stiffness, s)
    for q in range(count):
        lane = int(s[_WHICH + q])
        area, psi, plate = drawn[4 * LANES + lane], s[_FOUND + 3 * LANES + q], s[_PLATE + q]
        n[0], n[1], n[2] = s[_FOUND + q], s[_FOUND + LANES + q], s[_FOUND + 2 * LANES + q]
        if s[_FIRST + q] < -plate:  # slack
            e11, e22, e12 = s[_E + q], s[_E + LANES + q], s[_E + 2 * LANES + q]
            psi = wrinkling(e11, e22, e12, stiffness, plate, s[_HARDENING + q], n, no_tangent)
        s[_ENERGY + lane] = area * psi
        s[_N + lane], s[_N + LANES + lane], s[_N + 2 * LANES + lane] = area * n[0], area * n[1], area * n[2]


@device_function
def _pull(drawn, s):  # type: ignore[no-untyped-def]
    """Replace F^T by the gradients of nodes 1 and 2."""
    for lane in range(LANES):
        ax, ay = drawn[lane], drawn[LANES + lane]
        bx, by = drawn[2 * LANES + lane], drawn[3 * LANES + lane]
        f0, f1, f2 = s[_D1 + lane], s[_D1 + LANES + lane], s[_D1 + 2 * LANES + lane]
        k0, k1, k2 = s[_D2 + lane], s[_D2 + LANES + lane], s[_D2 + 2 * LANES + lane]
        n11, n22, n12 = s[_N + lane], s[_N + LANES + lane], s[_N + 2 * LANES + lane]
        p1, q1 = n11 * ax + n12 * ay, n12 * ax + n22 * ay
        p2, q2 = n11 * bx + n12 * by, n12 * bx + n22 * by
        s[_D1 + lane], s[_D2 + lane] = f0 * p1 + k0 * q1, f0 * p2 + k0 * q2
        s[_D1 + LANES + lane], s[_D2 + LANES + lane] = f1 * p1 + k1 * q1, f1 * p2 + k1 * q2
        s[_D1 + 2 * LANES + lane], s[_D2 + 2 * LANES + lane] = f2 * p1 + k2 * q1, f2 * p2 + k2 * q2


@device_function
def _scatter(triangles, first, lanes, s, gradient):  # type: ignore[no-untyped-def]
    """Add a group to gradient; return its energy."""
    energy = 0.0
    for lane in range(LANES):
        if lane == lanes:
            break
        e = first + lane
        i, j, k = corners_of(triangles, e)
        energy += s[_ENERGY + lane]
        for r in range(3):
            one, two = s[_D1 + r * LANES + lane], s[_D2 + r * LANES + lane]
            gradient[j, r] += one
            gradient[k, r] += two
            gradient[i, r] -= one + two
    return energy


@device_function
def add_membrane_gradients(x, triangles, drawn, stiffness, forces, gradient):  # type: ignore[no-untyped-def]
    """Add the gradient of all triangles to gradient; return the energy [J].

    `drawn` is what `in_lanes` returns; `forces` those of `wrinkling_forces`, empty for the plain law.
    """
    s, n, no_tangent = small_vector(_SIZE), small_vector(3), small_matrix(0, 0)
    energy = 0.0
    for first in range(0, triangles.shape[0], LANES):
        lanes, group = min(LANES, triangles.shape[0] - first), drawn[first // LANES]
        _gather(x, triangles, first, lanes, s)
        _stretch(group, stiffness, s)
        if forces.shape[0] > 0:
            _wrinkle(group, forces[first : first + lanes], lanes, stiffness, n, no_tangent, s)
        _pull(group, s)
        energy += _scatter(triangles, first, lanes, s, gradient)
    return energy
