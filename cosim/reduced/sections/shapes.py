"""Kernels on the shapes that a chain takes on one after the other."""

from __future__ import annotations

import numpy as np
from numba import int64, void

from cosim.base.kernels import CUBES, INDICES, MATRIX, REAL, VECTOR, kernel, small_matrix
from cosim.reduced.sections.assembly import combine_points, gas_volume
from cosim.reduced.sections.pressure_spline import TERMS, active_terms, weighted_rows
from cosim.reduced.sections.section_strains import CUBE


@kernel(void(CUBES, VECTOR, REAL, int64, MATRIX, INDICES, CUBE), allocates=True)
def chain_points(frames, pressures, largest, intervals, table, before, out):  # type: ignore[no-untyped-def]
    """Fill out (k, n, 3) with points of chains (k, f, 4, 3) at pressures (k,).

    table: (size, 8 n), each point as a combination of those of the two frames from `before` (n,) on.
    """
    terms, weights = small_matrix(2, TERMS), np.empty(table.shape[1])
    combinations = weights.reshape(len(before), 2, 4)
    for k in range(len(frames)):
        if k == 0 or pressures[k] != pressures[k - 1]:
            first = active_terms(pressures[k], largest, intervals, terms)
            weighted_rows(table, first, terms[0], weights)
        combine_points(frames[k], before, combinations, out[k])


@kernel(void(CUBES, VECTOR, REAL, int64, MATRIX, MATRIX, VECTOR, VECTOR), allocates=True)
def gas_volumes(frames, pressures, largest, intervals, energy, length, gas, out):  # type: ignore[no-untyped-def]
    """Fill out (k,) with the enclosed volumes [m^3] of chains (k, f, 4, 3) at pressures (k,).

    energy: (size, s c); length: (size, s); gas: (size,); see `SectionModel`.
    """
    sections = length.shape[1]
    terms, value, slope = small_matrix(2, TERMS), np.empty(energy.shape[1]), np.empty(energy.shape[1])
    coefficients, rates = value.reshape(sections, -1), slope.reshape(sections, -1)
    inverse_length, length_rate = np.empty(sections), np.empty(sections)
    rest = 0.0
    for k in range(len(frames)):
        if k == 0 or pressures[k] != pressures[k - 1]:
            first = active_terms(pressures[k], largest, intervals, terms)
            weighted_rows(energy, first, terms[0], value)
            weighted_rows(energy, first, terms[1], slope)
            weighted_rows(length, first, terms[0], inverse_length)
            weighted_rows(length, first, terms[1], length_rate)
            rest = 0.0
            for t in range(TERMS):
                rest += terms[1, t] * gas[first + t]
            for s in range(sections):
                inverse_length[s] = 1.0 / inverse_length[s]
        out[k] = gas_volume(frames[k], coefficients, rates, inverse_length, length_rate) - rest
