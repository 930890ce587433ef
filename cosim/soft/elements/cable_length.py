"""Cables commanded by their unstretched length, as a winch does, instead of by their tension.

The tension at the base end is T_0 = k f(L - L_0), L the length of the route, L_0 the commanded length, k the
stiffness of the cable, and f(s) = max(s, 0) with a transition of width d in which a slack cable gets taut:
    f = 0 for s < -d/2,  (s + d/2)^2 / (2 d) for |s| < d/2,  s beyond.
Segment i carries T_i = c_i T_0 (losses at the eyelets, see `cable`). For one solution the losses are frozen;
with w_i = c_i / m and m = sum c_i L_i / sum L_i at its start, the term has the potential
    energy = k m F(L_w - L_0), L_w = sum w_i L_i, F' = f,
    gradient = T_i t_i on the far node and -T_i t_i on the near one, T_i = k m f w_i,
    Hessian = T_i / L_i (1 - t_i t_i^T) + k m f' g g^T, g the gradient of L_w: one dense term per cable.
L_w is L wherever the losses were frozen, so that a command means the length of the cable itself. A solution
that moves away from there is repeated from where it ends, until it moves no more (as for capstan friction).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.elements.cable import Cable, add_segments
from cosim.soft.linear.low_rank import LowRank

TRANSITION_m: Final = 2e-5
"""d: far below the lengths that are wound; at L = L_0 a cable of 10 N/mm carries k d / 8 = 25 mN."""

_NO_SLOTS = np.zeros((0, 0), np.int64)
_NO_BLOCKS = np.zeros((0, 3, 3))


def onset(stretch_m: float) -> tuple[float, float, float]:
    """Return F(s), f(s) and f'(s) of a stretch s [m]."""
    d, s = TRANSITION_m, stretch_m
    ahead = s + 0.5 * d
    if ahead <= 0.0:
        return 0.0, 0.0, 0.0
    if ahead < d:
        return ahead**3 / (6.0 * d), ahead**2 / (2.0 * d), ahead / d
    return 0.5 * s * s + d * d / 24.0, s, 1.0


def stretch_at(tension_N: float, stiffness_N_m: float) -> float:
    """Return the stretch s [m] at which k f(s) is a tension; the largest one for a slack cable."""
    d, wanted = TRANSITION_m, tension_N / stiffness_N_m
    return wanted if wanted >= 0.5 * d else float(np.sqrt(2.0 * d * max(wanted, 0.0))) - 0.5 * d


def base_tension(cable: Cable, positions: Array, length_m: float) -> float:
    """Return T_0 [N] of a cable of commanded length [m] at the given shape (n, 3) [m]."""
    return cable.stiffness_N_m * onset(cable.length(positions) - length_m)[1]


def segment_weight(cable: Cable, positions: Array) -> Array:
    """Return w_i = c_i / m (segments,), losses frozen at the given shape (n, 3) [m]."""
    ratio, length = cable.tension_ratio(positions), cable.segment_lengths(positions)
    return np.asarray(ratio * (length.sum() / (ratio @ length)))


def losses_follow(cables: tuple[Cable, ...], lengths_m: tuple[float | None, ...]) -> bool:
    """Return whether a solution with given lengths (or none) has frozen losses that it changes itself."""
    pairs = zip(cables, lengths_m or (None,) * len(cables), strict=True)
    return any(
        length is not None and (cable.loss_factor < 1.0 or cable.friction_coefficient > 0.0)
        for cable, length in pairs
    )


def pull(cable: Cable, positions: Array, weight: Array, length_m: float) -> tuple[Array, float, LowRank]:
    """Return what a cable of commanded length does at a shape.

    Args:
        cable: routed through eyelets.
        positions: (n, 3) [m].
        weight: (segments,), w_i, from `segment_weight`.
        length_m: L_0.

    Returns:
        Tension T_i of the segments (segments,) [N]; energy less sum T_i L_i [J], the energy that these
        tensions would have if they were given; the dense part of the Hessian.
    """
    # the first segment has w_1 = c / m, so that m follows from it
    stiffness = cable.stiffness_N_m * cable.loss_factor / weight[0]
    weighted = float(weight @ cable.segment_lengths(positions))
    energy, force, slope = onset(weighted - length_m)
    gradient = np.zeros_like(positions)
    if slope > 0.0:
        add_segments(positions, cable.segments, weight, _NO_SLOTS, gradient, _NO_BLOCKS)
    dense = LowRank(gradient[None], np.array([stiffness * slope]))
    return stiffness * force * weight, stiffness * (energy - force * weighted), dense
