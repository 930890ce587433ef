"""States of a soft body: how the flange holds it, its equilibria, and the schemes that step it in time.

Nodes that the flange holds, in kernels: where it has them, and what they put on it.

The flange is a (4, 3) array: its origin [m], then its three axes, world.

Time schemes: what a step makes of positions and velocities, and how closely it is solved.

Implicit Euler:  y = x_n + h v_n,  M (x - y) / h^2 = f(x),  v = (x - x_n) / h.
BDF2, s = 2 h / 3:  a = (4 x_n - x_n-1) / 3,  y = a + s (4 v_n - v_n-1) / 3,  M (x - y) / s^2 = f(x),
v = (x - a) / s; its first step is implicit Euler.
Drag of air beta adds M beta v. Damping alpha adds M alpha (v - u): u is the velocity that nodes would have
if they went along with the flange, which bears the opposite of these forces. It is a loss within the body:
rigid motion is free of it. Of a step, u = (X - a) / s. X is made as a is, from the places to which the
flange's motion since then carries x_n and x_n-1.
Source: Hairer and Wanner, Solving ODEs II, chapter III.1.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Final, Literal, NamedTuple, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.base.kernel_types import Indices, Masks, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector, unchecked, zero_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.contact.self_contact_pairs import FilmMemory
from cosim.soft.solve.branching import Branching
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_begin import BedNumbers

_LEAST_WIDE: Final = 1e-6  # of a triangle of held nodes, over its length: rounding would turn a narrower one
_JUMP_m: Final = 2e-5
"""Of held nodes, from where free flight would have them; below it, flight is as good a start."""


class HeldNodes(NamedTuple):
    """The arrays of a `Clamp`.

    Args:
        nodes: (k,).
        offsets: (k, 3) [m], flange frame.
        components: (k, 3), world components that are held.
        triad: (3,), rows of nodes by which the flange's pose is known; (0,) if those held as a whole are on
            one line.
    """

    nodes: Indices
    offsets: Matrix
    components: Masks
    triad: Indices


def flange_axes(pose: Pose) -> Array:
    """Return a flange's pose as kernels see it (4, 3)."""
    flange = np.empty((4, 3))
    flange[0], flange[1:] = pose.translation, pose.rotation.T
    return flange


@device_function
def _place(held: HeldNodes, flange: Matrix, k: int, r: int) -> float:
    """Return component r of where the flange has held node k."""
    place = held.offsets[k, 0] * flange[1, r] + held.offsets[k, 1] * flange[2, r]
    return place + held.offsets[k, 2] * flange[3, r] + flange[0, r]


@device_function
def _place_all(held: HeldNodes, flange: Matrix, x: Matrix) -> None:
    for k in range(held.nodes.shape[0]):
        for r in range(3):
            if held.components[k, r]:
                x[held.nodes[k], r] = _place(held, flange, k, r)


@kernel
def place_held(held: HeldNodes, flange: Matrix, x: Matrix) -> None:
    """Put the held components of x (n, 3) [m] where the flange has them."""
    _place_all(held, flange, x)


@kernel
def place_flight(held: HeldNodes, flange: Matrix, x: Matrix) -> bool:
    """Put the held components where the flange has them; where that is a jump, all nodes go along.

    Free flight does not know a new command of the flange. Held nodes alone would stretch the film beside
    them, with a force beyond all else that acts; where all are moved, they meet their inertia only.

    Args:
        held: nodes.
        flange: (4, 3).
        x: (n, 3) [m], in free flight; changed.

    Returns:
        Whether the nodes went along: by the mean jump of those of which all components are held.
    """
    jump, count, most = zero_vector(3), 0, 0.0
    for k in range(held.nodes.shape[0]):
        if held.components[k, 0] and held.components[k, 1] and held.components[k, 2]:
            count += 1
            for r in range(3):
                jump[r] += _place(held, flange, k, r) - x[held.nodes[k], r]
    for r in range(3):
        most = max(most, abs(jump[r]))
    jumps = most > _JUMP_m * count
    if jumps:
        for i in range(x.shape[0]):
            for r in range(3):
                x[i, r] += jump[r] / count
    _place_all(held, flange, x)
    return jumps


@kernel
def add_wrench(held: HeldNodes, gradient: Matrix, x: Matrix, flange: Matrix, wrench: Vector) -> None:
    """Subtract the reactions r_k at the held nodes, and (x_k - o) x r_k, from the wrench at the flange.

    Args:
        held: nodes.
        gradient: (n, 3) [N], of the potential; held components are supplied with it.
        x: (n, 3) [m].
        flange: (4, 3).
        wrench: (6,), force and torque on the flange at its origin o, world axes.
    """
    reaction = small_vector(3)
    for k in range(held.nodes.shape[0]):
        node = held.nodes[k]
        for r in range(3):
            reaction[r] = gradient[node, r] if held.components[k, r] else 0.0
        for r in range(3):
            i, m = (r + 1) % 3, (r + 2) % 3
            arm_i, arm_m = x[node, i] - flange[0, i], x[node, m] - flange[0, m]
            wrench[r] -= reaction[r]
            wrench[3 + r] -= arm_i * reaction[m] - arm_m * reaction[i]


@device_function
def _fill_axes(place: Matrix, a: int, b: int, c: int, axes: Matrix) -> None:
    """Fill axes (3, 3) with unit vectors in its rows that go with three places, not on one line."""
    length = along = 0.0
    for r in range(3):
        axes[0, r], axes[1, r] = place[b, r] - place[a, r], place[c, r] - place[a, r]
        length += axes[0, r] * axes[0, r]
        along += axes[0, r] * axes[1, r]
    across = 0.0
    for r in range(3):
        axes[1, r] -= along / length * axes[0, r]
        across += axes[1, r] * axes[1, r]
    for r in range(3):
        axes[0, r], axes[1, r] = axes[0, r] / math.sqrt(length), axes[1, r] / math.sqrt(across)
    for r in range(3):
        i, k = (r + 1) % 3, (r + 2) % 3
        axes[2, r] = axes[0, i] * axes[1, k] - axes[0, k] * axes[1, i]


@device_function
def _add_carried(held: HeldNodes, flange: Matrix, x: Matrix, share: float, along: Matrix) -> None:
    """Add a share of how far the flange's motion since then carries the nodes at x (n, 3) [m]."""
    drawn, before, turn = small_matrix(3, 3), small_matrix(3, 3), small_matrix(3, 3)
    a, b, c = held.triad[0], held.triad[1], held.triad[2]
    first = held.nodes[a]
    _fill_axes(held.offsets, a, b, c, drawn)
    _fill_axes(x, first, held.nodes[b], held.nodes[c], before)
    for r in range(3):
        for s in range(3):
            turn[r, s] = 0.0
            for k in range(3):
                for m in range(3):
                    turn[r, s] += drawn[k, m] * flange[1 + m, r] * before[k, s]
    for r in range(3):
        place = _place(held, flange, a, r)
        for i in range(x.shape[0]):
            carried = place
            for s in range(3):
                carried += turn[r, s] * (x[i, s] - x[first, s])
            along[i, r] += share * (carried - x[i, r])


@kernel
def follow_flange(
    held: HeldNodes, flange: Matrix, x: Matrix, earlier_x: Matrix, numbers: BedNumbers, along: Matrix
) -> None:
    """Fill along (n, 3) [m/s]: how fast nodes would be in a step if they went along with the flange.

    It is zero where the flange's pose cannot be known from what it holds.

    Args:
        held: nodes; at x and earlier_x they are where the flange had them.
        flange: (4, 3), at the end of the step.
        x: (n, 3) [m], before the step.
        earlier_x: one step earlier; of one step alone: anything.
        numbers: of the step.
        along: filled.
    """
    for i in range(x.shape[0]):
        for r in range(3):
            along[i, r] = 0.0
    if held.triad.shape[0] < 3:
        return
    _add_carried(held, flange, x, (4.0 / 3.0 if numbers.two_steps else 1.0) / numbers.span, along)
    if numbers.two_steps:
        _add_carried(held, flange, earlier_x, -1.0 / (3.0 * numbers.span), along)


class Damped(NamedTuple):
    """What damping acts on.

    Args:
        mass: (n,) [kg].
        share: alpha s, and
        span: s [s], of the step; see `BedNumbers`.
        along: (n, 3) [m/s], see `follow_flange`.
    """

    mass: Vector
    share: float
    span: float
    along: Matrix


@kernel
def add_damping(damped: Damped, x: Matrix, velocity: Matrix, flange: Matrix, wrench: Vector) -> None:
    """Add what the flange bears of damping, m alpha (v - u) of each node, to the wrench (6,) on it."""
    for n in range(x.shape[0]):
        for r in range(3):
            i, k = (r + 1) % 3, (r + 2) % 3
            scale = damped.mass[n] * damped.share / damped.span
            wrench[r] += scale * (velocity[n, r] - damped.along[n, r])
            wrench[3 + r] += scale * (
                (x[n, i] - flange[0, i]) * (velocity[n, k] - damped.along[n, k])
                - (x[n, k] - flange[0, k]) * (velocity[n, i] - damped.along[n, i])
            )


@final
@dataclass(frozen=True)
class Clamp:
    """Nodes held rigidly to the flange, as a whole or in single world components.

    Args:
        nodes: (k,) indices, ascending.
        offsets: (k, 3) [m], their places in the flange frame.
        components: (k, 3) bool, the world components in which each is held.
    """

    nodes: Annotated[IntArray, ("k",)]
    offsets: Annotated[Array, ("k", 3)]
    components: Annotated[Mask, ("k", 3)]

    @classmethod
    def of_base(cls, body: SoftBody) -> Clamp:
        """Return the clamp of the body's base nodes, where they are drawn."""
        nodes = np.unique(body.base)
        return cls(nodes, body.positions[nodes], np.ones((len(nodes), 3), dtype=bool))

    def holds_as(self, other: Clamp) -> bool:
        """Return whether it holds the same nodes, at the same places, as another clamp."""
        if self is other:
            return True
        pairs = (self.nodes, other.nodes), (self.offsets, other.offsets), (self.components, other.components)
        return all(np.array_equal(one, two) for one, two in pairs)

    def extended(self, nodes: IntArray, positions: Array, world_from_flange: Pose) -> Clamp:
        """Return a clamp that also holds `nodes` (m,) as a whole; see `holding`."""
        held = np.zeros((len(positions), 3), dtype=bool)
        held[nodes] = True
        return self.holding(held, positions, world_from_flange)

    def holding(self, held: Mask, positions: Array, world_from_flange: Pose) -> Clamp:
        """Return a clamp that also holds further components where they are now.

        Args:
            held: (n, 3) bool, components to hold besides those held already.
            positions: (n, 3) [m], world, of all nodes.
            world_from_flange: present pose of the flange.
        """
        mask = self.mask(len(positions)) | held
        offsets = world_from_flange.inverse().apply(positions)
        whole = self.components.all(axis=1)
        offsets[self.nodes[whole]] = self.offsets[whole]
        nodes = np.flatnonzero(mask.any(axis=1))
        return Clamp(nodes, offsets[nodes], mask[nodes])

    def without(self, nodes: IntArray) -> Clamp:
        """Return a clamp that lets the given nodes go."""
        kept = ~np.isin(self.nodes, nodes)
        return Clamp(self.nodes[kept], self.offsets[kept], self.components[kept])

    def mask(self, count: int) -> Mask:
        """Return (count, 3) bool, true where a component is held."""
        held = np.zeros((count, 3), dtype=bool)
        held[self.nodes] = self.components
        return held

    def place(self, positions: Array, world_from_flange: Pose) -> Array:
        """Return the positions (n, 3) [m] with the held components where the flange has them."""
        placed = np.array(positions, order="C")
        place_held(self.held, flange_axes(world_from_flange), placed)
        return placed

    @cached_property
    def held(self) -> HeldNodes:
        """Its arrays, for kernels."""
        nodes, offsets = np.array(self.nodes, order="C"), np.array(self.offsets, order="C")
        return HeldNodes(nodes, offsets, np.array(self.components, order="C"), self._triad)

    @cached_property
    def _triad(self) -> IntArray:
        whole = np.flatnonzero(self.components.all(axis=1))
        if len(whole) < 3:
            return np.zeros(0, np.int64)
        place = self.offsets[whole]
        far = int(np.argmax(np.linalg.norm(place - place[0], axis=1)))
        across = np.linalg.norm(np.cross(place[far] - place[0], place - place[0]), axis=1)
        aside, length = int(np.argmax(across)), float(np.linalg.norm(place[far] - place[0]))
        if not across[aside] > _LEAST_WIDE * length**2:
            return np.zeros(0, np.int64)
        return np.asarray(whole[[0, far, aside]], dtype=np.int64)

    @cached_property
    def _whole(self) -> bool:
        """Whether all nodes are held in all components."""
        return bool(self.components.all())

    def reaction(self, gradient: Array) -> Array:
        """Return the force (k, 3) [N] that the flange supplies to each held node, free components zero.

        Args:
            gradient: (n, 3) [N], of the potential, inertia included.
        """
        held = gradient[self.nodes]
        return held if self._whole else np.where(self.components, held, 0.0)

    def wrench(
        self,
        gradient: Array,
        positions: Array,
        world_from_flange: Pose,
        damped: tuple[Damped, Array] | None = None,
    ) -> Wrench:
        """Return what the body exerts on the flange, at its origin, world axes.

        force = -sum_k r_k, torque = -sum_k (x_k - o) x r_k, with r the reactions at the held nodes.

        Args:
            gradient: (n, 3) [N].
            positions: (n, 3) [m], world.
            world_from_flange: pose of the flange, o its origin.
            damped: nodes that the flange damps, and their velocities (n, 3) [m/s]; None for none.
        """
        wrench, flange = np.zeros(6), flange_axes(world_from_flange)
        unchecked(add_wrench)(self.held, gradient, positions, flange, wrench)
        if damped is not None:
            unchecked(add_damping)(damped[0], positions, damped[1], flange, wrench)
        return Wrench.owning(wrench[:3], wrench[3:])


@final
@dataclass(frozen=True)
class SoftState:
    """What the next step of a soft body depends on.

    Args:
        positions: (n, 3) [m], world.
        velocities: (n, 3) [m/s].
        memory: (values,), what the elements remember, such as unwrapped hinge angles.
        earlier: positions and velocities one step before, for two-step integrators.
        touching: films that press on one another; None for none.
    """

    positions: Annotated[Array, ("nodes", 3)]
    velocities: Annotated[Array, ("nodes", 3)]
    memory: Annotated[Array, ("values",)]
    earlier: tuple[Annotated[Array, ("nodes", 3)], Annotated[Array, ("nodes", 3)]] | None = None
    touching: FilmMemory | None = None

    @classmethod
    def drawn(cls, body: SoftBody, world_from_flange: Pose) -> SoftState:
        """Return the drawn shape, at rest on the flange."""
        positions = np.ascontiguousarray(world_from_flange.apply(body.positions))
        return cls(positions, np.zeros_like(positions), body.first_memory())

    @classmethod
    def at_rest(cls, positions: Array, memory: Array, touching: FilmMemory | None = None) -> SoftState:
        """Return a state without velocity."""
        return cls(positions, np.zeros_like(positions), memory, None, touching)

    def carried(self, motion: Pose) -> SoftState:
        """Return the state moved rigidly by `motion` (world to world)."""
        turn = motion.rotation.T
        return SoftState(
            np.ascontiguousarray(motion.apply(self.positions)), self.velocities @ turn, self.memory, None,
            None if self.touching is None else self.touching.carried(motion),
        )  # fmt: skip


Obstacles: TypeAlias = Callable[[Array], ContactPlanes | None]
"""Positions (n, 3) [m] -> what may be touched near them, without friction; None for nothing."""


@final
@dataclass(frozen=True)
class Equilibrium:
    """A solved equilibrium.

    Args:
        state: at rest.
        world_from_flange: pose of the flange.
        loads: that it carries.
        wrench: exerted on the flange, at its origin, world axes.
        residual_N: largest out-of-balance component on a free node.
        iterations: Newton iterations spent since the equilibrium it was followed from.
        potential_J: potential energy, loads included.
        shifted: iterations that met an indefinite tangent.
        slides: how often on the way Newton's method found nothing near and a damped slide led on; see
            `equilibrium.slide`.
        negative_pivots: of its tangent, with losses along cables held: directions in which the potential
            falls, 0 where it is stable; None where loads have no potential.
        branchings: passed on the way.
    """

    state: SoftState
    world_from_flange: Pose
    loads: Loads
    wrench: Wrench
    residual_N: float
    iterations: int
    potential_J: float
    shifted: int
    slides: int = 0
    negative_pivots: int | None = None
    branchings: tuple[Branching, ...] = ()


_CLOSE_N = 1e-5  # rings of beams that end their search as in motion leave 2e-6 N
_REUSE_MAX = 30  # iterations with a kept factorisation in a step that is solved closely
_FINE_ITERATIONS_MAX = 4  # new tangents in it below an ordinary step's tolerance

Integrator: TypeAlias = Literal["implicit_euler", "bdf2"]


@final
@dataclass(frozen=True)
class StepOptions:
    """How a time step is solved.

    Args:
        integrator: "implicit_euler" (first order, damps) or "bdf2" (second order, damps less).
        tolerance_N: a step whose residual is below this is done.
        iterations: new tangents of an ordinary step, besides iterations with a kept one.
        residual_bound_N: a step whose residual is above this after them continues iterating; see `bound_N`.
        left_m_s2: what such a step leaves unbalanced accelerates the lightest node by no more.
        newton: bounds of the iteration.
        damping_per_s: alpha [1/s], of motion relative to the flange.
        air_drag_per_s: beta [1/s], of motion in the world.
    """

    integrator: Integrator = "implicit_euler"
    tolerance_N: float = 1e-4
    iterations: int = 1
    residual_bound_N: float = 0.1
    left_m_s2: float = 50.0
    newton: NewtonOptions = NewtonOptions(reuse_max=6)
    damping_per_s: float = 0.0
    air_drag_per_s: float = 0.0

    def bound_N(self, node_mass: Array) -> float:
        """Return the residual [N] with which an ordinary step of nodes (n,) [kg] may end: it throws none.

        min(residual_bound_N, left_m_s2 times the least mass), at least `tolerance_N`.
        """
        return max(self.tolerance_N, min(self.residual_bound_N, self.left_m_s2 * float(node_mass.min())))

    @property
    def losses_per_s(self) -> float:
        """Rate alpha + beta [1/s] at which motion is damped while the flange rests."""
        return self.damping_per_s + self.air_drag_per_s

    @property
    def whole(self) -> NewtonOptions:
        """Bounds of the iteration of an ordinary step until it is solved."""
        return replace(self.newton, tolerance_N=self.tolerance_N)

    @property
    def closely(self) -> bool:
        """Whether what elements find by themselves is to be found as in statics."""
        return self.tolerance_N < _CLOSE_N

    def bed(self, step_s: float, *, first: bool = False) -> BedNumbers:
        """Return the numbers of the bed that inertia and losses are in a step.

        Args:
            step_s: h [s].
            first: whether it begins without a step before it.
        """
        two_steps = self.integrator == "bdf2" and not first
        span = 2.0 * step_s / 3.0 if two_steps else step_s
        factor = span / (1.0 + self.losses_per_s * span)
        return BedNumbers(two_steps, span, factor, self.damping_per_s * span)

    @property
    def gain(self) -> float:
        """Fraction of a step's gain in velocity that moves the nodes; BDF2 moves them with half of it."""
        return 0.5 if self.integrator == "bdf2" else 1.0


def inertia_weight(span: float, losses_per_s: float) -> float:
    """Return (1 + c s) / s^2 [1/s^2]: what a step's inertia and losses add to the stiffness, per mass.

    Args:
        span: s [s], see `BedNumbers`.
        losses_per_s: c [1/s]: alpha + beta of single nodes, beta of the body as one.
    """
    return (1.0 + losses_per_s * span) / span**2


def mode_decay(
    integrator: Integrator, step_s: float, losses_per_s: float, frequency_Hz: float, own_per_s: float = 0.0
) -> tuple[float, float]:
    """Return the decay [1/s] of a natural mode that its losses ask for, and what steps add to it.

    The mode's complex eigenvalue is l = -c / 2 + i sqrt(w^2 - c^2 / 4). Steps multiply it by z:
    1 / (1 - l h) with implicit Euler, the larger root of (3/2 - l h) z^2 - 2 z + 1/2 = 0 with BDF2.

    Args:
        integrator: of the steps.
        step_s: h [s].
        losses_per_s: c, see `StepOptions`.
        frequency_Hz: w / 2 pi, without losses.
        own_per_s: of the mode's materials, comes to c; see `StabilityReport`.
    """
    half = 0.5 * (losses_per_s + own_per_s)
    eigenvalue = -half + cmath.sqrt(half**2 - (2.0 * math.pi * frequency_Hz) ** 2)
    away = eigenvalue * step_s
    if integrator == "bdf2":
        factor = (2.0 + cmath.sqrt(1.0 + 2.0 * away)) / (3.0 - 2.0 * away)
    else:
        factor = 1.0 / (1.0 - away)
    return -eigenvalue.real, eigenvalue.real - math.log(abs(factor)) / step_s


@final
@dataclass(frozen=True)
class StepScheme:
    """What the steps of one length have in common.

    Args:
        bed: its numbers.
        inertia: (n,) [N/m], coefficient of the bed that inertia is.
        kind: tells apart tangents of different beds.
    """

    bed: BedNumbers
    inertia: Array
    kind: float

    @classmethod
    def of(cls, bed: BedNumbers, options: StepOptions, mass: Array) -> StepScheme:
        """Return the scheme of steps with a bed, under some losses, of nodes (n,) [kg]."""
        inertia = mass * inertia_weight(bed.span, options.losses_per_s)
        return cls(bed, inertia, float(inertia.sum()))


@final
@dataclass(frozen=True)
class StepAccuracy:
    """How closely a step is solved that is taken again and again.

    Args:
        tolerance_N: a step whose residual is below this is done.
        start: (n, 3) [m], where an earlier try of the same step ended; None for the first.
        afresh: whether it does not continue with a step that was begun elsewhere: under other loads.
    """

    tolerance_N: float
    start: Array | None = None
    afresh: bool = False

    def newton(self, options: StepOptions) -> tuple[NewtonOptions, NewtonOptions]:
        """Return the bounds of Newton's method up to an ordinary step's tolerance, and beyond it.

        Beyond, few new tangents are spent: where films buckle, the tangent is shifted and gains little.
        """
        coarse = max(self.tolerance_N, options.tolerance_N)
        given, fine = replace(options.newton, reuse_max=_REUSE_MAX), self.tolerance_N
        return (
            replace(given, tolerance_N=coarse, start_tolerance_N=coarse),
            replace(given, tolerance_N=fine, start_tolerance_N=fine, iterations_max=_FINE_ITERATIONS_MAX),
        )
