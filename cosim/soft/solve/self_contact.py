"""Contact of a soft body with itself: unit with unit, finger with finger, the films of a unit, the flange.

For a step, or a round of a static solution, the pairs of points and triangles are found and kept; within it
their distances and normals are exact. Modelled are the outside of the film, between units of one body; its
inside, between faces of one unit, which is the outside of the film turned inside out; and the flange's face
before the films that begin on it. Not modelled is a face folded onto itself.
"""

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import (
    RecordStore,
    address_of,
    handing_on_views,
    inlined,
    kernel,
    record_at,
    small_matrix,
    small_vector,
)
from cosim.base.numba_insides import caller
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import contact_law, rigid_motion, self_contact_candidates, self_contact_pairs
from cosim.soft.contact.contact_law import ContactLaw, fill_point, fill_slopes, fill_weights, plane_of
from cosim.soft.contact.flange_face import FlangeFace, fill_before_face
from cosim.soft.contact.self_contact_candidates import FilmLists, FilmRows, keep_quiet, make_lists
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints
from cosim.soft.contact.self_contact_pairs import FilmMemory, FilmMemoryRows, FilmPairs, PairRows, pair_work
from cosim.soft.contact.self_contact_search import BEHIND_M, find_over
from cosim.soft.solve.state import SoftState

_STEP_REACH_M = 1e-3  # looked ahead besides what the film moves in a step
AHEAD_STEPS: Final = 2.0
"""How many steps' way of the fastest node, against the others, films look ahead."""
_STATIC_REACH_M = 3e-3  # the same in statics, where nothing says how far it will move
_FROM_EACH_SIDE = 0.5  # of the stiffness: the points of both films are counted


@final
@dataclass(frozen=True)
class FilmContactLaw:
    """How films press and rub on each other.

    Args:
        law: of pressing and sticking, as on an obstacle.
        friction: coefficient of sliding.
        throughout: whether every solution begins with what is near; otherwise one of films that have not
            pressed before it is tried without, and taken again if they press at its end.
        inside: whether films of a unit meet from inside, and the first unit the flange's face.

    Raises:
        InputError: the coefficient is negative, or not a number.
    """

    law: ContactLaw
    friction: float = 0.5
    throughout: bool = True
    inside: bool = True

    def __post_init__(self) -> None:
        if not self.friction >= 0.0:
            raise InputError(f"contact: the friction coefficient is {self.friction}; it must not be negative")


class ContactRows(NamedTuple):
    """What presses on what: points from outside, from inside, before the flange's face; triangles as well.

    Args:
        nodes: (p, 3) that each point combines.
        weights: (p, 3).
        stiffness: (p,) [N/m].
        spare: (p,) [m], see `contact_law.spare`.
        key: (p,) of each point, from which those of its pairs count.
        triangles: (t, 3).
        place: (t,), added to the key of the point; of the triangles of a unit it is one.
        first: (2, 2), the first point and triangle from inside, and those of the flange's face.
    """

    nodes: IndexTable
    weights: Matrix
    stiffness: Vector
    spare: Vector
    key: Indices
    triangles: IndexTable
    place: Indices
    first: IndexTable

    @classmethod
    def of(cls, outside: FilmRows, inside: FilmRows, face: FlangeFace, stiffness: Array) -> "ContactRows":
        """Return those of a film, with the stiffness (p,) of all points."""
        rows, b = (outside, inside), len(face.nodes)
        units = [len(each.units_from) - 1 for each in rows]
        counts = np.repeat([*units, 1], [len(outside.nodes), len(inside.nodes), b])
        first = np.cumsum([[len(each.nodes), len(each.triangles)] for each in rows], axis=0)
        return cls(
            np.concatenate([*(each.nodes for each in rows), face.nodes]),
            np.concatenate([*(each.weights for each in rows), face.weights]), stiffness,
            np.concatenate([*(each.spare for each in rows), face.spare]),
            np.cumsum(counts) - counts,
            np.concatenate([*(each.triangles for each in rows), face.corners]),
            np.concatenate([*(each.films[:, 1] for each in rows), np.zeros(b, np.int64)]), first,
        )  # fmt: skip


class FilmContacts(NamedTuple):
    """Films that may touch: what is searched, pairs that were found, what presses; filled from the beginning.

    Args:
        lists: that may be valid, from outside.
        inner: from inside; without entries where no unit has several faces.
        face: of the flange.
        rows: what the hits are of.
        friction: coefficient of sliding.
        hits: (k, 2), points and the triangles that they may press on.
        key: (k,) ascending; names pairs of point and unit, of point and face from inside.
        pairs: (k,).
        memory: (k,), of the last step.
        counts: (4,), see `REMEMBERED`, `NEEDED`, `OVERLOOKED` and `LACKING`.
        force: (n, 3), for `pair_work`.
        calls: (7,) addresses of kernels, see `FIND` and what follows.
        waits: whether steps of films that do not press are first taken without contact.
    """

    lists: FilmLists
    inner: FilmLists
    face: FlangeFace
    rows: ContactRows
    friction: float
    hits: IndexTable
    key: Indices
    pairs: PairRows
    memory: FilmMemoryRows
    counts: Indices
    force: Matrix
    calls: Indices
    waits: bool


REMEMBERED, NEEDED, OVERLOOKED, LACKING = range(4)
"""Places in `FilmContacts.counts`: pairs that are remembered; rows that the last search would have needed;
whether films pressed at the end of the last step, which was taken without contact; which lists have
too little room: 0 from outside, 1 from inside."""
FIND, SETTLE, ADD, PRESS, WORK, _OVER, _MAKE = range(7)
"""Places in `FilmContacts.calls`."""
_find_over, _make_lists = caller(find_over), caller(make_lists)
THROUGH_M: Final = 1.5e-3
"""How far behind a film a point is looked for that a step of slow films has taken there."""


@handing_on_views
def first_pairs(rows: PairRows, count: int) -> PairRows:
    """Return the first of some pairs."""
    return PairRows(
        rows.nodes[:count], rows.weights[:count], rows.stiffness[:count], rows.friction[:count],
        rows.foot[:count], rows.normal[:count], rows.stretch[:count], rows.spare[:count], rows.widths,
        rows.out[:count],
    )  # fmt: skip


@inlined
def _describe(x: Matrix, films: Any, e: int, y: Vector, slope: Matrix) -> None:
    """Fill pair e: as it is before a step, and without friction."""
    rows, pairs, p, t = films.rows, films.pairs, films.hits[e, 0], films.hits[e, 1]
    nodes, normal, foot = pairs.nodes[e], pairs.normal[e], pairs.foot[e]
    for r in range(3):
        nodes[r], nodes[3 + r] = rows.nodes[p, r], rows.triangles[t, r]
        pairs.weights[e, r], pairs.stretch[e, r] = rows.weights[p, r], 0.0
    films.key[e] = rows.key[p] + rows.place[t]
    pairs.stiffness[e], pairs.friction[e], pairs.spare[e] = rows.stiffness[p], 0.0, rows.spare[p]
    fill_point(x, nodes, pairs.weights[e], y)
    fill_slopes(x, nodes[3:], normal, plane_of(x, nodes[3:], normal), slope)
    fill_weights(x, nodes[3:], slope, y, foot)


@inlined
def _find_all(x: Matrix, films: Any, reach: float, behind: float) -> int:
    """Fill the hits; return how many there are, or -1 where lists do not serve."""
    count, first = 0, films.rows.first
    for inside in range(2):
        lists, begin = (films.inner if inside else films.lists), count
        if lists.meet.shape[0] == 0:
            continue
        asked = x, lists, reach, behind, films.hits[begin:]
        found = _find_over(films.calls[_OVER], asked)
        if found < 0:
            films.counts[LACKING] = inside
            return -1
        count += found
        for e in range(begin, min(count, films.hits.shape[0]) if inside else begin):
            films.hits[e, 0] += first[0, 0]
            films.hits[e, 1] += first[0, 1]
    shift = first[1, 0], first[1, 1]
    return count + fill_before_face(x, films.face, reach, behind, shift, films.hits[count:])


@kernel
def find_pairs(at: int, x: Matrix, velocity: Matrix, rest: float, ahead: float) -> int:
    """Fill what films may touch in a step; return how many pairs, -1 where lists or room do not suffice.

    Those that are remembered rub.

    Args:
        at: address of the `FilmContacts`, which are filled.
        x: (n, 3) [m], before the step.
        velocity: (n, 3) [m/s], then.
        rest: how far films at rest look [m].
        ahead: the time [s] for whose way of the fastest node against the others they look further.
    """
    films = record_at(at, FilmContacts)
    memory, pairs = films.memory, films.pairs
    reach = rest + ahead * rigid_motion.furthest_from_mean(velocity)
    count = _find_all(x, films, reach, BEHIND_M)
    films.counts[NEEDED] = count
    if count < 0 or count > films.hits.shape[0]:
        return -1
    y, slope, k = small_vector(3), small_matrix(3, 3), 0
    for e in range(count):
        _describe(x, films, e, y, slope)
        while k < films.counts[REMEMBERED] and memory.key[k] < films.key[e]:
            k += 1
        if k < films.counts[REMEMBERED] and memory.key[k] == films.key[e]:
            pairs.friction[e] = films.friction * memory.normal_force[k]
            for r in range(3):
                pairs.stretch[e, r] = memory.stretch[k, r]
    return count


@inlined
def _press_over(x: Matrix, films: Any, lists: FilmLists, ahead: float, bounds: tuple[float, float]) -> int:
    """Return at how many points films press on one side; -1 where there is too little room for lists.

    The bounds are how far behind a film is looked where no node is fast, and where one is.
    """
    reach, behind = 0.5 * films.pairs.widths[0], bounds[1]
    if self_contact_candidates.stays_quiet(x, lists, reach, bounds[0]):
        return 0
    asked = x, lists, reach, behind, films.hits[:0]
    count = _find_over(films.calls[_OVER], asked)
    if count < 0:
        made = x, lists, max(reach, behind), ahead > 0.0
        if _make_lists(films.calls[_MAKE], made) > lists.long.listed.shape[0]:
            return -1
        count = _find_over(films.calls[_OVER], asked)
    if count == 0:
        keep_quiet(x, lists, reach, behind)
    return count


@kernel
def films_press(at: int, x: Matrix, velocity: Matrix, ahead: float, through: float) -> int:
    """Return at how many points films press on one another; -1 where there is too little room for lists.

    Where at none, for how small a motion it stays so is kept.

    Args:
        at: address of the `FilmContacts`, whose lists are kept up to date.
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        ahead: the time [s] in whose way of the fastest node against the others films may have passed through.
        through: how far slow ones may have [m].
    """
    films = record_at(at, FilmContacts)
    behind = through
    if ahead * rigid_motion.furthest_from_mean(velocity) > through:
        behind = BEHIND_M
    reach, count = 0.5 * films.pairs.widths[0], 0
    for inside in range(2):
        lists = films.inner if inside else films.lists
        if count == 0 and lists.meet.shape[0] > 0:
            films.counts[LACKING] = inside
            count = _press_over(x, films, lists, ahead, (through, behind))
    if count == 0:
        count = fill_before_face(x, films.face, reach, behind, (0, 0), films.hits[:0])
    return count


def _lists(faces: FilmFaces, points: FilmPoints, body: SoftBody) -> FilmLists:
    """Return the lists of a film; without entries where no faces meet."""
    rows = FilmRows.of(faces, points, body.positions)
    meet = faces.units_meet if faces.can_meet else np.zeros((0, 0), dtype=bool)
    return FilmLists.room(rows, meet, body.nodes)


def _inner_lists(faces: FilmFaces, body: SoftBody, smoothing_m: float) -> tuple[FilmLists, Array]:
    """Return the lists of a film from inside, and the area (p,) [m^2] of its points there.

    Films that are drawn nearer than they would press spare as much. Points next to a seam press on nothing.
    """
    inside, x = faces.inside_out, body.positions
    points = FilmPoints.of(inside, x)
    lists, hits = _lists(inside, points, body), np.zeros((2 * len(points), 2), np.int64)
    if not inside.can_meet:
        return lists, points.area
    while (needed := make_lists(x, lists, max(smoothing_m, BEHIND_M), False)) > len(lists.long.listed):
        lists = lists.with_room(needed)
    count = find_over(x, lists, smoothing_m, BEHIND_M, hits)
    if count > len(hits):
        hits = np.zeros((count, 2), np.int64)
        find_over(x, lists, smoothing_m, BEHIND_M, hits)
    hits = hits[:count]
    point, rows = hits[:, 0], lists.rows
    nodes = np.concatenate((rows.nodes[point], rows.triangles[hits[:, 1]]), axis=1)
    distance = contact_law.feet(x, nodes, rows.weights[point])[2]
    np.maximum.at(rows.spare, point, contact_law.spare(distance, smoothing_m))
    # a seam that creases has what hangs on it behind the other film's planes, without coming through
    rows.spare[np.isin(rows.nodes, faces.seam_nodes).any(axis=1)] = np.inf
    return lists, points.area


@final
class SelfContact:
    """Finds the pairs of films that may touch; `work_J` is theirs on the film in the last step.

    Args:
        body: of which films.
        law: between them.
    """

    def __init__(self, body: SoftBody, law: FilmContactLaw) -> None:
        self.law, self.faces = law.law, FilmFaces.of(body)
        called = (
            find_pairs,
            self_contact_pairs.settle_pairs,
            self_contact_pairs.add_pairs,
            films_press,
            pair_work,
            find_over,
            make_lists,
        )
        self._overlooked: SoftState | None = None
        self._last: tuple[SoftState, float, FilmPairs | None] | None = None  # of the last step
        self.work_J = 0.0
        self._store = RecordStore(FilmContacts)
        points = FilmPoints.of(self.faces, body.positions)
        outside = _lists(self.faces, points, body)
        inside = _inner_lists(self.faces, body, self.law.smoothing_m)
        face = FlangeFace.of(body, self.faces, points, self.law)
        if not law.inside:
            none = np.zeros((0, 0), dtype=bool)
            inside = inside[0]._replace(meet=none), inside[1]
            face = FlangeFace._make(column[:0] for column in face)
        film = _FROM_EACH_SIDE * self.law.stiffness_N_m3 * np.concatenate((points.area, inside[1]))
        rows = ContactRows.of(outside.rows, inside[0].rows, face, np.concatenate((film, face.stiffness)))
        self.can_touch = self.faces.can_meet or self.faces.inside_out.can_meet or len(face.nodes) > 0
        """Whether films can touch one another or the flange at all."""
        self.contacts = FilmContacts(
            outside, inside[0], face, rows, law.friction,
            *self._room(len(points)), np.zeros(4, np.int64), np.empty((body.nodes, 3)),
            np.array([address_of(each) for each in called]), not law.throughout,
        )  # fmt: skip

    @property
    def at(self) -> int:
        """Address at which kernels read `contacts`, until these change."""
        return self._store.address(self.contacts)

    @property
    def rest_m(self) -> float:
        """How far films at rest look for one another in a step."""
        return 0.5 * self.law.smoothing_m + _STEP_REACH_M

    def waits(self, state: SoftState) -> bool:
        """Return whether a solution from a state is first tried without contact.

        Args:
            state: from which it begins.
        """
        return self.contacts.waits and state.touching is None and state is not self._overlooked

    def overlook(self, state: SoftState) -> None:
        """Take in whether kernels have found films that press after a step from a state without contact."""
        self._overlooked = state if self.contacts.counts[OVERLOOKED] else None

    def press(self, end: SoftState, step_s: float) -> bool:
        """Return whether films press on one another at the end of a step without contact.

        Args:
            end: of the step.
            step_s: length [s].
        """
        return self._press(end.positions, end.velocities, AHEAD_STEPS * step_s, THROUGH_M)

    def press_at_rest(self, positions: Array) -> bool:
        """Return whether films press on one another at positions (n, 3) [m], or have passed through."""
        return self._press(positions, np.zeros_like(positions), 0.0, BEHIND_M)

    def _press(self, x: Array, velocities: Array, ahead_s: float, through_m: float) -> bool:
        room_m = max(0.5 * self.law.smoothing_m, BEHIND_M)
        while (count := films_press(self.at, x, velocities, ahead_s, through_m)) < 0:
            self._make_lists(x, room_m, ahead_s > 0.0)
        return count > 0

    def _make_lists(self, x: Array, room_m: float, moves: bool) -> None:
        """Make the lists that kernels have found to have too little room, or not to serve."""
        contacts = self.contacts
        if contacts.counts[LACKING]:
            self.contacts = contacts._replace(inner=contacts.inner.made(x, room_m, moves))
        else:
            self.contacts = contacts._replace(lists=contacts.lists.made(x, room_m, moves))

    def step_pairs(self, state: SoftState, step_s: float) -> FilmPairs | None:
        """Return what may touch in a step, None for nothing.

        Args:
            state: before the step.
            step_s: length [s].
        """
        last = self._last
        if last is None or last[0] is not state or last[1] != step_s:  # it may be taken again and again
            self.remember(state.touching)
            found = self._found(state.positions, state.velocities, self.rest_m, AHEAD_STEPS * step_s)
            last = self._last = state, step_s, found
        return last[2]

    def static_pairs(
        self, positions: Array, held: FilmPairs | None = None, slack: float = 0.0
    ) -> FilmPairs | None:
        """Return what may touch near an equilibrium, without friction; None for nothing.

        Args:
            positions: (n, 3) [m].
            held: pairs of the round before: those that still hold keep their triangle.
            slack: how far beyond the triangle's edges a foot still holds, as barycentric weight.
        """
        self.remember(None)
        found = self._found(positions, np.zeros_like(positions), _STATIC_REACH_M, 0.0)
        if held is None:
            return found
        kept = held.holding(positions, slack, _STATIC_REACH_M)
        key, triangle = held.key[kept], held.triangle[kept]
        if found is not None:
            # of two triangles of one unit the first counts: the one that is held
            key, first = np.unique(np.concatenate([key, found.key]), return_index=True)
            triangle = np.concatenate([triangle, found.triangle])[first]
        if not len(key):
            return None
        return self._pairs(key, triangle, positions)

    def same_pairs(self, pairs: FilmPairs, positions: Array) -> FilmPairs:
        """Return the pairs of a body with the same triangles, drawn otherwise, with this body's areas.

        Args:
            pairs: without friction.
            positions: (n, 3) [m].
        """
        return self._pairs(pairs.key, pairs.triangle, positions)

    def _pairs(self, key: IntArray, triangle: IntArray, positions: Array) -> FilmPairs:
        rows = self.contacts.rows
        point = np.searchsorted(rows.key, key, side="right") - 1
        nodes = np.concatenate((rows.nodes[point], rows.triangles[triangle]), axis=1)
        pairs = FilmPairs.slack(
            key, triangle, nodes, rows.weights[point], rows.stiffness[point], self.law, positions
        )
        return replace(pairs, rows=pairs.rows._replace(spare=rows.spare[point]))

    def remember(self, memory: FilmMemory | None) -> None:
        """Let the next step begin with contacts that press."""
        count = 0 if memory is None else memory.count
        self.contacts.counts[REMEMBERED], self.contacts.counts[OVERLOOKED] = count, 0
        if memory is not None:
            self._make_room(count)
            for rows, name in zip(self.contacts.memory, FilmMemoryRows._fields, strict=True):
                rows[:count] = getattr(memory, name)

    def renew(self, x: Array, velocities: Array, step_s: float) -> None:
        """Make lists and room that a step from x and velocities (n, 3) needs; what is remembered stays."""
        memory = self.remembered
        self._found(x, velocities, self.rest_m, AHEAD_STEPS * step_s)
        self.remember(memory)

    @property
    def remembered(self) -> FilmMemory | None:
        """The contacts that press, as kernels have left them; None for none."""
        return self.contacts.memory.first(int(self.contacts.counts[REMEMBERED]))

    def _found(self, x: Array, velocities: Array, rest_m: float, ahead_s: float) -> FilmPairs | None:
        if not self.can_touch:
            return None
        while (count := find_pairs(self.at, x, velocities, rest_m, ahead_s)) < 0:
            needed = int(self.contacts.counts[NEEDED])
            if needed > len(self.contacts.hits):
                self._make_room(2 * needed)
            else:
                drift = np.linalg.norm(velocities - velocities.mean(axis=0), axis=1).max()
                room = max(rest_m + ahead_s * float(drift), BEHIND_M)
                self._make_lists(x, room, True)
        films = self.contacts
        if not count:
            return None
        rows = films.pairs.first(count)
        return FilmPairs(films.key[:count].copy(), films.hits[:count, 1].copy(), rows)

    def _room(self, count: int) -> tuple[IntArray, IntArray, PairRows, FilmMemoryRows]:
        widths = np.array([self.law.smoothing_m, self.law.stick_m])
        places = np.zeros((count, 2), np.int64), np.zeros(count, np.int64)
        return *places, PairRows.room(count, widths), FilmMemoryRows.room(count)

    def _make_room(self, count: int) -> None:
        """See to it that there is room for so many pairs; what is remembered is taken along."""
        if count > len(self.contacts.hits):
            before = self.remembered
            hits, key, pairs, memory = self._room(count)
            self.contacts = self.contacts._replace(hits=hits, key=key, pairs=pairs, memory=memory)
            self.remember(before)
