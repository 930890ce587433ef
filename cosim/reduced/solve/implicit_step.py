"""One implicit step of a chain of frames, from its start to the wrench at the flange, as a kernel.

The schemes are those of `cosim.soft.solve.time_step`: with v = (x - base) / span,
acceleration = (v - speed) / span and damping alpha, inertia is an elastic bed of coefficient
(1 + alpha span) / span^2 about the target base + span / (1 + alpha span) speed.
"""

from __future__ import annotations

from numba import int64, types

from cosim.base.kernels import MATRIX, REAL, VECTOR, device_function, kernel, small_vector
from cosim.reduced.sections.assembly import (
    CABLES,
    CHAIN,
    FACTOR,
    TOUCHED,
    change_frames,
    copy_frames,
    minimise,
)
from cosim.reduced.sections.outputs import fill_figures
from cosim.reduced.sections.section_strains import CUBE, FLAGS

MOTION = types.Array(types.float64, 4, "C")

FREE_FLIGHT, STANDING, CARRIED, GIVEN = 0, 1, 2, 3
"""Where Newton's method starts: as if nothing acted, where the frames are, as if rigid on the flange, or from
what is in the result already."""


@device_function
def _scheme(here, earlier, two_steps, h, damping, base, target):  # type: ignore[no-untyped-def]
    """Fill base and target (f, 4, 3); return span and the bed's coefficient."""
    span = 2.0 * h / 3.0 if two_steps else h
    share = span / (1.0 + damping * span)
    for f in range(base.shape[0]):
        for a in range(4):
            for r in range(3):
                x, speed = here[0, f, a, r], here[1, f, a, r]
                if two_steps:
                    x = (4.0 * x - earlier[0, f, a, r]) / 3.0
                    speed = (4.0 * speed - earlier[1, f, a, r]) / 3.0
                base[f, a, r] = x
                target[f, a, r] = x + share * speed
    return span, (1.0 + damping * span) / (span * span)


@device_function
def _free_flight(here, h, twists, out):  # type: ignore[no-untyped-def]
    """Fill out (f, 4, 3) with the frames after moving on as they do; twists (f, 6) is scratch."""
    for f in range(out.shape[0]):
        for r in range(3):
            i, k = (r + 1) % 3, (r + 2) % 3
            twists[f, r] = here[1, f, 0, r]
            spin = 0.0
            for a in range(1, 4):
                spin += here[0, f, a, i] * here[1, f, a, k] - here[0, f, a, k] * here[1, f, a, i]
            twists[f, 3 + r] = 0.5 * spin
    change_frames(here[0], twists, h, out)


@device_function
def _carry(frames, flange, out):  # type: ignore[no-untyped-def]
    """Fill out (f, 4, 3) with the frames moved rigidly as frame 0 comes to the flange (4, 3)."""
    arm = small_vector(3)
    for f in range(out.shape[0]):
        for a in range(4):
            for i in range(3):
                arm[i] = 0.0
                for r in range(3):
                    from_origin = frames[f, a, r] - (frames[0, 0, r] if a == 0 else 0.0)
                    arm[i] += from_origin * frames[0, i + 1, r]
            for r in range(3):
                out[f, a, r] = arm[0] * flange[1, r] + arm[1] * flange[2, r] + arm[2] * flange[3, r]
                if a == 0:
                    out[f, a, r] += flange[0, r]


@device_function
def _place(free, offsets, flange, out):  # type: ignore[no-untyped-def]
    """Put the held frames of out where the flange (4, 3) has them, offsets (f, 4, 3) in its frame."""
    for f in range(out.shape[0]):
        if free[f]:
            continue
        for a in range(4):
            for r in range(3):
                out[f, a, r] = (
                    offsets[f, a, 0] * flange[1, r] + offsets[f, a, 1] * flange[2, r]
                    + offsets[f, a, 2] * flange[3, r] + (flange[0, r] if a == 0 else 0.0)
                )  # fmt: skip


@kernel(
    types.Tuple((int64, int64, REAL, types.boolean))(
        MOTION, MOTION, types.boolean, REAL, REAL, int64, MATRIX, FLAGS, CUBE,
        *CHAIN, CUBE, *CABLES, *TOUCHED, CUBE, CUBE, CUBE, *FACTOR, VECTOR, int64, MOTION, MATRIX, VECTOR,
    )
)  # fmt: skip
def implicit_step(  # type: ignore[no-untyped-def]
    here, earlier, two_steps, h, damping, start, flange, free, offsets,
    coefficients, inverse_length, mass, load, far, eyelets, tension, touching, rows, widths,
    target, diagonal, off, low, side, kept, bounds, iterations_max, there, gradient, figures,
):  # fmt: skip
    """Take one step of h [s] from `here` (2, f, 4, 3); return (outcome, iterations, residual [N], kept).

    Fills `there` with the motion at its end, the gradient (f, 6) of the potential and the chain's figures.
    target (f, 4, 3), diagonal and off (f, 6, 6) are scratch; for low, side and kept see `minimise`.
    """
    frames, base = there[0], there[1]
    span, bed = _scheme(here, earlier, two_steps, h, damping, base, target)
    if start == FREE_FLIGHT:
        _free_flight(here, h, gradient, frames)
    elif start == STANDING:
        copy_frames(here[0], frames)
    elif start == CARRIED:
        _carry(here[0], flange, frames)
    _place(free, offsets, flange, frames)
    outcome, iterations, residual, _, _, kept = minimise(
        frames, free, coefficients, inverse_length, mass, load, bed, target, far, eyelets, tension,
        touching, rows, widths, gradient, diagonal, off, low, side, kept, bounds, iterations_max,
    )  # fmt: skip
    for f in range(base.shape[0]):
        for a in range(4):
            for r in range(3):
                base[f, a, r] = (frames[f, a, r] - base[f, a, r]) / span
    fill_figures(frames, free, mass, gradient, figures)
    return outcome, iterations, residual, kept
