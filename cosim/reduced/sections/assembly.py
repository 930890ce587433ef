"""Kernels on whole chains: assembly, factors, volume, and what a chain shows.

Cholesky factors of the block-tridiagonal tangents of chains.

With free frames f and the blocks A_f on the diagonal and B_f before them:
    L_f L_f^T = A_f + shift diag(scale) - S_f S_f^T,    S_f = B_f L_(f-1)^-T.
The diagonals of the L_f are kept as their reciprocals.

Kernels on the shapes that a chain takes on one after the other.

What a chain of frames shows its surroundings: the wrench on the flange, centre and inertia of its mass.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array, Mask, Wrench
from cosim.base.kernel_types import Blocks, Cubes, Flags, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector, zero_vector
from cosim.reduced.sections.section_energy import (
    TERMS,
    PressureSpline,
    active_terms,
    add_gaps,
    section_energy,
    weighted_rows,
)
from cosim.reduced.sections.section_strains import (
    Bed,
    ChainWork,
    LoadedChain,
    add_cables,
    add_contacts,
    add_frames,
    add_sections,
    section_strains,
)
from cosim.soft.elements.mass_terms import mass_moments


@device_function
def factorise(free: Flags, work: ChainWork, shift: float, scale: Vector) -> bool:
    """Fill low and side (f, 6, 6) with L and S; False where the free part is not positive definite."""
    low, side = work.low, work.side
    for f in range(free.shape[0]):
        if not free[f]:
            continue
        for i in range(6):
            for k in range(i + 1):
                low[f, i, k] = work.diagonal[f, i, k]
            low[f, i, i] += shift * scale[i]
        if f > 0 and free[f - 1]:
            for i in range(6):
                for k in range(6):
                    total = work.off[f, i, k]
                    for j in range(k):
                        total -= side[f, i, j] * low[f - 1, k, j]
                    side[f, i, k] = total * low[f - 1, k, k]
            for i in range(6):
                for k in range(i + 1):
                    total = low[f, i, k]
                    for j in range(6):
                        total -= side[f, i, j] * side[f, k, j]
                    low[f, i, k] = total
        for j in range(6):
            for i in range(j, 6):
                total = low[f, i, j]
                for k in range(j):
                    total -= low[f, i, k] * low[f, j, k]
                low[f, i, j] = total
            if not low[f, j, j] > 0.0:
                return False
            inverse = 1.0 / np.sqrt(low[f, j, j])
            low[f, j, j] = inverse
            for i in range(j + 1, 6):
                low[f, i, j] *= inverse
    return True


@device_function
def substitute(free: Flags, work: ChainWork, load: Matrix) -> None:
    """Solve with the factor for load (f, 6); the step (f, 6) is zero where a frame is held."""
    count, low, side, step = free.shape[0], work.low, work.side, work.step
    for f in range(count):
        for i in range(6):
            if not free[f]:
                step[f, i] = 0.0
                continue
            total = load[f, i]
            if f > 0 and free[f - 1]:
                for j in range(6):
                    total -= side[f, i, j] * step[f - 1, j]
            for j in range(i):
                total -= low[f, i, j] * step[f, j]
            step[f, i] = total * low[f, i, i]
    for f in range(count - 1, -1, -1):
        if not free[f]:
            continue
        for i in range(5, -1, -1):
            total = step[f, i]
            if f + 1 < count and free[f + 1]:
                for j in range(6):
                    total -= side[f + 1, j, i] * step[f + 1, j]
            for j in range(i + 1, 6):
                total -= low[f, j, i] * step[f, j]
            step[f, i] = total * low[f, i, i]


@kernel
def factorise_tangent(free: Flags, work: ChainWork) -> bool:
    """Make the factor of the tangent in the workspace; False where its free part is not positive definite."""
    return factorise(free, work, 0.0, zero_vector(6))


@kernel
def solve_tangent(free: Flags, work: ChainWork, load: Blocks, step: Blocks) -> None:
    """Solve with the factor for loads (k, f, 6); the steps (k, f, 6) are zero where a frame is held."""
    for k in range(load.shape[0]):
        substitute(free, work, load[k])
        for f in range(free.shape[0]):
            for i in range(6):
                step[k, f, i] = work.step[f, i]


@kernel
def assemble(
    frames: Blocks, chain: LoadedChain, bed: Bed, gradient: Matrix, work: ChainWork, hessian: bool
) -> float:
    """Fill the gradient (f, 6) and, if asked to, the Hessian's blocks; return the potential [J]."""
    energy = add_frames(frames, chain, bed, gradient, work, hessian)
    energy += add_sections(frames, chain, gradient, work, hessian)
    energy += add_cables(frames, chain, gradient, work, hessian)
    return energy + add_contacts(frames, chain, gradient, work, hessian)


@kernel
def change_frames(frames: Blocks, step: Matrix, factor: float, out: Blocks) -> None:
    """Move every frame by factor times its step (dr, phi): out = (r + dr, exp(S(phi)) a_i)."""
    phi, v, w = small_vector(3), small_vector(3), small_vector(3)
    for f in range(frames.shape[0]):
        square = 0.0
        for r in range(3):
            out[f, 0, r] = frames[f, 0, r] + factor * step[f, r]
            phi[r] = factor * step[f, 3 + r]
            square += phi[r] * phi[r]
        angle = np.sqrt(square)
        if angle < 1e-4:  # the series' next terms are below rounding
            sine, versine = 1.0 - square / 6.0, 0.5 - square / 24.0
        else:
            sine, versine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
        for a in range(1, 4):
            for r in range(3):
                i, k = (r + 1) % 3, (r + 2) % 3
                v[r] = phi[i] * frames[f, a, k] - phi[k] * frames[f, a, i]
            for r in range(3):
                i, k = (r + 1) % 3, (r + 2) % 3
                w[r] = phi[i] * v[k] - phi[k] * v[i]
            for r in range(3):
                out[f, a, r] = frames[f, a, r] + sine * v[r] + versine * w[r]


@kernel
def combine_points(frames: Blocks, before: Indices, weights: Blocks, out: Matrix) -> None:
    """Fill out (n, 3) with combinations (n, 2, 4) of the points of two frames, `before` (n,) and the next."""
    for n in range(out.shape[0]):
        b = before[n]
        for r in range(3):
            out[n, r] = (
                weights[n, 0, 0] * frames[b, 0, r] + weights[n, 0, 1] * frames[b, 1, r]
                + weights[n, 0, 2] * frames[b, 2, r] + weights[n, 0, 3] * frames[b, 3, r]
                + weights[n, 1, 0] * frames[b + 1, 0, r] + weights[n, 1, 1] * frames[b + 1, 1, r]
                + weights[n, 1, 2] * frames[b + 1, 2, r] + weights[n, 1, 3] * frames[b + 1, 3, r]
            )  # fmt: skip


@kernel(allocates=True)
def chain_points(
    frames: Cubes, pressures: Vector, spline: PressureSpline, table: Matrix, before: Indices, out: Blocks
) -> None:
    """Fill out (k, n, 3) with points of chains (k, f, 4, 3) at pressures (k,).

    table: (size, 8 n), each point as a combination of those of the two frames from `before` (n,) on.
    """
    terms, weights = small_matrix(2, TERMS), np.empty(table.shape[1])
    combinations = weights.reshape(len(before), 2, 4)
    for k in range(len(frames)):
        if k == 0 or pressures[k] != pressures[k - 1]:
            weighted_rows(table, active_terms(pressures[k], spline, terms), terms[0], weights)
        combine_points(frames[k], before, combinations, out[k])


class GasTables(NamedTuple):
    """What the gas in a chain hangs on, over the spline of pressure; see `SectionModel`.

    Args:
        energy: (size, s c).
        length: (size, s).
        gas: (size,), of one copy.
        near: (s,) the frame before each section.
        rims: (s, n, 2) [m], see `LoadedChain`.
    """

    energy: Matrix
    length: Matrix
    gas: Vector
    near: Indices
    rims: Blocks


@kernel(allocates=True)
def gas_volumes(
    frames: Cubes, pressures: Vector, spline: PressureSpline, tables: GasTables, out: Matrix
) -> None:
    """Fill out (k, copies) with the enclosed volumes [m^3], -d(energy of a copy's sections)/dp.

    frames: (k, f, 4, 3), of chains; pressures: (k,).
    """
    energy, length, gas, near = tables.energy, tables.length, tables.gas, tables.near
    sections = length.shape[1]
    own = sections // out.shape[1]
    out[:] = 0.0
    terms, value, slope = small_matrix(2, TERMS), np.empty(energy.shape[1]), np.empty(energy.shape[1])
    coefficients, rates = value.reshape(sections, -1), slope.reshape(sections, -1)
    inverse_length, length_rate, rest = np.empty(sections), np.empty(sections), 0.0
    x, d, gradient, none = small_vector(6), small_vector(3), small_vector(6), small_matrix(0, 6)
    for k in range(len(frames)):
        if k == 0 or pressures[k] != pressures[k - 1]:
            first = active_terms(pressures[k], spline, terms)
            weighted_rows(energy, first, terms[0], value)
            weighted_rows(energy, first, terms[1], slope)
            weighted_rows(length, first, terms[0], inverse_length)
            weighted_rows(length, first, terms[1], length_rate)
            rest = 0.0
            for t in range(TERMS):
                rest += terms[1, t] * gas[first + t]
            for s in range(sections):
                inverse_length[s] = 1.0 / inverse_length[s]
        for s in range(sections):
            copy = s // own
            section_strains(frames[k], near[s], d, x)
            section_energy(coefficients, s, x, inverse_length[s], gradient, none)
            # z = u_3 / L - 1 moves with L
            out[k, copy] += gradient[2] * x[2] * inverse_length[s] * length_rate[s]
            out[k, copy] -= section_energy(rates, s, x, inverse_length[s], gradient, none)
            out[k, copy] -= add_gaps(rates, s, x, tables.rims[s], gradient, none)
        for copy in range(out.shape[1]):
            out[k, copy] -= rest


WRENCH, CENTER, INERTIA, FIGURES = 0, 6, 9, 18
"""Places in the figures (FIGURES,): wrench (6,), centre (3,) [m] and inertia (3, 3) [kg m^2] about it."""


def figures_of(frames: Array, free: Mask, mass: Array, gradient: Array) -> Array:
    """Return the figures of a chain; see `fill_figures`."""
    figures = np.empty(FIGURES)
    fill_figures(frames, free, mass, gradient, figures)
    return figures


def supplied_wrench(figures: Array) -> Wrench:
    """Return what a chain exerts on the flange, at its origin."""
    return Wrench.owning(figures[WRENCH : WRENCH + 3], figures[WRENCH + 3 : CENTER])


def center_and_inertia(figures: Array) -> tuple[Array, Array]:
    """Return the centre (3,) [m] and the inertia (3, 3) [kg m^2] about it."""
    return figures[CENTER:INERTIA], figures[INERTIA:].reshape(3, 3)


@kernel
def fill_figures(frames: Blocks, free: Flags, mass: Blocks, gradient: Matrix, out: Vector) -> None:
    """Fill out (FIGURES,): the wrench on the flange at its origin, centre and inertia of the mass.

    Held frames are supplied with the gradient (f, 6) of the potential; the flange bears its opposite.
    """
    for k in range(CENTER):
        out[k] = 0.0
    for f in range(frames.shape[0]):
        if not free[f]:
            for r in range(3):
                i, k = (r + 1) % 3, (r + 2) % 3
                arm_i, arm_k = frames[f, 0, i] - frames[0, 0, i], frames[f, 0, k] - frames[0, 0, k]
                out[WRENCH + r] -= gradient[f, r]
                out[WRENCH + 3 + r] -= gradient[f, 3 + r] + arm_i * gradient[f, k] - arm_k * gradient[f, i]
    moments, at = small_vector(9), 3
    total = mass_moments(mass, frames, moments)
    for r in range(3):
        # what weighs nothing may have its centre anywhere
        out[CENTER + r] = moments[r] / total if total > 0.0 else frames[0, 0, r]
    for r in range(3):
        for c in range(r, 3):
            product = moments[at] - moments[r] * out[CENTER + c]
            at += 1
            out[INERTIA + 3 * r + c] = out[INERTIA + 3 * c + r] = -product
    x, y, z = out[INERTIA], out[INERTIA + 4], out[INERTIA + 8]
    out[INERTIA], out[INERTIA + 4], out[INERTIA + 8] = -y - z, -x - z, -x - y
