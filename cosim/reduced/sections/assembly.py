"""Kernels on whole chains: assembly, factors, Newton's method, volume, and what a chain shows.

Cholesky factors of the block-tridiagonal tangents of chains.

With free frames f and the blocks A_f on the diagonal and B_f before them:
    L_f L_f^T = A_f + shift diag(scale) - S_f S_f^T,    S_f = B_f L_(f-1)^-T.
The diagonals of the L_f are kept as their reciprocals.

Kernels on the shapes that a chain takes on one after the other.

What a chain of frames shows its surroundings: the wrench on the flange, centre and inertia of its mass.
"""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, Mask, Wrench
from cosim.base.kernels import (
    Blocks,
    Cubes,
    Flags,
    Indices,
    Matrix,
    Vector,
    device_function,
    kernel,
    small_matrix,
    small_vector,
)
from cosim.reduced.sections.section_energy import TERMS, active_terms, section_energy, weighted_rows
from cosim.reduced.sections.section_strains import (
    add_cables,
    add_contacts,
    add_frames,
    add_sections,
    section_strains,
)
from cosim.soft.elements.mass_terms import mass_moments


@device_function
def _cholesky(low: Blocks, f: int) -> bool:
    """Factorise the lower triangle of block f in place; False where it is not positive definite."""
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
def factorise(
    free: Flags, diagonal: Blocks, off: Blocks, shift: float, scale: Vector, low: Blocks, side: Blocks
) -> bool:
    """Fill low and side (f, 6, 6) with L and S; False where the free part is not positive definite."""
    for f in range(free.shape[0]):
        if not free[f]:
            continue
        for i in range(6):
            for k in range(i + 1):
                low[f, i, k] = diagonal[f, i, k]
            low[f, i, i] += shift * scale[i]
        if f > 0 and free[f - 1]:
            for i in range(6):
                for k in range(6):
                    total = off[f, i, k]
                    for j in range(k):
                        total -= side[f, i, j] * low[f - 1, k, j]
                    side[f, i, k] = total * low[f - 1, k, k]
            for i in range(6):
                for k in range(i + 1):
                    total = low[f, i, k]
                    for j in range(6):
                        total -= side[f, i, j] * side[f, k, j]
                    low[f, i, k] = total
        if not _cholesky(low, f):
            return False
    return True


@device_function
def substitute(free: Flags, low: Blocks, side: Blocks, load: Matrix, step: Matrix) -> None:
    """Solve with the factor for load (f, 6); step (f, 6) is zero where a frame is held."""
    count = free.shape[0]
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


# chain: coefficients (s, c), inverse lengths (s,), masses (f, 4, 4)
# loads (f, 4, 3), bed [1/s^2], targets (f, 4, 3)
# cables: far frame of each segment (k,), eyelets (k, 2, 3), tensions (k,)
# contacts: first frame of each (k,), rows (k, 17), widths (2,) of the law; see `chain_contact`
# gradient (f, 6), diagonal blocks (f, 6, 6), blocks of rows f and columns f - 1 (f, 6, 6)
# factor of the tangent: blocks (f, 6, 6) of their Cholesky factor, and whether they hold one that may serve

CONVERGED, LIMIT, NOT_FINITE, INDEFINITE, NO_DESCENT = 0, 1, 2, 3, 4
_SHIFT_START, _SHIFT_MAX = 0.05, 1e8  # [N/m]
_STEP_MAX_M, _TURN_MAX = 0.05, 0.4
_HALVINGS_MAX = 20


@kernel(taken_in=True)
def assemble(
    frames: Blocks,
    coefficients: Matrix,
    inverse_length: Vector,
    mass: Blocks,
    load: Blocks,
    bed: float,
    target: Blocks,
    far: Indices,
    eyelets: Blocks,
    tension: Vector,
    touching: Indices,
    rows: Matrix,
    widths: Vector,
    gradient: Matrix,
    diagonal: Blocks,
    off: Blocks,
    hessian: bool,
) -> float:
    """Fill the gradient and, if asked to, the Hessian's blocks; return the potential [J]."""
    energy = add_frames(frames, load, bed, mass, target, gradient, diagonal, hessian)
    energy += add_sections(frames, coefficients, inverse_length, gradient, diagonal, off, hessian)
    energy += add_cables(frames, far, eyelets, tension, gradient, diagonal, off, hessian)
    return energy + add_contacts(frames, touching, rows, widths, gradient, diagonal, off, hessian)


@kernel(taken_in=True)
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


@device_function
def copy_frames(frames: Blocks, out: Blocks) -> None:
    """Fill out (f, 4, 3); an assignment of whole arrays takes seconds to compile, as it can fail."""
    for f in range(frames.shape[0]):
        for a in range(4):
            for r in range(3):
                out[f, a, r] = frames[f, a, r]


@device_function
def _residual(gradient: Matrix, free: Flags, lever: float) -> float:
    """Return the largest out-of-balance force, or moment over lever."""
    largest = 0.0
    for f in range(free.shape[0]):
        if free[f]:
            for i in range(6):
                value = abs(gradient[f, i]) / (1.0 if i < 3 else lever)
                if not value <= largest:
                    largest = value
    return largest


@device_function
def _descent(free: Flags, gradient: Matrix, step: Matrix) -> tuple[float, float]:
    """Turn the solution into a step; return the potential's slope along it, and the factor that bounds it."""
    slope = longest = turn = 0.0
    for f in range(free.shape[0]):
        for i in range(6):
            step[f, i] = -step[f, i]
            slope += gradient[f, i] * step[f, i] if free[f] else 0.0
            if i < 3:
                longest = max(longest, abs(step[f, i]))
            else:
                turn = max(turn, abs(step[f, i]))
    return slope, min(1.0, min(_STEP_MAX_M / max(longest, 1e-30), _TURN_MAX / max(turn, 1e-30)))


@device_function
def _descends(value: float, energy: float, fall: float, residual: float, before: float) -> bool:
    """Whether a step has lowered the potential as it should, or the residual by far."""
    if not np.isfinite(value):
        return False
    return value <= energy + 1e-4 * fall + 1e-13 * (1.0 + abs(energy)) or residual < 0.1 * before


@device_function
def _factorise(free: Flags, diagonal: Blocks, off: Blocks, scale: Vector, low: Blocks, side: Blocks) -> float:
    """Factorise the tangent; return the least shift [N/m] tried that makes it definite, or one too large."""
    shift = 0.0
    while shift <= _SHIFT_MAX and not factorise(free, diagonal, off, shift, scale, low, side):
        shift = max(_SHIFT_START, 6.0 * shift)
    return shift


@kernel(allocates=True, taken_in=True)
def minimise(
    frames: Blocks,
    free: Flags,
    coefficients: Matrix,
    inverse_length: Vector,
    mass: Blocks,
    load: Blocks,
    bed: float,
    target: Blocks,
    far: Indices,
    eyelets: Blocks,
    tension: Vector,
    touching: Indices,
    rows: Matrix,
    widths: Vector,
    gradient: Matrix,
    diagonal: Blocks,
    off: Blocks,
    low: Blocks,
    side: Blocks,
    kept: bool,
    bounds: Vector,
    iterations_max: int,
) -> tuple[int, int, float, float, int, bool]:
    """Find the minimum of the potential near `frames`, which are moved there; gradient belongs to it.

    The factor of an earlier tangent, where one is kept, serves while the residual falls fast enough.
    bounds: residual [N], lever [m]. Returns (outcome, iterations, residual [N], potential [J], shifted,
    whether the factor that is left may serve the next solution).
    """
    tolerance, lever = bounds[0], bounds[1]
    scale = np.ones(6)
    scale[3:] = lever * lever
    step, trial = np.zeros_like(gradient), np.empty_like(frames)
    copy_frames(frames, trial)
    iterations = shifted = tries = reused = 0
    energy = residual = slope = factor = 0.0
    # numba would compile all anew for a literal
    wanted, judging, old = not kept, iterations > 0, kept
    while True:
        value = assemble(
            trial, coefficients, inverse_length, mass, load, bed, target, far, eyelets, tension,
            touching, rows, widths, gradient, diagonal, off, wanted,
        )  # fmt: skip
        before, residual = residual, _residual(gradient, free, lever)
        if judging and not _descends(value, energy, factor * slope, residual, before):
            residual, tries = before, tries + 1
            if old:  # a new tangent, where the step began
                copy_frames(frames, trial)
                wanted, judging, old = True, False, False
                continue
            if tries == _HALVINGS_MAX:
                return NO_DESCENT, iterations, residual, energy, shifted, False
            factor *= 0.5
            change_frames(frames, step, factor, trial)
            continue
        energy = value
        copy_frames(trial, frames)
        if not (np.isfinite(residual) and np.isfinite(energy)):
            return NOT_FINITE, iterations, residual, energy, shifted, False
        if residual <= tolerance:
            return CONVERGED, iterations, residual, energy, shifted, kept and reused < 2
        if iterations >= iterations_max:
            return LIMIT, iterations, residual, energy, shifted, False
        if judging and not (old and residual * residual <= tolerance * before):
            wanted, judging, old = True, False, False
            continue
        iterations += 1
        if wanted:
            shift = _factorise(free, diagonal, off, scale, low, side)
            if shift > _SHIFT_MAX:
                return INDEFINITE, iterations, residual, energy, shifted, False
            kept, reused = shift == 0.0, 0
            shifted += shift > 0.0
        else:
            reused += 1
        substitute(free, low, side, gradient, step)
        slope, factor = _descent(free, gradient, step)
        wanted, judging, tries = False, True, 0
        change_frames(frames, step, factor, trial)


@kernel(taken_in=True)
def gas_volume(
    frames: Blocks, coefficients: Matrix, rates: Matrix, inverse_length: Vector, length_rate: Vector
) -> float:
    """Return -d(energy of all sections)/dp [m^3] at given frames.

    rates: d coefficients / dp; length_rate: dL/dp [m/Pa].
    """
    volume = 0.0
    x, d, gradient, none = small_vector(6), small_vector(3), small_vector(6), small_matrix(0, 6)
    for s in range(coefficients.shape[0]):
        section_strains(frames, s, d, x)
        section_energy(coefficients, s, x, inverse_length[s], gradient, none)
        # z = u_3 / L - 1 moves with L
        volume += gradient[2] * x[2] * inverse_length[s] * length_rate[s]
        volume -= section_energy(rates, s, x, inverse_length[s], gradient, none)
    return volume


@kernel(taken_in=True)
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
    frames: Cubes,
    pressures: Vector,
    largest: float,
    intervals: int,
    table: Matrix,
    before: Indices,
    out: Blocks,
) -> None:
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


@kernel(allocates=True)
def gas_volumes(
    frames: Cubes,
    pressures: Vector,
    largest: float,
    intervals: int,
    energy: Matrix,
    length: Matrix,
    gas: Vector,
    out: Vector,
) -> None:
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


@kernel(taken_in=True)
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
    moments = small_vector(9)
    total = mass_moments(mass, frames, moments)
    fill_center_and_inertia(total, moments, frames[0, 0], out)


@device_function
def fill_center_and_inertia(total: float, moments: Vector, place: Vector, out: Vector) -> None:
    """Fill centre and inertia in figures out (FIGURES,).

    Args:
        total: mass [kg].
        moments: (9,), see `mass_moments`.
        place: (3,) [m]; what weighs nothing may have its centre anywhere.
        out: filled.
    """
    for r in range(3):
        out[CENTER + r] = moments[r] / total if total > 0.0 else place[r]
    at = 3
    for r in range(3):
        for c in range(r, 3):
            product = moments[at] - moments[r] * out[CENTER + c]
            at += 1
            out[INERTIA + 3 * r + c] = out[INERTIA + 3 * c + r] = -product
    x, y, z = out[INERTIA], out[INERTIA + 4], out[INERTIA + 8]
    out[INERTIA], out[INERTIA + 4], out[INERTIA + 8] = -y - z, -x - z, -x - y
