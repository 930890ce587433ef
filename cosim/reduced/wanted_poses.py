"""Draws the strains at which a film is sampled, over a working range: straight, almost straight and bent
ones.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array

_STRAIGHT = 5  # straight samples at each pressure
_BEND_MAX = 0.5
_ACROSS = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])  # all strains but the length
_HALF = 2.8  # largest bends of half units over those of whole units of the same length
_LEAST_GAP = 0.02  # part of the gap closed by a bend that stays open


@final
@dataclass(frozen=True)
class WorkingRange:
    """Range of pressures and strains that are sampled.

    Args:
        pressures_Pa: increasing from 0.
        tension_N: axial force up to which sections are stretched.
        samples: number at each pressure, in addition to straight and almost straight ones.
        compression: largest shortening of a section over its length without load; less at low pressure.
        least_compression: the same for square frames with hardly any gas.
        bend: largest angle between neighbouring frames, over the angle at which their rims would meet.
        fold: the same for square frames, at the length of the free film, or at half of that at the largest
            pressure if that is more.
        twist: sine of the largest angle about the axis.
        shear_m: largest shift between neighbouring frames.
        small: fraction of bend, twist and shear in samples that are almost straight.
    """

    pressures_Pa: tuple[float, ...]
    tension_N: float
    samples: int
    compression: float = 0.35
    least_compression: float = 0.1
    bend: float = 0.75
    fold: float = 0.9
    twist: float = 0.02
    shear_m: float = 3e-4
    small: float = 0.15


@final
@dataclass(frozen=True)
class Lengths:
    """Lengths (s,) [m] of the sections at a pressure: the shortest and longest to sample, and the free ones.

    Args:
        low: shortest.
        still: free.
        high: longest.
        longest: free at the largest pressure.
    """

    low: Array
    still: Array
    high: Array
    longest: Array


@final
@dataclass(frozen=True)
class Poses:
    """Draws random strains at a pressure.

    Args:
        lengths: of the sections.
        radii: (s,) [m], of the far ring of each section.
        rims: (s, n, 2) [m], see `RingFrames.rims`.
        work: working range.
    """

    lengths: Lengths
    radii: Array
    rims: Array
    work: WorkingRange

    def draw(self, random: np.random.Generator) -> list[Array]:
        """Return wanted strains (s, 6): straight ones, almost straight ones, and bent ones."""
        straight = [self._straight(fraction) for fraction in np.linspace(0.0, 1.0, _STRAIGHT)]
        # small ones identify the stiffnesses against shear, bending and twist separately
        small = [at + self.work.small * (self._bent(random) * _ACROSS) for at in straight for _ in range(2)]
        return straight + small + [self._bent(random) for _ in range(self.work.samples)]

    def _straight(self, fraction: Array | float) -> Array:
        """Return the strains (s, 6) of a straight chain, lengths a fraction of the way from low to high."""
        low, high = self.lengths.low, self.lengths.high
        strains = np.zeros((len(low), 6))
        strains[:, 2] = low + fraction * (high - low)
        return strains

    def _bent(self, random: np.random.Generator) -> Array:
        """Return random strains (s, 6) that change slowly along the chain."""
        count = len(self.lengths.low)
        along = np.linspace(0.0, 1.0, count)[:, None]

        def field(size: int) -> Array:
            """Return (s, size): constant and linear parts and a little noise, within about -1 to 1."""
            ends = random.uniform(-1.0, 1.0, (2, size))
            return np.asarray(
                (1.0 - along) * ends[0] + along * ends[1] + random.normal(0.0, 0.05, (count, size))
            )

        length_level = np.clip(field(1)[:, 0], -1.0, 1.0)
        strains = self._straight(0.5 + 0.5 * length_level)
        strains[:, :2] = self.work.shear_m * field(2)
        bend = 1.3 * np.sqrt(random.uniform(0.0, 1.0)) * field(2)
        bend /= np.maximum(1.0, np.linalg.norm(bend, axis=1, keepdims=True))
        if self.rims.size:
            self._fold(strains, length_level, bend)
        else:
            # rims of neighbouring frames meet at an angle of length over radius
            largest = np.minimum(self.work.bend * strains[:, 2] / self.radii, _BEND_MAX)
            strains[:, 3:5] = largest[:, None] * bend
        strains[:, 5] = self.work.twist * field(1)[:, 0]
        return strains

    def _fold(self, strains: Array, length_level: Array, bend: Array) -> None:
        """Fill lengths and bends (s, 2) of square units: most near their free length, no rims that overlap.

        Args:
            strains: (s, 6), filled.
            length_level: (s,), -1 at the shortest, 1 at the longest.
            bend: (s, 2), at most 1.
        """
        low, free, high = self.lengths.low, self.lengths.still, self.lengths.high
        strains[:, 2] = free + length_level * np.abs(length_level) * np.where(
            length_level < 0.0, free - low, high - free
        )
        folded = np.maximum(free, 0.5 * self.lengths.longest)
        unit = bend / np.maximum(np.linalg.norm(bend, axis=1, keepdims=True), 1e-12)
        across = np.where(self.rims.any(axis=(1, 2)), self._closed(unit), self.radii.max() / _HALF)
        largest = np.minimum(self.work.fold * folded / across, _BEND_MAX)
        strains[:, 3:5] = largest[:, None] * bend
        strains[:, 2] = np.maximum(strains[:, 2], (1.0 + _LEAST_GAP) * self._closed(strains[:, 3:5]))

    def _closed(self, bend: Array) -> Array:
        """Return the closing (s,) [m] of the gap between two square frames by bends (s, 2)."""
        closed = bend[:, :1] * self.rims[:, :, 1] - bend[:, 1:] * self.rims[:, :, 0]
        return np.asarray(np.abs(closed).max(axis=1))
