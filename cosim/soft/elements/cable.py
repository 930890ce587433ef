"""Cables through eyelets at nodes, with commanded tension, or with commanded length as by a winch.

Commanded length: the tension at the base end is T_0 = k f(L - L_0), L the length of the route, L_0 the
commanded length, k the stiffness of the cable, and f(s) = max(s, 0) with a transition of width d in which a
slack cable gets taut:
    f = 0 for s < -d/2,  (s + d/2)^2 / (2 d) for |s| < d/2,  s beyond.
Segment i carries T_i = c_i T_0 (losses at the eyelets, see below). For one solution the losses are frozen;
with w_i = c_i / m and m = sum c_i L_i / sum L_i at its start, the term has the potential
    energy = k m F(L_w - L_0), L_w = sum w_i L_i, F' = f,
    gradient = T_i t_i on the far node and -T_i t_i on the near one, T_i = k m f w_i,
    Hessian = T_i / L_i (1 - t_i t_i^T) + k m f' g g^T, g the gradient of L_w: one dense term per cable.
A cable that creeps (Kelvin-Voigt) carries T_0 = k s + c ds/dt, s = L - L_0. In an implicit Euler step h from
the stretch s_n >= 0 that is a cable q times as stiff, of another length, and with a transition of d / q,
    q = 1 + c / (h k),   L_0' = L_0 + (1 - 1 / q) s_n,
    T_0 = k f(q (L - L_0')),   energy = k m F(q (L_w - L_0')) / q.
A stretch below zero counts as zero: a slack cable has no rate.
L_w is L where the losses were frozen, so that a command means the length of the cable itself. A solution that
moves away from there is repeated from its end, until it does not move any more (as for capstan friction).
Commanded tension: segment i between eyelets has the length L_i and the tension T_i = T_0 c_i, so that
    energy = sum_i T_i L_i,
    gradient = T_i t_i on its far node and -T_i t_i on its near node, t_i the unit direction,
    hessian = T_i / L_i (1 - t_i t_i^T).
Eyelets that meet would have no direction, at the tip of the energy's cone. So below e = 0.1 mm, a film's
thickness, L_i means the rounded length
    l = e (3/8 + 3/4 s^2 - 1/8 s^4),   s = L_i / e,
which joins L_i with its first two derivatives.
Equal and opposite pairs: a cable adds no net force or moment. c_i = c^(i+1) with a loss factor c per
eyelet (segment 0 has passed one eyelet), or exp(-mu x wrap angle) up to the segment (capstan). These are the
losses of a cable without memory, and of one with memory (`eyelets`) while it slides to the base. A cable
cannot push: negative tensions are refused, zero tension is a slack cable.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.errors import InputError
from cosim.soft.elements.element import NODES, Element, Sums, Term
from cosim.soft.linear.pattern import add_block

TRANSITION_m: Final = 2e-5
"""d: far below the lengths that are wound; at L = L_0 a cable of 10 N/mm carries k d / 8 = 25 mN."""


def onset(stretch_m: float) -> tuple[float, float, float]:
    """Return F(s), f(s) and f'(s) of a stretch s [m]."""
    d, s = TRANSITION_m, stretch_m
    beyond = s + 0.5 * d
    if beyond <= 0.0:
        return 0.0, 0.0, 0.0
    if beyond < d:
        return beyond**3 / (6.0 * d), beyond**2 / (2.0 * d), beyond / d
    return 0.5 * s * s + d * d / 24.0, s, 1.0


def stretch_at(tension_N: float, stiffness_N_m: float) -> float:
    """Return the stretch s [m] at which k f(s) is a tension; the largest one for a slack cable."""
    d, taut = TRANSITION_m, tension_N / stiffness_N_m
    return taut if taut >= 0.5 * d else float(np.sqrt(2.0 * d * max(taut, 0.0))) - 0.5 * d


ROUNDED_m: Final = 1e-4
"""e: eyelets nearer to each other than this have met."""


@device_function
def segment_length(x: Matrix, a: int, b: int) -> float:
    """Return the length of a segment [m], rounded where its eyelets meet."""
    square = 0.0
    for r in range(3):
        square += (x[b, r] - x[a, r]) ** 2
    length = np.sqrt(square)
    s = length / ROUNDED_m
    return length if s >= 1.0 else ROUNDED_m * (0.375 + s * s * (0.75 - 0.125 * s * s))


@device_function
def segment_gradient(x: Matrix, a: int, b: int, gradient: Vector) -> None:
    """Fill the derivative (3,) of a segment's length by its far node."""
    square = 0.0
    for r in range(3):
        gradient[r] = x[b, r] - x[a, r]
        square += gradient[r] * gradient[r]
    length = np.sqrt(square)
    s = length / ROUNDED_m
    inverse_length = 1.0 / length if s >= 1.0 else (1.5 - 0.5 * s * s) / ROUNDED_m
    for r in range(3):
        gradient[r] *= inverse_length


@kernel
def weighted_length(x: Matrix, segments: IndexTable, weights: Vector) -> float:
    """Return L_w = sum w_i L_i [m] of the segments (k, 2) of a cable with weights (k,)."""
    total = 0.0
    for s in range(segments.shape[0]):
        total += weights[s] * segment_length(x, segments[s, 0], segments[s, 1])
    return total


@kernel
def add_segments(
    x: Matrix, segments: IndexTable, tension: Vector, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add all segments to gradient, their Hessian to blocks if slots is not empty.

    Returns the energy [J].
    """
    k = small_matrix(3, 3)
    minus = small_matrix(3, 3)
    t = small_vector(3)
    with_hessian = slots.shape[0] > 0
    energy = 0.0
    for e in range(segments.shape[0]):
        pull = tension[e]
        if pull == 0.0:
            continue
        a, b = segments[e, 0], segments[e, 1]
        length = 0.0
        for r in range(3):
            t[r] = x[b, r] - x[a, r]
            length += t[r] * t[r]
        length = np.sqrt(length)
        if length < ROUNDED_m:
            s = length / ROUNDED_m
            energy += pull * ROUNDED_m * (0.375 + s * s * (0.75 - 0.125 * s * s))
            across, along = pull * (1.5 - 0.5 * s * s) / ROUNDED_m, -pull / ROUNDED_m**3
        else:
            energy += pull * length
            across, along = pull / length, -pull / length**3
        for r in range(3):
            gradient[a, r] -= across * t[r]
            gradient[b, r] += across * t[r]
        if with_hessian:
            for r in range(3):
                for c in range(3):
                    k[r, c] = along * t[r] * t[c]
                k[r, r] += across
                for c in range(3):
                    minus[r, c] = -k[r, c]
            add_block(blocks, slots[e, 0], k)
            add_block(blocks, slots[e, 1], minus)
            add_block(blocks, slots[e, 2], k)
    return energy


UNSLID_m: Final = 1.0
"""By how far an anchor is ahead where the cable is pulled taut again, see `eyelets`: beyond every limit."""


@final
@dataclass(frozen=True)
class Cable(Element):
    """One routed cable.

    Args:
        nodes: (eyelets,) node indices, base to tip; the last one is the anchor.
        loss_factor: c, tension ratio per eyelet passed (1 for none).
        friction_coefficient: mu of the capstan law; 0 for none.
        stiffness_N_m: tension per stretch of the whole cable, E A over its length; acts where its length is
            commanded, and where the cable sticks at eyelets.
        loss_N: F, constant loss per eyelet, of a cable that knows which way it slides.
        directed: whether losses oppose the way it slides, see `eyelets`; otherwise tension falls from the
            base on whichever way that is.
        damping_Ns_m: c, tension per rate of that stretch.
    """

    label: ClassVar[str] = "cable"
    merges: ClassVar[bool] = False
    far: ClassVar[bool] = True

    nodes: Annotated[IntArray, NODES]
    loss_factor: float = 1.0
    friction_coefficient: float = 0.0
    stiffness_N_m: float = 1e4
    loss_N: float = 0.0
    directed: bool = False
    damping_Ns_m: float = 0.0

    def __post_init__(self) -> None:
        if len(self.nodes) < 2 or len(set(np.asarray(self.nodes).tolist())) != len(self.nodes):
            raise InputError(
                f"a cable needs at least two different eyelets and no eyelet twice; got nodes "
                f"{np.asarray(self.nodes).tolist()}"
            )
        if not 0.0 < self.loss_factor <= 1.0:
            raise InputError(f"cable loss factor {self.loss_factor} must lie in (0, 1]")
        if not self.friction_coefficient >= 0.0:
            raise InputError(f"cable friction coefficient {self.friction_coefficient} must not be negative")
        if not 0.0 < self.stiffness_N_m < np.inf:
            raise InputError(f"cable stiffness {self.stiffness_N_m} N/m must be positive and finite")
        if not 0.0 <= self.loss_N < np.inf:
            raise InputError(f"cable loss {self.loss_N} N per eyelet must be 0 or more, and finite")
        if not 0.0 <= self.damping_Ns_m < np.inf:
            raise InputError(f"cable damping {self.damping_Ns_m} N s/m must be 0 or more, and finite")

    @property
    def coupled(self) -> IntArray:
        return self.nodes[None] if self.remembers else self.segments

    @property
    def remembers(self) -> bool:
        """Whether its eyelets remember which way it has slid."""
        return self.directed and self.lossy

    @property
    def lossy(self) -> bool:
        """Whether tension is lost at its eyelets."""
        return self.loss_factor < 1.0 or self.friction_coefficient > 0.0 or self.loss_N > 0.0

    @property
    def law(self) -> tuple[float, float, float, float]:
        """c, mu, F [N] and k [N/m] of its eyelets, see `eyelets`."""
        return self.loss_factor, self.friction_coefficient, self.loss_N, self.stiffness_N_m

    def first_memory(self, positions: Array) -> Array:
        """Return the anchors (eyelets - 1,) [m] of a cable that is pulled taut; of others nothing."""
        if not self.remembers:
            return np.zeros(0)
        return UNSLID_m + np.cumsum(self.segment_lengths(positions)[::-1])[::-1]

    @classmethod
    def bound(cls, alike: "Sequence[Cable]", sums: Sums) -> Sequence[Term]:
        """Return no terms: cables depend on the loads of the body, so `FilmPotential` adds them."""
        return ()

    @property
    def segments(self) -> IntArray:
        """(eyelets - 1, 2) near and far node of each segment."""
        return np.stack([self.nodes[:-1], self.nodes[1:]], axis=1)

    def tension_ratio(self, positions: Array) -> Array:
        """Return T_i / T_0 (eyelets - 1,) at the given shape.

        Args:
            positions: (n, 3) [m].
        """
        ratio = self._frictionless_ratio
        if self.friction_coefficient > 0.0:
            step = np.diff(positions[self.nodes], axis=0)
            step = step / np.maximum(np.linalg.norm(step, axis=1), 1e-300)[:, None]
            cosine = np.clip((step[1:] * step[:-1]).sum(axis=1), -1.0, 1.0)
            wrap = np.concatenate([[0.0], np.cumsum(np.arccos(cosine))])
            ratio = ratio * np.exp(-self.friction_coefficient * wrap)
        return ratio

    @cached_property
    def _frictionless_ratio(self) -> Array:
        ratio: Array = self.loss_factor ** np.arange(1.0, len(self.nodes))
        return ratio

    def length(self, positions: Array) -> float:
        """Return the length of the routed polyline [m]."""
        return float(self.segment_lengths(positions).sum())

    def segment_lengths(self, positions: Array) -> Array:
        """Return the length of every segment (eyelets - 1,) [m], rounded where eyelets meet."""
        eyelets = positions[self.nodes]
        step = eyelets[1:] - eyelets[:-1]
        length = np.sqrt((step * step).sum(axis=1))
        if length.min() >= ROUNDED_m:
            return np.asarray(length)
        s = length / ROUNDED_m
        return np.asarray(np.where(s < 1.0, ROUNDED_m * (0.375 + s * s * (0.75 - 0.125 * s * s)), length))


def base_tension(cable: Cable, positions: Array, length_m: float, stiffening: float = 1.0) -> float:
    """Return T_0 [N] of a cable of commanded length [m] at the given shape (n, 3) [m].

    Args:
        cable: which one.
        positions: (n, 3) [m].
        length_m: L_0, or L_0' of a step.
        stiffening: q of a step.
    """
    return cable.stiffness_N_m * onset(stiffening * (cable.length(positions) - length_m))[1]


def step_spring(cable: Cable, stretch_m: float, step_s: float) -> tuple[float, float]:
    """Return q of a cable in a step, and by how much L_0' is longer than L_0 [m].

    Args:
        cable: which one.
        stretch_m: s_n, where the step begins.
        step_s: h; infinite in statics.
    """
    stiffening = 1.0 + cable.damping_Ns_m / (step_s * cable.stiffness_N_m)
    return stiffening, (1.0 - 1.0 / stiffening) * stretch_m


def losses_follow(cables: tuple[Cable, ...], lengths_m: tuple[float | None, ...]) -> bool:
    """Return whether a solution with given lengths (or none) has frozen losses that it changes itself."""
    if not any(lengths_m):
        return False
    return any(length is not None and cable.lossy for cable, length in zip(cables, lengths_m, strict=True))
