"""Frames of a chain that the flange holds, and the relation of frames and film nodes."""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, cross
from cosim.errors import InputError
from cosim.reduced.section_model import RingFrames, SectionBody, carried
from cosim.soft.solve.clamp import Clamp


def twists(frames: Array, rates: Array) -> Array:
    """Return (f, 6): velocity of each origin and angular velocity, sum_i a_i x da_i/dt / 2.

    Args:
        frames: (f, 4, 3).
        rates: (f, 4, 3), velocities of the points.
    """
    spin = 0.5 * cross(frames[:, 1:], rates[:, 1:]).sum(axis=1)
    return np.concatenate([rates[:, 0], spin], axis=1)


def upright(frames: Array) -> Array:
    """Return frames (f, 4, 3) with the nearest orthonormal axes."""
    u, _, v = np.linalg.svd(frames[:, 1:])
    return np.ascontiguousarray(np.concatenate([frames[:, :1], u @ v], axis=1))


def rigid_motion(arm: Array, moved: Array) -> Array:
    """Return the motion (6,) of the frame of some nodes that best fits how they move.

    Args:
        arm: (m, 3) [m], nodes from the frame's origin.
        moved: (m, 3) [m or m/s].
    """
    middle = arm.mean(axis=0)
    around = arm - middle
    inertia = (around**2).sum() * np.eye(3) - around.T @ around
    turn = np.linalg.solve(inertia, cross(around, moved).sum(axis=0))
    return np.concatenate([moved.mean(axis=0) - np.cross(turn, middle), turn])


def rates_from_nodes(layout: RingFrames, frames: Array, moved: Array) -> Array:
    """Return the motion of the frames' points (f, 4, 3) with the film's nodes; held frames are at rest.

    Args:
        layout: which rings are frames.
        frames: (f, 4, 3).
        moved: (n, 3) [m or m/s].
    """
    rates = np.zeros_like(frames)
    for f in np.flatnonzero(~layout.bases):
        ring, shape = layout.rings[f - 1], layout.shapes[f - 1]
        motion = rigid_motion(shape @ frames[f, 1:], moved[ring])
        rates[f, 0] = motion[:3]
        rates[f, 1:] = np.cross(motion[3:], frames[f, 1:])
    return rates


def node_motion(section: SectionBody, frames: Array, pressure_Pa: float) -> Array:
    """Return d nodes / d (dr, phi): (n, 3, f, 6).

    Args:
        section: of the film.
        frames: (f, 4, 3).
        pressure_Pa: of the gas.
    """
    weights, before = section.node_weights(pressure_Pa), section.frames.before
    count = len(weights)
    jacobian = np.zeros((count, 3, len(frames), 6))
    nodes = np.arange(count)
    for side in (0, 1):
        frame = before + side
        arm = np.einsum("na,nar->nr", weights[:, side, 1:], frames[frame, 1:])
        for r, s, t in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            jacobian[nodes, r, frame, r] = weights[:, side, 0]
            # phi x arm
            jacobian[nodes, r, frame, 3 + s] = arm[:, t]
            jacobian[nodes, r, frame, 3 + t] = -arm[:, s]
    return jacobian


@final
@dataclass(frozen=True)
class FrameClamp:
    """Frames held rigidly to the flange.

    Args:
        held: (f,), mask.
        offsets: (f, 4, 3), held frames in the flange frame; other rows are not used.
    """

    held: Mask
    offsets: Array

    @classmethod
    def of_base(cls, section: SectionBody) -> "FrameClamp":
        """Return the clamp that holds the frame of the flange and the base frames of copies."""
        return cls(section.frames.bases, section.frames.drawn)

    @cached_property
    def free(self) -> Mask:
        """(f,) frames that can move."""
        return ~self.held

    def place(self, frames: Array, flange: Pose) -> Array:
        """Return the frames (f, 4, 3) with the held ones at their poses on the flange."""
        placed = frames.copy()
        placed[self.held] = carried(self.offsets[self.held], flange)
        return placed

    def holding(self, section: SectionBody, nodes: Mask, frames: Array, flange: Pose) -> "FrameClamp":
        """Return a clamp that also holds the rings of some nodes at their present poses.

        Args:
            section: whose rings they are.
            nodes: (n, 3) components to hold: whole rings.
            frames: (f, 4, 3), present poses.
            flange: its pose.

        Raises:
            InputError: less than a whole ring, or nodes between rings, are to be held.
        """
        held, covered = self.held.copy(), np.zeros_like(nodes)
        covered[section.body.base] = True
        for f, ring in enumerate(section.frames.rings, start=1):
            if nodes[ring].all():  # one without a ring is held anyway
                held[f], covered[ring] = True, True
        if (nodes & ~covered).any():
            raise InputError("section models hold whole outer rings or the tip ring; use fidelity = 'lumped'")
        offsets, new = self.offsets.copy(), held & ~self.held
        offsets[new] = carried(frames[new], flange.inverse())
        return FrameClamp(held, offsets)

    def without(self, section: SectionBody, nodes: IntArray) -> "FrameClamp":
        """Return a clamp that releases the rings of nodes (m,).

        Raises:
            InputError: nodes of the base are among them.
        """
        if np.isin(section.body.base, nodes).any():
            raise InputError("section models cannot release their base; use fidelity = 'lumped'")
        held = self.held.copy()
        for f, ring in enumerate(section.frames.rings, start=1):
            held[f] &= not np.isin(ring, nodes).any()
        return FrameClamp(held, self.offsets)


def film_clamp(section: SectionBody, frames: FrameClamp, shape: Array, flange: Pose) -> Clamp:
    """Return the clamp of a film's base and of the rings of held frames at their present positions.

    Args:
        section: whose film.
        frames: that are held.
        shape: (n, 3) [m], of the film.
        flange: its pose.
    """
    held_components = np.zeros(shape.shape, dtype=bool)
    for ring, ring_is_held in zip(section.frames.rings, frames.held[1:], strict=True):
        held_components[ring] = ring_is_held
    clamp = Clamp.of_base(section.body)
    return clamp.holding(held_components, shape, flange) if held_components.any() else clamp
