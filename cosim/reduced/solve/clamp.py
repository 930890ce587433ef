"""How a chain is held, moves in time, and where in the working range of its model it is.

Which frames of a chain the flange holds, and where.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, cross
from cosim.errors import InputError, OutOfRangeError
from cosim.reduced.section_model import RingFrames, SectionBody, carried
from cosim.reduced.sections.section_energy import BENT, HIGH, LOW
from cosim.soft.solve.state import Clamp


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
    """Return how the frames' points (f, 4, 3) move with the film's nodes; what the flange holds is at rest.

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


@final
@dataclass(frozen=True)
class FrameClamp:
    """Frames held rigidly to the flange.

    Args:
        held: (f,) which.
        offsets: (f, 4, 3), held frames in the flange frame; of others without meaning.
    """

    held: Mask
    offsets: Array

    @classmethod
    def of_base(cls, section: SectionBody) -> "FrameClamp":
        """Return the clamp that holds the flange's own frame, and those at which copies begin."""
        return cls(section.frames.bases, section.frames.drawn)

    @cached_property
    def free(self) -> Mask:
        """(f,) frames that can move."""
        return ~self.held

    def place(self, frames: Array, flange: Pose) -> Array:
        """Return the frames (f, 4, 3) with the held ones where the flange has them."""
        placed = frames.copy()
        placed[self.held] = carried(self.offsets[self.held], flange)
        return placed

    def holding(self, section: SectionBody, nodes: Mask, frames: Array, flange: Pose) -> "FrameClamp":
        """Return a clamp that also holds the rings of some nodes where they are now.

        Args:
            section: whose rings they are.
            nodes: (n, 3) components to hold: whole rings.
            frames: (f, 4, 3), where they are.
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
        """Return a clamp that lets the rings of the given nodes (m,) go.

        Raises:
            InputError: the base is to be let go.
        """
        if np.isin(section.body.base, nodes).any():
            raise InputError("section models cannot let go of their base; use fidelity = 'lumped'")
        held = self.held.copy()
        for f, ring in enumerate(section.frames.rings, start=1):
            held[f] &= not np.isin(ring, nodes).any()
        return FrameClamp(held, self.offsets)


_AT_ITS_END = 0.95
"""Share of the range from which on a solution that is not found is put down to it."""


_ROUNDING = 1e-9
_NO_STRETCH = 1e-100  # what a stretch over it is: finite, and beyond any range
INSTEAD: Final = "use fidelity = 'lumped', which knows what lies beyond"


@final
@dataclass(frozen=True)
class PlaceInRange:
    """The section that is nearest to the end of its range.

    Args:
        fraction: of the range that it uses; 1 at its end.
        text: which section, which strain, its value and the end of its range.
    """

    fraction: float
    text: str

    @property
    def at_its_end(self) -> bool:
        """Whether a step or an equilibrium that is not found there is one that the model does not have."""
        return self.fraction > _AT_ITS_END


def place_in_range(
    section: SectionBody, frames: Array, pressure_Pa: float, *, bends_only: bool = False
) -> PlaceInRange:
    """Return where the section is that uses most of its range.

    Args:
        section: model.
        frames: (f, 4, 3).
        pressure_Pa: gauge.
        bends_only: whether stretch does not count.
    """
    section.set_pressure(pressure_Pa)
    values, limits = section.frames.strains(frames), section.coefficients
    stretch = values[:, 2] * section.inverse_length - 1.0
    # a spline through few pressures may leave its sign between them: no bend or stretch is within range there
    bend_end = np.sqrt(np.maximum(limits[:, BENT], np.finfo(float).tiny))
    bend = np.hypot(values[:, 3], values[:, 4])
    stretch_end = np.where(
        stretch < 0.0, np.minimum(limits[:, LOW], -_NO_STRETCH), np.maximum(limits[:, HIGH], _NO_STRETCH)
    )
    fractions = np.stack([np.where(bends_only, 0.0, stretch / stretch_end), bend / bend_end])
    kind, worst = divmod(int(np.argmax(fractions)), len(stretch))
    copy, at = divmod(worst, count := len(stretch) // section.frames.copies)
    names = ("flange", *section.body.frame_rings, "tip")
    where = f"section {at + 1} of {count} ({names[at]} to {names[at + 1]})"
    if section.frames.copies > 1:
        where += f" of copy {copy + 1}"
    if kind:
        what = f"is bent by {_degrees(bend[worst])} degrees, its model ends at {_degrees(bend_end[worst])}"
    else:
        word = "shortened" if stretch[worst] < 0.0 else "stretched"
        value, end = 100.0 * abs(stretch[worst]), 100.0 * abs(stretch_end[worst])
        what = f"is {word} by {value:.1f} %, its model ends at {end:.1f} %"
    return PlaceInRange(float(fractions[kind, worst]), f"{where} {what} (at {1e-3 * pressure_Pa:.3g} kPa)")


def check_pressure(section: SectionBody, pressure_Pa: float, residual_N: float, iterations: int) -> None:
    """Check that a solution is within the pressures that a model was built from.

    Args:
        section: model.
        pressure_Pa: gauge, of the solution.
        residual_N: of it.
        iterations: that it took.

    Raises:
        OutOfRangeError: it is beyond them.
    """
    end = section.model.spline.largest_Pa
    if pressure_Pa > end * (1.0 + _ROUNDING):
        text = f"its gas is at {1e-3 * pressure_Pa:.4g} kPa, its model ends at {1e-3 * end:.4g}"
        raise OutOfRangeError(f"the section model ends here: {text}; {INSTEAD}", residual_N, iterations, text)


def _degrees(sine: float) -> str:
    return f"{math.degrees(math.asin(min(float(sine), 1.0))):.1f}"


def film_clamp(section: SectionBody, frames: FrameClamp, shape: Array, flange: Pose) -> Clamp:
    """Return what holds a film as some frames of its chain are held: base, and rings where they are.

    Args:
        section: whose film.
        frames: that are held.
        shape: (n, 3) [m], of the film.
        flange: its pose.
    """
    held = np.zeros(shape.shape, dtype=bool)
    for ring, whole in zip(section.frames.rings, frames.held[1:], strict=True):
        held[ring] = whole
    clamp = Clamp.of_base(section.body)
    return clamp.holding(held, shape, flange) if held.any() else clamp
