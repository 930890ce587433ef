"""Kernels on whole chains: assembly, Newton's method, changes of frames, volume."""

from __future__ import annotations

import numpy as np
from numba import int64, types, void

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import (
    INDICES,
    MATRIX,
    REAL,
    VECTOR,
    device_function,
    kernel,
    small_matrix,
    small_vector,
)
from cosim.reduced.sections.block_cholesky import factorise, substitute
from cosim.reduced.sections.contact_terms import add_contacts
from cosim.reduced.sections.frame_terms import add_cables, add_frames
from cosim.reduced.sections.section_energy import section_energy
from cosim.reduced.sections.section_strains import CUBE, FLAGS, add_sections, section_strains

# chain: coefficients (s, c), inverse lengths (s,), masses (f, 4, 4)
CHAIN = (MATRIX, VECTOR, CUBE)
# loads (f, 4, 3), bed [1/s^2], targets (f, 4, 3)
LOADS = (CUBE, REAL, CUBE)
# cables: far frame of each segment (k,), eyelets (k, 2, 3), tensions (k,)
CABLES = (INDICES, CUBE, VECTOR)
# contacts: first frame of each (k,), rows (k, 17), widths (2,) of the law; see `chain_contact`
TOUCHED = (INDICES, MATRIX, VECTOR)
# gradient (f, 6), diagonal blocks (f, 6, 6), blocks of rows f and columns f - 1 (f, 6, 6)
OUT = (MATRIX, CUBE, CUBE)
# factor of the tangent: blocks (f, 6, 6) of `block_cholesky`, and whether they hold one that may serve
FACTOR = (CUBE, CUBE, types.boolean)

CONVERGED, LIMIT, NOT_FINITE, INDEFINITE, NO_DESCENT = 0, 1, 2, 3, 4
_SHIFT_START, _SHIFT_MAX = 0.05, 1e8  # [N/m]
_STEP_MAX_M, _TURN_MAX = 0.05, 0.4
_HALVINGS_MAX = 20


@kernel(REAL(CUBE, *CHAIN, *LOADS, *CABLES, *TOUCHED, *OUT, types.boolean), taken_in=True)
def assemble(  # type: ignore[no-untyped-def]
    frames, coefficients, inverse_length, mass, load, bed, target, far, eyelets, tension, touching, rows,
    widths, gradient, diagonal, off, hessian,
):  # fmt: skip
    """Fill the gradient and, if asked to, the Hessian's blocks; return the potential [J]."""
    energy = add_frames(frames, load, bed, mass, target, gradient, diagonal, hessian)
    energy += add_sections(frames, coefficients, inverse_length, gradient, diagonal, off, hessian)
    energy += add_cables(frames, far, eyelets, tension, gradient, diagonal, off, hessian)
    return energy + add_contacts(frames, touching, rows, widths, gradient, diagonal, off, hessian)


@kernel(void(CUBE, MATRIX, REAL, CUBE), taken_in=True)
def change_frames(frames: Array, step: Array, factor: float, out: Array) -> None:
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
def copy_frames(frames, out):  # type: ignore[no-untyped-def]
    """Fill out (f, 4, 3); an assignment of whole arrays takes seconds to compile, as it can fail."""
    for f in range(frames.shape[0]):
        for a in range(4):
            for r in range(3):
                out[f, a, r] = frames[f, a, r]


@device_function
def _residual(gradient, free, lever):  # type: ignore[no-untyped-def]
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
def _descent(free, gradient, step):  # type: ignore[no-untyped-def]
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
def _descends(value, energy, fall, residual, before):  # type: ignore[no-untyped-def]
    """Whether a step has lowered the potential as it should, or the residual by far."""
    if not np.isfinite(value):
        return False
    return value <= energy + 1e-4 * fall + 1e-13 * (1.0 + abs(energy)) or residual < 0.1 * before


@device_function
def _factorise(free, diagonal, off, scale, low, side):  # type: ignore[no-untyped-def]
    """Factorise the tangent; return the least shift [N/m] tried that makes it definite, or one too large."""
    shift = 0.0
    while shift <= _SHIFT_MAX and not factorise(free, diagonal, off, shift, scale, low, side):
        shift = max(_SHIFT_START, 6.0 * shift)
    return shift


@kernel(
    types.Tuple((int64, int64, REAL, REAL, int64, types.boolean))(
        CUBE, FLAGS, *CHAIN, *LOADS, *CABLES, *TOUCHED, *OUT, *FACTOR, VECTOR, int64
    ),
    allocates=True,
    taken_in=True,
)
def minimise(  # type: ignore[no-untyped-def]
    frames, free, coefficients, inverse_length, mass, load, bed, target, far, eyelets, tension,
    touching, rows, widths, gradient, diagonal, off, low, side, kept, bounds, iterations_max,
):  # fmt: skip
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


@kernel(REAL(CUBE, MATRIX, MATRIX, VECTOR, VECTOR), taken_in=True)
def gas_volume(
    frames: Array, coefficients: Array, rates: Array, inverse_length: Array, length_rate: Array
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


@kernel(void(CUBE, INDICES, CUBE, MATRIX), taken_in=True)
def combine_points(frames: Array, before: IntArray, weights: Array, out: Array) -> None:
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
