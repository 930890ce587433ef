"""Limits of an arm's joints, and the values of a motion that come nearest to them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Shown
from cosim.errors import InputError

if TYPE_CHECKING:  # a scene without an arm waits for neither engine
    from cosim.base.solid import LinkContact
    from cosim.kinematics.arm import Arm

TRACKING_BOUND_RAD: Final = 0.1
"""Distance of a joint from its reference above which the arm does not follow its plan."""

UNITS: Final[Mapping[str, str]] = {
    "position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "torque": "N m",
    "tracking_error": "rad",
}  # fmt: skip
"""Units of the quantities that have limits."""

PLANNED: Final = "planned: "
"""Prefix of the warnings of a plan."""

_ROUNDING = 1e-9
_ROUGH: Final = 1e-6
_MISREAD_RAD: Final = 0.05
_MISREAD_M: Final = 0.005


@final
@dataclass(frozen=True)
class ArmLimits(Shown):
    """Limits of an arm's joints; infinite if its file states none.

    Args:
        joint_names: base to flange.
        lower: (joints,) [rad].
        upper: (joints,) [rad].
        velocity: (joints,) [rad/s].
        acceleration: (joints,) [rad/s^2].
        torque: (joints,) [N m].
        prismatic: (joints,), which joints slide: theirs are [m] and [N].
    """

    joint_names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    torque: Array
    prismatic: Mask

    @classmethod
    def of(cls, arm: Arm) -> ArmLimits:
        """Return the limits of an arm."""
        return cls(
            arm.joint_names, arm.lower, arm.upper, _or_infinite(arm.velocity_limit), arm.acceleration_bound,
            _or_infinite(arm.effort_limit), arm.prismatic,
        )  # fmt: skip

    def check_measured(self, joints: Array, place: str) -> None:
        """Check that joint positions are not far beyond the limits, such as angles in degrees.

        Args:
            joints: (joints,) [rad], of sliding ones [m].
            place: where they are from, for messages.

        Raises:
            InputError: one is beyond its bounds by more than 0.05 rad (5 mm).
        """
        beyond = np.maximum(joints - self.upper, self.lower - joints)
        for k in np.flatnonzero(beyond > np.where(self.prismatic, _MISREAD_M, _MISREAD_RAD)):
            unit, other = ("m", "millimetres") if self.prismatic[k] else ("rad", "degrees")
            raise InputError(
                f"{place} of {self.joint_names[k]} is {joints[k]:.4g} {unit}; its bounds are "
                f"{self.lower[k]:.4g} to {self.upper[k]:.4g} {unit}: convert it if it is in {other}"
            )

    def too_fast(self, ways: Array, within_s: float | Array) -> Mask:
        """Return a mask (..., joints) of displacements that take longer than some time at the largest speed.

        Args:
            ways: see above.
            within_s: the time, or (...,).
        """
        bound = np.asarray(within_s)[..., None] * self.velocity
        return np.asarray(np.abs(ways) > (1.0 + _ROUGH) * bound + _ROUNDING)

    def bound(self, quantity: str) -> Array:
        """Return the largest sizes (joints,) of a quantity in `UNITS` other than the position."""
        if quantity == "tracking_error":
            return np.full(len(self.joint_names), TRACKING_BOUND_RAD)
        return np.asarray(getattr(self, quantity))

    def extreme(
        self, quantity: str, values: Array, time_s: Array, phase: IntArray, before: Extreme | None = None
    ) -> Extreme | None:
        """Return the value nearest to its limit, or farthest beyond it; None without any.

        Args:
            quantity: in `UNITS`.
            values: (n, joints).
            time_s: (n,).
            phase: (n,) index.
            before: extreme so far, which stands unless a value comes nearer.
        """
        if not values.size:
            return before
        if quantity == "position":
            low, high = values.min(axis=0), values.max(axis=0)
            to_low, to_high = self.lower - low, high - self.upper
            excess, bound = np.maximum(to_low, to_high), np.where(to_low > to_high, self.lower, self.upper)
        else:
            bound = self.bound(quantity)
            excess = np.maximum(values.max(axis=0), -values.min(axis=0)) / bound - 1.0
        joint = int(excess.argmax())  # what is not a number is larger than all others
        if before is not None and excess[joint] <= before.excess:
            return before
        column = values[:, joint]
        if quantity == "position":
            row = int(column.argmin() if bound[joint] == self.lower[joint] else column.argmax())
        else:
            row = int(np.abs(column).argmax())
        return Extreme(
            quantity, self.joint_names[joint], float(column[row]), float(bound[joint]), float(excess[joint]),
            float(time_s[row]), int(phase[row]), bool(self.prismatic[joint]),
        )  # fmt: skip


@final
@dataclass(frozen=True)
class Extreme:
    """The value of one quantity that is nearest to its limit.

    Args:
        quantity: in `UNITS`.
        joint: its name.
        value: in that unit, signed.
        bound: the one that is nearest.
        excess: above 0 beyond the bound; of positions [rad], else as a fraction of the bound.
        time_s: simulated.
        phase: index.
        prismatic: whether the joint slides: units are [m] and [N] then.
        remedy: what to change in the plan, to be put behind `text`; empty where nothing is known.
    """

    quantity: str
    joint: str
    value: float
    bound: float
    excess: float
    time_s: float
    phase: int
    prismatic: bool = False
    remedy: str = ""

    @property
    def beyond(self) -> bool:
        """Whether it is beyond the limit."""
        return not self.excess <= _ROUNDING

    @property
    def unit(self) -> str:
        """Unit of the value."""
        turning = UNITS[self.quantity]
        return turning.replace("rad", "m").replace("N m", "N") if self.prismatic else turning

    def figures(self, phase_names: tuple[str, ...]) -> dict[str, Any]:
        """Return it for the summary."""
        return {
            "joint": self.joint,
            "value": self.value,
            "unit": self.unit,
            "bound": self.bound if math.isfinite(self.bound) else None,
            "beyond": self.beyond,
            "time_s": self.time_s,
            "phase": phase_names[self.phase],
        }

    def text(self, phase_names: tuple[str, ...]) -> str:
        """Return a phrase with quantity, joint, value, limit and time."""
        name = self.quantity.replace("_", " ")
        return (
            f"{name} of {self.joint} {self.value:.3g} {self.unit} (bound {self.bound:.3g}) at "
            f"{self.time_s:.3f} s in phase '{phase_names[self.phase]}'"
        )


@final
@dataclass(frozen=True)
class Touch:
    """A link of the arm that touched something.

    Args:
        link: its name.
        other: of an object, of the floor, or of a link.
        first_s: simulated time when it was first seen.
        phase: index, then.
        depth_m: how far they overlapped at most; negative where they only came near.
    """

    link: str
    other: str
    first_s: float
    phase: int
    depth_m: float

    def figures(self, phase_names: tuple[str, ...]) -> dict[str, Any]:
        """Return it for the summary."""
        return vars(self) | {"phase": phase_names[self.phase]}

    def text(self, phase_names: tuple[str, ...]) -> str:
        """Return a phrase with link, body, depth and time."""
        since = f"from {self.first_s:.3f} s on, in phase '{phase_names[self.phase]}'"
        if self.depth_m < 0.0:
            return f"{self.link} comes near {self.other} {since}, up to {-1e3 * self.depth_m:.1f} mm"
        return f"{self.link} touches {self.other} {since}, up to {1e3 * self.depth_m:.1f} mm deep"


def with_touches(
    before: tuple[Touch, ...], found: Iterable[LinkContact], time_s: float, phase: int
) -> tuple[Touch, ...]:
    """Return the touches so far, updated with the contacts of another instant."""
    known = {(touch.link, touch.other): touch for touch in before}
    for contact in found:
        key = contact.link, contact.other
        touch = known.get(key) or Touch(*key, time_s, phase, -math.inf)
        known[key] = replace(touch, depth_m=max(touch.depth_m, contact.depth_m))
    return tuple(known.values())


def _or_infinite(limit: Array) -> Array:
    return np.where(limit > 0.0, limit, np.inf)


@final
@dataclass(frozen=True)
class Nearest:
    """The two solids with the smallest distance.

    Args:
        link: one of them, of a link or of the soft robot.
        other: of a link, of the floor or of what stands still.
        distance_m: negative where they overlap.
        time_s: planned.
        phase: index.
    """

    link: str
    other: str
    distance_m: float
    time_s: float
    phase: int

    def figures(self, phase_names: tuple[str, ...]) -> dict[str, Any]:
        """Return it for the summary."""
        return vars(self) | {"phase": phase_names[self.phase]}


def nearer(one: Nearest | None, other: Nearest | None) -> Nearest | None:
    """Return the nearer of two pairs of solids; None if both are None."""
    return min((each for each in (one, other) if each), key=lambda each: each.distance_m, default=None)


@final
@dataclass(frozen=True)
class PathClearances:
    """Clearances of a robot along its planned motion.

    Args:
        touches: whatever comes nearer than it may, in the order of time.
        links: nearest of all links to what is no part of the robot; None: there is nothing.
        soft_robot: nearest of the soft robot, the same.
    """

    touches: tuple[Touch, ...]
    links: Nearest | None
    soft_robot: Nearest | None

    def figures(self, phase_names: tuple[str, ...]) -> dict[str, Any]:
        """Return the nearest for the summary."""
        found = {"links": self.links, "soft_robot": self.soft_robot}
        return {name: nearest and nearest.figures(phase_names) for name, nearest in found.items()}


@final
@dataclass(frozen=True)
class PlannedArm:
    """Planned motion of an arm compared with its limits.

    Args:
        limits: of the arm.
        extremes: of each quantity.
        clearances: of links and soft robot, on the planned way; None where they are not looked at.
        phase_names: in order.
        avoided: what links would be in, had the arm not begun in another configuration; empty: it has not.
    """

    limits: ArmLimits
    extremes: tuple[Extreme, ...]
    clearances: PathClearances | None
    phase_names: tuple[str, ...]
    avoided: str = ""

    def figures(self) -> dict[str, Any]:
        """Return them for the summary."""
        found = {extreme.quantity: extreme.figures(self.phase_names) for extreme in self.extremes}
        return {
            **{name: found.get(name) for name in UNITS if name != "tracking_error"},
            "contacts": [touch.figures(self.phase_names) for touch in self._touches],
            "clearance": None if self.clearances is None else self.clearances.figures(self.phase_names),
        }

    @property
    def _touches(self) -> tuple[Touch, ...]:
        return () if self.clearances is None else self.clearances.touches

    def warnings(self) -> list[str]:
        """Return lines for an avoided start configuration, each exceeded limit, and each contact."""
        other = "the arm begins in another configuration; in the one nearest to its home, "
        texts = [f"{other}{self.avoided}"] if self.avoided else []
        texts += [each.text(self.phase_names) + each.remedy for each in self.extremes if each.beyond]
        texts += [touch.text(self.phase_names) for touch in self._touches]
        return [f"{PLANNED}{text}" for text in texts]
