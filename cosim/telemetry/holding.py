"""What became of objects: how far they were moved, when a soft robot held them, and how hard it pressed.

A soft robot holds an object that has touched it, and besides it nothing but what is mounted on flanges, for
0.1 s. It holds until that has not been so for 0.1 s; both times are those at which the 0.1 s began. An object
that touches nothing for 0.05 s right after it was held has been dropped.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array, Mask, rotation_from_quaternion
from cosim.telemetry import run_info, tick_batch

HELD_s: Final = 0.1
"""For which an object is on the soft robot alone before it is held, or off it before it no longer is."""
FALLS_s: Final = 0.05
LIFTS_m: Final = 0.01
"""By how much a phase lifts the flange that is to lift what is held."""
_NEVER: Final = math.inf
_LISTED: Final = 4


@final
@dataclass(frozen=True)
class ObjectCourse:
    """What became of one object so far; times that have not come about are infinite.

    Args:
        since_s: at which the present hold began.
        on_s: since when it is on the soft robot alone.
        off_s: since when it is not.
        loose_s: since when it touches nothing.
        spans_s: begin and end of each hold that has ended.
        dropped_s: when it was dropped, each time.
        pressed_s: when the soft robot first touched it.
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
        """Return the course after a tick in which it was on the soft robot alone, or touched nothing."""
        on_s = min(self.on_s, time_s) if on else _NEVER
        off_s = _NEVER if on else min(self.off_s, time_s)
        loose_s = min(self.loose_s, time_s) if loose else _NEVER
        since_s, spans_s, dropped_s = self.since_s, self.spans_s, self.dropped_s
        if not self.held and time_s - on_s >= HELD_s:
            since_s = on_s
        if self.held and time_s - off_s >= HELD_s:
            since_s, spans_s = _NEVER, (*spans_s, (self.since_s, off_s))
        let_go_s = off_s if self.held else max((end for _, end in spans_s), default=_NEVER)
        falls = time_s - loose_s >= FALLS_s and abs(loose_s - let_go_s) <= HELD_s
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
    """Figures of all objects that can move, so far.

    Args:
        courses: one for each; () before the first tick.
        first: (objects, 7), position [m] and quaternion at the start.
        last: the same now.
        largest: (objects, 2) [N], sum of the soft robot's normal forces on each, and its force on it.
    """

    courses: tuple[ObjectCourse, ...] = ()
    first: Annotated[Array, ("*", 7)] = field(default_factory=lambda: np.zeros((0, 7)))
    last: Annotated[Array, ("*", 7)] = field(default_factory=lambda: np.zeros((0, 7)))
    largest: Annotated[Array, ("*", 2)] = field(default_factory=lambda: np.zeros((0, 2)))

    def after(
        self, batch: "tick_batch.TickBatch", objects: "Sequence[run_info.ObjectInfo]"
    ) -> "ObjectFigures":
        """Return the figures with some ticks more."""
        bodies = [entry.body for entry in objects]
        places = np.concatenate([batch.body_position[:, bodies], batch.body_quaternion[:, bodies]], axis=2)
        touch = batch.body_touch[:, bodies]
        force = np.linalg.norm(batch.body_contact_force[:, bodies], axis=2)
        courses = self.courses or (ObjectCourse(),) * len(bodies)
        largest = np.stack([touch[:, :, 0], force], axis=2).max(axis=0)
        return ObjectFigures(
            tuple(
                _after(course, batch.time_s, touch[:, k]) if entry.free else course
                for k, (course, entry) in enumerate(zip(courses, objects, strict=True))
            ),
            self.first if len(self.first) else places[0].copy(),
            places[-1].copy(),
            np.maximum(largest, self.largest) if len(self.largest) else largest,
        )

    def figures(self, objects: "Sequence[run_info.ObjectInfo]") -> list[dict[str, Any]]:
        """Return them for the summary."""
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
        self, objects: "Sequence[run_info.ObjectInfo]", phase: str, began_s: float, lifted_m: float
    ) -> list[str]:
        """Return a warning where a phase has lifted the flange, and nothing of what was pressed is held.

        Args:
            objects: of the run.
            phase: its name.
            began_s: when it began.
            lifted_m: by how much it has lifted the flange.
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
    """Return a course after ticks in which an object was touched, (n, 3) as of `TickBatch.body_touch`."""
    pressed = touch[:, 0] > 0.0
    on, loose = pressed & (touch[:, 2] == 0.0), np.asarray(~touch.any(axis=1))
    if course.pressed_s == _NEVER and pressed.any():
        course = replace(course, pressed_s=float(time_s[np.argmax(pressed)]))
    for k in _edges(on, loose):
        course = course.after(float(time_s[k]), on=bool(on[k]), loose=bool(loose[k]))
    return course


def _edges(on: Mask, loose: Mask) -> list[int]:
    """Return the rows that begin or end a stretch of ticks alike."""
    changes = np.flatnonzero((on[1:] != on[:-1]) | (loose[1:] != loose[:-1]))
    return sorted({0, len(on) - 1, *changes.tolist(), *(changes + 1).tolist()})


def _tilt(first: Array, last: Array) -> float:
    """Return the angle [rad] between the vertical and a line on a body that was vertical at the start."""
    turn = rotation_from_quaternion(last) @ rotation_from_quaternion(first).T
    return float(np.arctan2(np.hypot(turn[0, 2], turn[1, 2]), turn[2, 2]))


def object_lines(objects: Sequence[dict[str, Any]]) -> list[str]:
    """Return a line for each object of a summary: moved, tilted, held, dropped, and how hard it was pressed.

    Objects that were neither touched nor moved are left out; beyond the first few they are counted.
    """
    lines = [
        _line(row)
        for row in objects
        if row["max_squeeze_N"] or (row["moved_m"] or 0.0) > 1e-3 or (row["tilted_rad"] or 0.0) > 0.01
    ]
    more = len(lines) - _LISTED
    return lines[:_LISTED] + ([f"{more} more: objects in the summary"] if more > 0 else [])


def _line(row: dict[str, Any]) -> str:
    held = f", held {', '.join(map(_span, row['held']))}" if row["held"] else ", never held" * row["free"]
    if row["dropped_s"]:
        held += f", dropped at {', '.join(f'{time_s:.3g}' for time_s in row['dropped_s'])} s"
    values = (row[key] for key in ("moved_m", "tilted_rad", "max_squeeze_N", "max_contact_force_N"))
    moved, tilted, squeeze, force = (math.nan if value is None else value for value in values)
    return (
        f"'{row['name']}' ({row['mass_kg']:.3g} kg): moved by {1e3 * moved:.3g} mm, tilted by "
        f"{math.degrees(tilted):.2g} degrees{held}; squeezed with up to {squeeze:.3g} N, contact force "
        f"up to {force:.3g} N"
    )


def _span(span: dict[str, float | None]) -> str:
    end = span["until_s"]
    return f"from {span['since_s']:.3g} s to {'the end' if end is None else f'{end:.3g} s'}"


@final
@dataclass(frozen=True)
class HeldPart:
    """An object while a soft robot holds it.

    Args:
        name: of it.
        mass_kg: of it.
        since_s: from when.
        until_s: to when; infinite if it is held at the end.
    """

    name: str
    mass_kg: float
    since_s: float
    until_s: float

    def at(self, time_s: Array) -> Mask:
        """Return at which times (n,) [s] it is held."""
        return np.asarray((time_s >= self.since_s) & (time_s < self.until_s))


def held_parts(summary: Mapping[str, Any]) -> list[HeldPart]:
    """Return what a run held, by its summary, one for each time that something was held."""
    return [
        HeldPart(
            row["name"],
            row["mass_kg"],
            span["since_s"],
            _NEVER if span["until_s"] is None else span["until_s"],
        )
        for row in summary.get("objects", ())
        for span in row["held"]
    ]
