"""Motion, holds and forces of objects. A hold begins when an object has touched the soft robot for 0.1 s, and
nothing else but bodies mounted on flanges; it ends when this has not been so for 0.1 s; both times are the
starts of these 0.1 s. An object that touches nothing for 0.05 s right after a hold has been dropped.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array, Mask, rotation_from_quaternion
from cosim.telemetry.run_info import ObjectInfo
from cosim.telemetry.tick_batch import TickBatch

HELD_s: Final = 0.1
"""Time on the soft robot alone before an object is held, or off it before it is no longer held."""
FALLS_s: Final = 0.05
LIFTS_m: Final = 0.01
"""Height by which the flange is lifted in a phase that lifts a held object."""
_NEVER: Final = math.inf


@final
@dataclass(frozen=True)
class ObjectCourse:
    """Holds of an object so far; times of events that have not happened are infinite.

    Args:
        since_s: start of the present hold.
        on_s: time since which it is on the soft robot alone.
        off_s: time since which it is not.
        loose_s: time since which it touches nothing.
        spans_s: start and end of each hold that has ended.
        dropped_s: time of each drop.
        pressed_s: time of the soft robot's first contact.
    """

    since_s: float = _NEVER
    on_s: float = _NEVER
    off_s: float = _NEVER
    loose_s: float = _NEVER
    spans_s: tuple[tuple[float, float], ...] = ()
    dropped_s: tuple[float, ...] = ()
    pressed_s: float = _NEVER

    @property
    def held(self) -> bool:
        """Whether it is held at present."""
        return self.since_s < _NEVER

    def after(self, time_s: float, *, on: bool, loose: bool) -> "ObjectCourse":
        """Return the course after a tick.

        Args:
            time_s: at the end of the tick.
            on: whether it was on the soft robot alone.
            loose: whether it touched nothing.
        """
        on_s = min(self.on_s, time_s) if on else _NEVER
        off_s = _NEVER if on else min(self.off_s, time_s)
        loose_s = min(self.loose_s, time_s) if loose else _NEVER
        since_s, spans_s, dropped_s = self.since_s, self.spans_s, self.dropped_s
        if not self.held and time_s - on_s >= HELD_s:
            since_s = on_s
        if self.held and time_s - off_s >= HELD_s:
            since_s, spans_s = _NEVER, (*spans_s, (self.since_s, off_s))
        released_s = off_s if self.held else max((end for _, end in spans_s), default=_NEVER)
        falls = time_s - loose_s >= FALLS_s and abs(loose_s - released_s) <= HELD_s
        if falls and loose_s not in dropped_s:
            dropped_s = (*dropped_s, loose_s)
        return replace(
            self,
            since_s=since_s,
            on_s=on_s,
            off_s=off_s,
            loose_s=loose_s,
            spans_s=spans_s,
            dropped_s=dropped_s,
        )


@final
@dataclass(frozen=True)
class ObjectFigures:
    """Figures of all movable objects so far.

    Args:
        courses: one for each; () before the first tick.
        first: (objects, 7), position [m] and quaternion at the start.
        last: present position and quaternion.
        largest: (objects, 2) [N], largest sum of the soft robot's normal forces, and largest force.
    """

    courses: tuple[ObjectCourse, ...] = ()
    first: Annotated[Array, ("*", 7)] = field(default_factory=lambda: np.zeros((0, 7)))
    last: Annotated[Array, ("*", 7)] = field(default_factory=lambda: np.zeros((0, 7)))
    largest: Annotated[Array, ("*", 2)] = field(default_factory=lambda: np.zeros((0, 2)))

    def after(self, batch: TickBatch, objects: Sequence[ObjectInfo]) -> "ObjectFigures":
        """Return the figures after further ticks."""
        bodies = [entry.body for entry in objects]
        poses = np.concatenate([batch.body_position[:, bodies], batch.body_quaternion[:, bodies]], axis=2)
        touch = batch.body_touch[:, bodies]
        force = np.linalg.norm(batch.body_contact_force[:, bodies], axis=2)
        courses = self.courses or (ObjectCourse(),) * len(bodies)
        largest = np.stack([touch[:, :, 0], force], axis=2).max(axis=0)
        return ObjectFigures(
            tuple(
                _after(course, batch.time_s, touch[:, k]) if entry.free else course
                for k, (course, entry) in enumerate(zip(courses, objects, strict=True))
            ),
            self.first if len(self.first) else poses[0].copy(),
            poses[-1].copy(),
            np.maximum(largest, self.largest) if len(self.largest) else largest,
        )

    def figures(self, objects: Sequence[ObjectInfo]) -> list[dict[str, Any]]:
        """Return the figures for the summary."""
        return [
            {
                "name": entry.name,
                "mass_kg": entry.figures[0],
                "free": entry.free,
                "moved_m": float(np.linalg.norm(self.last[k, :3] - self.first[k, :3])),
                "tilted_rad": _tilt(self.first[k, 3:], self.last[k, 3:]),
                "held": [
                    {"since_s": since, "until_s": until}
                    for since, until in (*course.spans_s, *([(course.since_s, None)] if course.held else []))
                ],
                "dropped_s": list(course.dropped_s),
                "max_squeeze_N": float(self.largest[k, 0]),
                "max_contact_force_N": float(self.largest[k, 1]),
            }
            for k, (entry, course) in enumerate(zip(objects, self.courses, strict=False))
        ]

    def not_lifted(
        self, objects: Sequence[ObjectInfo], phase: str, began_s: float, lifted_m: float
    ) -> list[str]:
        """Return a warning if a phase lifts the flange, and none of the pressed objects is held at its end.

        Args:
            objects: of the run.
            phase: its name.
            began_s: its start.
            lifted_m: height by which the flange is lifted.
        """
        if lifted_m <= LIFTS_m or any(course.held for course in self.courses):
            return []
        missed = []
        for entry, course, forces in zip(objects, self.courses, self.largest.tolist(), strict=True):
            ends_s = [end for _, end in course.spans_s]
            lost = bool(ends_s) and ends_s[-1] > began_s
            if lost or (not ends_s and course.pressed_s <= began_s):
                what = f"held it until {ends_s[-1]:.3g} s" if lost else "never held it"
                missed.append(f"'{entry.name}' (pressed with up to {forces[0]:.2g} N and {what})")
        if not missed:
            return []
        return [
            f"phase '{phase}' lifts the flange by {1e3 * lifted_m:.0f} mm, and no object is held at its end: "
            f"{', '.join(missed)}; close it further, place it lower, or raise friction or pressure"
        ]


def _after(course: ObjectCourse, time_s: Array, touch: Array) -> ObjectCourse:
    """Return the course after ticks with contacts (n, 3) of an object, see `TickBatch.body_touch`."""
    pressed = touch[:, 0] > 0.0
    on, loose = pressed & (touch[:, 2] == 0.0), np.asarray(~touch.any(axis=1))
    if course.pressed_s == _NEVER and pressed.any():
        course = replace(course, pressed_s=float(time_s[np.argmax(pressed)]))
    for k in _edges(on, loose):
        course = course.after(float(time_s[k]), on=bool(on[k]), loose=bool(loose[k]))
    return course


def _edges(on: Mask, loose: Mask) -> list[int]:
    """Return the first and last rows of all spans of equal ticks."""
    changes = np.flatnonzero((on[1:] != on[:-1]) | (loose[1:] != loose[:-1]))
    return sorted({0, len(on) - 1, *changes.tolist(), *(changes + 1).tolist()})


def _tilt(first: Array, last: Array) -> float:
    """Return the angle [rad] between the vertical and a line of the body that was vertical at the start."""
    turn = rotation_from_quaternion(last) @ rotation_from_quaternion(first).T
    return float(np.arctan2(np.hypot(turn[0, 2], turn[1, 2]), turn[2, 2]))
