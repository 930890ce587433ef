"""Kernels on the shapes of a chain: change of frames, points between frames, and enclosed volumes."""

from typing import NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, Cubes, Indices, Matrix, Vector
from cosim.base.kernels import kernel, small_matrix, small_vector
from cosim.reduced.sections.gap_energy import add_gaps
from cosim.reduced.sections.pressure_spline import TERMS, PressureSpline, active_terms, weighted_rows
from cosim.reduced.sections.section_energy import section_energy
from cosim.reduced.sections.section_strains import section_strains


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
    """Coefficients of the gas volume of a chain over the spline of pressure; see `SectionModel`.

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
    sections_per_copy = sections // out.shape[1]
    out[:] = 0.0
    terms, value, slope = small_matrix(2, TERMS), np.empty(energy.shape[1]), np.empty(energy.shape[1])
    coefficients, rates = value.reshape(sections, -1), slope.reshape(sections, -1)
    inverse_length, length_rate, gas_slope = np.empty(sections), np.empty(sections), 0.0
    x, d, gradient, no_hessian = small_vector(6), small_vector(3), small_vector(6), small_matrix(0, 6)
    for k in range(len(frames)):
        if k == 0 or pressures[k] != pressures[k - 1]:
            first = active_terms(pressures[k], spline, terms)
            weighted_rows(energy, first, terms[0], value)
            weighted_rows(energy, first, terms[1], slope)
            weighted_rows(length, first, terms[0], inverse_length)
            weighted_rows(length, first, terms[1], length_rate)
            gas_slope = 0.0
            for t in range(TERMS):
                gas_slope += terms[1, t] * gas[first + t]
            for s in range(sections):
                inverse_length[s] = 1.0 / inverse_length[s]
        for s in range(sections):
            copy = s // sections_per_copy
            section_strains(frames[k], near[s], d, x)
            section_energy(coefficients, s, x, inverse_length[s], gradient, no_hessian)
            # z = u_3 / L - 1 moves with L
            out[k, copy] += gradient[2] * x[2] * inverse_length[s] * length_rate[s]
            out[k, copy] -= section_energy(rates, s, x, inverse_length[s], gradient, no_hessian)
            out[k, copy] -= add_gaps(rates, s, x, tables.rims[s], gradient, no_hessian)
        for copy in range(out.shape[1]):
            out[k, copy] -= gas_slope
