"""The case that every simulator runs: an inflated arm on a fixed base, its pressure raised, gravity turned.

The ten-unit hexagonal arm, film only (no hinges, no cables), its mass at the nodes, hangs at rest at 10 kPa.
Within 0.5 s the pressure rises to 30 kPa; within the next 0.5 s gravity turns by 45 degrees; then the arm
swings for 1 s with mass-proportional damping. All simulators get the same nodes, triangles, masses and start.

This module needs numpy only, so that a simulator in an environment of its own can import it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

DURATION_S = 2.0
SAMPLE_S = 0.02  # where trajectories are compared
LOW_Pa, HIGH_Pa = 10e3, 30e3
GRAVITY_M_S2 = 9.81
TURN_RAD = math.radians(45.0)
DAMPING_PER_S = 2.0


def _smooth(share: float) -> float:
    """Return the minimum-jerk quintic of a share of a ramp."""
    s = min(max(share, 0.0), 1.0)
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def pressure_at(time_s: float) -> float:
    """Return the gauge pressure [Pa]."""
    return LOW_Pa + (HIGH_Pa - LOW_Pa) * _smooth(time_s / 0.5)


def gravity_at(time_s: float) -> tuple[float, float, float]:
    """Return gravity (3,) [m/s^2]; it turns from -z towards +x."""
    angle = TURN_RAD * _smooth((time_s - 0.5) / 0.5)
    return GRAVITY_M_S2 * math.sin(angle), 0.0, -GRAVITY_M_S2 * math.cos(angle)


@dataclass(frozen=True)
class Case:
    """Mesh, film and start.

    Args:
        drawn: (n, 3) [m], stress-free shape.
        start: (n, 3) [m], equilibrium at `LOW_Pa` under gravity.
        triangles: (m, 3), outward.
        caps: rings of nodes that close the chamber.
        base: fixed nodes.
        tip: nodes whose mean is the tip.
        mass: (n,) [kg].
        young_Pa: E.
        poisson: nu.
        thickness_m: t.
    """

    drawn: np.ndarray
    start: np.ndarray
    triangles: np.ndarray
    caps: tuple[np.ndarray, ...]
    base: np.ndarray
    tip: np.ndarray
    mass: np.ndarray
    young_Pa: float
    poisson: float
    thickness_m: float

    def save(self, path: Path) -> None:
        """Write the case to an .npz file."""
        values: dict[str, Any] = {name: value for name, value in vars(self).items() if name != "caps"}
        values |= {f"cap_{k}": cap for k, cap in enumerate(self.caps)}
        np.savez(path, cap_count=len(self.caps), **values)

    @classmethod
    def load(cls, path: Path) -> Case:
        """Read what `save` wrote."""
        with np.load(path) as data:
            caps = tuple(data[f"cap_{k}"] for k in range(int(data["cap_count"])))
            names = ("drawn", "start", "triangles", "base", "tip", "mass")
            values: dict[str, Any] = {name: data[name] for name in names}
            values |= {name: float(data[name]) for name in ("young_Pa", "poisson", "thickness_m")}
            return cls(caps=caps, **values)


class FollowerPressure:
    """The force of a gas on film and caps, written by hand as a user of another simulator would.

    Each film triangle gives a third of p A n to each corner; a cap is the fan from the mean of its ring.
    """

    def __init__(self, case: Case) -> None:
        self._triangles, self._caps = case.triangles, case.caps
        corners = case.triangles.T.ravel()
        order = np.argsort(corners, kind="stable")
        self._order = np.concatenate([order % len(case.triangles)])
        nodes, self._first = np.unique(corners[order], return_index=True)
        self._nodes, self._count = nodes, len(case.drawn)

    def __call__(self, x: np.ndarray, pressure: float) -> np.ndarray:
        """Return the force (n, 3) [N] at positions (n, 3) [m]."""
        a, b, c = (x[self._triangles[:, k]] for k in range(3))
        share = pressure / 6.0 * np.cross(b - a, c - a)
        force = np.zeros((self._count, 3))
        force[self._nodes] = np.add.reduceat(share[self._order], self._first, axis=0)
        for ring in self._caps:
            r = x[ring]
            after, mean = np.roll(r, -1, axis=0), r.mean(axis=0)
            part = pressure / 6.0 * np.cross(r - mean, after - mean)
            force[ring] += part + np.roll(part, 1, axis=0) + part.sum(axis=0) / len(ring)
        return force


@dataclass(frozen=True)
class Run:
    """What a simulator made of the case.

    Args:
        tip: (samples, 3) [m] at multiples of `SAMPLE_S`, from the start on; NaN after it blew up.
        cpu_s: CPU time of the loop [s]; other work on the machine does not count.
    """

    tip: np.ndarray
    cpu_s: float


def run(case: Case, tick_s: float, step: Callable[[float], None], tip: Callable[[], np.ndarray]) -> Run:
    """Step a simulator through the case; a run whose tip is more than 2 m away has blown up.

    Args:
        case: mesh and start.
        tick_s: length of a step; a whole number of them fits into `SAMPLE_S`.
        step: advances to the given time [s].
        tip: returns the present tip (3,) [m].
    """
    ticks, every = round(DURATION_S / tick_s), round(SAMPLE_S / tick_s)
    tips = np.full((round(DURATION_S / SAMPLE_S) + 1, 3), np.nan)
    tips[0] = tip()
    began = time.process_time()
    for k in range(1, ticks + 1):
        with np.errstate(all="ignore"):  # what blows up is found below
            step(k * tick_s)
        if k % every == 0:
            tips[k // every] = tip()
            if not np.abs(tips[k // every]).max() < 2.0:
                tips[k // every] = np.nan
                break
    return Run(tips, time.process_time() - began)
