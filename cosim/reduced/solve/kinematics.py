"""Changes of a chain of frames in time."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, Pose, cross
from cosim.reduced.section_model import SectionBody
from cosim.reduced.sections.ring_frames import RingFrames


def twists(frames: Array, rates: Array) -> Array:
    """Return (f, 6): velocity of each origin and angular velocity, sum_i a_i x da_i/dt / 2.

    Args:
        frames: (f, 4, 3).
        rates: (f, 4, 3), velocities of the points.
    """
    spin = 0.5 * cross(frames[:, 1:], rates[:, 1:]).sum(axis=1)
    return np.concatenate([rates[:, 0], spin], axis=1)


def carried(frames: Array, motion: Pose) -> Array:
    """Return the frames (f, 4, 3) moved rigidly by a motion, world to world."""
    result = frames @ motion.rotation.T
    result[:, 0] += motion.translation
    return np.ascontiguousarray(result)


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
    """Return how the frames' points (f, 4, 3) move with the film's nodes, the flange taken to be at rest.

    Args:
        layout: which rings are frames.
        frames: (f, 4, 3).
        moved: (n, 3) [m or m/s].
    """
    rates = np.zeros_like(frames)
    for f, (ring, shape) in enumerate(zip(layout.rings, layout.shapes, strict=True), start=1):
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
    result = np.zeros((count, 3, len(frames), 6))
    nodes = np.arange(count)
    for side in (0, 1):
        frame = before + side
        arm = np.einsum("na,nar->nr", weights[:, side, 1:], frames[frame, 1:])
        for r, s, t in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            result[nodes, r, frame, r] = weights[:, side, 0]
            # phi x arm
            result[nodes, r, frame, 3 + s] = arm[:, t]
            result[nodes, r, frame, 3 + t] = -arm[:, s]
    return result
