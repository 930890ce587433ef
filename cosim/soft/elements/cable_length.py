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

TRANSITION_m: Final = 2e-5
"""d: far below the lengths that are wound; at L = L_0 a cable of 10 N/mm carries k d / 8 = 25 mN."""


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
