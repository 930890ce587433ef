"""Nodes that the flange holds: their positions, their reactions, and damping relative to the flange.

Kernels see the flange as a (4, 3) array: its origin [m], then its three axes, world. Damping alpha adds
M alpha (v - u) to the gradient: u is the velocity that nodes would have if they moved with the flange, which
bears the opposite of these forces. It is a loss within the body, and zero for rigid motion. In a step,
u = (X - a) / s, with X made from the last states as a is (see `step_scheme`), after carrying them rigidly
with the flange's motion to the end of the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.base.kernel_types import Indices, Masks, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector, unchecked, zero_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.step_prediction import StepCoefficients

_LEAST_WIDE: Final = (
    1e-6  # width of a triangle of held nodes over its length: rounding rotates a narrower one
)
_JUMP_m: Final = 2e-5
"""Distance of held nodes from free flight above which all nodes are moved with the flange."""


class HeldNodes(NamedTuple):
    """The arrays of a `Clamp`.

    Args:
        nodes: (k,).
        offsets: (k, 3) [m], flange frame.
        components: (k, 3), world components that are held.
        triad: (3,), rows of three wholly held nodes that define the flange's pose; (0,) if all wholly held
            nodes are on one line.
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
def _held_position(held: HeldNodes, flange: Matrix, k: int, r: int) -> float:
    """Return component r of the position of held node k on the flange."""
    position = held.offsets[k, 0] * flange[1, r] + held.offsets[k, 1] * flange[2, r]
    return position + held.offsets[k, 2] * flange[3, r] + flange[0, r]


@device_function
def _place_all(held: HeldNodes, flange: Matrix, x: Matrix) -> None:
    for k in range(held.nodes.shape[0]):
        for r in range(3):
            if held.components[k, r]:
                x[held.nodes[k], r] = _held_position(held, flange, k, r)


@kernel
def place_held(held: HeldNodes, flange: Matrix, x: Matrix) -> None:
    """Set the held components of x (n, 3) [m] to their positions on the flange."""
    _place_all(held, flange, x)


@kernel
def place_flight(held: HeldNodes, flange: Matrix, x: Matrix) -> bool:
    """Set the held components to their positions on the flange; after a jump, move all nodes with them.

    Free flight does not include a new command of the flange. Moving the held nodes alone would stretch the
    film next to them with very large forces; if all nodes are moved, only their inertia resists.

    Args:
        held: nodes.
        flange: (4, 3).
        x: (n, 3) [m], in free flight; changed.

    Returns:
        Whether all nodes were moved, by the mean jump of the wholly held ones.
    """
    jump, count, largest_jump = zero_vector(3), 0, 0.0
    for k in range(held.nodes.shape[0]):
        if held.components[k, 0] and held.components[k, 1] and held.components[k, 2]:
            count += 1
            for r in range(3):
                jump[r] += _held_position(held, flange, k, r) - x[held.nodes[k], r]
    for r in range(3):
        largest_jump = max(largest_jump, abs(jump[r]))
    jumps = largest_jump > _JUMP_m * count
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
        gradient: (n, 3) [N], of the potential; in held components it is the reaction.
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
def _fill_axes(points: Matrix, a: int, b: int, c: int, axes: Matrix) -> None:
    """Fill axes (3, 3) with the unit vectors, as rows, of a frame on three points not on one line."""
    length = along = 0.0
    for r in range(3):
        axes[0, r], axes[1, r] = points[b, r] - points[a, r], points[c, r] - points[a, r]
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
def _add_carried(held: HeldNodes, flange: Matrix, x: Matrix, weight: float, along: Matrix) -> None:
    """Add weight times the displacement of nodes at x (n, 3) [m] by the flange's motion since then."""
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
        origin = _held_position(held, flange, a, r)
        for i in range(x.shape[0]):
            carried = origin
            for s in range(3):
                carried += turn[r, s] * (x[i, s] - x[first, s])
            along[i, r] += weight * (carried - x[i, r])


@kernel
def fill_flange_velocity(
    held: HeldNodes, flange: Matrix, x: Matrix, earlier_x: Matrix, numbers: StepCoefficients, along: Matrix
) -> None:
    """Fill along (n, 3) [m/s] with u, the velocities of nodes that move with the flange in a step.

    Zero if the held nodes do not define the flange's pose.

    Args:
        held: nodes; at x and earlier_x they are at their positions on the flange.
        flange: (4, 3), at the end of the step.
        x: (n, 3) [m], before the step.
        earlier_x: one step earlier; not used by one-step schemes.
        numbers: coefficients of the step.
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


class DampedNodes(NamedTuple):
    """Nodes with damping relative to the flange.

    Args:
        mass: (n,) [kg].
        alpha_s: alpha s, and
        span: s [s], of the step; see `StepCoefficients`.
        along: (n, 3) [m/s], u of `fill_flange_velocity`.
    """

    mass: Vector
    alpha_s: float
    span: float
    along: Matrix


@kernel
def add_damping(damped: DampedNodes, x: Matrix, velocity: Matrix, flange: Matrix, wrench: Vector) -> None:
    """Add the damping forces on the flange, m alpha (v - u) of each node, to the wrench (6,) on it."""
    for n in range(x.shape[0]):
        for r in range(3):
            i, k = (r + 1) % 3, (r + 2) % 3
            scale = damped.mass[n] * damped.alpha_s / damped.span
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
        offsets: (k, 3) [m], their positions in the flange frame.
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
        """Return whether it holds the same nodes at the same positions as another clamp."""
        if self is other:
            return True
        pairs = (self.nodes, other.nodes), (self.offsets, other.offsets), (self.components, other.components)
        return all(np.array_equal(own_array, other_array) for own_array, other_array in pairs)

    def extended(self, nodes: IntArray, positions: Array, world_from_flange: Pose) -> Clamp:
        """Return a clamp that also holds `nodes` (m,) as a whole; see `holding`."""
        held = np.zeros((len(positions), 3), dtype=bool)
        held[nodes] = True
        return self.holding(held, positions, world_from_flange)

    def holding(self, held: Mask, positions: Array, world_from_flange: Pose) -> Clamp:
        """Return a clamp that also holds further components where they are now.

        Args:
            held: (n, 3) bool, components to hold in addition to those already held.
            positions: (n, 3) [m], world, of all nodes.
            world_from_flange: present pose of the flange.
        """
        mask = self.mask(len(positions)) | held
        offsets = world_from_flange.inverse().apply(positions)
        is_whole = self.components.all(axis=1)
        offsets[self.nodes[is_whole]] = self.offsets[is_whole]
        nodes = np.flatnonzero(mask.any(axis=1))
        return Clamp(nodes, offsets[nodes], mask[nodes])

    def without(self, nodes: IntArray) -> Clamp:
        """Return a clamp that does not hold the given nodes."""
        remaining = ~np.isin(self.nodes, nodes)
        return Clamp(self.nodes[remaining], self.offsets[remaining], self.components[remaining])

    def mask(self, count: int) -> Mask:
        """Return (count, 3) bool, true where a component is held."""
        held = np.zeros((count, 3), dtype=bool)
        held[self.nodes] = self.components
        return held

    def place(self, positions: Array, world_from_flange: Pose) -> Array:
        """Return the positions (n, 3) [m] with the held components at their positions on the flange."""
        placed = np.array(positions, order="C")
        place_held(self.held, flange_axes(world_from_flange), placed)
        return placed

    @cached_property
    def held(self) -> HeldNodes:
        """The clamp's arrays, for kernels."""
        nodes, offsets = np.array(self.nodes, order="C"), np.array(self.offsets, order="C")
        return HeldNodes(nodes, offsets, np.array(self.components, order="C"), self._triad)

    @cached_property
    def _triad(self) -> IntArray:
        whole = np.flatnonzero(self.components.all(axis=1))
        if len(whole) < 3:
            return np.zeros(0, np.int64)
        offsets = self.offsets[whole]
        farthest = int(np.argmax(np.linalg.norm(offsets - offsets[0], axis=1)))
        across = np.linalg.norm(np.cross(offsets[farthest] - offsets[0], offsets - offsets[0]), axis=1)
        aside, length = int(np.argmax(across)), float(np.linalg.norm(offsets[farthest] - offsets[0]))
        if not across[aside] > _LEAST_WIDE * length**2:
            return np.zeros(0, np.int64)
        return np.asarray(whole[[0, farthest, aside]], dtype=np.int64)

    @cached_property
    def _whole(self) -> bool:
        """Whether all nodes are held in all components."""
        return bool(self.components.all())

    def reaction(self, gradient: Array) -> Array:
        """Return the reaction (k, 3) [N] of the flange on each held node, zero in free components.

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
        damped: tuple[DampedNodes, Array] | None = None,
    ) -> Wrench:
        """Return the body's wrench on the flange, at its origin, world axes.

        force = -sum_k r_k, torque = -sum_k (x_k - o) x r_k, with r the reactions at the held nodes.

        Args:
            gradient: (n, 3) [N].
            positions: (n, 3) [m], world.
            world_from_flange: pose of the flange, o its origin.
            damped: damped nodes, and their velocities (n, 3) [m/s]; None for none.
        """
        wrench, flange = np.zeros(6), flange_axes(world_from_flange)
        unchecked(add_wrench)(self.held, gradient, positions, flange, wrench)
        if damped is not None:
            unchecked(add_damping)(damped[0], positions, damped[1], flange, wrench)
        return Wrench.owning(wrench[:3], wrench[3:])
