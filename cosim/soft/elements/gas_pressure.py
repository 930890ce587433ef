"""The gas of all chambers of a body in its potential: at a given pressure -p V, or sealed U(V).

It follows from the body's film, caps and chambers, and is no element beside them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.soft.elements.element import Instant, Sums
from cosim.soft.elements.gas import SealedGas
from cosim.soft.elements.pressure import add_cap, add_pressure, cap_force, cap_stiffness, fill_volumes

_NO_TABLE = np.zeros((0, 0), np.int64)
_NO_SLOTS = np.zeros(0, np.int64)


@final
class _Enclosure:
    """Film triangles and caps of one chamber, with their places in the tangent."""

    def __init__(self, triangles: IntArray, caps: Sequence[IntArray], sums: Sums) -> None:
        self._triangles = np.ascontiguousarray(triangles)
        self._slots = sums.slots(self._triangles)
        self._rings = np.concatenate([_NO_SLOTS, *caps])
        self._ring_starts = np.cumsum([0, *(len(ring) for ring in caps)], dtype=np.int64)
        self._caps = [(ring, np.ascontiguousarray(sums.slots(ring[None, :])[0])) for ring in caps]

    def add(self, x: Array, pressure: float, sums: Sums, hessian: bool) -> float:
        """Add the gradient and Hessian of -p V at a given pressure; return V [m^3]."""
        slots = self._slots if hessian else _NO_TABLE
        gradient, blocks = sums.gradient, sums.blocks
        volume: float = add_pressure(x, self._triangles, pressure, slots, gradient, blocks)
        for ring, cap_slots in self._caps:
            volume += add_cap(x, ring, pressure, cap_slots if hessian else _NO_SLOTS, gradient, blocks)
        return volume

    def volumes(self, shapes: Array) -> Array:
        """Return V (k,) [m^3] of shapes (k, n, 3) [m]."""
        found = np.empty(len(shapes))
        fill_volumes(shapes, self._triangles, self._rings, self._ring_starts, found)
        return found

    def take_caps_away(self, x: Array, pressure: float, gradient: Array) -> None:
        """Subtract the caps' load from the gradient."""
        for ring, _ in self._caps:
            gradient[ring] += cap_force(x, ring, pressure)

    def open_stiffness(self, x: Array, pressure: float) -> list[tuple[IntArray, Array]]:
        """Return what caps that are taken away add to the stiffness, by ring."""
        return [(ring, cap_stiffness(x, ring, pressure)) for ring, _ in self._caps]


@final
class GasElements:
    """Assembles the gas of all chambers.

    After `add`: `volumes` [m^3] and `pressures` [Pa, gauge] of each chamber; with the Hessian,
    `open_cap_stiffness` (what missing caps add to it).

    Args:
        enclosures: film triangles (t, 3) and caps of each chamber.
        closed: whether the caps carry pressure.
        sums: what they add to.
    """

    def __init__(
        self, enclosures: Iterable[tuple[IntArray, Sequence[IntArray]]], closed: bool, sums: Sums
    ) -> None:
        self._sums, self._closed = sums, closed
        self._enclosures = [_Enclosure(triangles, caps, sums) for triangles, caps in enclosures]
        self.count = len(self._enclosures)
        self.volumes: tuple[float, ...] = (0.0,) * self.count
        self.pressures: tuple[float, ...] = (0.0,) * self.count
        self.open_cap_stiffness: list[tuple[IntArray, Array]] = []

    def enclosed_volumes(self, shapes: Array) -> Array:
        """Return the volume (k, chambers) [m^3] of each chamber in shapes (k, n, 3) [m]; change nothing."""
        found = np.empty((len(shapes), self.count))
        for chamber, part in enumerate(self._enclosures):
            found[:, chamber] = part.volumes(shapes)
        return found

    def add(self, positions: Array, at: Instant, hessian: bool) -> float:
        """Add the gradient and, if told to, the Hessian; return the energy [J], infinite without volume."""
        if at.loads is None:
            return 0.0
        gases, pressures = at.loads.gases(self.count), at.loads.pressures(self.count)
        if any(gases):
            pressures = self._with_sealed(positions, gases, pressures)
            if not np.isfinite(pressures).all():
                return np.inf
        self.pressures = pressures
        self.volumes = tuple(
            part.add(positions, pressure, self._sums, hessian)
            for part, pressure in zip(self._enclosures, pressures, strict=True)
        )
        if not self._closed:
            loaded = list(zip(self._enclosures, pressures, strict=True))
            for part, pressure in loaded:
                part.take_caps_away(positions, pressure, self._sums.gradient)
            if hessian:
                pairs = [part.open_stiffness(positions, pressure) for part, pressure in loaded]
                self.open_cap_stiffness = [entry for found in pairs for entry in found]
        energy = 0.0
        for gas, pressure, volume in zip(gases, pressures, self.volumes, strict=True):
            energy += -pressure * volume if gas is None else gas.potential(volume)
        return energy

    def _with_sealed(
        self, x: Array, gases: tuple[SealedGas | None, ...], pressures: tuple[float, ...]
    ) -> tuple[float, ...]:
        """Return the gauge pressures [Pa], sealed gases at this shape; keep their dense stiffness."""
        if not self._closed:
            raise InputError("a sealed gas needs a closed body; this one has open caps")
        found, slopes, stiffness = list(pressures), [], []
        for k, gas in enumerate(gases):
            if gas is None:
                continue
            slope = np.zeros_like(x)
            volume = self._enclosures[k].add(x, -1.0, Sums(slope), hessian=False)
            found[k] = gas.gauge_pressure(volume)
            if not np.isfinite(found[k]):
                return tuple(found)
            slopes.append(slope)
            stiffness.append(gas.stiffness(volume))
        if slopes:
            self._sums.add_dense(np.array(slopes), np.array(stiffness))
        return tuple(found)
