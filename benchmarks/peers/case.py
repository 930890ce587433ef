"""The cases that simulators run: an inflated arm on a fixed base swings, in the air or against a bar.

The ten-unit hexagonal arm, film only (no hinges, no cables), its mass at the nodes, hangs at rest. `SWING`:
from 10 kPa on the pressure rises to 30 kPa within 0.5 s; within the next 0.5 s gravity turns by 45 degrees;
then the arm swings for 1 s. `ON_BAR`: at 30 kPa gravity turns by 45 degrees within 0.5 s, and the arm lays
itself against a bar beside its middle. All simulators get the same nodes, triangles, masses and start, and
damping proportional to mass.

This module needs numpy and numba only, so that a simulator in an environment of its own can import it.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np

SAMPLE_S = 0.02  # where trajectories are compared
GRAVITY_M_S2 = 9.81
PAIRS_HEAD = (
    "| peer | its error, mm | times real time | cosim at no larger error | its error, mm | times real time "
    "| cosim is faster by |"
)


def _smooth(share: float) -> float:
    """Return the minimum-jerk quintic of a share of a ramp."""
    s = min(max(share, 0.0), 1.0)
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


@dataclass(frozen=True)
class Bar:
    """A fixed round bar along y.

    Args:
        x_m: of its axis.
        z_m: of its axis.
        radius_m: of the surface that the film touches.
        friction: coefficient.
    """

    x_m: float
    z_m: float
    radius_m: float
    friction: float

    HALF_LENGTH_M = 0.15

    def mjcf(self, less_m: float = 0.0) -> str:
        """Return it as a geom of MuJoCo, its radius smaller by what the film is thick there."""
        ends = f"{self.x_m} {-self.HALF_LENGTH_M} {self.z_m} {self.x_m} {self.HALF_LENGTH_M} {self.z_m}"
        size = self.radius_m - less_m
        return f'<geom name="bar" type="capsule" size="{size}" fromto="{ends}" friction="{self.friction}"/>'


@dataclass(frozen=True)
class Course:
    """What is done to the arm.

    Args:
        duration_s: of the run.
        low_Pa: gauge pressure at the start.
        high_Pa: gauge pressure at the end of its rise.
        rise_s: how long it rises.
        turn_from_s: when gravity begins to turn, from -z towards +x by 45 degrees.
        turn_s: how long it turns.
        damping_per_s: proportional to mass.
        bar: in its way; None for none.
    """

    duration_s: float
    low_Pa: float
    high_Pa: float
    rise_s: float
    turn_from_s: float
    turn_s: float
    damping_per_s: float
    bar: Bar | None = None

    TURN_RAD = math.radians(45.0)

    def pressure_at(self, time_s: float) -> float:
        """Return the gauge pressure [Pa]."""
        return self.low_Pa + (self.high_Pa - self.low_Pa) * _smooth(time_s / self.rise_s)

    def gravity_at(self, time_s: float) -> tuple[float, float, float]:
        """Return gravity (3,) [m/s^2]."""
        angle = self.TURN_RAD * _smooth((time_s - self.turn_from_s) / self.turn_s)
        return GRAVITY_M_S2 * math.sin(angle), 0.0, -GRAVITY_M_S2 * math.cos(angle)


SWING = Course(2.0, 10e3, 30e3, 0.5, 0.5, 0.5, damping_per_s=2.0)
ON_BAR = Course(1.0, 30e3, 30e3, 0.5, 0.0, 0.5, damping_per_s=5.0, bar=Bar(0.06, -0.09, 0.02, 0.8))


@dataclass(frozen=True)
class Case:
    """Mesh, film and start.

    Args:
        drawn: (n, 3) [m], stress-free shape.
        start: (n, 3) [m], equilibrium at the course's low pressure under gravity.
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
    """The force of a gas on film and caps, compiled, as a user of another simulator would add it.

    Each film triangle gives a third of p A n to each corner; a cap is the fan from the mean of its ring.
    """

    def __init__(self, case: Case) -> None:
        self._triangles = np.ascontiguousarray(case.triangles, np.int64)
        self._rings = np.concatenate([np.zeros(0, np.int64), *case.caps])
        self._ends = np.cumsum([0, *map(len, case.caps)])
        self._force = np.zeros(case.drawn.shape)

    def __call__(self, x: np.ndarray, pressure: float) -> np.ndarray:
        """Return the force (n, 3) [N] at positions (n, 3) [m]; the next call writes over it."""
        add_pressure(x, pressure, self._triangles, self._rings, self._ends, self._force)
        return self._force


@numba.njit
def add_pressure(
    x: np.ndarray,
    pressure: float,
    triangles: np.ndarray,
    rings: np.ndarray,
    ends: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill out (n, 3) with the force of a gas; rings follow one another, `ends` (caps + 1,) says where."""
    out[:] = 0.0
    for t in range(triangles.shape[0]):
        i, j, k = triangles[t]
        _add_share(x[i], x[j], x[k], pressure, out[i], out[j], out[k])
    middle, pull = np.empty(3), np.empty(3)
    for cap in range(ends.shape[0] - 1):
        first, end = ends[cap], ends[cap + 1]
        middle[:], pull[:] = 0.0, 0.0
        for at in range(first, end):
            for r in range(3):
                middle[r] += x[rings[at], r] / (end - first)
        for at in range(first, end):
            i, j = rings[at], rings[at + 1 if at + 1 < end else first]
            _add_share(middle, x[i], x[j], pressure, pull, out[i], out[j])
        for at in range(first, end):
            for r in range(3):
                out[rings[at], r] += pull[r] / (end - first)


@numba.njit
def _add_share(a, b, c, pressure, at_a, at_b, at_c):  # type: ignore[no-untyped-def]
    """Add what each corner of a triangle bears."""
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        share = pressure / 6.0 * ((b[s] - a[s]) * (c[t] - a[t]) - (b[t] - a[t]) * (c[s] - a[s]))
        at_a[r] += share
        at_b[r] += share
        at_c[r] += share


@dataclass(frozen=True)
class Run:
    """What a simulator made of the case.

    Args:
        tip: (samples, 3) [m] at multiples of `SAMPLE_S`, from the start on; NaN after it blew up.
        cpu_s: CPU time of the loop [s]; other work on the machine does not count.
    """

    tip: np.ndarray
    cpu_s: float


def run(
    course: Course, case: Case, tick_s: float, step: Callable[[float], None], place: Callable[[], np.ndarray]
) -> Run:
    """Step a simulator through a course; a run whose tip is more than 2 m away has blown up.

    Args:
        course: what is done to the arm.
        case: mesh and start.
        tick_s: of a call of `step`, of which a whole number fits into `SAMPLE_S`.
        step: advances to the given time [s].
        place: returns the present nodes (n, 3) [m].
    """
    ticks, every = round(course.duration_s / tick_s), round(SAMPLE_S / tick_s)
    tips = np.full((round(course.duration_s / SAMPLE_S) + 1, 3), np.nan)
    tips[0] = place()[case.tip].mean(axis=0)
    began = time.process_time()
    for k in range(1, ticks + 1):
        with np.errstate(all="ignore"):  # what blows up is found below
            step(k * tick_s)
        if k % every == 0:
            tips[k // every] = place()[case.tip].mean(axis=0)
            if not np.abs(tips[k // every]).max() < 2.0:
                tips[k // every] = np.nan
                break
    return Run(tips, time.process_time() - began)


def longest_tick(error_of: Callable[[float], float], allowed_m: float) -> float | None:
    """Return the longest tick [s] from 10 ms down to 0.25 ms whose error is allowed; None if none is.

    Errors need not grow with the tick: below some length they are those of the tolerance, so all are tried.

    Args:
        error_of: of a tick [s], of which a whole number fits into `SAMPLE_S`.
        allowed_m: bound on it.
    """
    ticks_s = (SAMPLE_S / ticks for ticks in range(round(SAMPLE_S / 1e-2), round(SAMPLE_S / 2.5e-4) + 1))
    return next((tick_s for tick_s in ticks_s if error_of(tick_s) <= allowed_m), None)


def alternately(first: Callable[[], Run], second: Callable[[], Run], repeats: int) -> tuple[float, float]:
    """Return the median CPU times [s] of two runs made in turn: how fast the machine is changes for both."""
    pairs = [(first().cpu_s, second().cpu_s) for _ in range(repeats)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)
